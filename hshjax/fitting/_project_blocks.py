"""The closed form over samples that no memory holds: one pass over blocks, from wherever they come.

The factor R of the weighted design matrix is all that least squares needs to know of the samples, and R of two blocks
is that of their two R, one above the other. A block is read, folded into the factor, and forgotten.
"""

from collections.abc import Callable, Iterable, Sized
from contextlib import ExitStack
from os import PathLike

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.bases._base import matmul
from hshjax.brdfs._linear import LinearBRDF
from hshjax.fitting._block_sums import ENTRIES, BlockSums
from hshjax.fitting._checkpoint import Checkpoint, fingerprint, packed, unpacked
from hshjax.fitting._checks import check_determined, check_enough
from hshjax.fitting._finished import Finished, Verify, check_verify
from hshjax.fitting._lapack import suited_threads
from hshjax.fitting._mesh import own_mesh
from hshjax.fitting._misfit import ratio
from hshjax.fitting._norms import Norm, named_norm
from hshjax.fitting._prior import Prior, penalty
from hshjax.fitting._processes import Processes, check_same_call
from hshjax.fitting._project import posterior_of, solve_factor
from hshjax.fitting._result import Fit
from hshjax.fitting._sample_blocks import check_source
from hshjax.samples import Samples


def project_blocks(
    basis: AbstractPairBasis,
    blocks: Iterable[Samples],
    *,
    norm: str = "D",
    ridge: float = 0.0,
    prior: Prior | None = None,
    covariance: bool = False,
    mesh: Mesh | None = None,
    checkpoint: str | PathLike | None = None,
    every: float = 30.0,
    verify: Verify = "last",
    timeout: float = 60.0,
    on_block: Callable[[int, int | None], None] | None = None,
) -> Fit[LinearBRDF]:
    """`project`, in one pass over blocks of samples, of which one at a time is held.

    - `blocks`: anything that yields `Samples` of the same channels, dtype and `isotropic`, of any sizes: a list, a
      generator, `SampleBlocks` over files. Where it has a length, so many blocks must come.
    - `basis`, `norm`, `ridge`, `prior`, `covariance`: see `project`. Least squares by QR throughout: a rule that comes
      in blocks is not recognised as exact. Reciprocity of the data is not measured.
    - `mesh`: devices that share the samples of every step (`device_mesh`). Where they are of n processes, all of these
      make the same call: the p-th takes blocks p, p + n, p + 2n ..., what they found is put together at the end, and
      all return the same fit. Blocks of a sequence (`SampleBlocks`, a list) are read by the process that takes them
      only; anything else is gone through by every process.
    - `checkpoint`: a folder for what has been done, one file a process, written beside and renamed every so many
      seconds (`every`; 0 for after each block) and at the end of the pass. The same call, with as many processes,
      goes on after the blocks that are in it, on any number of devices, and also after an error; `ridge`, `prior` and
      `covariance` may be others. One run at a time has the folder. The files are removed when the fit is returned.
    - `verify`: which of the blocks that are in are read once more by a call that goes on, to see that they are the same
      (CRC-32): "last", of each process, and a change in others is not seen; or "all".
    - `timeout`: seconds without a sign of life after which another process counts as lost, from this call on. jax ends
      all processes by itself when `heartbeat_timeout_seconds` of `jax.distributed.initialize` have passed, or as soon
      as process 0 is lost: keep this less.
    - `on_block(number, of)`: called when a block of this process is in, `of` their length or None.

    **Returns:** the `Fit` that `project` gives of all samples together, to rounding.

    **Raises:** BlockError, naming the block, for one that is no `Samples`, differs from the first in channels, dtype or
    `isotropic`, or holds what `project` refuses, where fewer or more blocks come than the length says, and where one
    that is in the checkpoint and read once more is another one now. What reading raises is passed on, with a note that
    names the block. ValueError as of `project` where all blocks together do not determine the fit; for a checkpoint of
    another basis, norm, length or number of processes, and for one that another run is using. ProcessError in every
    process that is left, where one is lost or has ended with an error.
    """
    check_source(blocks)
    check_verify(verify)
    chosen = named_norm(norm)
    gamma = penalty(basis, ridge, prior)
    length = len(blocks) if isinstance(blocks, Sized) else None
    sums = BlockSums(basis, chosen, None if mesh is None else own_mesh(mesh), keep=checkpoint is not None)
    with (
        Processes(mesh, "project_blocks", timeout, _advice(checkpoint)) as processes,
        suited_threads(basis.count),
        ExitStack() as held,
    ):
        index, count = processes.index, processes.count
        run = {"length": length, **fingerprint(basis=basis, norm=norm)}
        saved = None if checkpoint is None else Checkpoint(checkpoint, run, index, count, every)
        if saved is not None:
            held.enter_context(saved.held())
        before = None if saved is None else saved.load(*ENTRIES)
        if before is not None:
            sums.include(before)
        finished = Finished(verify, sums.marks, sums.begin)

        def wanted(number: int) -> bool:
            return finished.wanted(number) and number % count == index

        def said(number: int) -> None:
            processes.check()
            if on_block is not None:
                on_block(number, length)

        def due() -> bool:
            return saved is not None and saved.due

        everything = finished.begin == 0 and count == 1
        for _ in sums.fold(blocks, None if everything else wanted, said, due, finished):
            if saved is not None:
                saved.save(sums.state())
        if count > 1:
            own = packed({**sums.state(), "run": np.asarray(repr(run))})
            state = unpacked(processes.put_together(own, lambda found: _together(basis, chosen, found)))
            sums = BlockSums(basis, chosen)
            sums.include(state)
        fit = _solved(sums, gamma, covariance=covariance)
        processes.finish()
        if saved is not None:
            saved.remove()
    return fit


def _advice(checkpoint: str | PathLike | None) -> str:
    if checkpoint is None:
        return "nothing was written, for no checkpoint was asked for: the same command begins anew"
    return f"the blocks that are in are kept in {checkpoint}: the same command goes on after them"


def _together(basis: AbstractPairBasis, norm: Norm, found: list[bytes]) -> bytes:
    """The state of all processes from that of each."""
    sums, states = BlockSums(basis, norm), [unpacked(one) for one in found]
    check_same_call([str(state["run"]) for state in states])
    for k, state in enumerate(states):
        sums.include(state, f"process {k} of the mesh")
    return packed(sums.state())


def _solved(sums: BlockSums, gamma: Array | None, *, covariance: bool) -> Fit[LinearBRDF]:
    """The fit of the blocks that are in."""
    if sums.counts.size == 0:
        raise ValueError("no sample to fit: no block came, or empty ones only; a generator yields its blocks once")
    basis, norm, ridged = sums.basis, sums.norm, gamma is not None
    check_enough(sums.counts, norm, basis.count, ridged=ridged)
    assert sums.factor is not None  # or there was no sample
    coefficients, condition, root = jax.block_until_ready(solve_factor(sums.factor, gamma, basis.count))
    check_determined(condition, basis.count, ridged=ridged)
    residual, size = _misfit(sums.factor if sums.judged is None else sums.judged, coefficients)
    spread = noise = None
    if covariance:
        spread, noise = posterior_of(sums.factor, root, coefficients, jnp.asarray(sums.seen))
    return Fit(
        LinearBRDF(basis, coefficients, norm.target),
        residual,
        ratio(residual, size),
        condition,
        norm=norm.name,
        method="QR",
        samples=sums.counts.used,
        unknowns=basis.count,
        covariance=spread,
        noise=noise,
    )


@jax.jit
def _misfit(factor: Array, coefficients: Float[Array, "modes channels"]) -> tuple[Array, Array]:
    """Root of Σ w |f - Σ c B|² and of Σ w |f|² by channel, of the samples behind a factor."""
    channels = coefficients.shape[1]
    size = jnp.linalg.norm(factor[:, -channels:], axis=0)
    difference = matmul(factor, jnp.concatenate([coefficients, -jnp.eye(channels, dtype=factor.dtype)]))
    return jnp.linalg.norm(difference, axis=0), size
