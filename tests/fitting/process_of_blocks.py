"""One process of a run over blocks: `test_processes` starts several of them."""

import argparse
import os
import signal
import sys

import jax
import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("process", "of", "port", "devices"):
        parser.add_argument(f"--{name}", type=int, required=True)
    parser.add_argument("--folder", required=True)
    parser.add_argument("--kill-after", type=int, help="blocks after which this process is gone, without a word")
    parser.add_argument("--timeout", type=float, default=60.0)
    parser.add_argument("--order", type=int, default=2)
    parser.add_argument("--beside", action="store_true", help="the coordination service is none of the processes'")
    parser.add_argument("--what", choices=("blocks", "whole", "pixels"), default="blocks")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", arguments.devices)
    own = {"coordinator_bind_address": "127.0.0.1:0"} if arguments.beside else {}
    jax.distributed.initialize(f"127.0.0.1:{arguments.port}", arguments.of, arguments.process, **own)

    from hshjax import HSH, IsotropicBasis, SampleBlocks, device_mesh, project, project_blocks, project_pixels

    folder, done = arguments.folder, []

    def on_block(number: int, of: int) -> None:
        print(f"block {number} of {of}", flush=True)
        done.append(number)
        if len(done) == arguments.kill_after:
            os.kill(os.getpid(), signal.SIGKILL)

    names = ("wi", "wo", "value", "weight")
    mapped = {name: np.load(f"{folder}/{name}.npy", mmap_mode="r") for name in names}
    blocks = SampleBlocks(**mapped, rows=100, isotropic=True)
    basis = IsotropicBasis(HSH(arguments.order))

    def fitted():
        settings = {"mesh": device_mesh(), "every": 0, "timeout": arguments.timeout}
        if arguments.what == "whole":
            return project(basis, next(iter(SampleBlocks(**mapped, isotropic=True))), mesh=device_mesh())
        if arguments.what == "blocks":
            return project_blocks(basis, blocks, checkpoint=f"{folder}/checkpoint", on_block=on_block, **settings)
        lights, values = (np.load(f"{folder}/{name}.npy") for name in ("lights", "photographs"))
        out = f"{folder}/coefficients.npy"
        return project_pixels(HSH(2), lights, values, rows=10, out=out, on_tile=on_block, **settings)

    try:
        fit = fitted()
    except Exception as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        if arguments.beside:
            sys.exit(3)
        os._exit(3)  # not by way of jax, which would wait for the process that is gone
    coefficients = fit.coefficients if arguments.what == "pixels" else fit.model.coefficients
    np.savez(f"{folder}/fit-{arguments.process}.npz", coefficients=coefficients, residual=fit.residual)


if __name__ == "__main__":
    main()
