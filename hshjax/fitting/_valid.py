"""Physically valid coefficients: the closed form under constraints, with its certificate."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from hshjax._typing import Array, Float
from hshjax.bases import AbstractProductBasis
from hshjax.brdfs._linear import EXPONENTS, Target
from hshjax.fitting._certificate import Certificate, Certifier
from hshjax.fitting._constraints import CONSTRAINTS, families, horizon_equations, interior, vanishes
from hshjax.fitting._exchange import Exchange
from hshjax.fitting._least_distance import InfeasibleError

LARGEST_LIFT = 0.01
"""The largest constant BRDF [sr^-1] that may be added to an optimum, to make up for what its last round left over."""

SAFETY = 1.5
"""How much more than what was found is made up for: there is something between any directions."""


def constrained(
    basis: AbstractProductBasis,
    target: Target,
    constraints: tuple[str, ...],
    rounds: int,
    start: Float[Array, "modes channels"],
    root: Float[Array, "modes modes"],
) -> tuple[Float[Array, "modes channels"], Certificate]:
    """argmin |root (c - start)|² in the constraints, and its certificate; `root` is upper triangular.

    **Raises:** ValueError under a transformation of jax, and where nothing in the span satisfies the constraints.
    """
    if any(isinstance(array, Tracer) for array in (start, root)):
        raise ValueError(
            "constraints are met by looking at the values, which jax.jit, jax.vmap and jax.grad hide: call `project` "
            "outside of them (`project_all` takes many materials), or fit a model that is positive by construction, "
            "such as ExpBRDF"
        )
    dtype = np.dtype(start.dtype)
    begin = np.asarray(start, np.float64)
    # Rounding to nearest moves every coefficient by eps/2 of itself at most; the constrained ones are no larger than
    # twice those without constraints.
    rounding = float(jnp.finfo(dtype).eps) * np.linalg.norm(begin, axis=0)
    exponent = EXPONENTS[target]
    free = _free(basis) if vanishes(exponent, constraints) else None
    with jax.enable_x64(True):
        try:
            exchange = Exchange(
                families(basis, exponent, constraints, dtype), np.asarray(root, np.float64), begin, free, rounding
            )
            certificate = _until_certified(exchange, basis, target, constraints, rounds, dtype)
        except InfeasibleError as error:
            raise ValueError(
                f"no series of {basis} for the target {target!r} satisfies {constraints}: raise its order"
            ) from error
        return jnp.asarray(exchange.coefficients, dtype), certificate


def _until_certified(
    exchange: Exchange,
    basis: AbstractProductBasis,
    target: Target,
    constraints: tuple[str, ...],
    rounds: int,
    dtype: np.dtype,
) -> Certificate:
    certifier = Certifier(basis, target, constraints, dtype)

    def look(lift):
        kept = exchange.coefficients.astype(dtype).astype(np.float64)
        active = tuple(channel.active for channel in exchange.channels)
        return certifier.certify(kept, exchange.rounds, active, lift)

    none = np.zeros(len(exchange.channels))
    while True:
        while not exchange.settled and exchange.rounds < rounds:
            exchange.round()
        certificate, found = look(none)
        if certificate.holds:
            return certificate
        if exchange.rounds >= rounds:
            break
        exchange.add([found[name] for name in CONSTRAINTS if name in constraints])
    # What the last round left over: a constant on top, and a factor for what it adds to the albedo.
    lift = none
    if "non_negative" in constraints:
        lift = SAFETY * np.maximum(-found["non_negative"].lowest, 0)
    if np.any(lift > LARGEST_LIFT):
        return certificate
    inside = interior(basis, EXPONENTS[target], constraints)
    exchange.coefficients = exchange.coefficients + lift * inside[:, None]
    if "energy" in constraints:
        gap = found["energy"].lowest
        albedo = 1 - gap + (SAFETY - 1) * np.maximum(-gap, 0) + np.pi * lift
        exchange.coefficients = exchange.coefficients / np.maximum(albedo, 1)
    return look(lift)[0]


@lru_cache
def _free(basis: AbstractProductBasis) -> np.ndarray:
    """An orthonormal basis of the coefficients whose series vanishes at the horizon."""
    equations = horizon_equations(basis)
    _, size, right = np.linalg.svd(equations)
    rank = int(np.sum(size > 1e-10 * size[0]))
    return right[rank:].T
