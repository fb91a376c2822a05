"""Lights one by one: what they send, from where, and what they refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import SphericalHarmonics
from hshjax.brdfs import GGX, Lambert
from hshjax.geometry import frame
from hshjax.lighting import DirectionalLight, EnvironmentMap, HarmonicLight, MaskedLight, PointLight, Points
from hshjax.reflectance import reflect
from tests.helpers import DTYPE, X64, assert_close, directions

SOFT = 1e-10 if X64 else 1e-4
"""Least squares over some thousand pixels, solved by normal equations."""


def points(n=3, *, positions=True):
    position = jnp.arange(3.0 * n, dtype=DTYPE).reshape(n, 3) / 7
    return Points(frame(directions(0, n)), position if positions else None, jnp.arange(n), (n,))


def coefficients(order, channels=2):
    return jnp.asarray(np.random.default_rng(1).normal(size=((order + 1) ** 2, channels)), DTYPE)


def test_a_directional_light_does_not_mind_the_length_of_its_direction():
    light = DirectionalLight(jnp.asarray([0, 3.0, 4.0], DTYPE), jnp.asarray([1.0, 2.0], DTYPE))
    incident = light.incident(points())
    assert_close(incident.direction, [[[0, 0.6, 0.8]]])
    assert_close(incident.irradiance, [[[1, 2]]])


def test_a_point_light_falls_with_the_square_of_the_distance():
    light = PointLight(jnp.asarray([0.0, 0.0, 2.0], DTYPE), 8.0)
    at = Points(frame(directions(0, 2)), jnp.asarray([[0.0, 0, 0], [0, 0, 1.5]], DTYPE), jnp.arange(2), (2,))
    incident = light.incident(at)
    assert_close(incident.irradiance[:, 0, 0], [2, 32])
    assert_close(incident.direction[:, 0], [[0, 0, 1], [0, 0, 1]])


def test_pixels_of_an_environment_fill_the_sphere():
    light = EnvironmentMap(jnp.ones((6, 9, 1), DTYPE), up="z")
    assert_close(9 * np.sum(light.solid_angle), 4 * np.pi)
    assert_close(np.linalg.norm(light.direction, axis=-1), np.ones((6, 9)))
    assert_close(jnp.sum(light.incident(points()).irradiance), 4 * np.pi)


@pytest.mark.parametrize(("up", "first", "quarter"), [("z", [0, 1, 0], [1, 0, 0]), ("y", [0, 0, -1], [1, 0, 0])])
def test_columns_run_to_the_right_and_rows_down(up, first, quarter):
    """On the horizon, between the two middle rows; columns -1/2 and width/4 - 1/2."""
    light = EnvironmentMap(jnp.zeros((2, 400, 1), DTYPE), up=up)
    horizon = light.direction.mean(axis=0)
    horizon /= np.linalg.norm(horizon, axis=-1, keepdims=True)
    step = 2 * np.pi / 400
    assert_close(horizon[0], first, tolerance=step)
    assert_close(horizon[100], quarter, tolerance=step)
    assert light.direction[0, 0] @ {"z": [0, 0, 1], "y": [0, 1, 0]}[up] > 0


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_map_is_what_it_is_at_the_centres_of_its_pixels(up):
    radiance = jnp.asarray(np.random.default_rng(0).uniform(size=(5, 8, 3)), DTYPE)
    light = EnvironmentMap(radiance, up=up)
    assert_close(light(jnp.asarray(light.direction, DTYPE)), radiance, tolerance=1e-10 if X64 else 1e-4)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_map_has_derivatives_straight_up_and_down(up):
    light = EnvironmentMap(jnp.asarray(np.random.default_rng(0).normal(size=(4, 8, 1)), DTYPE), up=up)
    for w in ([0, 0, 1.0], [0, 0, -1], [0, 1, 0], [0, -1, 0]):
        assert np.all(np.isfinite(jax.grad(lambda w: light(w)[0])(jnp.asarray(w, DTYPE))))


def test_a_map_is_linear_between_centres_and_closed_around():
    radiance = jnp.asarray(np.random.default_rng(0).uniform(size=(4, 6, 1)), DTYPE)
    light = EnvironmentMap(radiance, up="z")
    theta, turn = np.pi * 1.5 / 4, 0.0  # the centre of row 1, between the last column and the first
    w = jnp.asarray([np.sin(theta) * np.sin(turn), np.sin(theta) * np.cos(turn), np.cos(theta)], DTYPE)
    assert_close(light(w), (radiance[1, 0] + radiance[1, 5]) / 2, tolerance=1e-10 if X64 else 1e-5)
    assert np.all(np.isfinite(light(jnp.asarray([[0, 0, 1.0], [0, 0, -1]], DTYPE))))


def test_a_harmonic_light_is_found_again_in_its_map():
    light = HarmonicLight(coefficients(4))
    empty = EnvironmentMap(jnp.zeros((24, 40, 2), DTYPE), up="y")
    environment = EnvironmentMap(light(jnp.asarray(empty.direction, DTYPE)), up="y")
    found = HarmonicLight.from_environment(environment, 4)
    assert found.order == 4
    assert_close(found.coefficients, light.coefficients, tolerance=SOFT)


def test_a_harmonic_light_is_its_series():
    light, w = HarmonicLight(coefficients(3)), -directions(5, 20)
    assert_close(light(w), SphericalHarmonics(3)(w) @ light.coefficients)
    incident = light.incident(points(2))
    assert_close(jnp.sum(incident.irradiance / light(incident.direction), axis=1), np.full((2, 2), 2 * np.pi))


def test_sums_hold_all_emitters():
    parts = (
        DirectionalLight(jnp.asarray([0, 0, 1.0], DTYPE), jnp.asarray([1.0, 2, 3], DTYPE)),
        PointLight(jnp.asarray([0.0, 0.0, 2.0], DTYPE), 8.0),
        EnvironmentMap(jnp.ones((2, 4, 1), DTYPE), up="z"),
    )
    light = parts[0] + parts[1] + parts[2]
    incident = light.incident(points())
    assert light.emitters == 10
    assert light.needs_positions
    assert incident.direction.shape == (3, 10, 3)
    assert incident.irradiance.shape == (3, 10, 3)
    assert_close(incident.irradiance[:, 1:2], parts[1].incident(points()).irradiance * jnp.ones((3, 1, 3), DTYPE))


def test_a_masked_light_goes_by_pixel_and_emitter():
    visible = jnp.asarray([[0.0, 1], [0.5, 0], [1, 1]], DTYPE)
    one = DirectionalLight(jnp.asarray([0, 0, 1.0], DTYPE), 2.0)
    light = MaskedLight(one + one, visible)
    assert_close(light.incident(points()).irradiance[:, :, 0], 2 * visible)
    some = Points(points().frame, None, jnp.asarray([2, 2, 0]), (3,))
    assert_close(light.incident(some).irradiance[:, :, 0], 2 * visible[jnp.asarray([2, 2, 0])])


def test_many_lights_are_one_vmapped_one():
    many = jax.vmap(DirectionalLight)(directions(0, 4), jnp.ones((4, 1), DTYPE))
    assert_close(jax.vmap(lambda light: light.incident(points()).direction)(many)[:, 0, 0], directions(0, 4))


REFUSED = {
    "a direction in two dimensions": (
        lambda: DirectionalLight(jnp.zeros(2), 1.0),
        r"direction of shape \(3,\), got \(2,\)",
    ),
    "a position for each of two": (
        lambda: PointLight(jnp.zeros((2, 3)), 1.0),
        r"position of shape \(3,\), got \(2, 3\)",
    ),
    "an irradiance of two axes": (
        lambda: DirectionalLight(jnp.zeros(3), jnp.zeros((1, 2))),
        r"shape \(\) or \(channels,\)",
    ),
    "a grey image": (lambda: EnvironmentMap(jnp.zeros((2, 4)), up="z"), r"\(height, width, channels\), got \(2, 4\)"),
    "an unknown axis": (lambda: EnvironmentMap(jnp.zeros((2, 4, 1)), up="x"), "up must be one of y, z, got 'x'"),
    "five harmonics": (lambda: HarmonicLight(jnp.zeros((5, 1))), r"\(\(order \+ 1\)², channels\), got \(5, 1\)"),
    "a negative degree": (lambda: HarmonicLight(jnp.zeros((4, 1)), degree=-1), "degree must be >= 0, got -1"),
    "more orders than pixels": (
        lambda: HarmonicLight.from_environment(EnvironmentMap(jnp.zeros((4, 8, 1)), up="z"), 2),
        "4 x 8 pixels determines orders below 2",
    ),
    "masks of other emitters": (
        lambda: MaskedLight(DirectionalLight(jnp.ones(3), 1.0), jnp.zeros((5, 2))),
        r"visible must have shape \(\*pixels, 1\), one for each emitter, got \(5, 2\)",
    ),
    "a point light without points": (
        lambda: PointLight(jnp.zeros(3), 1.0).incident(points(positions=False)),
        "needs the positions",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, unchecked):
    make, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        make()


def test_a_sum_with_something_else():
    with pytest.raises(TypeError):
        DirectionalLight(jnp.ones(3), 1.0) + 1


@pytest.mark.parametrize("tolerance", [0.1, 0.02])
def test_the_order_that_a_material_tells_apart(tolerance):
    """Not too low: under the series that is chosen, radiance differs by less than asked for; nor much too high."""
    radiance = 1 + jnp.asarray(np.random.default_rng(0).uniform(size=(8, 16, 2)) ** 4, DTYPE)
    environment = EnvironmentMap(jnp.kron(radiance, jnp.ones((4, 4, 1), DTYPE)), up="z")
    light = HarmonicLight.from_environment(environment, tolerance=tolerance)
    normals = jnp.concatenate([directions(0, 50), -directions(1, 50)])
    brdf = Lambert(jnp.ones(1, DTYPE))
    truth = reflect(brdf, environment, normals, normals)

    def error(order):
        found = reflect(brdf, HarmonicLight.from_environment(environment, order), normals, normals)
        return float(jnp.sqrt(jnp.mean((found - truth) ** 2) / jnp.mean(truth**2)))

    assert error(light.order) < tolerance
    assert light.order <= {0.1: 2, 0.02: 6}[tolerance]


def test_sharper_lobes_need_higher_orders():
    environment = EnvironmentMap(jnp.ones((16, 32, 1), DTYPE).at[4:6, 7:10].set(30), up="z")
    order = [HarmonicLight.from_environment(environment, brdf=GGX(1.0, a), tolerance=0.05).order for a in (0.9, 0.6)]
    assert order[0] < order[1]
    with pytest.raises(ValueError, match="order 7, the highest that is tried for a map of 16 x 32 pixels"):
        HarmonicLight.from_environment(environment, brdf=GGX(1.0, 0.05), tolerance=0.01)


def test_masks_of_other_pixels(unchecked):
    light = MaskedLight(DirectionalLight(jnp.ones(3), 1.0), jnp.ones((5, 1)))
    with pytest.raises(ValueError, match=r"visible must have shape \(4, 1\) for these normals, got \(5, 1\)"):
        reflect(Lambert(0.5), light, jnp.ones((4, 3)), jnp.ones(3))
