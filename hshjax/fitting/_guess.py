"""Where to start a fit of an analytic BRDF: shape parameters by search, amplitudes by linear least squares."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import KeyPath

from hshjax._typing import Array, Float, Int
from hshjax.brdfs._base import AbstractBRDF
from hshjax.fitting._bounds import declaration, path_name
from hshjax.fitting._fit import chosen
from hshjax.fitting._mappings import AbstractMapping, CosineWeighted
from hshjax.fitting._optimistix import half_square
from hshjax.fitting._terms import SampleMisfit
from hshjax.samples import Samples

COSINE_WEIGHTED = CosineWeighted()
FEWEST_CANDIDATES = 64
CANDIDATES_PER_GUESS = 4
SHORTLIST = 16
"""Fewest candidates whose misfit is looked at."""

SWEEPS = 50
"""Of coordinate descent: two columns at a cosine of 0.9 agree to 0.81^50 = 3e-5, far beyond what a start needs."""


def initial_guesses(
    template: AbstractBRDF,
    samples: Samples,
    count: int = 16,
    *,
    mapping: AbstractMapping = COSINE_WEIGHTED,
    trainable: Any = None,
) -> AbstractBRDF:
    """Starts for `multi_start`: models like the template with a leading axis of guesses, best first.

    Candidates for the shape parameters (slope, roughness, exponent, Fresnel) are spread evenly over the ranges that
    their fields declare by `bounded(..., search=...)`, one value for all channels. For each, the amplitudes (albedo,
    diffuse, specular, scale) follow by least squares within their bounds, channel by channel. Of the candidates, the
    best `count` that differ in shape are kept.

    **Arguments:**

    - `template`: the structure, channels and dtypes wanted. What is trainable is guessed, whatever its value.
    - `samples`: the data; weight 0 masks a sample.
    - `count`: how many guesses. A model whose trainable parameters are all amplitudes has one.
    - `mapping`: in which numbers model and samples are compared. Where it is not linear (`LogRelative`), amplitudes are
      those of its linearisation about the samples; the order of the guesses is by the true misfit.
    - `trainable`: as for `fit`: what is guessed. The rest keeps the template's value.

    `OrenNayar(full=True)` is quadratic in its albedo: it is taken for the straight line from 0 to 1. Where
    amplitudes multiply each other, as in `scale * Lambert(albedo)`, the samples tell their product only: the inner ones
    are solved for with the outer at 1, then the outer ones, which so stay at 1 unless an inner one ended on a bound, or
    has fewer channels. A fit should hold one of the two.

    Runs under jit, and under vmap over the values of samples.

    **Raises:** ValueError for a count below 1, nothing trainable, a trainable parameter that is neither an amplitude
    nor has a search range, channels that differ from those of the samples.
    """
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    free, held = eqx.partition(template, chosen(template, trainable))
    return _guesses(free, held, samples.cleared(), mapping, count)


@eqx.filter_jit
def _guesses(free: Any, held: Any, samples: Samples, mapping: AbstractMapping, count: int) -> AbstractBRDF:
    unknowns, structure = _unknowns(free), jax.tree.structure(free)
    misfit = SampleMisfit(samples, mapping)
    eqx.filter_eval_shape(misfit, eqx.combine(free, held))  # refuses other channels than those of the samples
    dtype = samples.value.dtype
    # The slope of the mapping at the data turns the misfit into one that is linear in ρ, and root weights into rows.
    _, slope = jax.jvp(
        lambda rho: mapping(rho, samples.wi, samples.wo), (samples.value,), (jnp.ones_like(samples.value),)
    )
    rows = slope * jnp.sqrt(samples.weight)[:, None]
    data = rows * samples.value

    def assemble(leaves):
        typed = [leaf.astype(unknown.dtype) for leaf, unknown in zip(leaves, unknowns, strict=True)]
        return eqx.combine(jax.tree.unflatten(structure, typed), held)

    def solve(candidate):
        shapes = iter(candidate)
        leaves = [jnp.full(u.shape, 1 if u.amplitude else next(shapes), dtype) for u in unknowns]
        loss = None
        for group in _groups(unknowns):

            def predicted(values, leaves=tuple(leaves), group=group):
                at = dict(zip(group, values, strict=True))
                model = assemble([jnp.full_like(leaf, at[k]) if k in at else leaf for k, leaf in enumerate(leaves)])
                return rows * model(samples.wi, samples.wo)

            rest = predicted(jnp.zeros(len(group), dtype))
            columns = jax.vmap(predicted)(jnp.eye(len(group), dtype=dtype)) - rest[None]
            amplitudes, loss = _box_least_squares(columns, rest, data, [unknowns[k] for k in group])
            for k, amplitude in zip(group, amplitudes, strict=True):
                leaves[k] = amplitude
        if loss is None or not mapping.linear:
            loss = half_square(misfit(assemble(leaves)))
        return leaves, loss

    points = _spread(sum(not u.amplitude for u in unknowns), max(FEWEST_CANDIDATES, CANDIDATES_PER_GUESS * count))
    # Of many materials on the same directions the columns are the same, the misfit is not: so candidates compete by
    # what least squares says of it, a difference of large numbers, and only those that are left by the misfit itself.
    leaves, losses = jax.lax.map(solve, jnp.asarray(_in_ranges(points, unknowns), dtype))
    kept = _best_distinct(losses, points, min(max(count, SHORTLIST), len(points)))
    true = jax.lax.map(lambda k: half_square(misfit(assemble([leaf[k] for leaf in leaves]))), kept)
    kept = kept[jnp.argsort(true)][:count]

    def spread_out(leaf):
        return jnp.broadcast_to(leaf, (kept.size, *leaf.shape)) if eqx.is_inexact_array(leaf) else leaf

    guesses = [leaf[kept].astype(u.dtype) for leaf, u in zip(leaves, unknowns, strict=True)]
    return eqx.combine(jax.tree.unflatten(structure, guesses), jax.tree.map(spread_out, held))


class _Unknown(NamedTuple):
    """A trainable leaf; `owner` is the path of the module whose field it is."""

    name: str
    owner: KeyPath
    shape: tuple[int, ...]
    dtype: Any
    bounds: tuple[float, float]
    amplitude: bool
    search: tuple[float, float]
    logarithmic: bool


def _unknowns(free: Any) -> list[_Unknown]:
    unknowns = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(free):
        owner, metadata = declaration(free, path)
        low, high = metadata.get("bounds", (-np.inf, np.inf))
        amplitude, search = metadata.get("amplitude", False), metadata.get("search") or (low, high)
        if not (amplitude or np.all(np.isfinite(search))):
            raise ValueError(
                f"{path_name(path)} is no amplitude and has no finite range to be searched: declare one by "
                "bounded(low, high, search=(from, to)), or hold it by `trainable`"
            )
        if amplitude and len(leaf.shape) > 1:
            raise ValueError(f"the amplitude {path_name(path)} must be () or (channels,), got {leaf.shape}")
        unknowns.append(
            _Unknown(
                path_name(path), owner, leaf.shape, leaf.dtype, (low, high), amplitude, search,
                metadata.get("logarithmic", False),
            )
        )  # fmt: skip
    return unknowns


def _groups(unknowns: list[_Unknown]) -> list[list[int]]:
    """Sets of amplitudes in which ρ is linear, to be solved in turn: cuts through the tree, innermost first.

    An amplitude multiplies those of the modules inside its own. A cut at a depth holds the amplitudes of that depth,
    and those less deep that multiply none.
    """
    own = {k: u.owner for k, u in enumerate(unknowns) if u.amplitude}

    def inside(inner, outer):
        return len(inner) > len(outer) and inner[: len(outer)] == outer

    depth = {k: len({o for o in own.values() if inside(owner, o)}) for k, owner in own.items()}
    multiplies = {k: any(inside(o, owner) for o in own.values()) for k, owner in own.items()}
    levels = range(max(depth.values(), default=-1), -1, -1)
    return [[k for k in own if depth[k] == level or (depth[k] < level and not multiplies[k])] for level in levels]


def _box_least_squares(
    columns: Float[Array, "amplitudes n channels"],
    rest: Float[Array, "n channels"],
    data: Float[Array, "n channels"],
    amplitudes: list[_Unknown],
) -> tuple[list[Array], Float[Array, ""]]:
    """The amplitudes x in their boxes that minimise ½|Σ x columns + rest - data|², and that minimum.

    By coordinate descent on the Gram matrix.
    """
    every = jnp.concatenate([columns, rest[None]])
    grams = jnp.einsum("anc,bnc->abc", every, every, precision="highest")
    rights = jnp.einsum("anc,nc->ac", every, data, precision="highest")
    gram, right = grams[:-1, :-1], rights[:-1] - grams[:-1, -1]
    channels = data.shape[1]

    def sweep(_, x):
        for a, unknown in enumerate(amplitudes):
            top = right[a] - jnp.sum(gram[a] * x, axis=0) + gram[a, a] * x[a]
            bottom = gram[a, a]
            if unknown.shape != (channels,):  # one number for all channels
                top, bottom = (jnp.broadcast_to(jnp.sum(part), channels) for part in (top, bottom))
            # A lobe too narrow for any sample to see has no column.
            best = jnp.where(bottom > 0, top / jnp.where(bottom > 0, bottom, 1), 0)
            x = x.at[a].set(jnp.clip(best, *unknown.bounds))
        return x

    x = jax.lax.fori_loop(0, SWEEPS, sweep, jnp.zeros_like(right))
    whole = jnp.concatenate([x, jnp.ones((1, channels), x.dtype)])
    product = jnp.sum(grams * whole[None], axis=1)  # Gram matrix times x, by channel
    loss = (jnp.sum(data * data) + jnp.sum(whole * (product - 2 * rights))) / 2
    found = [x[a] if u.shape == (channels,) else jnp.full(u.shape, x[a, 0]) for a, u in enumerate(amplitudes)]
    return found, loss


def _spread(dimensions: int, count: int) -> np.ndarray:
    """Evenly spread points of the unit cube, `(count, dimensions)`; one where there is no dimension.

    The Kronecker sequence frac(1/2 + k a), a_j = g^-j, g the root of g^(dimensions + 1) = g + 1, the golden ratio in
    one dimension. Every prefix is spread evenly, as of Sobol's or Halton's sequence, and it needs no tables.

    Source: Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018.
    """
    if dimensions == 0:
        return np.zeros((1, 0))
    g = 2.0
    for _ in range(60):  # each brings g nearer by more than a half
        g = (1 + g) ** (1 / (dimensions + 1))
    steps = g ** -np.arange(1.0, dimensions + 1)
    return (0.5 + np.arange(count)[:, None] * steps) % 1


def _in_ranges(points: np.ndarray, unknowns: list[_Unknown]) -> np.ndarray:
    """Points of the unit cube as shape parameters in their search ranges."""
    out = np.empty_like(points)
    for j, unknown in enumerate(u for u in unknowns if not u.amplitude):
        low, high = unknown.search
        x = points[:, j]
        out[:, j] = low * (high / low) ** x if unknown.logarithmic else low + (high - low) * x
    return out


def _best_distinct(losses: Float[Array, " candidates"], points: np.ndarray, count: int) -> Int[Array, " count"]:
    """Indices of the best candidates that are no neighbours, best first; neighbours where there are too few others.

    Neighbours are nearer than the side of a cube of 1/(2 count) of the volume: `count` neighbourhoods fill the unit
    cube at most about half.
    """
    reach = (0.5 / count) ** (1 / max(points.shape[1], 1)) / 2
    near = jnp.asarray(np.max(np.abs(points[:, None] - points[None, :]), axis=-1, initial=0) < reach)
    losses = jnp.where(jnp.isfinite(losses), losses, jnp.finfo(losses.dtype).max / 4)

    def pick(taken, _):
        taken_or_near = taken | jnp.any(near & taken[:, None], axis=0)
        # Lexicographic: those free of neighbours first, among them the best.
        first = jnp.lexsort((losses, taken_or_near, taken))[0]
        return taken.at[first].set(True), first

    _, kept = jax.lax.scan(pick, jnp.zeros(losses.size, bool), length=count)
    return kept[jnp.argsort(losses[kept])]
