"""Any isotropic BRDF as a table over half and difference angles, with the error of the conversion."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Float, PairFunction
from hshjax.brdfs._half_vector_table import HalfVectorTable
from hshjax.brdfs._isotropy import is_isotropic
from hshjax.brdfs._tabulated import TabulatedBRDF
from hshjax.fitting._blocks import evaluated
from hshjax.fitting._compact import HORIZON
from hshjax.fitting._misfit import ratio
from hshjax.geometry import from_half_difference

PLACES = 200_000
"""Centres of cells at which errors are measured; of larger tables an even choice."""

LOWEST = -0.99
"""What ρ z below it counts as in a logarithm: measurements may be negative."""

LARGEST = float(np.radians(80))
"""Where measurements end that can be trusted, off the normal [radians]."""


class TableError(NamedTuple):
    """How far a table is from its BRDF at the centres of cells, where interpolation errs most.

    - `mean`, `largest`: of |Δ ln(1 + ρ z)| over places, channels and the two cosines z.
    - `relative` `(channels,)`: L2 of z_i z_o ρ over solid angle, as in norm D. Host array.
    - `places`: how many; of so few cells that none lies there, the rest is NaN.
    """

    mean: float
    largest: float
    relative: Float[np.ndarray, " channels"]
    places: int


class Tabulated(NamedTuple):
    """What `tabulate` has made.

    - `table`: the BRDF at the nodes.
    - `error`: between the nodes, where both directions lie up to 80 degrees from the normal. - `grazing`: where one
      lies beyond, both up to 89.5 degrees. Both are of the reciprocal part of the BRDF.
    - `folding`: mean |Δ ln(1 + ρ z)| between that part and the BRDF as it is, up to 80 degrees: 0 if it is reciprocal.
    """

    table: HalfVectorTable
    error: TableError
    grazing: TableError
    folding: float


def tabulate(brdf: PairFunction, *, steps: tuple[int, int, int] = (90, 45, 36)) -> Tabulated:
    """An isotropic BRDF as a `HalfVectorTable`: what is costly to evaluate, in a lookup of eight values.

    Nodes are `steps` equal steps of sqrt(θ_h) and θ_d over [0, π/2], both ends included, and of φ_d over [0, π), which
    is a period: (90, 90, 180) are those of a MERL file and one more each at 90 degrees. Each value is the mean over
    the swap of directions, which a table cannot tell apart; it need not be bilateral. A pair with a direction lower
    than 89.5 degrees off the normal holds what θ_d gives where the lower direction meets that bound: cells that
    straddle the horizon are not dimmed, and the last half degree is no copy.

    Found in float64, in blocks, and kept in the default float of the caller's configuration. Not under `jax.jit`.

    **Raises:** ValueError for an anisotropic BRDF, for values that are not finite, or too few steps.
    """
    if len(steps) != 3 or min(steps) < 1:
        raise ValueError(f"a table needs at least one step each in θ_h, θ_d and φ_d, got {steps}")
    with jax.enable_x64(True):
        if not is_isotropic(brdf):
            raise ValueError("a table over half and difference angles is for isotropic BRDFs, and this one is not")
        nodes = _nodes(steps)
        grid = [axis.ravel() for axis in np.meshgrid(*nodes, indexing="ij")]
        values = np.mean(_both_ways(brdf, *_raised(*grid)), axis=0)
        if not np.all(np.isfinite(values)):
            bad = np.count_nonzero(~np.isfinite(values).all(axis=1))
            raise ValueError(f"a table needs finite values, got {bad} nodes of {len(values)} that are not")
        table = HalfVectorTable(
            values=jnp.asarray(values.reshape(*(axis.size for axis in nodes), -1)),
            theta_h=jnp.asarray(nodes[0]),
            theta_d=jnp.asarray(nodes[1]),
            phi_d=jnp.asarray(nodes[2]),
            channel_names=_channel_names(brdf, values.shape[1]),
            description=brdf.description if isinstance(brdf, TabulatedBRDF) else "",
        ).settled()
        errors = _errors(brdf, table, steps)
    return Tabulated(jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)), table), *errors)


def _nodes(steps: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """θ_h, θ_d and φ_d [radians]."""
    h, d, f = (np.arange(count + 1) / count for count in steps)
    return h**2 * np.pi / 2, d * np.pi / 2, np.pi * f[:-1]


def _raised(theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same, with θ_d (θ_h first, if need be) lowered until both directions are above 89.5 degrees."""
    lowest = np.cos(HORIZON)
    theta_h = np.minimum(theta_h, HORIZON)
    # The lower cosine is cos θ_h cos θ_d - sin θ_h sin θ_d |cos φ_d| = r cos(θ_d + δ).
    x, y = np.cos(theta_h), np.sin(theta_h) * np.abs(np.cos(phi_d))
    return theta_h, np.clip(np.arccos(lowest / np.hypot(x, y)) - np.arctan2(y, x), 0, theta_d), phi_d


def _both_ways(
    brdf: PairFunction, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray
) -> Float[np.ndarray, "2 pairs channels"]:
    """ρ at pairs, and at what a swap makes of them."""
    wi, wo = map(np.asarray, from_half_difference(*map(jnp.asarray, (theta_h, theta_d, phi_d))))
    return np.stack([evaluated(brdf, wi, wo), evaluated(brdf, wo, wi)])


def _channel_names(brdf: PairFunction, channels: int) -> tuple[str, ...]:
    if isinstance(brdf, TabulatedBRDF):
        return brdf.channel_names
    return ("R", "G", "B") if channels == 3 else tuple(str(k) for k in range(channels))


def _errors(
    brdf: PairFunction, table: HalfVectorTable, steps: tuple[int, int, int]
) -> tuple[TableError, TableError, float]:
    """Up to 80 degrees, beyond, and what folding changes."""
    cells = int(np.prod(steps))
    chosen = np.linspace(0, cells - 1, min(cells, PLACES)).astype(int)
    h, d, f = ((index + 0.5) / count for index, count in zip(np.unravel_index(chosen, steps), steps, strict=True))
    angles = h**2 * np.pi / 2, d * np.pi / 2, f * np.pi
    wi, wo = map(np.asarray, from_half_difference(*map(jnp.asarray, angles)))
    # dω_i dω_o = 4 cos θ_d dω_h dω_d, on cells of equal width in sqrt(θ_h).
    measure = np.sin(angles[0]) * h * np.sin(angles[1]) * np.cos(angles[1])
    lowest = np.minimum(wi[:, 2], wo[:, 2])
    within, seen = lowest >= np.cos(LARGEST), lowest >= np.cos(HORIZON)
    there, back = _both_ways(brdf, *(axis[seen] for axis in angles))
    folded = (there + back) / 2
    found = evaluated(table, wi[seen], wo[seen])
    z, weight, within = np.stack([wi[seen, 2], wo[seen, 2]]), measure[seen], within[seen]

    def of(places):
        return _table_error(folded[places], found[places], z[:, places], weight[places])

    raw = _table_error(there[within], folded[within], z[:, within], weight[within])
    return of(within), of(~within), raw.mean


def _changes(a: np.ndarray, b: np.ndarray, z: np.ndarray) -> np.ndarray:
    """|Δ ln(1 + ρ z)|, `(2, places, channels)`."""
    before, after = (np.log1p(np.maximum(value * z[..., None], LOWEST)) for value in (a, b))
    return np.abs(after - before)


def _table_error(value: np.ndarray, found: np.ndarray, z: np.ndarray, weight: np.ndarray) -> TableError:
    if not len(value):
        return TableError(float("nan"), float("nan"), np.full(value.shape[1], np.nan), 0)
    change = _changes(value, found, z)
    weight = weight * (z[0] * z[1]) ** 2
    missed, size = (np.sqrt(weight @ part**2) for part in (found - value, value))
    return TableError(float(change.mean()), float(change.max()), np.asarray(ratio(missed, size)), len(value))
