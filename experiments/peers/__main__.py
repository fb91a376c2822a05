"""Makes the environments of the peers: `python -m experiments.peers`."""

import sys

from experiments.peers import PEERS, PeerUnavailableError, environment, llvm_library


def main() -> int:
    missing = 0
    for name, make in {**{name: lambda name=name: environment(name) for name in PEERS}, "LLVM": llvm_library}.items():
        try:
            print(f"{name}: {make()}", flush=True)
        except PeerUnavailableError as error:
            print(f"{name}: {error}", file=sys.stderr)
            missing += 1
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
