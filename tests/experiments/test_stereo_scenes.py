"""Synthetic photographs: closed forms of values, normals and shadows, seeds, and what corruption does."""

import collections

import jax.numpy as jnp
import numpy as np
import pytest

from experiments import peers
from experiments.recipes import _stereo_corruption as corruption, _stereo_mitsuba
from experiments.recipes._stereo_lights import LAYOUTS, directional, nearby
from experiments.recipes._stereo_materials import BODY, material
from experiments.recipes._stereo_meshes import HALF_WIDTH, LEAST_COSINE, camera, pinhole, relief, seen, visible
from experiments.recipes._stereo_scenes import NAMES, parts, photographs, scenes
from experiments.recipes._stereo_shapes import SHAPES
from experiments.recipes.stereo_near import as_far
from hshjax import Horizon, OrthographicCamera
from tests.helpers import X64, assert_close

FREE = [name for name in SHAPES if name != "head"]
"""Shapes that need no data."""

EXACT = 1e-9 if X64 else 3e-6


@pytest.fixture(scope="module")
def groove_photographs():
    return scenes(["grooves/lambert"], size=40, lights=24, layout="dome", spread=0.3, seed=5)["grooves/lambert"]


def centres(size):
    """x, y of the pixels of [-1, 1]², `(size, size)` each."""
    step = (2 * np.arange(size) + 1 - size) / size
    return np.meshgrid(step, -step)


def test_a_lambert_sphere_is_albedo_times_cosine():
    photographed = scenes(["sphere/lambert"], size=24, lights=7, seed=3)["sphere/lambert"]
    x, y = centres(24)
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    np.testing.assert_array_equal(photographed.mask, z > LEAST_COSINE)
    normal = np.stack([x, y, z], -1)[photographed.mask]
    np.testing.assert_allclose(photographed.truth, normal, atol=EXACT)
    cosine = np.maximum(normal @ np.asarray(photographed.lights.direction).T, 0)
    assert np.mean(cosine == 0) > 0.005  # attached shadows are among them
    np.testing.assert_allclose(photographed.values, cosine[..., None] * BODY, atol=EXACT)


def test_grooves_are_dark_where_ridges_stand_in_the_way(groove_photographs):
    """All ridges are 0.4 high and lie at multiples of 0.5: the next one towards the light is the one that hides it."""
    x = centres(40)[0].ravel()
    towards, irradiance = (
        np.asarray(a, float) for a in (groove_photographs.lights.direction, groove_photographs.lights.irradiance)
    )
    height = 0.8 * np.abs(2 * x - np.round(2 * x))  # 0 at ridges, 0.4 in between: the depth below ridges
    right, left = np.ceil(2 * x) / 2, np.floor(2 * x) / 2
    side = np.where(towards[:, 0] > 0, right[:, None] - x[:, None], x[:, None] - left[:, None])
    seen_light = towards[:, 2] / np.abs(towards[:, 0]) > height[:, None] / side
    slope = 0.4 / 0.25 * np.where(x - left < right - x, 1.0, -1.0)  # z falls from a ridge to the right
    normal = np.stack([slope, 0 * x, 1 + 0 * x], -1) / np.hypot(0.4 / 0.25, 1)
    np.testing.assert_allclose(groove_photographs.truth, normal, atol=1e-6)
    cosine = np.maximum(normal @ towards.T, 0)
    expected = (cosine * seen_light)[..., None] * BODY * irradiance / np.pi
    cast = (cosine > 0) & ~seen_light
    assert np.mean(cast) > 0.05
    assert np.all(groove_photographs.values[cast] == 0)
    np.testing.assert_allclose(groove_photographs.values, expected, atol=1e-6)


def test_without_cast_shadows_grooves_have_attached_ones_only(groove_photographs):
    open_ = scenes(["grooves/lambert"], size=40, lights=24, layout="dome", spread=0.3, shadows=False, seed=5)
    values = open_["grooves/lambert"].values
    lit = groove_photographs.values > 0
    np.testing.assert_allclose(values[lit], groove_photographs.values[lit], rtol=1e-6)
    cosine = open_["grooves/lambert"].truth @ np.asarray(groove_photographs.lights.direction).T
    np.testing.assert_array_equal(values[..., 0] > 0, cosine > 0)


def test_rays_and_horizon_cast_the_same_shadows():
    steps = 48

    def bumps(p):
        return 0.4 * jnp.sin(3 * p[0] + p[1]) * jnp.cos(4 * p[1])

    shape = relief(bumps, steps)
    spacing, side = 2 * HALF_WIDTH / steps, (steps + 1, steps + 1)
    # Nodes run along x, then y; a field's rows run down, its columns along x.
    heights = shape.vertices[:, 2].reshape(side).T[::-1]
    towards = np.asarray(directional(16, "dome", seed=2).direction, float)
    ours = visible(shape, shape.normals, shape.vertices, towards)
    horizon = Horizon.from_heights(heights, spacing=spacing, azimuths=256)
    index = jnp.arange(heights.size)
    theirs = np.asarray(horizon(jnp.asarray(towards)[None], index), bool).reshape(*side, 16)
    theirs = np.swapaxes(theirs[::-1], 0, 1).reshape(-1, 16)
    facing = shape.normals @ towards.T > 0.05
    assert np.mean(~theirs[facing]) > 0.05
    assert np.mean(ours[facing] == theirs[facing]) > 0.985  # they differ along borders, a spacing wide at most


@pytest.mark.parametrize("name", FREE)
def test_true_normals_are_those_of_the_visible_surface(name):
    """Unit, facing the eye, and at a right angle to what neighbouring pixels see, creases and borders apart."""
    mask, normal, position = seen(SHAPES[name](4), 48)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)
    assert np.all(normal[:, 2] > LEAST_COSINE)
    places, normals = np.full((2, *mask.shape, 3), np.nan)
    places[mask], normals[mask] = position, normal
    x, y = centres(48)
    np.testing.assert_allclose(places[mask][:, :2], np.stack([x, y], -1)[mask], atol=1e-5)
    facet = np.cross(places[1:-1, 2:] - places[1:-1, :-2], places[:-2, 1:-1] - places[2:, 1:-1])
    facet /= np.linalg.norm(facet, axis=-1, keepdims=True)
    cosine = np.sum(facet * normals[1:-1, 1:-1], -1)
    cosine = cosine[~np.isnan(cosine)]
    assert cosine.size > 500
    assert np.degrees(np.arccos(np.quantile(cosine, 0.4))) < 3
    assert np.quantile(cosine, 0.1) > 0.7


@pytest.mark.parametrize("name", ["sphere", "blob"])
def test_closed_bodies_have_no_seams(name):
    """Every edge belongs to two faces, in opposite senses: no ray passes between."""
    faces = SHAPES[name](0).faces
    edges = collections.Counter(map(tuple, np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])))
    assert set(edges.values()) == {1}
    assert all(edge[::-1] in edges for edge in edges)


@pytest.mark.parametrize("name", FREE)
def test_faces_are_wound_as_their_normals_say(name):
    shape = SHAPES[name](1)
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    assert np.all(np.sum(np.cross(b - a, c - a) * shape.normals[shape.faces].sum(1), -1) >= -1e-12)


def test_the_head_is_a_face(data):
    """Its nose is nearest to the eye, and in the middle."""
    mask, normal, position = seen(SHAPES["head"](0), 48)
    assert 0.4 < mask.mean() < 0.7
    nose = position[np.argmax(position[:, 2])]
    assert abs(nose[0]) < 0.1
    assert normal[:, 2].mean() > 0.5


@pytest.mark.parametrize("count", [1, 4, 12, 32, 96])
def test_a_patch_of_lights_surrounds_the_view(count):
    light = directional(count)
    towards = np.asarray(light.direction)
    assert towards.shape == (count, 3)
    assert_close(np.linalg.norm(towards, axis=1), np.ones(count))
    assert_close(light.irradiance, np.full((count, 3), np.pi))
    theta = np.degrees(np.arccos(towards[:, 2]))
    assert theta.max() < 45
    assert count < 12 or theta.max() > 30
    assert np.linalg.norm(towards[:, :2].mean(0)) < 0.25 / count**0.5
    gap = np.linalg.norm(towards[:, None] - towards, axis=-1) + 9 * np.eye(count)
    assert count == 1 or gap.min() > 0.5 / np.sqrt(count)


def test_a_dome_of_lights_is_even():
    towards = np.asarray(directional(96, "dome", spread=0.5).direction)
    z = np.sort(towards[:, 2])
    assert_close(z.min(), np.cos(np.radians(80)), tolerance=0.02)
    np.testing.assert_allclose(z, np.linspace(z[0], z[-1], 96), atol=0.02)  # equal areas have equally many
    assert np.linalg.norm(towards[:, :2].mean(0)) < 0.03


def test_scenes_follow_their_seed():
    names = ["blob/textured:0.3", "sphere/two:0.2"]
    settings = {"size": 16, "lights": 5, "spread": 0.2}
    first, again = scenes(names, seed=1, **settings), scenes(names[:1], seed=1, **settings)
    np.testing.assert_array_equal(first[names[0]].values, again[names[0]].values)
    other = scenes(names, seed=2, **settings)
    for name in names:
        assert not np.array_equal(np.sort(first[name].values, None)[-20:], np.sort(other[name].values, None)[-20:])
        assert not np.array_equal(first[name].lights.direction, other[name].lights.direction)
        assert not np.array_equal(first[name].lights.irradiance, other[name].lights.irradiance)
    assert not np.array_equal(first[names[0]].mask, other[names[0]].mask)


def test_two_materials_share_a_surface():
    shape, two = parts("sphere/two:0.2", 0)
    lights = directional(6)
    values = photographs(shape, two, lights, size=20, seed=3).values
    matte, glossy = (photographs(shape, material(name), lights, size=20).values for name in ("lambert", "glossy:0.2"))
    is_matte = np.all(np.isclose(values, matte, rtol=1e-5), axis=(1, 2))
    is_glossy = np.all(np.isclose(values, glossy, rtol=1e-5), axis=(1, 2))
    assert np.all(is_matte ^ is_glossy)
    assert 0.1 < is_matte.mean() < 0.9
    assert not np.array_equal(values, photographs(shape, two, lights, size=20, seed=4).values)


def test_a_texture_is_an_albedo():
    photographed = scenes(["sphere/textured"], size=20, lights=6, seed=1)["sphere/textured"]
    cosine = photographed.truth @ np.asarray(photographed.lights.direction).T
    albedo = photographed.values / np.where(cosine > 0.1, cosine, np.nan)[..., None]
    mean = np.nanmean(albedo, axis=1, keepdims=True)
    assert np.nanmax(np.abs(albedo - mean)) < 1e-5
    assert 0.1 < mean.min() < 0.4 < 0.6 < mean.max() < 0.95


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cube/lambert", "a scene is a shape, one of sphere, .*cube/lambert"),
        ("sphere/lambart", "kind of a material must be one of lambert, .*lambart"),
        ("sphere", "kind of a material must be one of"),
        ("sphere/lambert:2", "takes no argument"),
    ],
)
def test_unknown_names_are_refused(name, message):
    with pytest.raises(ValueError, match=message):
        scenes([name], size=8, lights=2)


def test_unknown_lights_are_refused():
    for settings, message in (
        ({"count": 0}, "at least one"),
        ({"layout": "ring"}, "patch, dome"),
        ({"spread": -1.0}, "negative"),
    ):
        with pytest.raises(ValueError, match=message):
            directional(**{"count": 3} | settings)
    assert set(LAYOUTS) == {"patch", "dome"}


@pytest.mark.slow
def test_measured_materials(data):
    """The compact fit of a file looks like the file; a network's fit is a material, too."""
    names = ["sphere/rgl:paper_white", "sphere/table:paper_white", "sphere/merl:gold-paint"]
    fit, table, gold = scenes(names, size=24, lights=8).values()
    # Measurements and fits are poor where they graze.
    level = (fit.truth[:, 2:] > 0.3) & (fit.truth @ np.asarray(fit.lights.direction).T > 0.3)
    assert level.mean() > 0.6
    assert np.quantile(np.abs(fit.values[level] / table.values[level] - 1), 0.99) < 0.1
    assert np.all(gold.values >= 0)
    red, _, blue = gold.values.mean((0, 1))
    assert red > 2 * blue
    with pytest.raises(ValueError, match="'' names 4 files"):
        scenes(["sphere/rgl:"], size=8, lights=2)
    with pytest.raises(ValueError, match="no 'gold' in merl_surrogate"):
        scenes(["sphere/merl:gold"], size=8, lights=2)


@pytest.fixture(scope="module")
def clean():
    return scenes(["sphere/glossy:0.2"], size=40, lights=12)["sphere/glossy:0.2"]


def test_noise_has_the_variance_that_is_asked_for(clean):
    noise = corruption.noisy(clean, read=0.01, photons=400, seed=1).values - clean.values
    unit = corruption.level(clean)
    dark, bright = clean.values == 0, clean.values > 0.2 * unit
    assert dark.sum() > 500
    np.testing.assert_allclose(noise[dark].std() / unit, 0.01, rtol=0.1)
    expected = np.sqrt(1e-4 * unit**2 + clean.values * unit / 400)
    np.testing.assert_allclose((noise / expected)[bright].std(), 1, rtol=0.03)
    assert abs((noise / expected)[bright].mean()) < 0.03
    assert not np.array_equal(corruption.noisy(clean, seed=1).values, corruption.noisy(clean, seed=2).values)
    np.testing.assert_array_equal(corruption.noisy(clean, seed=1).values, corruption.noisy(clean, seed=1).values)


def test_saturation_takes_the_brightest_values(clean):
    unknown = corruption.saturated(clean, 0.02)
    lost = np.isnan(unknown.values)
    np.testing.assert_allclose(lost.mean(), 0.02, atol=1e-3)
    assert clean.values[lost].min() > clean.values[~lost].max()
    clipped = corruption.saturated(clean, 0.02, "clipped").values
    np.testing.assert_array_equal(clipped[~lost], clean.values[~lost])
    assert np.all(clipped[lost] == clipped.max())
    assert clipped.max() >= clean.values[~lost].max()


def test_so_many_photographs_are_too_bright(clean):
    ratio = corruption.misjudged(clean, 3, seed=4).values / np.where(clean.values > 0, clean.values, np.nan)
    gain = np.nanmean(ratio, axis=(0, 2))
    np.testing.assert_allclose(np.nanstd(ratio, axis=(0, 2)), 0, atol=1e-6)
    assert np.sum(np.abs(gain - 1) < 1e-6) == clean.count - 3
    assert np.all((np.abs(gain - 1) < 1e-6) | ((gain > 1.15 - 1e-6) & (gain < 1.35 + 1e-6)))


@pytest.mark.parametrize("kind", ["black", "garbage"])
def test_so_many_photographs_are_ruined(clean, kind):
    ruined = corruption.ruined(clean, 2, kind, seed=4)
    hit = np.any(ruined.values != clean.values, axis=(0, 2))
    assert hit.sum() == 2
    values = ruined.values[:, hit]
    if kind == "black":
        assert np.all(values == 0)
    else:
        assert abs(np.corrcoef(values.ravel(), clean.values[:, hit].ravel())[0, 1]) < 0.1
        assert values.min() >= 0
    assert kind in ruined.notes[-1]
    assert len(ruined.notes) == len(clean.notes) + 1


def test_outliers_are_so_many_in_each_photograph(clean):
    wrong = np.any(corruption.outliers(clean, 0.05, seed=2).values != clean.values, axis=2)
    np.testing.assert_array_equal(wrong.sum(0), round(0.05 * clean.pixels))
    assert len({tuple(np.flatnonzero(column)) for column in wrong.T}) == clean.count


def test_what_is_unknown_stays_unknown(clean):
    holes = corruption.saturated(clean, 0.2)
    lost = np.isnan(holes.values)
    for spoilt in (
        corruption.noisy(holes), corruption.misjudged(holes, 12), corruption.ruined(holes, 12),
        corruption.outliers(holes, 1.0),
    ):  # fmt: skip
        np.testing.assert_array_equal(np.isnan(spoilt.values), lost)


def test_corruption_refuses_what_makes_no_sense(clean):
    for call, message in (
        (lambda: corruption.noisy(clean, photons=0), "photons > 0"),
        (lambda: corruption.saturated(clean, 0.0), "share must be in"),
        (lambda: corruption.saturated(clean, kind="white"), "nan or clipped"),
        (lambda: corruption.misjudged(clean, 13), "0 to 12"),
        (lambda: corruption.ruined(clean, 1, "grey"), "black or garbage"),
        (lambda: corruption.outliers(clean, 1.5), "share must be in"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_mitsuba_is_asked_once(monkeypatch, tmp_path):
    """What it said is kept by what it was asked; a material that it does not know is refused."""
    asked = []

    def answer(name, script, inputs, *, llvm):
        asked.append((name, script, inputs["seed"], llvm))
        points, lights = len(inputs["points"]), len(inputs["directions"])
        normal = np.tile([0.0, 0.0, 1.0], (points, 1))
        return {"mean": np.ones((points, lights, 3)), "error": np.zeros((points, lights, 3)), "normal": normal}

    monkeypatch.setattr(_stereo_mitsuba.peers, "run", answer)
    for seed in (0, 0, 1):
        made = _stereo_mitsuba.mitsuba_scenes(["bowl/lambert"], size=8, lights=3, seed=seed, folder=tmp_path)
    assert [seed for *_, seed, _ in asked] == [0, 1]
    assert asked[0] == ("mitsuba", "mitsuba_photographs", 0, True)
    assert made["bowl/lambert"].values.shape == (64, 3, 3)
    with pytest.raises(ValueError, match="Mitsuba cannot be told of the material of bowl/textured"):
        _stereo_mitsuba.mitsuba_scenes(["bowl/textured"], size=8, lights=3)
    assert len(NAMES) > len(_stereo_mitsuba.NAMES)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "share"), [("sphere/glossy:0.3", 2e-3), ("grooves/lambert", 0), ("bowl/glossy:0.2", 2e-3)]
)
def test_direct_light_is_that_of_mitsuba(name, share):
    """Without chance, but for that share of values: triangles that turn away from a light which normals still see."""
    try:
        peers.environment("mitsuba")
    except peers.PeerUnavailableError as error:
        pytest.skip(str(error))
    shape, surface = parts(name, 1)
    lights = directional(6, "dome", spread=0.3, seed=1)
    ours = photographs(shape, surface, lights, size=24)
    theirs, error = _stereo_mitsuba.traced(shape, surface, lights, size=24, depth=2, variant="scalar_rgb")
    assert np.all(error == 0)
    np.testing.assert_array_equal(ours.mask, theirs.mask)
    np.testing.assert_allclose(ours.truth, theirs.truth, atol=2e-3)
    level = corruption.level(ours)
    wrong = np.abs(ours.values - theirs.values) > 2e-3 * (level + ours.values)
    assert wrong.mean() <= share
    deep, error = _stereo_mitsuba.traced(shape, surface, lights, size=24, depth=4, spp=4, variant="scalar_rgb")
    more = deep.values.sum() / theirs.values.sum() - 1
    assert abs(more) < 1e-3 if name.startswith("sphere") else 0.05 < more < 0.6


def test_lights_far_out_are_lights_far_away():
    """Cast shadows among them; a camera that tells places changes nothing."""
    far = directional(6, "dome", seed=1)
    shape, surface = parts("pillars/lambert", 0)
    expected = photographs(shape, surface, far, size=40)
    found = photographs(shape, surface, nearby(far, 1e4), camera=camera(40), size=40)
    assert np.mean(np.abs(found.values - expected.values) > 1e-3) < 0.01  # borders of shadows
    assert np.mean(expected.values == 0) > 0.05


def test_a_camera_tells_the_mean_depth():
    shape, surface = parts("sphere/lambert", 0)
    lights = nearby(directional(4), 4.0)
    for eye in (camera(32), pinhole(32, 3.0)):
        _, normal, position = seen(shape, 32, eye)
        np.testing.assert_allclose(position, normal, atol=1e-6)  # a unit sphere
        for off in (0.0, 0.3):
            told = photographs(shape, surface, lights, camera=eye, off=off, size=32).camera
            if isinstance(told, OrthographicCamera):
                assert np.isclose(told.centre[2] + off, position[:, 2].mean())
            else:
                assert np.isclose(np.log(3 - told.target[2] - off), np.log(3 - position[:, 2]).mean())
            np.testing.assert_allclose(told.rays()[1], eye.rays()[1], atol=1e-6)


@pytest.mark.parametrize("eye", [camera(5), pinhole(5, 3.0)])
def test_lights_taken_as_far_away_are_what_the_middle_of_the_image_sees(eye):
    """A plane, whose middle pixel has the mean depth: there, and nowhere else, nothing changes."""
    plane = relief(lambda p: 0.3 + 0 * p[0], steps=8)
    near = photographs(plane, material("lambert"), nearby(directional(6, "dome", 0.2), 2.0), camera=eye, size=5)
    far = as_far(near)
    assert far.camera is None
    again = photographs(plane, material("lambert"), far.lights, size=5)
    middle = 5 * 5 // 2
    np.testing.assert_allclose(again.values[middle], near.values[middle], rtol=1e-9 if X64 else 1e-5)
    assert np.abs(again.values[0] / near.values[0] - 1).max() > 0.05
