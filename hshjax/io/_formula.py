"""Fitted models as formulas in plain arithmetic, for renderers: no array of JAX, no loop, no table of their own.

`terms` is written in +, -, * and / and a handful of functions (`Arithmetic`). Run on arrays of another program it
evaluates there; run on names of variables it writes source text. So there is one formula, wherever it is evaluated.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import numpy as np

from hshjax._special import RadialTables
from hshjax.bases import (
    HSH,
    SHR,
    AbstractBasis,
    AbstractPairBasis,
    AbstractWarp,
    HalfVectorBasis,
    HelmholtzBasis,
    IdentityWarp,
    IsotropicBasis,
    LogWarp,
    RationalWarp,
    RootWarp,
    TensorBasis,
    Zernike,
)
from hshjax.bases._half_vector import function_layout
from hshjax.brdfs import ExpBRDF, LinearBRDF, LogLinearBRDF
from hshjax.brdfs._linear import EXPONENTS

Vector = tuple[Any, Any, Any]
"""A direction as three numbers, whatever numbers are."""

Complex = tuple[Any, Any]


@runtime_checkable
class Arithmetic(Protocol):
    """What numbers of a renderer cannot do by operators."""

    def sqrt(self, x: Any) -> Any: ...
    def log(self, x: Any) -> Any: ...
    def select(self, condition: Any, yes: Any, no: Any) -> Any: ...

    def keep(self, name: str, value: Any) -> Any:
        """The value, which is used more than once: where to give it a name."""

    def part(self, title: str) -> None:
        """What the lines that follow are: a place for a comment."""


class Formula(NamedTuple):
    """ρ_c = s_c / (z_i z_o)^exponent, or exp(clip(s_c, low_c, high_c)), of the series s_c = Σ_t coefficients[t, c] B_t.

    Host arrays: `coefficients` `(modes, channels)`; `low` and `high` `(channels,)` of the exponential, else None.
    """

    basis: AbstractPairBasis
    coefficients: np.ndarray
    exponent: float = 0.0
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    @property
    def channels(self) -> int:
        return self.coefficients.shape[1]

    @property
    def exponential(self) -> bool:
        return self.low is not None


class Term(NamedTuple):
    """A basis function: `norm` x `value` is B_t of the directions."""

    number: int
    norm: float
    value: Any


def formula(model: eqx.Module) -> Formula:
    """What a renderer is to evaluate.

    **Raises:** ValueError for a model or a basis that has no such formula, naming those that have.
    """
    match model:
        case LinearBRDF():
            found = Formula(model.basis, _host(model.coefficients), EXPONENTS[model.target])
        case ExpBRDF():
            unbounded = np.full(model.coefficients.shape[1], np.inf)
            found = Formula(model.basis, _host(model.coefficients), 0.0, -unbounded, unbounded)
        case LogLinearBRDF():
            coefficients = _host(model.matrix) @ _host(model.mixing)
            found = Formula(model.basis, coefficients, 0.0, _host(model.low), _host(model.high))
        case _:
            raise ValueError(
                "renderers are told of a LinearBRDF, an ExpBRDF or a LogLinearBRDF; project other models onto a basis, "
                f"or fit a compact one (hshjax.project, hshjax.fit_compact); got {type(model).__name__}"
            )
    _check(found.basis)
    if not np.all(np.isfinite(found.coefficients)):
        raise ValueError(f"the coefficients of {type(model).__name__} are not all finite")
    return found


def _host(array: Any) -> np.ndarray:
    return np.asarray(array, np.float64)


def _check(basis: AbstractPairBasis) -> None:
    if isinstance(basis, HalfVectorBasis):
        kinds = (IdentityWarp, RootWarp, RationalWarp, LogWarp)
        known = isinstance(basis.warp, kinds) and isinstance(basis.difference_warp, kinds)
    else:
        known = isinstance(basis, IsotropicBasis | HelmholtzBasis | TensorBasis) and type(basis.basis) in _CHARTS
    if not known:
        raise ValueError(
            "renderers are told of IsotropicBasis, HelmholtzBasis and TensorBasis over HSH, Zernike or SHR, and of "
            f"HalfVectorBasis under the library's own warps; got {basis}"
        )


def terms(basis: AbstractPairBasis, wi: Vector, wo: Vector, on: Arithmetic) -> Iterator[Term]:
    """Every function of the basis at one pair of unit directions with z > 0, each once, in an order of its own."""
    match basis:
        case IsotropicBasis():
            return _isotropic(basis, wi, wo, on)
        case HelmholtzBasis() | TensorBasis():
            return _products(basis, wi, wo, on)
        case HalfVectorBasis():
            return _half_vector(basis, wi, wo, on)
    raise ValueError(f"no formula for {basis}")


# Single directions: the radial variable x of z, and the factor q with s² = q (x + iy)²; 1 where it is None.


def _hsh(z: Any) -> tuple[Any, Any]:
    return 2 * z - 1, 4 * z / (1 + z)


def _zernike(z: Any) -> tuple[Any, Any]:
    return 1 - 2 * z, 1 / (1 + z)


def _shr(z: Any) -> tuple[Any, Any]:
    return z, None


_CHARTS = {HSH: _hsh, Zernike: _zernike, SHR: _shr}


def _radial(tables: RadialTables, m: int, x: Any, name: str, on: Arithmetic) -> list[Any]:
    """p_j^m(x) for every j, by the recurrence of `RadialTables`."""
    values: list[Any] = [float(tables.start[m])]
    for j in range(1, int(tables.counts[m])):
        slope, shift, back = (float(table[m, j]) for table in (tables.slope, tables.shift, tables.back))
        value = _plus(slope * x, shift) * values[-1]
        if j > 1:
            value = value - back * values[-2]
        values.append(on.keep(f"{name}_{m}_{j}", value))
    return values


def _plus(value: Any, number: float) -> Any:
    return value + number if number else value


def _powers(square: Complex, odd: Complex, orders: int, on: Arithmetic, name: str = "s") -> list[Complex]:
    """s^m as (Re, Im) for m < orders: even ones are powers of s², which knows no root."""
    found: list[Complex] = [(1.0, 0.0)]
    for m in range(1, orders):
        if m <= 2:
            re, im = odd if m == 1 else square
        else:
            (a, b), (c, d) = found[m - 1 - (m + 1) % 2], found[1 if m % 2 else 2]
            re, im = a * c - b * d, a * d + b * c
        found.append((on.keep(f"re_{name}{m}", re), on.keep(f"im_{name}{m}", im)))
    return found


def _isotropic(pairs: IsotropicBasis, wi: Vector, wo: Vector, on: Arithmetic) -> Iterator[Term]:
    """N (Re|Im s^m) [R_j(i) R_k(o) ± R_k(i) R_j(o)], s = s_i conj(s_o), as in `hshjax.bases.IsotropicBasis`."""
    chart, tables, table = _CHARTS[type(pairs.basis)], pairs.basis.tables(), pairs.table()
    on.part(f"Coordinates: {pairs.basis}, azimuths by powers of s, of phase phi_i - phi_o")
    (xi, yi, zi), (xo, yo, zo) = wi, wo
    (x, factor_i), (y, factor_o) = chart(zi), chart(zo)
    x, y = on.keep("x_i", x), on.keep("x_o", y)
    re, im = on.keep("re", xi * xo + yi * yo), on.keep("im", yi * xo - xi * yo)
    square, odd = (re * re - im * im, 2 * re * im), (re, im)
    if factor_i is not None:
        factor = on.keep("factor", factor_i * factor_o)
        root = on.keep("root", on.sqrt(factor))
        square, odd = (factor * square[0], factor * square[1]), (root * re, root * im)
    power = _powers(square, odd, len(tables.start), on)
    for m in range(len(tables.start)):
        on.part(f"m = {m}")
        left, right = (_radial(tables, m, x, name, on) for x, name in ((x, "i"), (y, "o")))
        for t in np.flatnonzero(table.m == m):
            j, k, sine = int(table.j[t]), int(table.k[t]), bool(table.sine[t])
            if j == k:
                product, norm = left[j] * right[j], 2 * table.norm[t]
            else:
                swapped = left[k] * right[j]
                product, norm = left[j] * right[k] + (-swapped if sine else swapped), table.norm[t]
            yield Term(int(t), float(norm), product if m == 0 else power[m][int(sine)] * product)


def _single(basis: AbstractBasis, w: Vector, name: str, on: Arithmetic) -> list[Any]:
    """Every function of a basis of single directions, in the order of its columns."""
    tables, columns = basis.tables(), basis.columns()
    x, y, z = w
    radial, factor = _CHARTS[type(basis)](z)
    radial = on.keep(f"x_{name}", radial)
    square, odd = (x * x - y * y, 2 * x * y), (x, y)
    if factor is not None:
        factor = on.keep(f"factor_{name}", factor)
        root = on.keep(f"root_{name}", on.sqrt(factor))
        square, odd = (factor * square[0], factor * square[1]), (root * x, root * y)
    power = _powers(square, odd, len(tables.start), on, f"{name}_")
    values: list[Any] = [None] * basis.count
    for m in range(len(tables.start)):
        for j, value in enumerate(_radial(tables, m, radial, name, on)):
            for sine in (0, 1) if m else (0,):
                column = int(columns[m, j, sine])
                values[column] = on.keep(f"h_{name}_{column}", power[m][sine] * value) if m else value
    return values


def _products(pairs: HelmholtzBasis | TensorBasis, wi: Vector, wo: Vector, on: Arithmetic) -> Iterator[Term]:
    """h_a(wi) h_b(wo), or N_ab [h_a(wi) h_b(wo) + h_b(wi) h_a(wo)]."""
    left, right = [], []
    for values, w, name in ((left, wi, "i"), (right, wo, "o")):
        on.part(f"{pairs.basis} of w{name}")
        values.extend(_single(pairs.basis, w, name, on))
    on.part("Products of both")
    if isinstance(pairs, TensorBasis):
        for t, (a, b) in enumerate(np.ndindex(len(left), len(right))):
            yield Term(t, 1.0, left[a] * right[b])
        return
    for t, (a, b) in enumerate(zip(*pairs.unordered(), strict=True)):
        if a == b:
            yield Term(t, 1.0, left[a] * right[a])
        else:
            yield Term(t, float(np.sqrt(0.5)), left[a] * right[b] + left[b] * right[a])


def _half_vector(pairs: HalfVectorBasis, wi: Vector, wo: Vector, on: Arithmetic) -> Iterator[Term]:
    """norm (Re|Im c^p) U_j(u) V_k(v), c = u v exp(2i φ_d), as in `hshjax.bases.HalfVectorBasis`."""
    n = function_layout(pairs.functions)
    u, v, turn = _half_chart(pairs, wi, wo, on)
    re, im = turn
    power = _powers((re * re - im * im, 2 * re * im), turn, n.half.counts.size, on)
    x, y = on.keep("x_h", 2 * u - 1), on.keep("x_d", 2 * v - 1)
    for p in range(n.half.counts.size):
        chosen = np.flatnonzero(n.p == p)
        if not chosen.size:
            continue
        on.part(f"m = {2 * p}")
        half, difference = _radial(n.half, p, x, "h", on), _radial(n.difference, p, y, "d", on)
        for t in chosen:
            product = half[n.j[t]] * difference[n.k[t]]
            yield Term(int(t), float(n.norm[t]), product if p == 0 else power[p][int(n.sine[t])] * product)


def _half_chart(pairs: HalfVectorBasis, wi: Vector, wo: Vector, on: Arithmetic) -> tuple[Any, Any, Complex]:
    """u, v and u v exp(2i φ_d), as in `hshjax.bases._half_vector.half_chart`, for z > 0 in both directions."""
    on.part("Coordinates: half vector and difference vector on the equal-area disk, turned to the pole")
    total = [on.keep(f"sum_{axis}", a + b) for axis, a, b in zip("xyz", wi, wo, strict=True)]
    dx, dy, dz = (on.keep(f"half_{axis}", 0.5 * (a - b)) for axis, a, b in zip("xyz", wi, wo, strict=True))
    length = on.keep("length_of_sum", on.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2]))
    hx, hy, hz = (on.keep(f"h_{axis}", a / length) for axis, a in zip("xyz", total, strict=True))
    cos_d = 0.5 * length
    o_h = on.keep("o_h", (hx * hx + hy * hy) / (1 + hz))
    o_d = on.keep("o_d", (dx * dx + dy * dy + dz * dz) / (1 + cos_d))
    lift = on.keep("lift", dz / (1 + hz))
    qx, qy = on.keep("q_x", dx - lift * hx), on.keep("q_y", dy - lift * hy)
    # Both disks' scales, 1 / sqrt(1 + cos), enter squared.
    scale = on.keep("scale", 1 / ((1 + hz) * (1 + cos_d)))
    ratio_h, ratio_d = (
        on.keep(f"ratio_{name}", _ratio(warp, o, name, on))
        for warp, o, name in ((pairs.warp, o_h, "h"), (pairs.difference_warp, o_d, "d"))
    )
    re, im = on.keep("re", qx * hx + qy * hy), on.keep("im", qy * hx - qx * hy)
    scale = on.keep("scale_c", scale * ratio_h * ratio_d)
    turn = on.keep("re_c", scale * (re * re - im * im)), on.keep("im_c", scale * (2 * re * im))
    return on.keep("u", o_h * ratio_h), on.keep("v", o_d * ratio_d), turn


ATANH = tuple(1 / (2 * k + 1) for k in range(6, 0, -1))
"""Coefficients of z^12 ... z^2 in atanh(z) / z."""


def _ratio(warp: AbstractWarp, o: Any, name: str, on: Arithmetic) -> Any:
    """u(o) / o of a warp."""
    match warp:
        case RootWarp():
            positive = o > 0
            return on.select(positive, 1 / on.sqrt(on.select(positive, o, 1.0)), 0.0)
        case RationalWarp():
            alpha = float(warp.alpha)
            return (1 + alpha) / (o + alpha)
        case LogWarp():
            alpha = float(warp.alpha)
            x = on.keep(f"stretched_{name}", o * (1 / alpha))
            small = x < 0.5
            # ln(1 + x) = 2 atanh(z), z = x / (2 + x): where 1 + x would lose the digits of x. Left out: 1e-10.
            below = on.keep(f"below_{name}", on.select(small, x, 0.0))
            z = on.keep(f"z_{name}", below / (2 + below))
            square = on.keep(f"z2_{name}", z * z)
            series: Any = ATANH[0]
            for coefficient in ATANH[1:]:
                series = series * square + coefficient
            series = 2 * (series * square + 1) / (2 + below)
            above = on.keep(f"above_{name}", on.select(small, 1.0, x))
            scale = 1 / (alpha * float(np.log1p(1 / alpha)))
            return scale * on.select(small, series, on.log(1 + above) / above)
    return 1.0
