"""Other programs that compute what this library computes, as oracles and for timing, each in an environment of its own.

- `environment(name)`: the Python of a peer's environment, made on demand from pinned requirements.
- `run(name, script, inputs)`: runs a script of this folder in it, arrays in, arrays out.
- `run_each(name, script, several)`: the same for several inputs, in one process.
- `PeerUnavailableError`: the environment cannot be made here, or a library that the peer needs is missing.

`python -m experiments.peers` makes them all and says what is missing. Modules without an underscore, but for
`interpolation`, run inside a peer's environment and import nothing of this project but each other.
"""

from experiments.peers._environments import PEERS, environment
from experiments.peers._errors import PeerError, PeerUnavailableError
from experiments.peers._llvm import llvm_library
from experiments.peers._process import run, run_each

__all__ = ["PEERS", "PeerError", "PeerUnavailableError", "environment", "llvm_library", "run", "run_each"]
