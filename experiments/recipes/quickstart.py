"""The whole path in a minute: the paper's two BRDFs, sampled, fitted by three bases, judged and pictured."""

from typing import Annotated, Literal

import jax.numpy as jnp
from pydantic import Field

import hshjax
from experiments.config import RecipeConfig
from experiments.recipes._material import FitSection, PictureSection, study, verdict
from experiments.record import Record


class Config(RecipeConfig):
    """Parameters of the two BRDFs, and how they are fitted."""

    recipe: Literal["quickstart"]
    specular: Annotated[float, Field(ge=0, le=1, description="Cook-Torrance: weight of the lobe, rho_s")] = 0.458
    slope: Annotated[float, Field(gt=0, le=1, description="Cook-Torrance: rms slope of the facets, m")] = 0.125
    diffuse: Annotated[float, Field(ge=0, le=1, description="Cook-Torrance: albedo of the diffuse part")] = 0.3
    sigma: Annotated[float, Field(ge=0, description="Oren-Nayar: deviation of the facets' angles [rad]")] = 0.3
    albedo: Annotated[float, Field(ge=0, le=1, description="Oren-Nayar: albedo of the facets")] = 0.8
    fit: FitSection = FitSection(orders=(2, 4, 8, 12))
    pictures: PictureSection = PictureSection()


def run(config: Config, record: Record) -> None:
    materials = {
        "Cook-Torrance": hshjax.CookTorrance(
            jnp.asarray([config.diffuse]), jnp.asarray([config.specular]), jnp.asarray(config.slope)
        ),
        "Oren-Nayar": hshjax.OrenNayar(jnp.asarray([config.albedo]), jnp.asarray(config.sigma)),
    }
    record.paragraph(
        "A BRDF lives on pairs of directions. Here two analytic ones are sampled on an exact rule and projected on "
        "reciprocal, isotropic pair bases: products of hemispherical harmonics (HSH, the paper's proposal), of Zernike "
        "functions (its rival), and of spherical harmonics orthonormalised on the hemisphere (SHR, a control with as "
        "many functions as HSH). Every fit is a closed form; there is nothing to tune but the order."
    )
    verdicts = []
    for name, brdf in materials.items():
        record.heading(name)
        rows = study(record, name, brdf, config.fit, config.pictures)
        verdicts.append(verdict(name, rows, config.fit.norm))
    record.heading("What the paper claims, and what was measured")
    record.paragraph(
        "The paper (Elhabian, Rara, Farag) claims that at a given order HSH fit better than Zernike functions. "
        + " ".join(verdicts)
        + " At a given order HSH have about twice as many functions as Zernike, so both counts are in the table. "
        "The Cook-Torrance lobe is narrow: no product basis of these orders follows it, and what is left of the lobe "
        "shows as ringing with negative values. `configs/paper_basis_sweep.toml` holds the comparison at every order."
    )
