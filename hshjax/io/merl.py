"""Isotropic materials of the MERL database, `.binary`: a table over half and difference angles.

    steps of θ_h, θ_d, φ_d: 3 x int32, as a rule 90, 90, 180    values: 3 planes (red, green, blue) of float64

little-endian, φ_d fastest, then θ_d, θ_h. A value times 1/1500, 1.15/1500 or 1.66/1500, by its plane, is in sr^-1.
Index i is θ_h = (i/steps)² π/2, θ_d = i/steps π/2, φ_d = i/steps π: the angle from which on the database's own lookup,
which rounds down, gives the value. It is read as measured there, at the lower edge of what that lookup calls a cell;
the format does not say, and readers that take the middle of a cell differ by half a step. A swap of the directions is
φ_d + π, so φ_d in [0, π) is all there is. Negative values mark what was not measured, pairs below the horizon above
all.

Source: Matusik, Pfister, Brand, McMillan, A Data-Driven Reflectance Model, ACM TOG 22(3), 2003, and the reference
reader that comes with the database (header, order, scales, steps). Originals were not at hand: files of this layout
were written by independent code.
"""

import struct
from os import PathLike
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import PairFunction
from hshjax.brdfs import HalfVectorTable
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._known import known
from hshjax.geometry import from_half_difference
from hshjax.io._binary import file_size, finite_doubles
from hshjax.io._replace import replacing
from hshjax.io.errors import FileFormatError
from hshjax.io.measured import GRAZING, LARGEST, Findings, Measured, Negatives, check_negatives
from hshjax.metrics import with_channels

HEADER = struct.Struct("<3i")
SCALES = np.array([1, 1.15, 1.66]) / 1500
"""sr^-1 a unit of the file: red, green, blue."""

STEPS = (90, 90, 180)
MAX_NODES = 2**23
"""Of a file, six times those of the database: what a header asks for must not exhaust a machine."""

UNMEASURED = -1.0
NAMES = ("theta_h", "theta_d", "phi_d")


def sniff(head: bytes, size: int) -> bool:
    """Whether a file of `size` bytes that begins with `head` is of this format: its header fits its size."""
    if len(head) < HEADER.size:
        return False
    steps = HEADER.unpack_from(head)
    return min(steps) > 0 and _expected_size(steps) == size


def read_merl(path: str | PathLike, *, negatives: Negatives = "keep") -> HalfVectorTable:
    """The data of `measured_merl`."""
    data = measured_merl(path, negatives=negatives).data
    assert isinstance(data, HalfVectorTable)
    return data


def measured_merl(path: str | PathLike, *, negatives: Negatives = "keep") -> Measured:
    """The material as a `HalfVectorTable`, channels R, G, B, in the default float of jax's configuration.

    A node with a negative value in any channel counts as unmeasured, whatever `negatives` says: negative values mark
    that, in this format. Other counts of steps than the database's are read too, up to 2^23 nodes; φ_d spans [0, π).

    **Raises:** FileFormatError where counts do not fit the size of the file, before any value is read; for values that
    are not finite, and where nothing was measured. ValueError for another word in `negatives`; OSError where the file
    cannot be opened.
    """
    check_negatives(negatives)
    steps = _steps(path)
    nodes = int(np.prod(steps))
    planes = finite_doubles(path, HEADER.size, 3 * nodes).reshape(3, nodes)
    if planes.max() > LARGEST:
        first = int(np.argmax(planes))
        where = f"byte {HEADER.size + 8 * first}, value {first}"
        raise FileFormatError(path, where, f"at most {LARGEST:g}", f"{planes.flat[first]:g}")
    measured = (planes >= 0).all(axis=0)
    if not measured.any():
        raise FileFormatError(
            path, f"byte {HEADER.size}, values", "a measured one", f"none among {nodes}: all negative"
        )
    values = np.empty((nodes, 3))
    for k, scale in enumerate(SCALES):
        np.multiply(planes[k], scale, out=values[:, k])
    del planes
    theta_h, theta_d, phi_d = _nodes(steps)
    missing = np.flatnonzero(~measured)
    masked = {}
    if missing.size:
        h, d, f = np.unravel_index(missing, steps)
        seen = int(np.sum(_lowest(theta_h[h], theta_d[d], phi_d[f]) > GRAZING))
        reasons = {"negative, a direction on or below the horizon": missing.size - seen, "negative": seen}
        masked = {reason: count for reason, count in reasons.items() if count}
    dtype = jnp.result_type(float)
    table = HalfVectorTable(
        values=jnp.asarray(values.reshape(*steps, 3), dtype),
        theta_h=jnp.asarray(theta_h, dtype),
        theta_d=jnp.asarray(theta_d, dtype),
        phi_d=jnp.asarray(phi_d, dtype),
        measured=jnp.asarray(measured.reshape(steps)) if missing.size else None,
    )
    notes = (
        "Values are read as of the lower edge of a cell in θ_h, θ_d and φ_d.",
        *(("Nodes with a negative value in any channel count as not measured.",) if missing.size else ()),
        *(() if steps == STEPS else (f"{' x '.join(map(str, steps))} steps, where the database has 90 x 90 x 180.",)),
    )
    found = Findings(
        "MERL binary", "", ("R", "G", "B"), "sr^-1, by the format's scales", nodes, masked=masked, notes=notes
    )
    return Measured(table, found)


def write_merl(
    path: str | PathLike,
    brdf: PairFunction,
    *,
    steps: tuple[int, int, int] = STEPS,
    repeat: bool = False,
    negatives: Literal["clip", "mask"] | None = None,
) -> int:
    """An isotropic BRDF [sr^-1] at the nodes of a file, slice by slice of θ_h, in float64; written beside and renamed.

    Each value is the mean over the swap of directions, which the format cannot tell apart. Pairs with a direction on
    or below the horizon are marked as not measured, and so are those where a table has no value: at its unmeasured
    nodes, and in cells without a measured one. A single channel is written three times if `repeat`. Values below 0
    above the horizon, which the format has no room for, become 0 ("clip") or are marked as not measured ("mask").
    Returned is how many nodes with both directions above the horizon are marked so.

    **Raises:** ValueError for an anisotropic BRDF, for other than three channels, for values that are not finite, for
    negative ones unless `negatives` says what becomes of them, and for steps that no file has.
    """
    if len(steps) != 3 or min(steps) < 1 or min(steps[:2]) < 2 or np.prod(steps, dtype=object) > MAX_NODES:
        raise ValueError(f"steps must be at least (2, 2, 1), of at most {MAX_NODES} nodes, got {steps}")
    nodes = int(np.prod(steps))
    theta_h, theta_d, phi_d = _nodes(steps)
    d, f = (axis.ravel() for axis in np.meshgrid(theta_d, phi_d, indexing="ij"))
    with jax.enable_x64(True), replacing(path) as beside, beside.open("xb") as file:
        if not is_isotropic(brdf):
            raise ValueError("a MERL file is for isotropic BRDFs, and this one is not")
        file.write(HEADER.pack(*steps))
        marked = 0
        for k, half in enumerate(theta_h):
            values, there = _slice(brdf, half, d, f, repeat)
            below = _lowest(half, d, f) <= GRAZING
            seen = (there & ~below)[:, None]
            wrong = seen & ~np.isfinite(values)
            if wrong.any():
                raise ValueError(f"values must be finite, got {values[wrong][0]} at θ_h = {half:.6g}")
            negative = seen & (values < 0)
            if negative.any() and negatives is None:
                raise ValueError(
                    f'values must be >= 0, got {values[negative].min():.6g} at θ_h = {half:.6g}: negatives="clip" '
                    'makes them 0, "mask" marks them as not measured'
                )
            unmeasured = ~seen[:, 0]
            if negatives == "mask":
                unmeasured |= negative.any(axis=1)
            marked += int(np.sum(unmeasured & ~below))
            raw = np.where(unmeasured[:, None], UNMEASURED, np.maximum(values, 0) / SCALES)
            for plane in range(3):
                file.seek(HEADER.size + 8 * (plane * nodes + k * d.size))
                file.write(raw[:, plane].astype("<f8").tobytes())
    return marked


def _slice(
    brdf: PairFunction, half: float, d: np.ndarray, f: np.ndarray, repeat: bool
) -> tuple[np.ndarray, np.ndarray]:
    """ρ `(pairs, 3)`, the mean over the swap, and `(pairs,)`, whether it is known both ways."""
    wi, wo = from_half_difference(*(jnp.asarray(x) for x in (np.float64(half), d, f)))
    values, there = map(np.asarray, _both_ways(brdf, wi, wo))
    if values.shape[1] == 1 and repeat:
        values = np.repeat(values, 3, axis=1)
    if values.shape[1] != 3:
        hint = ": repeat=True writes it three times" if values.shape[1] == 1 else ""
        raise ValueError(f"a MERL file has 3 channels, got {values.shape[1]}{hint}")
    return values, there


@eqx.filter_jit  # every slice has the same shape: one program
def _both_ways(brdf: PairFunction, wi, wo):
    values = (with_channels(brdf(wi, wo), 1) + with_channels(brdf(wo, wi), 1)) / 2
    return values, known(brdf, wi, wo) & known(brdf, wo, wi)


def _nodes(steps: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    h, d, f = (np.arange(count) / count for count in steps)
    return h**2 * np.pi / 2, d * np.pi / 2, f * np.pi


def _lowest(theta_h, theta_d, phi_d) -> np.ndarray:
    """The lower of the two cosines."""
    return np.cos(theta_h) * np.cos(theta_d) - np.sin(theta_h) * np.sin(theta_d) * np.abs(np.cos(phi_d))


def _steps(path: str | PathLike) -> tuple[int, int, int]:
    """The counts, which fit the size of the file."""
    size = file_size(path)
    with open(path, "rb") as file:
        head = file.read(HEADER.size)
    if len(head) < HEADER.size:
        raise FileFormatError(
            path, "byte 0, header", f"{HEADER.size} bytes", f"{len(head)}" if head else "an empty file"
        )
    steps = HEADER.unpack(head)
    for k, (name, count) in enumerate(zip(NAMES, steps, strict=True)):
        least = 1 if name == "phi_d" else 2
        if count < least:
            raise FileFormatError(path, f"byte {4 * k}, steps of {name}", f"at least {least}", f"{count}")
    if _expected_size(steps) != size:
        swapped = struct.unpack(">3i", head)
        hint = " (in the other byte order it would fit)" if sniff(HEADER.pack(*swapped), size) else ""
        expected = f"counts that make {size} bytes, the size of the file"
        got = f"{' x '.join(map(str, steps))}, which make {_expected_size(steps)}{hint}"
        raise FileFormatError(path, "byte 0, steps", expected, got)
    if steps[0] * steps[1] * steps[2] > MAX_NODES:
        got = f"{' x '.join(map(str, steps))}"
        raise FileFormatError(path, "byte 0, steps", f"at most {MAX_NODES} nodes", got)
    return steps


def _expected_size(steps: tuple[int, ...]) -> int:
    """Python integers: no overflow."""
    return HEADER.size + 3 * 8 * steps[0] * steps[1] * steps[2]
