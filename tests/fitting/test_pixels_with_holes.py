"""Pixels in which lights are missing: each as `project` fits it alone, on the lights that it has."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, AbstractPairBasis
from hshjax.fitting import TileError, project, project_pixels
from hshjax.fitting._fit_pixels import TOGETHER
from hshjax.samples import Samples
from tests.fitting.test_project_pixels import BASIS, LIGHTS, PIXELS, ROWS, Lazy, expected, photographs
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close

LOOSE = TOLERANCE if X64 else 2e-3
"""Of coefficients over few lights, whose condition number is some hundreds: in float32 that many roundings."""


class OfTheLight(AbstractPairBasis):
    """Functions of wi alone, for `project`."""

    basis: HSH

    @property
    def modes(self):
        return self.basis.modes

    @property
    def count(self):
        return self.basis.count

    def degrees(self):
        return np.array([(n, 0) for n, _ in self.basis.modes])

    @property
    def reciprocal(self):
        return False

    def block_rows(self, wi, wo):
        return self.basis(wi)

    def block_sums(self, coefficients, wi, wo):
        return self.basis.evaluate(coefficients, wi)


def alone(values, weight, **settings):
    """The coefficients of one pixel by `project`, which masks what has no weight."""
    up = jnp.tile(jnp.asarray([0, 0, 1], DTYPE), (len(LIGHTS), 1))
    weight = jnp.asarray(np.where(np.isnan(values).any(axis=1), 0, weight), DTYPE)
    samples = Samples.scattered(jnp.asarray(LIGHTS), up, jnp.asarray(values), weight)
    return project(OfTheLight(BASIS), samples, norm="C", reciprocity=False, **settings).model.coefficients


def with_holes(seed=0, pixels=PIXELS, share=0.3, least=11):
    """Photographs in which some lights are missing, in one channel or another; every third pixel has all."""
    values, rng = photographs(seed, pixels), np.random.default_rng(seed)
    holes = rng.random((pixels, len(LIGHTS))) < share
    holes[::3] = False
    for one in holes:
        one[np.flatnonzero(one)[len(LIGHTS) - least :]] = False
    channel = rng.integers(0, 3, holes.shape)
    values[holes[..., None] & (channel[..., None] == np.arange(3))] = np.nan
    return values


def of_each(values, **settings):
    """One pixel after the other, by the least squares of numpy on the lights that it has."""
    known = ~np.isnan(values).any(axis=2)
    weights = settings.pop("weight", np.ones(len(LIGHTS))) * known
    return np.concatenate(
        [expected(one[None], weight=weight, **settings) for one, weight in zip(values, weights, strict=True)]
    )


@pytest.mark.parametrize("settings", [{}, {"ridge": 0.1, "prior": "spectral"}, {"ridge": 0.01}])
def test_a_pixel_is_fitted_as_by_itself(settings):
    values, weight = with_holes(), np.random.default_rng(1).uniform(0.5, 2, len(LIGHTS))
    weight[3], values[:, 3] = 0, np.nan
    fit = project_pixels(BASIS, LIGHTS, values, weight=weight, rows=40, **settings)
    for pixel in range(0, PIXELS, 17):
        assert_close(fit.coefficients[pixel], alone(values[pixel], weight, **settings), tolerance=LOOSE)
    orders = np.array([n for n, _ in BASIS.modes])
    penalty = (orders * (orders + 1.0)) ** 2 if "prior" in settings else np.ones(BASIS.count)
    gamma = settings["ridge"] * penalty if settings else None
    values[:, 3] = 0  # without weight, and no hole
    assert_close(fit.coefficients, of_each(values, weight=weight, gamma=gamma), tolerance=LOOSE)
    lacking = np.isnan(values).any(axis=(1, 2))
    assert 0 < lacking.sum() < PIXELS
    assert (fit.partial, fit.undetermined) == (lacking.sum(), 0)


def test_the_residual_is_over_the_lights_that_are_known():
    values = with_holes()
    fit = project_pixels(BASIS, LIGHTS, values, rows=40)
    known = ~np.isnan(values).any(axis=2, keepdims=True)
    used = np.where(known, values, 0)
    left = known * (used - np.einsum("lk,pkc->plc", ROWS, fit.coefficients))
    assert_close(fit.residual / np.linalg.norm(used, axis=(0, 1)), fit.relative)
    assert_close(fit.relative, np.linalg.norm(left, axis=(0, 1)) / np.linalg.norm(used, axis=(0, 1)))
    assert_close(fit.condition, project_pixels(BASIS, LIGHTS, photographs()).condition)


@pytest.mark.parametrize(("ridge", "undetermined"), [(0.0, [0, 1, 2, 3]), (0.1, [0])])
def test_pixels_that_their_lights_do_not_determine_are_nan_and_counted(ridge, undetermined):
    """Without a light; with one; with one fewer than functions; with as many on a line, on which some are the same."""
    lights = LIGHTS.copy()
    angle = np.linspace(0, 1.2, 10)
    lights[10:] = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    values = photographs()
    for pixel, there in enumerate([[], [4], range(8), range(10, 20)]):
        values[pixel, np.setdiff1d(np.arange(20), there)] = np.nan
    fit = project_pixels(BASIS, lights, values, ridge=ridge, rows=50)
    nothing = np.isnan(fit.coefficients)
    assert np.flatnonzero(nothing.any(axis=(1, 2))).tolist() == undetermined
    assert nothing[undetermined].all()
    assert (fit.partial, fit.undetermined) == (4, len(undetermined))
    assert np.isfinite([*fit.residual, *fit.relative]).all()
    rest = project_pixels(BASIS, lights, np.delete(values, undetermined, axis=0), ridge=ridge)
    assert_close(fit.residual, rest.residual)
    assert np.isnan(fit.relit(jnp.asarray(lights[0]))).any(axis=1).sum() == len(undetermined)


@pytest.mark.parametrize("pixels", [1, TOGETHER - 1, TOGETHER, TOGETHER + 1])
def test_any_number_of_pixels_with_holes(pixels):
    values = photographs(pixels=pixels)
    values[:, 5, 1] = np.nan
    fit = project_pixels(BASIS, LIGHTS, values)
    weight = np.where(np.arange(len(LIGHTS)) == 5, 0, 1.0)
    assert_close(fit.coefficients, expected(values, weight=weight), tolerance=LOOSE)
    assert fit.partial == pixels


@pytest.mark.parametrize("numbers", [1, 3 * 29 * 12])
def test_large_matrices_come_a_few_at_a_time(numbers, monkeypatch):
    monkeypatch.setattr("hshjax.fitting._fit_pixels.NUMBERS", numbers)
    values = with_holes(pixels=10)
    assert_close(project_pixels(BASIS, LIGHTS, values).coefficients, of_each(values), tolerance=LOOSE)


def test_half_floats_and_photographs_that_are_never_whole():
    values = with_holes().astype(np.float16)
    values[::3, 2] = np.nan
    fit = project_pixels(BASIS, LIGHTS, values)
    assert fit.coefficients.dtype == np.float32
    assert fit.partial == PIXELS
    assert_close(fit.coefficients, of_each(values.astype(np.float32)), tolerance=2e-3)


def undetermined_too():
    values = with_holes()
    values[45, 2:] = np.nan  # in the last tile that is done
    return values


def test_a_run_with_holes_goes_on(tmp_path):
    values, out = undetermined_too(), tmp_path / "out.npy"
    with pytest.raises(OSError, match="the disk is gone"):
        project_pixels(BASIS, LIGHTS, Lazy(values, broken=60), rows=20, out=out, every=0.0)
    file = out.with_name(f".{out.name}.unfinished") / "coefficients.npy"
    for pixel, wrong in ((46, np.nan), (46, 0.5), (45, 0.5)):  # one that lacks lights, and one that is undetermined
        there = np.load(file, mmap_mode="r+")
        before, there[pixel] = there[pixel].copy(), wrong
        there.flush()
        with pytest.raises(TileError, match="tile 2: was done, and out does not hold its fit"):
            project_pixels(BASIS, LIGHTS, values, rows=20, out=out)
        there[pixel] = before
        there.flush()
    source = Lazy(values)
    fit = project_pixels(BASIS, LIGHTS, source, rows=20, out=out)
    assert source.read[1:] == [(40, 60), (60, 80), (80, 100), (100, PIXELS)]
    whole = project_pixels(BASIS, LIGHTS, values)
    np.testing.assert_allclose(fit.coefficients, whole.coefficients, rtol=LOOSE, atol=LOOSE)
    assert (fit.partial, fit.undetermined) == (whole.partial, whole.undetermined)
    assert whole.undetermined == 1
    assert_close(fit.residual, whole.residual)


def test_saturated_photographs_of_an_object(data):
    """Real ones: 4 % of the pixels of the ball have saturated highlights."""
    from hshjax.io import read_diligent

    photographs = read_diligent(data / "diligent" / "ballPNG")
    values = np.asarray(photographs.values, DTYPE)
    lacking = np.flatnonzero(np.isnan(values).any(axis=(1, 2)))
    values = values[lacking] / np.nanmax(values)
    lights = np.asarray(jax.device_get(photographs.lights.direction), np.float64)
    fit = project_pixels(HSH(3), lights, values, ridge=1e-3)
    assert (fit.partial, fit.undetermined) == (len(lacking), 0)
    rows = np.asarray(HSH(3)(jnp.asarray(lights)), np.float64)
    for pixel in range(0, len(lacking), 50):
        known = ~np.isnan(values[pixel]).any(axis=1)
        system = np.concatenate([rows[known], np.sqrt(1e-3) * np.eye(16)])
        right = np.concatenate([values[pixel][known].astype(np.float64), np.zeros((16, 3))])
        assert_close(fit.coefficients[pixel], np.linalg.lstsq(system, right)[0], tolerance=LOOSE)
