"""Samples in blocks: from arrays of which a slice at a time is read, checked, cut to one size."""

import operator
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from typing import Any, overload

import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array
from hshjax.fitting._parts import PartError, naming, native
from hshjax.geometry import common_dtype
from hshjax.samples import Samples


class BlockError(PartError):
    """A block of samples that cannot be used, or that is missing: `block` is its number from 0."""

    what = "block"

    @property
    def block(self) -> int:
        return self.number


class SampleBlocks(Sequence[Samples]):
    """Samples in arrays that need not fit in memory, as a sequence of blocks, each read when it is asked for.

    - `wi`, `wo`, `value`, `weight`: as of `Samples.scattered`, arrays of anything with `shape` that gives an array for
      `array[start:stop]`: of numpy, memory-mapped, datasets of h5py, arrays of zarr.
    - `rows`: of a block; the last one may have fewer. - `isotropic`: see `Samples`.

    **Raises:** ValueError where shapes disagree; TypeError for what has no shape, such as a path. BlockError, by the
    block that is asked for, where fewer rows come, or other than real numbers, or some that are masked.
    """

    def __init__(self, wi: Any, wo: Any, value: Any, weight: Any = None, *, rows: int = 2**18, isotropic: bool = False):
        self._parts = {"wi": wi, "wo": wo, "value": value} | ({} if weight is None else {"weight": weight})
        for name, part in self._parts.items():
            if not hasattr(part, "shape"):
                raise TypeError(f"{name} must be an array, got {type(part).__name__} {part!r:.60}")
        n = wi.shape[0]
        expected = {"wi": (n, 3), "wo": (n, 3), "value": (n, *value.shape[1:2]), "weight": (n,)}
        for name, part in self._parts.items():
            if tuple(part.shape) != expected[name] or (name == "value" and len(part.shape) != 2):
                raise ValueError(
                    f"blocks need wi (n, 3), wo (n, 3), value (n, channels), weight (n,); got n = {n} from wi and "
                    f"{name} of shape {tuple(part.shape)}"
                )
        rows = operator.index(rows)
        if rows < 1:
            raise ValueError(f"rows of a block must be at least 1, got {rows}")
        self._size, self._rows, self._isotropic = n, rows, isotropic

    def __len__(self) -> int:
        return -(-self._size // self._rows)

    @overload
    def __getitem__(self, number: int) -> Samples: ...

    @overload
    def __getitem__(self, number: slice) -> list[Samples]: ...

    def __getitem__(self, number):
        if isinstance(number, slice):
            return [self[k] for k in range(*number.indices(len(self)))]
        if not -len(self) <= number < len(self):
            raise IndexError(f"block {number} of {len(self)}")
        number %= len(self)
        start = number * self._rows
        rows = min(self._rows, self._size - start)
        parts = {name: part[start : start + rows] for name, part in self._parts.items()}
        for name, part in parts.items():
            if isinstance(part, np.ma.MaskedArray):  # whose mask nobody would look at
                raise BlockError(number, f"{name} is a masked array: mask samples by the weight 0")
            parts[name] = found = native(part)
            if len(found) != rows:  # a file may have become shorter than its header says
                raise BlockError(number, f"expected {rows} rows of {name} from {start} on, got {len(found)}")
            if not (found.dtype.kind in "iub" or jnp.issubdtype(found.dtype, jnp.floating)):
                raise BlockError(number, f"expected real numbers for {name}, got {found.dtype}")
        parts = {name: jnp.asarray(part) for name, part in parts.items()}
        return Samples.scattered(**parts, isotropic=self._isotropic)


def check_source(blocks: object) -> None:
    """TypeError for what yields no blocks."""
    if isinstance(blocks, Samples) or not isinstance(blocks, Iterable):
        raise TypeError(
            f"blocks must be a list of Samples, a generator of them, or SampleBlocks, got {type(blocks).__name__}; "
            "of Samples in memory `project` makes the fit"
        )


Kind = dict[str, Any]
"""What blocks have in common, by name."""


def kind_of(samples: Samples) -> Kind:
    """Of samples in one dtype."""
    return {"channels": samples.channels, "dtype": samples.value.dtype.name, "isotropic": samples.isotropic}


def read_blocks(
    blocks: Iterable[Samples], wanted: Callable[[int], bool] | None = None, first: Kind | None = None
) -> Iterator[tuple[int, Samples]]:
    """The blocks with their numbers, in one dtype each, all of the same kind.

    - `wanted(number)`: whether a block is; others are not read where `blocks` is a sequence, and else read and dropped.
    - `first`: the kind that all must be of; by default that of the first one.

    **Raises:** BlockError for one that is no `Samples` or is of another kind, and where not as many come as the
    length of `blocks` says. What reading raises gets a note that names the block.
    """
    for number, samples in _numbered(blocks, wanted):
        if not isinstance(samples, Samples):
            raise BlockError(number, f"expected Samples, got {type(samples).__name__}")
        wi, wo, value, weight = common_dtype(samples.wi, samples.wo, samples.value, samples.weight)
        kept = Samples(wi, wo, value, weight, None, samples.isotropic)
        kind = kind_of(kept)
        first = kind if first is None else first
        for name, expected in first.items():
            if kind[name] != expected:
                raise BlockError(number, f"expected {name} {expected} as of block 0, got {kind[name]}")
        yield number, kept


def _numbered(blocks: Iterable[Any], wanted: Callable[[int], bool] | None) -> Iterator[tuple[int, Any]]:
    """Those that are wanted, as they come; see `read_blocks`."""
    if wanted is not None and isinstance(blocks, Sequence):
        for number in filter(wanted, range(len(blocks))):
            with naming(f"block {number} of samples"):
                block = blocks[number]
            yield number, block
        return
    number, source = 0, iter(blocks)
    while True:
        with naming(f"block {number} of samples"):
            try:
                block = next(source)
            except StopIteration:
                break
        if wanted is None or wanted(number):
            yield number, block
        number += 1
    if isinstance(blocks, Sized) and len(blocks) != number:
        raise BlockError(number, f"expected {len(blocks)} blocks, as many as their length says, got {number}")


def regrouped(blocks: Iterable[Samples], rows: int) -> Iterator[Samples]:
    """The same samples in blocks of exactly `rows`; the last one is filled up by samples of weight 0."""
    rest: list[Samples] = []  # fewer than `rows` together
    for samples in blocks:
        start, count = 0, sum(one.size for one in rest)
        while count + samples.size - start >= rows:
            stop = start + rows - count
            yield _joined([*rest, _rows(samples, start, stop)])
            rest, start, count = [], stop, 0
        rest.append(_rows(samples, start, samples.size))
    if any(one.size for one in rest):
        yield filled(_joined(rest), rows)


def filled(samples: Samples, rows: int) -> Samples:
    """Samples of weight 0 after these, up to so many."""
    lacking = rows - samples.size
    up = jnp.asarray(np.tile(np.asarray([0, 0, 1], samples.wi.dtype), (lacking, 1)))
    black = jnp.asarray(np.zeros((lacking, samples.channels), samples.value.dtype))
    nothing = jnp.asarray(np.zeros(lacking, samples.weight.dtype))
    return _joined([samples, Samples(up, up, black, nothing)])


def _joined(blocks: list[Samples]) -> Samples:
    if len(blocks) == 1:
        return blocks[0]
    wi, wo, value, weight = map(_stacked, zip(*map(_parts, blocks), strict=True))
    return Samples(wi, wo, value, weight, None, blocks[0].isotropic)


def _rows(samples: Samples, start: int, stop: int) -> Samples:
    if (start, stop) == (0, samples.size):
        return samples
    wi, wo, value, weight = (jnp.asarray(np.asarray(part)[start:stop]) for part in _parts(samples))
    return Samples(wi, wo, value, weight, None, samples.isotropic)


def _parts(samples: Samples) -> tuple[Array, Array, Array, Array]:
    return samples.wi, samples.wo, samples.value, samples.weight


def _stacked(parts: tuple[Array, ...]) -> Array:
    """On the host: blocks differ in size, and jax would compile a program for each."""
    return jnp.asarray(np.concatenate([np.asarray(part) for part in parts]))
