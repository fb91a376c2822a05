"""Shape from shading: known surfaces, the energy's derivatives, odd masks, and what is refused."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import hshjax
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors, solve_single_image
from hshjax.stereo._corners import Corners
from hshjax.stereo._relief_energy import ReliefEnergy, Target, Weights
from hshjax.stereo._relief_levels import finer, levels
from hshjax.stereo._slope_shading import normals_of
from tests.helpers import DTYPE, X64

GLOSSY = hshjax.Lambert(0.5) + 0.3 * hshjax.GGX(1.0, 0.3)


def light(*degrees):
    """Lights that many degrees from the view, towards the upper right; irradiance 2."""
    angle = np.radians(degrees)
    towards = np.stack([0.8 * np.sin(angle), 0.6 * np.sin(angle), np.cos(angle)], axis=1)
    return jax.vmap(hshjax.DirectionalLight)(jnp.asarray(towards, DTYPE), jnp.full(len(degrees), 2.0, DTYPE))


def photograph(normals, mask, brdf=GLOSSY, *degrees) -> Photographs:
    """Of unit normals `(rows, columns, 3)`."""
    lights = light(*(degrees or (30.0,)))
    truth, view = jnp.asarray(normals[mask], DTYPE), jnp.asarray([0, 0, 1], DTYPE)
    values = jax.vmap(lambda lamp: hshjax.reflect(brdf, lamp, truth, view))(lights)
    return Photographs(np.moveaxis(np.asarray(values), 0, 1), mask, lights, None, np.asarray(truth))


def sphere(size=32, brdf=GLOSSY, *degrees) -> Photographs:
    eye = jnp.asarray((0.0, 0, 1), DTYPE), jnp.asarray((0.0, 1, 0), DTYPE)
    seen = hshjax.sphere(hshjax.OrthographicCamera(*eye, height=2.2, resolution=(size, size)))
    return photograph(np.asarray(seen.normal), np.asarray(seen.mask), brdf, *degrees)


def relief(size=24, *degrees):
    """A bulge that the border of the photograph cuts; and its heights, in pixels."""
    y, x = (axis / size for axis in np.mgrid[:size, :size] - (size - 1) / 2)
    y = -y
    slopes = -1.2 * x - 0.3 * y, -0.3 * x - 0.9 * y
    heights = size * (-0.6 * x**2 - 0.3 * x * y - 0.45 * y**2)
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return photograph(normals, np.ones((size, size), bool), GLOSSY, *degrees), heights


def mean_error(result, scene):
    return float(angular_errors(result.normals, scene.truth).mean())


def changed(scene, values):
    return replace(scene, values=values)


def test_a_camera_far_away_may_be_turned():
    """With the light: the world is that of the lights, and normals turn with it."""
    scene = sphere(16, GLOSSY, 30.0)
    axes = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])  # right, up, towards
    camera = hshjax.OrthographicCamera(axes[2], axes[1], height=2.2, resolution=(16, 16))
    lights = jax.vmap(hshjax.DirectionalLight)(scene.lights.direction @ axes.astype(DTYPE), scene.lights.irradiance)
    turned = solve_single_image(replace(scene, lights=lights, camera=camera), GLOSSY, starts=("convex",))
    plain = solve_single_image(scene, GLOSSY, starts=("convex",))
    # Shading is rendered in jax's default float, and minima are found to its rounding.
    np.testing.assert_allclose(turned.normals, plain.normals @ axes, atol=1e-6 if X64 else 1e-2)
    np.testing.assert_allclose(turned.heights, plain.heights, atol=1e-5 if X64 else 1e-1)
    assert turned.camera is camera
    assert plain.camera is None
    assert turned.lights is lights


@pytest.mark.parametrize("degrees", [5.0, 40.0])
def test_a_sphere(degrees):
    """To a tenth of what a pixel sees: normals change by 1/15 (4 degrees) from one to the next."""
    scene = sphere(32, GLOSSY, degrees)
    result = solve_single_image(scene, GLOSSY)
    assert mean_error(result, scene) < 0.4
    row, column = np.nonzero(scene.mask)
    radius = 32 / 2.2
    z = np.sqrt(np.maximum(radius**2 - (column - 15.5) ** 2 - (row - 15.5) ** 2, 0))
    inner = scene.truth[:, 2] > 0.3
    found = result.heights[scene.mask]
    error = (found - found[inner].mean() - z + z[inner].mean())[inner]
    assert np.sqrt(np.mean(error**2)) < 0.01 * radius
    # The image is explained, but for the rim, where a pixel sees many normals.
    misfit = result.prediction - scene.values
    assert np.median(np.abs(misfit)) < 2e-3 * scene.values.max()


def test_a_relief_without_outline():
    """Exactly, up to the bending of a paraboloid, where the light tells: near the camera, and once it is no hollow."""
    scene, heights = relief(24, 5.0)
    result = solve_single_image(scene, GLOSSY, contour=False, starts=("convex",))
    assert mean_error(result, scene) < 0.1
    np.testing.assert_allclose(result.heights, heights - heights.mean(), atol=1e-3 * np.ptp(heights))
    assert not result.contour.any()


def test_hollows_and_hills_look_alike_from_the_light():
    scene, heights = relief(24, 0.0)
    energies = []
    for start, sign in (("convex", 1), ("concave", -1)):
        result = solve_single_image(scene, GLOSSY, contour=False, starts=(start,))
        assert sign * np.corrcoef(result.heights.ravel(), heights.ravel())[0, 1] > 0.99
        energies.append(result.history[0].figures["energy"])
    assert energies[0] == pytest.approx(energies[1], rel=1e-2)


def test_the_right_material_does_better_than_lambert():
    scene = sphere()
    right, wrong = (solve_single_image(scene, brdf) for brdf in (GLOSSY, hshjax.Lambert(0.65)))
    assert mean_error(wrong, scene) > 4 * mean_error(right, scene)
    assert wrong.history[0].figures["energy"] > 4 * right.history[0].figures["energy"]


def test_normals_are_integrable_whatever_the_photograph():
    """Of 2 x 2 pixels: x slopes above less below are y slopes right less left. A photograph of noise, too."""
    scene = sphere(20)
    values = np.random.default_rng(0).uniform(0.1, 1, scene.values.shape).astype(scene.values.dtype)
    for given in (scene, changed(scene, values)):
        result = solve_single_image(given, GLOSSY, starts=("convex",))
        image = result.image(result.normals)
        slope = -image[..., :2] / np.where(result.mask, image[..., 2], 1)[..., None]
        x, y = slope[..., 0], slope[..., 1]
        curl = (x[:-1, :-1] + x[:-1, 1:] - x[1:, :-1] - x[1:, 1:]) - (y[:-1, 1:] + y[1:, 1:] - y[:-1, :-1] - y[1:, :-1])
        whole = ndimage.minimum_filter(result.mask, 2)[1:, 1:]
        assert whole.sum() > 100
        assert np.max(np.abs(curl[whole])) < 1e-9 * np.max(np.abs(slope))
        # and they are those of the corners
        used = np.isfinite(result.corners)
        corners = Corners(result.mask)
        np.testing.assert_array_equal(used, corners.used)
        np.testing.assert_allclose(normals_of(corners.slopes(result.corners[used])), result.normals, atol=1e-9)


def energy(scaled_albedo=1.0, contour=True):
    scene = sphere(14)
    known = np.ones(scene.values.shape)
    known[5] = 0
    target = Target(np.asarray(scene.values, float) * 0.5, known, np.full(known.shape, scaled_albedo), scene.mask)
    towards = np.asarray(scene.lights.direction, float)
    return ReliefEnergy(target, GLOSSY, towards, contour)


def test_the_gradient_by_finite_differences():
    """Along random directions, in heights and in the scale; no pixel lies at the border of its shadow."""
    rng = np.random.default_rng(3)
    of, weights = energy(), Weights(1e3)
    heights, scale = rng.normal(size=of.corners.count), 0.1
    state = of.at(heights, scale, weights)
    equations = of.equations(state, weights)
    step = 1e-6 if X64 else 3e-3
    for _ in range(3):
        along = rng.normal(size=heights.shape)
        along /= np.linalg.norm(along)
        ends = [of.at(heights + s * step * along, scale, weights).energy for s in (1, -1)]
        # the gradient is half of the energy's, whose squares have no factor
        assert (ends[0] - ends[1]) / (4 * step) == pytest.approx(
            float(equations.gradient @ along), rel=1e-5 if X64 else 3e-2, abs=1e-7 if X64 else 1e-3
        )
    ends = [of.at(heights, scale + s * step, weights).energy for s in (1, -1)]
    assert (ends[0] - ends[1]) / (4 * step) == pytest.approx(equations.scale_gradient, rel=1e-5 if X64 else 3e-2)


def test_the_matrix_is_the_curvature_where_all_fits():
    """At a sphere's own photograph misfit and bending are nearly 0, so that Gauss and Newton agree."""
    rng = np.random.default_rng(4)
    of, weights = energy(contour=False), Weights(1e-9, misfit=1e3)
    state = of.at(0.2 * rng.normal(size=of.corners.count), 0.0, weights)
    of.target = of.target._replace(values=state.shading.value)
    state = of.at(state.heights, 0.0, weights)
    equations = of.equations(state, weights)
    along = rng.normal(size=state.heights.shape) / 30
    step = 1e-3 if X64 else 1e-1
    ends = [of.at(state.heights + s * step * along, 0.0, weights).energy for s in (1, -1)]
    assert sum(ends) / 2 / step**2 == pytest.approx(along @ equations.matrix @ along, rel=1e-2)


def test_planes_and_spheres_do_not_bend():
    """Up to what a mean slope over a pixel is off at the steep rim."""
    scene = sphere(40)
    of = ReliefEnergy(
        Target(*(np.zeros(scene.values.shape),) * 3, scene.mask), GLOSSY, np.array([[0, 0, 1.0]]), contour=False
    )
    row, column = np.nonzero(of.corners.used)
    plane = of.at(0.7 * row - 1.3 * column, 0.0, Weights(1.0)).energy
    radius = 60.0
    ball = of.at(np.sqrt(radius**2 - (row - 20.0) ** 2 - (column - 20.0) ** 2), 0.0, Weights(1.0)).energy
    wave = of.at(np.sin(row / 3.0), 0.0, Weights(1.0)).energy
    assert plane < 1e-15
    assert ball < 1e-5 * wave


def test_an_unknown_scale():
    scene = sphere()
    result = solve_single_image(changed(scene, scene.values * np.asarray(1.7, scene.values.dtype)), GLOSSY, scaled=True)
    assert result.scale == pytest.approx(1.7, rel=0.03)
    assert mean_error(result, scene) < 1.0
    assert solve_single_image(scene, GLOSSY, starts=("convex",)).scale == 1.0


def test_albedo_and_irradiance_are_factors():
    scene = sphere(20)
    albedo = np.random.default_rng(1).uniform(0.2, 1, scene.pixels).astype(scene.values.dtype)
    plain = solve_single_image(scene, GLOSSY, starts=("convex",))
    brighter = eqx.tree_at(lambda s: s.lights.irradiance, scene, 4 * scene.lights.irradiance)
    painted = solve_single_image(changed(brighter, 2 * scene.values), 0.5 * GLOSSY, starts=("convex",))
    np.testing.assert_allclose(painted.normals, plain.normals, atol=1e-6 if X64 else 2e-2)
    painted = solve_single_image(
        changed(scene, scene.values * albedo[:, None, None]), GLOSSY, albedo=albedo, starts=("convex",)
    )
    assert mean_error(painted, scene) < 1.0


def test_attached_shadow_is_said_and_filled_in():
    scene = sphere(32, GLOSSY, 60.0)
    result = solve_single_image(scene, GLOSSY)
    dark = scene.truth @ np.asarray(scene.lights.direction, scene.truth.dtype)[0] < 0
    assert np.mean(result.shadows[:, 0] != dark) < 0.03
    assert not np.any(result.determined & result.shadows[:, 0])
    assert angular_errors(result.normals, scene.truth)[dark].mean() < 3.0  # between lit parts and outline


def test_a_second_photograph_tells_more():
    scene, _ = relief(20, 60.0, 61.0)
    second = jax.vmap(hshjax.DirectionalLight)(
        scene.lights.direction.at[1].set(jnp.asarray([-0.6, 0.3, 0.7], DTYPE)), scene.lights.irradiance
    )
    view, truth = jnp.asarray([0, 0, 1], DTYPE), jnp.asarray(scene.truth)
    values = jax.vmap(lambda lamp: hshjax.reflect(GLOSSY, lamp, truth, view))(second)
    values = np.moveaxis(np.asarray(values), 0, 1)
    noise = 0.02 * values.max() * np.random.default_rng(0).normal(size=values.shape).astype(values.dtype)
    both = replace(scene, values=values + noise, lights=second)
    first = replace(both, values=both.values[:, :1], lights=jax.tree.map(lambda leaf: leaf[:1], second))
    one, two = (solve_single_image(given, GLOSSY, contour=False, starts=("convex",)) for given in (first, both))
    assert mean_error(two, scene) < 0.8 * mean_error(one, scene)
    assert two.shadows.shape == two.outliers.shape == (scene.pixels, 2)


def test_what_is_not_known_or_does_not_fit_is_left_out():
    scene = sphere()
    values = scene.values.copy()
    rng = np.random.default_rng(2)
    hit = rng.permutation(scene.pixels)[:40]
    values[hit[:30]], values[hit[30:]] = np.nan, 3 * values.max()
    result = solve_single_image(changed(scene, values), GLOSSY, starts=("smooth", "convex"))
    assert mean_error(result, scene) < 1.5
    assert np.all(result.outliers[hit[30:]])
    assert not np.any(result.outliers[hit[:30]])
    assert not np.any(result.determined[hit])
    assert np.isfinite(result.prediction).all()


MASKS = {
    "one pixel": ["#"],
    "a row": ["#" * 23],
    "a column": ["#"] * 17,
    "a stair": ["#....", ".#...", "..#..", "...##"],
    "pieces": ["###..##", "###..##", "###....", "......#", "#.#.#..", "######."],
    "a ring": ["#####", "#...#", "#...#", "#####"],
}


@pytest.mark.parametrize("name", MASKS)
def test_odd_masks(name):
    mask = np.array([[c == "#" for c in row] for row in MASKS[name]])
    normals = np.broadcast_to(np.array([0.36, 0.48, 0.8]), (*mask.shape, 3))
    scene = photograph(normals, mask)
    result = solve_single_image(scene, GLOSSY, contour=False)
    assert np.isfinite(result.normals).all()
    assert np.array_equal(np.isfinite(result.heights), mask)
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    np.testing.assert_allclose(ndimage.mean(np.nan_to_num(result.heights), labels, range(1, count + 1)), 0, atol=1e-9)
    np.testing.assert_allclose(result.prediction, scene.values, atol=0.02 * scene.values.max())


def test_the_same_again():
    scene = sphere(20)
    first, second = (solve_single_image(scene, GLOSSY) for _ in range(2))
    np.testing.assert_array_equal(first.normals, second.normals)
    np.testing.assert_array_equal(first.corners, second.corners)
    assert first.start == second.start


def test_progress_and_history():
    told = []
    result = solve_single_image(sphere(32), GLOSSY, progress=lambda *what: told.append(what))
    assert told[:2] == [("smooth", 1, 2), ("smooth", 2, 2)]
    assert [stage.name for stage in result.history] == ["smooth", "convex", "concave", "flat"]
    least = min(result.history, key=lambda stage: stage.figures["energy"])
    assert least.name == result.start


def test_finer_heights_have_the_same_normals_and_bend_no_more():
    """A cap of a ball, steep at its border."""
    row, column = np.mgrid[:40, :40] - 19.5
    mask, radius = np.hypot(row, column) < 19, 20.0
    nothing = Target(*(np.zeros((int(mask.sum()), 1, 1)),) * 3, mask)
    fine, coarse = (ReliefEnergy(t, GLOSSY, np.array([[0, 0, 1.0]]), contour=False) for t in levels(nothing)[:2])
    row, column = np.nonzero(coarse.corners.used)
    z = np.sqrt(np.maximum((radius / 2) ** 2 - (row - 10) ** 2 - (column - 10) ** 2, 0.3))
    found = finer(z, coarse.corners, fine.corners)
    parent = np.zeros(coarse.target.mask.shape, int)
    parent[coarse.target.mask] = np.arange(coarse.corners.pixels)
    row, column = np.nonzero(mask)
    before = normals_of(coarse.corners.slopes(z))[parent[row // 2, column // 2]]
    errors = angular_errors(normals_of(fine.corners.slopes(found)), before)
    assert np.median(errors) < 3.0  # of a pixel and the four in one, which differ by 2
    energies = [
        of.at(heights, 0.0, Weights(1.0)).energy / of.corners.pixels for of, heights in ((fine, found), (coarse, z))
    ]
    assert energies[0] < 2 * energies[1]


def with_lights(scene, directions, irradiance=1.0):
    strength = jnp.full(len(directions), irradiance, DTYPE)
    return replace(scene, lights=jax.vmap(hshjax.DirectionalLight)(jnp.asarray(directions, DTYPE), strength))


NEARBY = hshjax.PerspectiveCamera((0.0, 0, 5), (0.0, 0, 0), (0.0, 1, 0), field_of_view=0.5, resolution=(12, 12))

HOSTILE = {
    "lights unknown": (lambda s: (replace(s, lights=None), GLOSSY, {}), "known lights far away .* got none"),
    "light behind": (lambda s: (with_lights(s, [[1.0, 0, -0.1]]), GLOSSY, {}), "camera's side of the object, z > 0"),
    "light of no direction": (lambda s: (with_lights(s, [[0.0, 0, 0]]), GLOSSY, {}), "finite and not zero"),
    "no irradiance": (lambda s: (with_lights(s, [[0, 0, 1.0]], 0.0), GLOSSY, {}), "irradiance of every light"),
    "black": (lambda s: (changed(s, 0 * s.values), GLOSSY, {}), r"photographs \[1\] are black"),
    "nothing known": (lambda s: (changed(s, np.nan * s.values), GLOSSY, {}), r"photographs \[1\] are black"),
    "BRDF of other channels": (lambda s: (s, hshjax.Lambert((0.1, 0.2)), {}), "1 channel or 1, .* got 2"),
    "black BRDF": (lambda s: (s, hshjax.Lambert(0.0), {}), "reflects nothing"),
    "BRDF that is NaN": (lambda s: (s, hshjax.Lambert(np.nan), {}), "not finite"),
    "anisotropic": (lambda s: (s, hshjax.Ward(0.1, 0.5, 0.1), {}), "must be isotropic"),
    "smoothness": (lambda s: (s, GLOSSY, {"smoothness": 0.0}), "smoothness must be a finite number above 0, got 0.0"),
    "no start": (lambda s: (s, GLOSSY, {"starts": ()}), "starts must be some of smooth, convex"),
    "albedo": (lambda s: (s, GLOSSY, {"albedo": np.ones(3)}), "albedo must be .* got \\(3,\\)"),
    "near camera": (
        lambda s: (
            replace(s, camera=NEARBY),
            GLOSSY,
            {},
        ),
        "the camera must be far away",
    ),
    "NaN albedo": (lambda s: (s, GLOSSY, {"albedo": np.full(s.pixels, np.nan)}), "finite and not negative"),
    "negative albedo": (lambda s: (s, GLOSSY, {"albedo": -np.ones(s.pixels)}), "finite and not negative"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_refused(name):
    make, message = HOSTILE[name]
    with np.errstate(invalid="ignore"):
        scene, brdf, arguments = make(sphere(12))
    with pytest.raises(ValueError, match=message):
        solve_single_image(scene, brdf, **arguments)


def test_an_unknown_start_is_refused(unchecked):
    with pytest.raises(ValueError, match="starts must be some of smooth, convex"):
        solve_single_image(sphere(12), GLOSSY, starts=("round",))


def test_a_mask_without_outline_is_refused():
    scene, _ = relief(12)
    with pytest.raises(ValueError, match="no outline inside of the photographs: ask for contour=False"):
        solve_single_image(scene, GLOSSY)
    with pytest.raises(ValueError, match="the mask is empty"):
        replace(scene, mask=np.zeros_like(scene.mask))


def test_channels():
    """A colour photograph, and one channel of BRDF for three of the photograph."""
    colour = hshjax.Lambert((0.6, 0.4, 0.2)) + 0.2 * hshjax.GGX(1.0, 0.3)
    scene = sphere(20, colour)
    result = solve_single_image(scene, colour, starts=("convex",))
    assert mean_error(result, scene) < 0.7
    assert result.prediction.shape == scene.values.shape
    grey = sphere(20)
    three = changed(grey, np.repeat(grey.values, 3, axis=2))
    again = solve_single_image(three, GLOSSY, starts=("convex",))
    single = solve_single_image(grey, GLOSSY, starts=("convex",))
    np.testing.assert_allclose(again.normals, single.normals, atol=1e-6 if X64 else 2e-2)
