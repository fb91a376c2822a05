"""Horizons of height fields, and the shadows that they cast."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.brdfs import Lambert
from hshjax.geometry import frame
from hshjax.lighting import DirectionalLight, EnvironmentMap, Horizon, Points, ShadowedLight
from hshjax.lighting._horizon import NOTHING
from hshjax.reflectance import reflect
from hshjax.surface import height_field
from tests.helpers import DTYPE, assert_close

UP = jnp.asarray([0, 0, 1.0], DTYPE)


def heights(values):
    return jnp.asarray(values, DTYPE)


def rough(rows, columns, seed=0):
    """A smooth field with hills some pixels wide."""
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    waves = np.random.default_rng(seed).normal(size=(12, 3)) * [0.35, 0.35, 9]
    return sum(np.sin(a * row + b * column + c) for a, b, c in waves)


def bilinear(z, row, column):
    """z between its nodes; -inf outside."""
    rows, columns = z.shape
    if not (0 <= row <= rows - 1 and 0 <= column <= columns - 1):
        return -np.inf
    i, j = min(int(row), rows - 2), min(int(column), columns - 2)
    a, b = row - i, column - j
    return (1 - a) * ((1 - b) * z[i, j] + b * z[i, j + 1]) + a * ((1 - b) * z[i + 1, j] + b * z[i + 1, j + 1])


def direction(azimuth, slope):
    w = np.array([np.cos(azimuth), np.sin(azimuth), slope])
    return w / np.linalg.norm(w)


# --- slopes -----------------------------------------------------------------------------------------------------------


def test_a_plain_has_a_flat_horizon_and_nothing_beyond():
    slope = Horizon.from_heights(jnp.ones((5, 7), DTYPE), azimuths=8).slope
    assert slope.shape == (5, 7, 8)
    assert slope.dtype == DTYPE
    assert_close(slope[1:-1, 1:-1], np.zeros((3, 5, 8)))
    assert_close(slope[0, 0], [0, *[NOTHING] * 5, 0, 0])  # top left: open but for +x, -y and between


def test_a_slope_is_a_slope_in_every_direction():
    """Of a plane, up to the border: the horizon is its own inclination."""
    row, column = np.meshgrid(np.arange(9), np.arange(8), indexing="ij")
    slope = Horizon.from_heights(heights(0.5 * (2.0 * column - 3.0 * row)), spacing=0.5, azimuths=64).slope
    azimuth = 2 * np.pi * np.arange(64) / 64
    assert_close(slope[4, 4], 2 * np.cos(azimuth) + 3 * np.sin(azimuth))


@pytest.mark.parametrize("side", range(4))
def test_a_wall_is_as_high_as_it_is_far(side):
    """H/d along the axis, H cos / d aside, whatever the angle to the grid."""
    z = np.zeros((41, 41))
    z[:, 30:] = 3.0
    turned = Horizon.from_heights(heights(np.rot90(z, side)), spacing=0.1, azimuths=48).slope
    slope = np.roll(np.rot90(turned, -side), -side * 12, axis=-1)  # back again
    for column in (10, 24, 29):
        d = 0.1 * (30 - column)
        aside = np.arange(-6, 7)  # up to 45 degrees
        assert_close(slope[20, column, aside], 3 / d * np.cos(aside * 2 * np.pi / 48))
    assert_close(slope[20, 10, 18:31], np.zeros(13))


def test_a_thin_wall_is_seen_at_every_angle():
    z = np.zeros((30, 30))
    z[:, 15] = 1.0
    slope = Horizon.from_heights(heights(z), azimuths=64).slope
    assert_close(slope[15, 12, :14], np.cos(2 * np.pi * np.arange(14) / 64) / 3)


def test_a_cone_from_its_foot():
    """Its apex lies in the directions of the grid's axes and diagonals, seen at height over distance."""
    row, column = np.meshgrid(np.arange(33), np.arange(33), indexing="ij")
    z = np.maximum(0, 10 - np.hypot(row - 16, column - 16))
    slope = Horizon.from_heights(heights(z), azimuths=8).slope
    assert_close(slope[16, 2, 0], 10 / 14)
    assert_close(slope[30, 16, 2], 10 / 14)
    assert_close(slope[2, 30, 5], 10 / (14 * np.sqrt(2)))
    assert_close(slope[16, 16, ::2], np.full(4, -10 / 16))  # from the top, the rim of the field is the horizon


def test_a_hemisphere_is_seen_along_its_tangent():
    """From distance D to the centre, under R / sqrt(D² - R²)."""
    n, spacing = 161, 1 / 40
    x = spacing * (np.arange(n) - n // 2)
    z = np.sqrt(np.maximum(0, 1 - x[:, None] ** 2 - x[None] ** 2))
    slope = Horizon.from_heights(heights(z), spacing=spacing, azimuths=16).slope
    for pixel, azimuth, distance in (((80, 10), 0, 1.75), ((16, 16), 14, 1.6 * np.sqrt(2))):
        assert_close(slope[(*pixel, azimuth)], 1 / np.sqrt(distance**2 - 1), tolerance=2e-3)


def test_against_a_fine_march():
    """Independent: samples a tenth of a pixel apart in the bilinear surface, where the library looks at crossings."""
    z, azimuths = rough(17, 23), 20
    slope = np.asarray(Horizon.from_heights(heights(z), spacing=2.0, azimuths=azimuths).slope)
    for row, column in ((0, 0), (3, 20), (8, 11), (16, 5)):
        for k in range(azimuths):
            angle = 2 * np.pi * k / azimuths
            distance = np.arange(1, 300) / 10
            seen = [
                (bilinear(z, row - d * np.sin(angle), column + d * np.cos(angle)) - z[row, column]) / (2 * d)
                for d in distance
            ]
            # The first cell is left out: there a march sees a slope of its own, where crossings see the chord.
            expected = max((s for s, d in zip(seen, distance, strict=True) if d >= 1), default=-np.inf)
            if np.isfinite(expected):
                assert expected - 0.02 < slope[row, column, k] < max(seen) + 0.02  # of slopes up to 0.9


def test_quarter_turns_and_units_change_nothing():
    z = heights(rough(9, 12))
    slope = Horizon.from_heights(z, azimuths=12).slope
    assert_close(Horizon.from_heights(jnp.rot90(z), azimuths=12).slope, jnp.roll(jnp.rot90(slope), 3, axis=-1))
    assert_close(Horizon.from_heights(3 * z, spacing=3.0, azimuths=12).slope, slope)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1), (2, 2)])
def test_small_fields(shape):
    slope = Horizon.from_heights(jnp.ones(shape, DTYPE), azimuths=4).slope
    expected = np.full((*shape, 4), NOTHING)
    expected[:, :-1, 0] = expected[1:, :, 1] = expected[:, 1:, 2] = expected[:-1, :, 3] = 0
    assert_close(slope, expected)


# --- visibility -------------------------------------------------------------------------------------------------------


def test_light_comes_over_the_horizon_or_not():
    slope = heights([[0.5, 1.0, 0.5, -0.5], [2.0, 2, 2, 2]])  # two pixels, four azimuths
    horizon = Horizon(slope)
    azimuth = np.array([0, 1, 2, 3, 0.5, 2.5, 3.25, 3.5]) * np.pi / 2
    level = np.array([0.5, 1, 0.5, -0.5, 0.75, 0.0, -0.25, 0.0])  # linear in between
    above, below = (
        np.stack([direction(*pair) for pair in zip(azimuth, level + d, strict=True)]) for d in (1e-3, -1e-3)
    )
    w = jnp.asarray(np.stack([above, below]), DTYPE)
    first, second = jnp.zeros(2, int), jnp.ones(2, int)
    assert_close(horizon(w, first), np.repeat([[1], [0]], 8, axis=1))
    assert_close(horizon(w, second), np.zeros((2, 8)))
    assert_close(horizon(w[:1], jnp.asarray([0, 1, 0])), np.repeat([[1], [0], [1]], 8, axis=1))
    assert_close(horizon(jnp.stack([UP, -UP])[None], first[:1]), [[1, 0]])


@pytest.mark.parametrize("azimuth", [0, 30, 45, 90, 200])
def test_a_box_casts_a_shadow_as_long_as_geometry_says(azimuth):
    """A light at 40 degrees: a box of height 8 shades the ground for 8 / tan 40° = 9.5 pixels, away from the light."""
    angle, tangent = np.radians(azimuth), np.tan(np.radians(40))
    z = np.zeros((64, 64))
    z[24:40, 24:40] = 8.0
    surface, horizon = height_field(heights(z)), Horizon.from_heights(heights(z), azimuths=72)
    sun = DirectionalLight(jnp.asarray(direction(angle, tangent), DTYPE), 1.0)
    flat = jnp.broadcast_to(UP, surface.normal.shape)
    dark = np.asarray(reflect(Lambert(0.5), ShadowedLight(sun, horizon), flat, UP))[..., 0] == 0
    row, column = np.meshgrid(np.arange(64), np.arange(64), indexing="ij")

    def shaded(margin):
        """Ground within a box, grown by `margin`, moved along the shadow by up to its length."""
        moved = np.linspace(0, 8 / tangent + margin, 200)
        r, c = (row[..., None] - moved * np.sin(angle), column[..., None] + moved * np.cos(angle))
        inside = (np.abs(r - 31.5) <= 7.5 + margin) & (np.abs(c - 31.5) <= 7.5 + margin)
        return inside.any(axis=-1) & (z == 0)

    assert np.sum(dark) > 100
    assert not np.any(dark & ~shaded(1)), "a shadow where geometry has none"
    assert not np.any(shaded(-1) & ~dark), "light where geometry has none"


def shaded_scene(light):
    z = heights(rough(6, 8))
    return height_field(z), ShadowedLight(light, Horizon.from_heights(z, azimuths=16))


def test_every_emitter_has_its_own_shadow():
    """An environment is the sum of its pixels; a chunk knows which pixels are its own."""
    sky = EnvironmentMap(1 + heights(np.random.default_rng(0).uniform(size=(6, 8, 2))), up="z")
    surface, light = shaded_scene(sky)
    assert light.emitters == 48
    image = reflect(Lambert(0.5), light, surface.normal, UP)
    assert_close(reflect(Lambert(0.5), light, surface.normal, UP, chunk=7), image)
    power = sky.radiance * jnp.asarray(sky.solid_angle, DTYPE)[:, None, None]
    suns = [(w, p) for row in zip(sky.direction, power, strict=True) for w, p in zip(*row, strict=True)]
    total = sum(
        reflect(Lambert(0.5), ShadowedLight(DirectionalLight(heights(w), p), light.horizon), surface.normal, UP)
        for w, p in suns[12:20]
    )
    chosen = (np.arange(48) >= 12) & (np.arange(48) < 20)
    some = EnvironmentMap(jnp.where(chosen.reshape(6, 8, 1), sky.radiance, 0), up="z")
    assert_close(reflect(Lambert(0.5), ShadowedLight(some, light.horizon), surface.normal, UP), total)
    assert jnp.all(image <= reflect(Lambert(0.5), sky, surface.normal, UP) + 1e-6)
    assert jnp.any(image < 0.9 * reflect(Lambert(0.5), sky, surface.normal, UP))


def test_derivatives_by_the_light_are_those_of_what_is_seen():
    surface, light = shaded_scene(DirectionalLight(jnp.asarray([1.0, 0.3, 0.4], DTYPE), jnp.asarray([2.0], DTYPE)))

    def total(light):
        return jnp.sum(reflect(Lambert(0.5), light, surface.normal, UP))

    gradient = eqx.filter_grad(total)(light)
    assert_close(2 * gradient.light.irradiance[0], total(light))
    assert_close(gradient.horizon.slope, jnp.zeros_like(light.horizon.slope))
    assert np.all(np.isfinite(gradient.light.direction))


def test_transforms():
    """Heights may be traced; they have no derivative."""
    z = heights(rough(5, 6))
    expected = Horizon.from_heights(z, azimuths=8).slope
    slopes = jax.jit(jax.vmap(lambda z: Horizon.from_heights(z, azimuths=8).slope))(jnp.stack([z, 2 * z]))
    assert_close(slopes, jnp.stack([expected, jnp.where(expected == NOTHING, NOTHING, 2 * expected)]))
    gradient = jax.grad(lambda z: jnp.sum(Horizon.from_heights(z, azimuths=8).slope))(z)
    assert_close(gradient, jnp.zeros_like(z))


def at(*pixels):
    n = int(np.prod(pixels))
    return Points(frame(jnp.tile(UP, (n, 1))), None, jnp.arange(n), pixels)


SUN = DirectionalLight(jnp.ones(3), 1.0)

REFUSED = {
    "a line": (lambda: Horizon.from_heights(jnp.ones(4)), r"\(rows, columns\), got \(4,\)"),
    "two azimuths": (lambda: Horizon.from_heights(jnp.ones((4, 4)), azimuths=2), "azimuths must be >= 3, got 2"),
    "two slopes": (lambda: Horizon(jnp.ones((4, 4, 2))), r"at least 3 azimuths, got \(4, 4, 2\)"),
    "no spacing": (lambda: Horizon.from_heights(jnp.ones((4, 4)), spacing=0), "positive scalar, got 0.0"),
    "holes": (lambda: Horizon.from_heights(jnp.full((2, 4), jnp.nan)), "heights must be finite, 8 are not"),
    "other pixels": (
        lambda: ShadowedLight(SUN, Horizon(jnp.ones((4, 3, 8)))).incident(at(3, 4)),
        r"pixels \(4, 3\) cannot shade normals \(3, 4, 3\)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case, unchecked):
    make, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        make()
