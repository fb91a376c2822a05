"""Published fits of analytic models to the MERL materials: their parameters, and the models that these belong to.

Which normalisation the parameters mean was settled on the networks that stand in for the materials: over the half of
them that a model fits best, the factor of its lobe that brings the least error is 1 / π for ABC, and 1 / π² for SGD.
"""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from hshjax import ABC, AbstractBRDF, DielectricFresnel
from hshjax._typing import Array, Float
from hshjax.geometry import half_vector

Parameters = dict[str, np.ndarray]


def read_parameters(path: Path) -> dict[str, Parameters]:
    """The rows of a table by material; columns name_r, name_g, name_b become one array `(3,)`."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    found = {}
    for row in rows:
        name = row.pop("material")
        stems = dict.fromkeys(key.removesuffix("_r").removesuffix("_g").removesuffix("_b") for key in row)
        found[name] = {
            stem: np.array([float(row[f"{stem}_{c}"]) for c in "rgb"] if stem not in row else float(row[stem]))
            for stem in stems
        }
    return found


def abc(row: Parameters) -> ABC:
    """Nine numbers. Source: the supplement of Löw et al. 2012, see `hshjax.ABC`."""
    return ABC(row["kd"], row["A"], row["B"], row["C"], DielectricFresnel(row["ior"]))


def shifted_gamma(row: Parameters) -> "ShiftedGamma":
    """Thirty-three numbers; how far each was from its material, a column too, is left out."""
    return ShiftedGamma(*(jnp.asarray(row[key]) for key in COLUMNS))


COLUMNS = ("rhoD", "rhoS", "alpha", "p", "kap", "F0", "F1", "lambda", "c", "k", "theta0")


class ShiftedGamma(AbstractBRDF):
    """ρ = diffuse / π + specular F D G1(θ_i) G1(θ_o) / (π z_i z_o), each channel by itself: all fields `(channels,)`.

        D = norm exp(-x) / (π x^power cos⁴θ_h), x = α + tan²θ_h / α    (norm = 1 / (α Γ(1 - power, α)))
        F = f0 - f1 z_d + (1 - f0) (1 - z_d)^5
        G1 = 1 + weight (1 - exp(rate max(θ - start, 0)^steepness)), at least 0

    Source: Bagher, Soler, Holzschuch, Accurate Fitting of Measured Reflectances Using a Shifted Gamma Micro-facet
    Distribution, Computer Graphics Forum 31(4), 2012.
    """

    diffuse: Float[Array, " channels"]
    specular: Float[Array, " channels"]
    alpha: Float[Array, " channels"]
    power: Float[Array, " channels"]
    norm: Float[Array, " channels"]
    f0: Float[Array, " channels"]
    f1: Float[Array, " channels"]
    weight: Float[Array, " channels"]
    rate: Float[Array, " channels"]
    steepness: Float[Array, " channels"]
    start: Float[Array, " channels"]

    def formula(self, wi, wo):
        lead = (1,) * (wi.ndim - 1) + (-1,)
        own = {name: jnp.reshape(value, lead) for name, value in vars(self).items()}
        zi, zo, h = wi[..., 2:], wo[..., 2:], half_vector(wi, wo)
        tan2 = jnp.sum((h[..., :2] / h[..., 2:]) ** 2, axis=-1, keepdims=True)
        x = own["alpha"] + tan2 / own["alpha"]
        facets = own["norm"] * jnp.exp(-x - own["power"] * jnp.log(x)) * (1 + tan2) ** 2 / jnp.pi
        z_d = jnp.sum(wi * h, axis=-1, keepdims=True)
        fresnel = own["f0"] - own["f1"] * z_d + (1 - own["f0"]) * (1 - z_d) ** 5

        def seen(z):
            beyond = jnp.maximum(jnp.arccos(z) - own["start"], 0)
            return jnp.clip(1 - own["weight"] * jnp.expm1(own["rate"] * beyond ** own["steepness"]), 0, 1)

        lobe = fresnel * facets * seen(zi) * seen(zo) / (jnp.pi * zi * zo)
        return own["diffuse"] / jnp.pi + own["specular"] * lobe
