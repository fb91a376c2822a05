"""Lambert's law: against numpy's least squares, and on what its variants are for."""

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax.io import read_photographs
from hshjax.stereo import angular_errors, lambertian
from tests.stereo.cases import ball, changed

MATTE = hshjax.Lambert(jnp.asarray([0.6, 0.3, 0.1]))


def errors(photographs, method):
    return angular_errors(lambertian(photographs, method).normals, photographs.truth)


def test_least_squares_are_those_of_numpy():
    photographs = ball(lights=9)
    directions = np.asarray(photographs.lights.direction, float)
    expected = np.linalg.lstsq(directions, photographs.values[..., 0].T.astype(float), rcond=None)[0].T
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    found = lambertian(photographs, "least squares")
    assert np.max(angular_errors(found.normals, expected)) < 0.01


@pytest.mark.parametrize("method", ["least squares", "robust", "band"])
def test_a_matte_surface_without_shadows_is_exact(method):
    photographs = ball(MATTE)
    lit = np.all(photographs.values[..., 0] > 0.15 * photographs.values[..., 0].max(axis=1, keepdims=True), axis=1)
    found = lambertian(photographs, method)
    assert lit.sum() > 100
    assert np.max(angular_errors(found.normals, photographs.truth)[lit]) < 0.05
    np.testing.assert_allclose(found.albedo[lit], np.broadcast_to([0.6, 0.3, 0.1], (lit.sum(), 3)), rtol=1e-3)


def test_shadows_do_not_bend_the_others():
    photographs = ball(MATTE)
    assert np.mean(errors(photographs, "least squares")) > 2 * np.mean(errors(photographs, "robust"))


def test_highlights_do_not_bend_the_band():
    photographs = ball(hshjax.Lambert(0.4) + hshjax.GGX(0.15, 0.2), lights=24)
    assert np.mean(errors(photographs, "least squares")) > 1.5 * np.mean(errors(photographs, "band"))


def test_what_is_not_determined_is_not_a_number():
    photographs = ball()
    values = photographs.values.copy()
    values[3] = np.nan
    values[5] = 0
    found = lambertian(changed(photographs, values), "least squares")
    assert np.all(np.isnan(found.normals[[3, 5]]))
    assert np.all(np.isnan(found.albedo[[3, 5]]))
    assert np.all(np.isfinite(np.delete(found.normals, [3, 5], axis=0)))


def test_other_methods_are_refused(unchecked):
    with pytest.raises(ValueError, match="method must be one of least squares, robust, band, got 'median'"):
        lambertian(ball(size=12, lights=6), "median")


@pytest.mark.parametrize(("name", "expected"), [("ball", 3.78), ("cat", 8.41), ("reading", 19.08)])
def test_diligent(data, name, expected):
    """Published figures are 4.09, 8.41 and 19.78, with saturated values and a clip; here those are dropped."""
    photographs = read_photographs(data / "diligent" / f"{name}PNG")
    assert np.nanmean(errors(photographs, "least squares")) == pytest.approx(expected, abs=0.02)
