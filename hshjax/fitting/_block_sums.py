"""Blocks of samples folded into the factors of a least-squares problem, and the state of that on the way."""

import json
from collections.abc import Callable, Iterable, Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.brdfs._linear import cosine_power
from hshjax.fitting._checks import Counts, check_isotropy, check_numbers, check_values
from hshjax.fitting._finished import Finished, mark_of
from hshjax.fitting._mesh import gathered, spread
from hshjax.fitting._norms import Norm
from hshjax.fitting._project import factorize
from hshjax.fitting._sample_blocks import BlockError, Kind, filled, kind_of, read_blocks, regrouped
from hshjax.samples import Samples

STEP = 2**16
"""Samples that one call of the compiled program folds, on every device."""

ANEW = "take another folder for the checkpoint, or empty it to begin anew"

ENTRIES = "numbers", "total", "kind", "marks"
"""Of every state."""


class BlockSums:
    """What is known of the blocks so far.

    `factor`: R of [sqrt(w) B, sqrt(w) f] under the weight of the fit; `judged`: under that of the judge, None where it
    is the same. `counts` of samples; `seen`: those that have a weight in the fit. `kind` of the blocks, `begin`: the
    number of the first block that is not among them. `marks` of all of them, if `keep`, for whoever goes on to compare.
    `mesh`: a flat one of this process, which shares every step.
    """

    def __init__(self, basis: AbstractPairBasis, norm: Norm, mesh: Mesh | None = None, *, keep: bool = False):
        self.basis, self.norm, self.mesh, self.keep = basis, norm, mesh, keep
        self.counts, self.seen = Counts(0, 0, 0, 0.0), 0
        self.factor: Array | None = None
        self.judged: Array | None = None
        self.kind: Kind | None = None
        self.begin = 0
        self.marks: list[int] = []

    def fold(
        self,
        blocks: Iterable[Samples],
        wanted: Callable[[int], bool] | None,
        on_block: Callable[[int], None],
        pause: Callable[[], bool],
        finished: Finished,
    ) -> Iterator[None]:
        """Folds the blocks that are wanted, with a stop at the end and wherever `pause()` is true between two: there,
        all blocks that were read are in. `on_block(number)` after each.

        **Raises:** BlockError where one that is wanted though it is `finished` does not come again as it was.
        """
        reading = read_blocks(blocks, wanted, self.kind)
        more = True

        def until_pause() -> Iterator[Samples]:
            nonlocal more
            for number, samples in reading:
                if number < finished.begin:
                    if not finished.comes_again(_mark(samples)):
                        raise BlockError(number, f"is another one than the checkpoint holds: {ANEW}")
                    continue
                yield self._counted(number, samples)
                self.begin = number + 1
                if self.keep:
                    self.marks.append(_mark(samples))
                on_block(number)
                if pause():
                    return
            if finished.missing:
                raise BlockError(finished.begin - 1, f"is in the checkpoint, and does not come any more: {ANEW}")
            more = False

        while more:
            for samples in regrouped(until_pause(), STEP * (1 if self.mesh is None else self.mesh.size)):
                self._add(samples)
            yield

    def _counted(self, number: int, samples: Samples) -> Samples:
        """A block that has been checked."""
        self.kind = kind_of(samples) if self.kind is None else self.kind
        try:
            check_isotropy(self.basis, samples)
            check_numbers(samples)
            # Filled up to a power of two: a program is compiled for every size.
            whole = filled(samples, 1 << (samples.size - 1).bit_length())
            self.counts = self.counts.plus(check_values(whole, self.norm, samples.size))
        except ValueError as error:
            raise BlockError(number, str(error)) from error
        return samples

    def _add(self, samples: Samples) -> None:
        """Fold samples into the factors."""
        self.factor = self._with(self.factor, samples)
        if self.norm.judge_series != self.norm.fit:
            power = cosine_power(samples.wi, samples.wo, self.norm.judge_series - self.norm.fit)
            self.judged = self._with(self.judged, samples.reweighted(samples.weight * power))
        self.seen += int(_seen(self.norm, samples))

    def _with(self, factor: Array | None, samples: Samples) -> Array:
        samples = samples if self.mesh is None else spread(samples, self.mesh)
        new = gathered(factorize(self.basis, self.norm, samples, self.mesh), self.mesh)
        return new if factor is None else _merged(factor, new)

    def state(self) -> dict[str, np.ndarray]:
        """Everything, as arrays that can be written."""
        factors = {"factor": self.factor, "judged": self.judged}
        return {name: np.asarray(factor) for name, factor in factors.items() if factor is not None} | {
            "numbers": np.asarray([self.counts.size, self.counts.used, self.counts.inside, self.seen, self.begin]),
            "total": np.asarray(self.counts.total, np.float64),
            "kind": np.asarray(json.dumps(self.kind)),
            "marks": np.asarray(self.marks, np.uint32),
        }

    def include(self, state: dict[str, np.ndarray], who: str = "") -> None:
        """What was the state of other sums, beside this; ValueError, naming `who`, for blocks of another kind."""
        size, used, inside, seen, begin = (int(number) for number in state["numbers"])
        kind = json.loads(str(state["kind"]))
        if None not in (kind, self.kind) and kind != self.kind:
            raise ValueError(f"blocks of {who} are of another kind, {kind}, than those before, {self.kind}")
        self.kind = self.kind if kind is None else kind
        self.counts = self.counts.plus(Counts(size, used, inside, float(state["total"])))
        self.seen, self.begin = self.seen + seen, max(self.begin, begin)
        self.marks += state["marks"].tolist()
        self.factor = _both(self.factor, state.get("factor"))
        self.judged = _both(self.judged, state.get("judged"))


def _mark(samples: Samples) -> int:
    return mark_of(samples.wi, samples.wo, samples.value, samples.weight)


def _both(here: Array | None, there: np.ndarray | None) -> Array | None:
    if there is None:
        return here
    return jnp.asarray(there) if here is None else _merged(here, jnp.asarray(there))


@jax.jit
def _merged(above: Float[Array, "n n"], below: Float[Array, "n n"]) -> Float[Array, "n n"]:
    return jnp.linalg.qr(jnp.concatenate([above, below]), mode="r")


@partial(jax.jit, static_argnums=0)
def _seen(norm: Norm, samples: Samples) -> Array:
    return jnp.sum(samples.weight * norm.fit_weight(samples.wi, samples.wo) > 0)
