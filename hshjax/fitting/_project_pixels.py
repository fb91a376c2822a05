"""Relightable images: in every pixel a series over the direction of the light, from photographs under known lights.

    L(pixel, light) ~ Σ_k c_k(pixel) y_k(light)

Pixels that see all lights have one factorisation together: coefficients are one matrix, of as many rows as functions
and columns as lights, times the values of a pixel. A pixel in which lights are missing has a factorisation of its own.
"""

import json
import operator
from collections.abc import Callable
from contextlib import ExitStack
from os import PathLike
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from hshjax._typing import Array, Float
from hshjax.bases import AbstractBasis
from hshjax.fitting._checkpoint import Checkpoint, fingerprint, packed, unpacked
from hshjax.fitting._finished import Finished, Verify, check_verify, mark_of
from hshjax.fitting._fit_pixels import fit_pixels
from hshjax.fitting._lapack import suited_threads
from hshjax.fitting._light_design import LightDesign
from hshjax.fitting._mesh import own_mesh
from hshjax.fitting._prior import Prior
from hshjax.fitting._processes import Processes, check_same_call
from hshjax.fitting._tile_results import TileResults
from hshjax.fitting._tiles import TileError, Tiles, known_values


class PixelFit(eqx.Module):
    """Coefficients of every pixel, and what can be said about the fit.

    - `coefficients`: `(pixels, functions, channels)`: an array, mapped from a file, or the `out` that was given.
    - `residual`: root of Σ w |L - L̂|² over pixels and the lights that are known in them, per channel. - `relative`:
      that over the root of Σ w |L|².
    - `condition`: condition number of the weighted design matrix, shared by all pixels that lack no light.
    - `partial`: how many pixels lack a light. - `undetermined`: how many of them have NaN for coefficients, for the
      lights that are left do not determine the functions; `residual` and `relative` leave these out.
    """

    basis: AbstractBasis
    coefficients: Any
    residual: Float[np.ndarray, " channels"]
    relative: Float[np.ndarray, " channels"]
    condition: float
    partial: int
    undetermined: int

    def relit(
        self, light: Float[Array, "3"] | np.ndarray, pixels: slice = slice(None)
    ) -> Float[Array, "pixels channels"]:
        """What some pixels look like under a light from that direction, as strong as those of the photographs; NaN in
        those that are undetermined."""
        coefficients = jnp.asarray(np.asarray(self.coefficients[pixels]))
        return self.basis.evaluate(jnp.swapaxes(coefficients, 0, 1), jnp.asarray(light))


def project_pixels(
    basis: AbstractBasis,
    lights: Float[Array, "lights 3"] | np.ndarray,
    source: Any,
    *,
    weight: Float[Array, " lights"] | np.ndarray | None = None,
    ridge: float = 0.0,
    prior: Prior | None = None,
    out: Any = None,
    pixels: int | None = None,
    rows: int = 2**15,
    mesh: Mesh | None = None,
    checkpoint: str | PathLike | None = None,
    every: float = 30.0,
    verify: Verify = "last",
    timeout: float = 60.0,
    on_tile: Callable[[int, int | None], None] | None = None,
) -> PixelFit:
    """A series over the direction of the light in every pixel: least squares, tile by tile in bounded memory.

    - `basis`: functions of one direction: `HSH` for lights above a plane, `SphericalHarmonics` for lights all around.
    - `lights`: unit vectors towards the distant lights, in the frame of the basis (the camera's, or the plane's).
    - `source`: photographs, linear in light, under lights of one strength: anything with `shape` (pixels, lights,
      channels) that gives an array for `source[start:stop]` (of numpy, mapped, of h5py, zarr, `io.stack_images`), which
      is cut into tiles of `rows` pixels; or anything that yields such tiles. A light that is NaN, or masked (numpy.ma),
      in some channel of a pixel (saturated, shadowed, broken) is left out of that pixel, in all channels. The pixel is
      then fitted by itself, as `project` fits samples of weight 0; it is undetermined, and NaN, without any light, with
      fewer lights than functions and no ridge, and where the condition number (in the Frobenius norm) is more than its
      dtype resolves, 1 / (functions x eps).
    - `weight`: of every light; 0 leaves one out, whatever its values are.
    - `ridge`, `prior`: see `project`; "spectral" is (n(n+1))², which leaves the constant free.
    - `out`: where coefficients go: None for memory; anything with `shape` (pixels, functions, channels) that takes
      `out[start:stop] = array`; or the path of a .npy file, which gets its name when it is whole. Beside a path, the
      folder `.NAME.unfinished` holds what is done, and the same call goes on from there after an interruption. The
      last tile that is done is then fitted again and compared with `out`, which must give it for `out[start:stop]`.
      One run at a time has a path or checkpoint.
    - `pixels`: how many a source without a shape will yield; a path needs to know.
    - `checkpoint`: a folder for what has been done, where `out` is an array that outlives the process. `every`: see
      `project_blocks`. Only tiles are in it that are whole in `out`, and flushed where `out` can.
    - `verify`: whether photographs are the ones before: of the "last" tile that is done, or of "all", which are read
      again for that; see `project_blocks`.
    - `mesh`, `timeout`: see `project_blocks`. Each device takes a share of the pixels of a tile, each process every
      n-th tile. `out` must then be writable by all processes: a path that all share, or an array of which different
      parts may be written at the same time.
    - `on_tile(number, of)`: called when a tile has been written, `of` how many there are or None.

    Integers count as they are; the result has the dtype of floating values, or else jax's default.

    **Returns:** a `PixelFit`.

    **Raises:** TileError, naming the tile, for one of another shape or dtype than the first, for infinite values, where
    another number of pixels comes than was said, and where what is done is not in `out`, or of other photographs.
    ValueError for lights that are not of unit length, below the horizon of the basis, or do not determine the
    functions; for a source, `out` or checkpoint that do not fit, and for one that another run is using.
    ProcessError: see `project_blocks`.
    """
    check_verify(verify)
    design = LightDesign(basis, lights, weight, ridge, prior)
    tiles, results = Tiles(source, rows, len(design.rows)), TileResults(out)
    total = _total(tiles, pixels, out, results)
    if checkpoint is not None and (out is None or results.path is not None):
        raise ValueError("a checkpoint is for an `out` that is an array and outlives the process; a path has its own")
    folder = results.unfinished if checkpoint is None else checkpoint
    dtype = _floating(tiles.dtype)
    run = {"pixels": total, "tiles": tiles.rows if tiles.pixels else "as they come", "kind": tiles.kind}
    run |= fingerprint(basis=basis, lights=(design.operator, design.weight))
    own, of = None if mesh is None else own_mesh(mesh), len(tiles) if tiles.pixels else None
    with (
        Processes(mesh, "project_pixels", timeout, _advice(folder)) as processes,
        suited_threads(basis.count + tiles.channels),
        ExitStack() as held,
    ):
        index, count = processes.index, processes.count
        if count > 1 and out is None:
            raise ValueError("processes that share the pixels need an `out` to write to, got None")
        saved = None if folder is None else Checkpoint(folder, run, index, count, every)
        if saved is not None:
            held.enter_context(saved.held())
        state = (None if saved is None else saved.load("begin", "marks", "counts", "sums")) or {
            "begin": np.zeros((), np.int64),
            "marks": np.zeros(0, np.uint32),
            "counts": np.zeros(3, np.int64),  # of pixels, of those that are partial, undetermined
            "sums": np.zeros((2, tiles.channels)),
        }
        begin, shape = int(state["begin"]), (total, basis.count, tiles.channels)
        marks = state.pop("marks").tolist()
        finished = Finished(verify, marks, begin)

        def create(found: list[bytes]) -> bytes:
            """What the first process does for all."""
            calls = [json.loads(one) for one in found]
            check_same_call([call for call, _ in calls])
            results.create(shape, dtype, anew=not any(done for _, done in calls))
            return b""

        processes.put_together(json.dumps([run, begin]).encode(), create)
        results.open(shape)
        for tile in tiles.read(lambda number: finished.wanted(number) and number % count == index):
            mark = 0 if saved is None else mark_of(tile.values)
            if tile.number < begin and not finished.comes_again(mark):
                raise TileError(tile.number, f"was done with other photographs than these: {results.anew}")
            if tile.number < begin - 1:
                continue
            found = fit_pixels(design, *known_values(tile, dtype, design.weight > 0), own)
            if tile.number < begin:
                results.check(tile, found.coefficients, found.conditions)
                continue
            results.write(tile, found.coefficients)
            marks.append(mark)
            state = {
                "begin": np.asarray(tile.number + 1),
                "counts": state["counts"] + [len(tile.values), found.partial, found.undetermined],
                "sums": state["sums"] + found.sums,
            }
            processes.check()
            if on_tile is not None:
                on_tile(tile.number, of)
            if saved is not None and saved.due:
                results.flush()
                saved.save(state | {"marks": np.asarray(marks, np.uint32)})
        if finished.missing:
            raise TileError(begin - 1, f"was done, and does not come any more: {results.anew}")
        if saved is not None:
            results.flush()
            saved.save(state | {"marks": np.asarray(marks, np.uint32)})

        def publish(found: list[bytes]) -> bytes:
            states = [unpacked(one) for one in found]
            together = {name: np.sum([one[name] for one in states], axis=0) for name in ("counts", "sums")}
            if total not in (None, together["counts"][0]):
                last = max(int(one["begin"]) for one in states)
                raise TileError(last, f"expected {total} pixels in all, got {together['counts'][0]} up to here")
            results.publish()
            return packed(together)

        together = unpacked(processes.put_together(packed(state), publish))
        held.close()  # nobody writes any more, and network file systems remove no file that is open
        processes.finish()
        if saved is not None and results.unfinished is None:
            saved.remove()
        if index == 0:  # for all: others would remove at the same time
            results.clear()
    coefficients = results.array if results.path is None else np.load(results.path, mmap_mode="r")
    error, size = np.sqrt(together["sums"])
    _, partial, undetermined = map(int, together["counts"])
    return PixelFit(
        basis, coefficients, error, error / np.where(size > 0, size, 1), design.condition, partial, undetermined
    )


def _total(tiles: Tiles, pixels: int | None, out: Any, results: TileResults) -> int | None:
    """How many pixels there are to be, where anything says so."""
    if tiles.pixels is not None:
        if pixels not in (None, tiles.pixels):
            raise ValueError(f"pixels is for a source without shape; this one has {tiles.pixels}, got {pixels}")
        return tiles.pixels
    if pixels is None:
        return int(out.shape[0]) if out is not None and results.path is None else None
    if pixels < 1:
        raise ValueError(f"pixels must be at least 1, got {pixels}")
    return operator.index(pixels)


def _floating(dtype: np.dtype) -> np.dtype:
    """In which values are computed with: their own where that is float32 or jax has float64."""
    default = jnp.zeros(()).dtype
    return jax.dtypes.canonicalize_dtype(np.promote_types(dtype, np.float32)) if dtype.kind == "f" else default


def _advice(folder: Any) -> str:
    if folder is None:
        return "nothing was kept: the same command begins anew"
    return f"the tiles that are done are kept in {folder}: the same command goes on after them"
