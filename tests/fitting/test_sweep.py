"""Errors of all orders at once against `project`, order by order."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, SHR, IsotropicBasis, Zernike
from hshjax.fitting import NORMS, IsotropicTable, order_sweep, project
from hshjax.quadrature import PairRule, graded_azimuths, polar_nodes
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, slow_unless

ORDER, POLAR, LEVELS = 3, 12, 1


def smooth(wi, wo):
    """Reciprocal, bilateral, isotropic, and not in any span; two channels."""
    z, cosine = wi[..., 2] * wo[..., 2], wi[..., 0] * wo[..., 0] + wi[..., 1] * wo[..., 1]
    return jnp.stack([jnp.exp(cosine + z), 1 / (2 + z - cosine)], axis=-1)


def same_grid(max_theta):
    """The nodes of `IsotropicTable.from_brdf`: both sums are then the same, and nothing is left to converge."""
    z, dz = polar_nodes(POLAR - 1, sqrt=True)
    edge = math.cos(max_theta)
    z, dz = edge + (1 - edge) * z, (1 - edge) * dz
    phi, dphi = graded_azimuths(LEVELS, ORDER)
    zi, zo, azimuth = (a.ravel() for a in np.meshgrid(z, z, phi, indexing="ij"))
    weight = 2 * np.pi * (dz[:, None, None] * dz[None, :, None] * dphi).ravel()

    def directions(z, phi):
        rim = np.sqrt(1 - z * z)
        return jnp.asarray(np.stack([rim * np.cos(phi), rim * np.sin(phi), z], -1), DTYPE)

    wi, wo = directions(zi, np.zeros_like(zi)), directions(zo, azimuth)
    # Gauss in sqrt(z) and in panels of Δφ: exact for these orders up to rounding.
    return PairRule(wi, wo, jnp.asarray(weight, DTYPE), 2 * ORDER, isotropic=True)


@pytest.fixture(scope="module")
def tables():
    angles = {norm.max_theta for norm in NORMS.values()}
    return {
        angle: IsotropicTable.from_brdf(smooth, ORDER, max_theta=angle, polar=POLAR, levels=LEVELS) for angle in angles
    }


@pytest.mark.parametrize(
    ("family", "norm"),
    [
        slow_unless((family, norm) in ((HSH, "A"), (Zernike, "D")), family, norm)
        for family in (HSH, Zernike, SHR)
        for norm in NORMS
    ],
)
def test_every_order_is_that_of_project(family, norm, tables):
    max_theta = NORMS[norm].max_theta
    errors = order_sweep(family(ORDER), tables[max_theta], norm)
    samples = Samples.from_function(smooth, same_grid(max_theta))
    assert errors.shape == (ORDER + 1, 2)
    for n in range(1, ORDER + 1, 2):
        fit = project(IsotropicBasis(family(n)), samples, norm=norm, reciprocity=False)
        # Both are roots of small differences: 1e-9 of the data's size; in float32 the values are rounded to 1e-7.
        assert_close(fit.relative, errors[n], tolerance=1e-8 if X64 else 1e-4)
    if NORMS[norm].orthonormal is False:
        assert np.all(np.diff(errors, axis=0) <= 1e-12)  # a larger space is never worse in its own norm


def test_what_is_not_reciprocal_or_not_bilateral_counts_as_error(tables):
    def lopsided(wi, wo):
        return (1 + wi[..., 2] - wo[..., 2])[..., None]

    def twisted(wi, wo):
        return (1 + wi[..., 1] * wo[..., 0] - wi[..., 0] * wo[..., 1])[..., None]

    for brdf in (lopsided, twisted):
        table = IsotropicTable.from_brdf(brdf, ORDER, polar=POLAR, levels=LEVELS)
        samples = Samples.from_function(brdf, same_grid(math.pi / 2))
        error = order_sweep(HSH(ORDER), table, "C")[-1]
        fit = project(IsotropicBasis(HSH(ORDER)), samples, norm="C", reciprocity=False)
        assert_close(error, fit.relative, tolerance=1e-8 if X64 else 1e-4)
        assert error > 0.05


def test_a_table_of_another_range_is_refused(tables):
    table = tables[math.pi / 2]
    with pytest.raises(ValueError, match=r"norm E needs a table with max_theta = 1.3963, got 1.5708"):
        order_sweep(HSH(2), table, "E")
    with pytest.raises(ValueError, match=r"norm A needs a table with max_theta = 1.5708, got 1.3963"):
        order_sweep(HSH(2), tables[NORMS["E"].max_theta], "A")


def test_a_table_of_a_lower_order_is_refused(tables):
    with pytest.raises(ValueError, match=r"the table holds orders up to 3, HSH\(order=4\) needs 4"):
        order_sweep(HSH(ORDER + 1), tables[math.pi / 2])


def test_an_unknown_norm_is_refused(tables):
    with pytest.raises(ValueError, match="norm must be one of A, B, C, D, E"):
        order_sweep(HSH(2), tables[math.pi / 2], "F")
