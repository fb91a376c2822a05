"""Physically valid coefficients: the closed form under constraints, with its certificate and its derivative.

The derivative is that of the implicit function theorem for the optimum with the inequalities that shape it held as
equations, and with their points held at minima: for coefficients c, multipliers λ and points x,

    gradient(c) + Σ λ_j row(x_j) = 0,     row(x_j) · c = floor(x_j),     ∇_x (row(x_j) · c - floor(x_j)) = 0.

The points move with the data, and that is of first order in dc: without the third line gradients are wrong.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._typing import Array, Float
from hshjax.bases import AbstractPairBasis
from hshjax.bases._base import matmul
from hshjax.brdfs._linear import EXPONENTS, Target
from hshjax.fitting._certificate import Certificate, certify
from hshjax.fitting._constraints import CONSTRAINTS, Family, families, horizon_equations, interior, vanishes
from hshjax.fitting._exchange import Active, Exchange
from hshjax.fitting._least_distance import InfeasibleError
from hshjax.fitting._search import follow

LARGEST_LIFT = 0.01
"""The largest constant BRDF [sr^-1] that may be added to an optimum, to make up for what its last round left over."""

SAFETY = 1.5
"""How much more than what was found is made up for: there is something between any directions."""


@dataclass(frozen=True)
class Problem:
    """What is to be solved, but for its numbers.

    `gradient(parameters, coefficients)`, `(modes, channels)`: minus the gradient of half the squared error, linear in
    the coefficients; 0 at the optimum without constraints.
    """

    basis: AbstractPairBasis
    target: Target
    constraints: tuple[str, ...]
    rounds: int
    gradient: Callable[[Any, Array], Array]

    def families(self, dtype: np.dtype) -> tuple[Family, ...]:
        return families(self.basis, EXPONENTS[self.target], self.constraints, dtype)

    def equations(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Orthonormal rows E of E c = 0, and an orthonormal basis of the c that they leave; None without equations."""
        return _split(self.basis) if vanishes(EXPONENTS[self.target], self.constraints) else None


class Shape(eqx.Module):
    """What shapes a channel, for every family: points `(m, d)` at minima, and multipliers `(m,)`."""

    x: tuple[Array, ...]
    multiplier: tuple[Array, ...]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def constrained(
    problem: Problem, parameters: Any, start: Float[Array, "modes channels"], root: Float[Array, "modes modes"]
) -> tuple[Float[Array, "modes channels"], tuple[Shape, ...], Certificate]:
    """argmin |root (c - start)|² in the constraints, what shapes each channel, and the certificate.

    `start` and `root` (upper triangular) are those that `parameters` lead to: `start` is where the gradient is 0, and
    rootᵀ root its derivative.

    **Raises:** ValueError under `jax.jit` or `jax.vmap`, and where nothing in the span satisfies the constraints.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((parameters, start, root))):
        raise ValueError(
            "constraints are met by looking at the values, which jax.jit and jax.vmap hide: call `project` outside of "
            "them (jax.grad and jax.jvp work there; several materials on the same directions are channels)"
        )
    dtype = np.dtype(start.dtype)
    begin = np.asarray(start, np.float64)
    # Rounding to nearest moves every coefficient by eps/2 of itself at most; the constrained ones are no larger than
    # twice those without constraints.
    rounding = float(jnp.finfo(dtype).eps) * np.linalg.norm(begin, axis=0)
    equations = problem.equations()
    with jax.enable_x64(True):
        try:
            exchange = Exchange(
                problem.families(dtype),
                np.asarray(root, np.float64),
                begin,
                None if equations is None else equations[1],
                rounding,
            )
            certificate = _until_certified(problem, exchange, dtype)
        except InfeasibleError as error:
            raise ValueError(
                f"no series of {problem.basis} for the target {problem.target!r} satisfies {problem.constraints}: "
                "raise its order"
            ) from error
        shapes = tuple(_shape(exchange, c, dtype) for c in range(begin.shape[1]))
        return jnp.asarray(exchange.coefficients, dtype), shapes, certificate


def _until_certified(problem: Problem, exchange: Exchange, dtype: np.dtype) -> Certificate:
    def look(lift):
        kept = exchange.coefficients.astype(dtype).astype(np.float64)
        active = tuple(sum(a.multiplier.size for a in channel.active) for channel in exchange.channels)
        return certify(problem.basis, kept, problem.target, problem.constraints, dtype, exchange.rounds, active, lift)

    none = np.zeros(len(exchange.channels))
    while True:
        while not exchange.settled and exchange.rounds < problem.rounds:
            exchange.round()
        certificate, found = look(none)
        if certificate.holds:
            return certificate
        if exchange.rounds >= problem.rounds:
            break
        exchange.add([found[name] for name in CONSTRAINTS if name in problem.constraints])
    # What the last round left over: a constant on top, and a factor for what it adds to the albedo.
    lift = none
    if "non_negative" in problem.constraints:
        lift = SAFETY * np.maximum(-found["non_negative"].lowest, 0)
    if np.any(lift > LARGEST_LIFT):
        return certificate
    inside = interior(problem.basis, EXPONENTS[problem.target], problem.constraints)
    exchange.coefficients = exchange.coefficients + lift * inside[:, None]
    if "energy" in problem.constraints:
        gap = found["energy"].lowest
        albedo = 1 - gap + (SAFETY - 1) * np.maximum(-gap, 0) + np.pi * lift
        exchange.coefficients = exchange.coefficients / np.maximum(albedo, 1)
    return look(lift)[0]


def _shape(exchange: Exchange, c: int, dtype: np.dtype) -> Shape:
    """Active points at the minima that they stand by, each minimum once."""
    points, multipliers = [], []
    active = exchange.channels[c].active or [
        Active(np.zeros((0, grid.spacing.size)), np.zeros(0)) for grid in exchange.grids
    ]
    for grid, (x, multiplier) in zip(exchange.grids, active, strict=True):
        minima = follow(grid.family, exchange.coefficients[:, c], exchange.rounding[c], x, grid.spacing / 20, steps=4).x
        if grid.family.swaps and minima.shape[1] == 3:
            turned = minima[:, [1, 0, 2]] * [1, 1, 1 if not grid.family.periodic[2] else -1]
            minima = np.where(minima[:, :1] > minima[:, 1:2], turned, minima)
        _, first, which = np.unique(
            np.round(minima / (1e-2 * grid.spacing)), axis=0, return_index=True, return_inverse=True
        )
        points.append(jnp.asarray(minima[first], dtype))
        multipliers.append(jnp.asarray(np.bincount(which.ravel(), multiplier, len(first)), dtype))
    return Shape(tuple(points), tuple(multipliers))


@constrained.defjvp
def _(problem, primals, tangents):
    parameters, start, root = primals
    coefficients, shapes, certificate = constrained(problem, parameters, start, root)
    force = jax.jvp(lambda p: problem.gradient(p, coefficients), (parameters,), (tangents[0],))[1]
    hessian = _hessian(problem, parameters, coefficients)
    found = [_sensitivity(problem, hessian, coefficients[:, c], shape, force[:, c]) for c, shape in enumerate(shapes)]
    tangent = jnp.stack([d for d, _ in found], axis=1)
    still = jax.tree.map(jnp.zeros_like, certificate)
    return (coefficients, shapes, certificate), (tangent, tuple(shape for _, shape in found), still)


def _hessian(problem: Problem, parameters: Any, coefficients: Array) -> Float[Array, "modes modes"]:
    def column(unit):
        tangent = jnp.zeros_like(coefficients).at[:, 0].set(unit)
        return -jax.jvp(partial(problem.gradient, parameters), (coefficients,), (tangent,))[1][:, 0]

    return jax.vmap(column, out_axes=1)(jnp.eye(coefficients.shape[0], dtype=coefficients.dtype))


def _sensitivity(
    problem: Problem, hessian: Array, coefficients: Array, shape: Shape, force: Array
) -> tuple[Array, Shape]:
    """dc, and how points and multipliers move, for a change `force` of the gradient."""
    dtype, n = coefficients.dtype, coefficients.size
    known = problem.families(np.dtype(dtype))
    equations = problem.equations()
    held = [jnp.zeros((0, n), dtype) if equations is None else jnp.asarray(equations[0], dtype)]
    moves = []
    for family, x, multiplier in zip(known, shape.x, shape.multiplier, strict=True):
        rows, slopes, response = _local(family, x, coefficients)
        hessian = hessian + jnp.einsum("j,jnd,jde,jme->nm", multiplier, slopes, response, slopes, precision="highest")
        held.append(rows)
        moves.append((slopes, response))
    matrix = jnp.concatenate(held)
    count = matrix.shape[0]
    size = jnp.linalg.norm(matrix, axis=1, keepdims=True)
    matrix = matrix / size
    # Merged points may leave rows that depend on each other: a trace of compliance chooses among their multipliers.
    compliance = 10 * jnp.finfo(dtype).eps * jnp.eye(count, dtype=dtype) / jnp.trace(hessian) * n
    system = jnp.block([[hessian, -matrix.T], [matrix, compliance]])
    solution = jnp.linalg.solve(system, jnp.concatenate([force, jnp.zeros(count, dtype)]))
    tangent, forces = solution[:n], solution[n:] / size[:, 0]
    ends = np.cumsum([0 if equations is None else len(equations[0]), *(len(x) for x in shape.x)])
    d_multiplier = tuple(forces[a:b] for a, b in pairwise(ends))
    d_x = tuple(-jnp.einsum("jde,jne,n->jd", response, slopes, tangent) for slopes, response in moves)
    return tangent, Shape(d_x, d_multiplier)


@partial(jax.jit, static_argnums=0)
def _local(family: Family, x: Array, coefficients: Array) -> tuple[Array, Array, Array]:
    """At active points: rows `(m, n)`, their derivative `(m, n, d)`, and the inverse of the gap's Hessian `(m, d, d)`.

    Coordinates that rest on a face of the box do not move, and neither do those that mean nothing, as φ at the pole.
    """
    lower, upper = (jnp.asarray(corner, x.dtype) for corner in family.box)
    near = 1e-6 * (upper - lower)
    free = jnp.asarray(family.periodic)[None] | ((x > (lower + near)[None]) & (x < (upper - near)[None]))

    def row(point):
        return family.rows(point[None])[0]

    def gap(point):
        return matmul(row(point), coefficients) - family.floor(point[None])[0]

    def at(point, moves):
        slope = jnp.where(moves, jax.jacfwd(row)(point), 0)
        both = moves[:, None] & moves[None, :]
        unit = jnp.eye(point.size, dtype=point.dtype)
        curvature = jnp.where(both, jax.hessian(gap)(point), 0)
        rest = jnp.where(moves, 0, unit) + 1e-9 * unit * (1 + jnp.trace(curvature))
        return row(point), slope, jnp.linalg.inv(curvature + rest)

    return jax.vmap(at)(x, free)


@lru_cache
def _split(basis: AbstractPairBasis) -> tuple[np.ndarray, np.ndarray]:
    equations = horizon_equations(basis)
    _, size, right = np.linalg.svd(equations)
    rank = int(np.sum(size > 1e-10 * size[0]))
    return right[:rank], right[rank:].T
