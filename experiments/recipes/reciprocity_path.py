"""Reciprocity as a penalty, from none to all: the path of a free series towards the Helmholtz fit."""

from typing import Annotated, Any, Literal

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import optimistix as optx
from pydantic import Field

from experiments.config import RecipeConfig
from experiments.recipes._paper import BLUE, RED, plain
from experiments.record import Record
from hshjax import (
    HSH,
    HelmholtzBasis,
    LinearBRDF,
    OrenNayar,
    Reciprocity,
    SampleMisfit,
    Samples,
    TensorBasis,
    fit,
    project,
)
from hshjax.bases import to_matrix


class Config(RecipeConfig):
    recipe: Literal["reciprocity_path"]
    order: Annotated[int, Field(ge=0, le=6, description="order of HSH")] = 2
    samples: Annotated[int, Field(ge=1, description="scattered pairs of directions")] = 4000
    noise: Annotated[float, Field(ge=0, description="relative size of the noise, which is not reciprocal")] = 0.1
    smallest: Annotated[float, Field(description="decimal logarithm of the smallest weight")] = -3.0
    largest: Annotated[float, Field(description="decimal logarithm of the largest weight")] = 11.0
    steps: Annotated[int, Field(ge=2, description="weights, evenly spaced in their logarithm")] = 15


def run(config: Config, record: Record) -> None:
    rows = record.stage("path", _path, config, record)
    last = rows[-1]
    record.paragraph(
        f"{config.samples} samples of an Oren-Nayar surface with {100 * config.noise:g} % of noise, fitted by HSH of "
        f"order {config.order} in norm C: by all products of two functions, {last['coefficients']} coefficients, with "
        "the penalty weight x ||A - Aᵀ||²/2, and by the Helmholtz basis, which is reciprocal by construction. Without "
        f"the penalty the free fit violates reciprocity by {rows[0]['violation']:.2g} of its size; at weight "
        f"{last['weight']:.0e} its coefficients differ from the Helmholtz fit by {last['difference']:.1e} of the "
        "largest of them. The penalty costs one iterative fit for each weight and never quite arrives; the basis costs "
        "one linear solve with half as many unknowns. Both have the same optimum in the limit, as the mathematics asks."
    )
    record.figure(
        "path", _draw(rows),
        "Violation ||A - Aᵀ||/||A|| of the free fit, and its distance to the Helmholtz fit, against the penalty.",
    )  # fmt: skip
    record.table("path", rows, "difference: the largest of any coefficient of A, over the largest coefficient.")
    record.metric("coefficient_difference_at_largest_weight", last["difference"])
    record.metric("violation_without_penalty", rows[0]["violation"])


def _path(config: Config, record: Record) -> list[dict[str, Any]]:
    rng = record.rng("samples")
    wi, wo = (jnp.asarray(_directions(rng, config.samples)) for _ in range(2))
    value = OrenNayar(0.8, 0.3)(wi, wo)
    value = value * (1 + config.noise * rng.standard_normal(value.shape))
    samples = Samples.scattered(wi, wo, value)
    tensor, helmholtz = TensorBasis(HSH(config.order)), HelmholtzBasis(HSH(config.order))
    exact = to_matrix(helmholtz, project(helmholtz, samples, norm="C", reciprocity=False).model.coefficients)
    start = LinearBRDF(tensor, jnp.zeros((tensor.count, 1)))
    # Both terms are linear in the coefficients: Gauss-Newton arrives with its first step and stops after the second.
    solver = optx.GaussNewton(rtol=1e-10, atol=1e-10)
    weights = [0.0, *np.logspace(config.smallest, config.largest, config.steps)]
    rows = []
    for weight in record.progress(weights, "weights"):
        found = fit(start, {"data": SampleMisfit(samples), "reciprocity": weight * Reciprocity()}, solver)
        matrix = to_matrix(tensor, found.model.coefficients)
        rows.append({
            "weight": float(weight), "coefficients": tensor.count, "steps": int(found.steps),
            "data loss": float(found.losses["data"]),
            "violation": float(jnp.linalg.norm(matrix - jnp.swapaxes(matrix, 0, 1)) / jnp.linalg.norm(matrix)),
            "difference": float(jnp.max(jnp.abs(matrix - exact)) / jnp.max(jnp.abs(exact))),
        })  # fmt: skip
    return rows


def _directions(rng: np.random.Generator, n: int) -> np.ndarray:
    z, phi = rng.uniform(0.05, 1, n), rng.uniform(-np.pi, np.pi, n)
    rim = np.sqrt(1 - z * z)
    return np.stack([rim * np.cos(phi), rim * np.sin(phi), z], axis=1)


def _draw(rows):
    figure, ax = plt.subplots(figsize=(5, 3.4))
    path = [row for row in rows if row["weight"] > 0]
    for key, color, marker in (("violation", BLUE, "s"), ("difference", RED, "o")):
        ax.loglog(
            [r["weight"] for r in path], [r[key] for r in path], color=color, marker=marker, ms=4, lw=1.2, label=key
        )
    ax.set_xlabel("weight of the penalty")
    ax.legend(frameon=False, fontsize=8)
    plain(ax)
    figure.tight_layout()
    return figure
