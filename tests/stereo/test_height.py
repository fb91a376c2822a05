"""Heights from normals: surfaces that are known, a solver of another kind, and what is refused."""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from hshjax.brdfs import Lambert
from hshjax.camera import OrthographicCamera, PerspectiveCamera
from hshjax.io import read_diligent
from hshjax.stereo import depth_from_normals, height_from_normals, lambertian
from hshjax.stereo._poisson import Edges, differences, divergence, solve
from hshjax.surface import height_field, sphere
from tests.helpers import DTYPE, X64, assert_close
from tests.stereo.near import ball as near_ball, rotation


def grid(rows, columns, spacing):
    x = spacing * (np.arange(columns) - (columns - 1) / 2)
    y = spacing * ((rows - 1) / 2 - np.arange(rows))
    return x[None], y[:, None]


def normals(x_slope, y_slope):
    p, q = np.broadcast_arrays(x_slope, y_slope)
    return np.stack([-p, -q, np.ones_like(p)], -1) / np.sqrt(1 + p**2 + q**2)[..., None]


def centred(heights, mask=None):
    """Heights less the mean of each piece."""
    labels, _ = ndimage.label(np.ones(heights.shape, bool) if mask is None else mask)
    result = np.full(heights.shape, np.nan)
    for piece in range(1, labels.max() + 1):
        result[labels == piece] = heights[labels == piece] - heights[labels == piece].mean()
    return result


def disc(rows, columns, hole=True):
    x, y = grid(rows, columns, 2 / min(rows, columns))
    rim = np.hypot(x, y)
    return (rim < 0.95) & ((rim > 0.3) if hole else True)


def ball(x, y, radius=2.2):
    z = np.sqrt(radius**2 - x**2 - y**2)
    return z, -x / z, -y / z


SURFACES = {
    "plane": lambda x, y: (0.7 * x - 0.4 * y, 0.7 + 0 * y, -0.4 + 0 * x),
    "steep plane": lambda x, y: (30 * x + 20 * y, 30.0 + 0 * y, 20.0 + 0 * x),
    "sphere": ball,
}


def paraboloid(x, y):
    return 0.5 * x**2 - 0.3 * x * y + 0.2 * y**2 + x, x - 0.3 * y + 1, -0.3 * x + 0.4 * y


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", SURFACES)
def test_planes_and_spheres_come_back_exactly(name, masked):
    rows, columns, spacing = 31, 43, 0.07
    z, p, q = SURFACES[name](*grid(rows, columns, spacing))
    mask = disc(rows, columns) if masked else None
    found = height_from_normals(normals(p, q), mask, spacing=spacing)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, centred(z, mask), atol=1e-8 * np.ptp(z))


@pytest.mark.parametrize("jumps", [False, True])
def test_a_paraboloid(jumps):
    z, p, q = paraboloid(*grid(31, 43, 0.07))
    for mask in (None, disc(31, 43)):
        found = height_from_normals(normals(p, q), mask, spacing=0.07, jumps=jumps)
        assert np.nanmax(np.abs(found - centred(z, mask))) < 3e-4 * np.ptp(z)


def test_planes_come_back_exactly_where_jumps_are_looked_for():
    z, p, q = SURFACES["plane"](*grid(31, 43, 0.07))
    for mask in (None, disc(31, 43)):
        found = height_from_normals(normals(p, q), mask, spacing=0.07, jumps=True)
        np.testing.assert_allclose(found, centred(z, mask), atol=1e-8)


@pytest.mark.parametrize("jumps", [False, True])
def test_the_error_is_of_second_order(jumps):
    def error(count):
        x, y = grid(count, count, 2 / (count - 1))
        z = 0.2 * np.sin(3 * x + 1) * np.cos(4 * y)
        slopes = 0.6 * np.cos(3 * x + 1) * np.cos(4 * y), -0.8 * np.sin(3 * x + 1) * np.sin(4 * y)
        found = height_from_normals(normals(*slopes), spacing=2 / (count - 1), jumps=jumps)
        return np.abs(found - centred(z)).max()

    assert error(81) < 1.2 * error(41) / 4
    assert error(41) < 2e-3


def test_there_and_back_with_height_field():
    x, y = grid(40, 50, 0.05)
    z = 0.3 * np.sin(2 * x) * np.cos(3 * y) + 0.1 * x
    field = height_field(jnp.asarray(z, DTYPE), spacing=0.05)
    np.testing.assert_allclose(height_from_normals(field.normal, spacing=0.05), centred(z), atol=2e-3)


def test_a_sphere_as_its_camera_sees_it():
    """Axes, signs and spacing are those of cameras; slopes at its rim are infinite."""
    camera = OrthographicCamera(
        jnp.asarray((0.0, 0, 1), DTYPE), jnp.asarray((0.0, 1, 0), DTYPE), height=2.4, resolution=(120, 160)
    )
    seen = sphere(camera, jnp.asarray((0.3, 0.1, 0.0), DTYPE), 0.9)
    mask = np.asarray(seen.mask)
    found = height_from_normals(seen.normal, mask, spacing=2.4 / 120)
    assert np.isnan(found[~mask]).all()
    expected = centred(np.asarray(seen.position[..., 2], float), np.isfinite(found))
    np.testing.assert_allclose(found, expected, atol=1e-8 if X64 else 1e-4)


def dense(weights, weighted):
    """The normal equations, one edge after the other, by a direct solver; the first pixel of a piece is held at 0."""
    rows, columns = weights.right.shape[0], weights.up.shape[1]
    number = np.arange(rows * columns).reshape(rows, columns)
    first = np.concatenate([number[:, :-1].ravel(), number[1:].ravel()])
    second = np.concatenate([number[:, 1:].ravel(), number[:-1].ravel()])
    w = np.concatenate([weights.right.ravel(), weights.up.ravel()])
    ws = np.concatenate([weighted.right.ravel(), weighted.up.ravel()])
    matrix, side = sparse.lil_matrix((number.size, number.size)), np.zeros(number.size)
    for a, b, weight, target in zip(first, second, w, ws, strict=True):
        matrix[a, a] += weight
        matrix[b, b] += weight
        matrix[a, b] -= weight
        matrix[b, a] -= weight
        side[b] += target
        side[a] -= target
    _, labels = sparse.csgraph.connected_components(matrix)
    for piece in range(labels.max() + 1):
        matrix[np.argmax(labels == piece), np.argmax(labels == piece)] += 1
    return spsolve(matrix.tocsc(), side).reshape(rows, columns), labels.reshape(rows, columns)


@pytest.mark.parametrize("shape", [(9, 12), (1, 7), (6, 1), (2, 2)])
def test_the_solver_against_a_direct_one(shape):
    rng = np.random.default_rng(sum(shape))
    rows, columns = shape
    sizes = ((rows, columns - 1), (rows - 1, columns))
    weights = Edges(*(np.exp(rng.normal(size=size)) * (rng.random(size) < 0.7) for size in sizes))
    weighted = Edges(*(weight * rng.normal(size=weight.shape) for weight in weights))
    expected, labels = dense(weights, weighted)
    found = solve(weights, weighted, np.zeros(shape), 1e-12)
    for piece in range(labels.max() + 1):
        inside = labels == piece
        if inside.sum() > 1:
            assert_close(
                found[inside] - found[inside].mean(), expected[inside] - expected[inside].mean(), tolerance=1e-8
            )


def test_divergence_is_the_adjoint_of_differences():
    rng = np.random.default_rng(0)
    values, edges = rng.normal(size=(5, 8)), Edges(rng.normal(size=(5, 7)), rng.normal(size=(4, 8)))
    steps = differences(values)
    assert_close(np.sum(steps.right * edges.right) + np.sum(steps.up * edges.up), np.sum(values * divergence(edges)))


def test_pieces_have_mean_0_each():
    z, p, q = SURFACES["sphere"](*grid(20, 31, 0.1))
    mask = np.ones((20, 31), bool)
    mask[:, 10], mask[7, 11:], mask[15:, 20] = False, False, False
    mask[0, 9] = mask[1, 8] = False  # a pixel on its own, joined by a corner only
    mask[1, 9] = True
    mask[2, 9] = False
    found = height_from_normals(normals(p, q), mask, spacing=0.1)
    np.testing.assert_allclose(found, centred(z, mask), atol=1e-8)
    assert found[1, 9] == 0


def test_a_normal_that_is_missing_or_turned_away_leaves_its_pixel_out():
    z, p, q = SURFACES["sphere"](*grid(20, 31, 0.1))
    field = normals(p, q)
    field[3, 4], field[5, 6], field[7, 8], field[9, 10] = np.nan, 0, (0.6, 0, -0.8), (1, 0, 0.005)
    field[11, 12] *= 17  # length does not count
    known = np.ones((20, 31), bool)
    known[[3, 5, 7, 9], [4, 6, 8, 10]] = False
    np.testing.assert_allclose(height_from_normals(field, spacing=0.1), centred(z, known), atol=1e-8)
    np.testing.assert_allclose(height_from_normals(field, known, spacing=0.1), centred(z, known), atol=1e-8)


def test_the_horizon_carries_little_weight():
    """A ring of normals near the horizon, wrong by all they can be, moves the heights inside by next to nothing."""
    z, p, q = SURFACES["sphere"](*grid(41, 41, 0.05))
    field = normals(p, q)
    ring = disc(41, 41, hole=False) & ~ndimage.binary_erosion(disc(41, 41, hole=False))
    field[ring] = (np.sqrt(1 - 0.02**2), 0, 0.02)
    inner = disc(41, 41, hole=False) & ~ring
    found = height_from_normals(field, disc(41, 41, hole=False), spacing=0.05)
    assert np.abs(centred(np.where(inner, found, 0), inner) - centred(z, inner))[inner].max() < 0.02


def torn(rows=60, columns=70, spacing=0.04):
    """A flap that rises out of a floor: a hinge at its lower edge, jumps at the three others."""
    x, y = grid(rows, columns, spacing)
    flap = (np.abs(x) < 0.5) & (y > -0.5)
    return np.where(flap, 0.6 * (y + 0.5), 0), np.zeros(flap.shape), np.where(flap, 0.6, 0.0) + 0 * x


def test_jumps_are_found_where_they_are_looked_for():
    z, p, q = torn()
    bent, found = (height_from_normals(normals(p, q), spacing=0.04, jumps=jumps) for jumps in (False, True))
    error = [np.sqrt(np.mean((h - np.median(h - z) - z) ** 2)) for h in (bent, found)]
    assert error[0] > 0.1
    assert error[1] < 0.02


def test_heights_scale_with_the_spacing_and_turn_with_the_image():
    _, p, q = SURFACES["sphere"](*grid(20, 31, 0.1))
    field, mask = normals(p, q), disc(20, 31)
    found = height_from_normals(field, mask, spacing=0.1)
    np.testing.assert_allclose(height_from_normals(field, mask, spacing=0.3), 3 * found, atol=1e-8)
    turned = np.rot90(field)  # by 90 degrees to the left: what was x is y
    turned = np.stack([-turned[..., 1], turned[..., 0], turned[..., 2]], -1)
    np.testing.assert_allclose(height_from_normals(turned, np.rot90(mask), spacing=0.1), np.rot90(found), atol=1e-8)


def perspective(rows=60, columns=80):
    return PerspectiveCamera(
        jnp.asarray((1.0, 2, 5), DTYPE),
        jnp.asarray((0.1, 0, 0), DTYPE),
        jnp.asarray((0.0, 1, 0.2), DTYPE),
        field_of_view=0.6,
        resolution=(rows, columns),
    )


def depths(camera, position):
    """Along the axis of view."""
    axis = np.asarray(camera.target - camera.eye, float)
    return (np.asarray(position, float) - np.asarray(camera.eye, float)) @ (axis / np.linalg.norm(axis))


@pytest.mark.parametrize("jumps", [False, True])
def test_a_plane_through_a_pinhole(jumps):
    camera = perspective()
    normal = np.asarray((0.3, 0.4, 0.9)) / np.linalg.norm((0.3, 0.4, 0.9))
    origin, ray = (np.asarray(array, float) for array in camera.rays())
    distance = -(origin @ normal) / (ray @ normal)
    expected = depths(camera, origin + distance[..., None] * ray)
    mean = float(np.exp(np.log(expected).mean()))
    found = depth_from_normals(np.broadcast_to(normal, ray.shape), camera, distance=mean, jumps=jumps)
    np.testing.assert_allclose(found, expected, rtol=1e-7 if X64 else 1e-4)


def test_a_sphere_through_a_pinhole():
    camera = perspective(120, 160)
    seen = sphere(camera, jnp.asarray((0.2, -0.1, 0.3), DTYPE), 0.8)
    mask, expected = np.asarray(seen.mask), depths(camera, seen.position)
    found = depth_from_normals(seen.normal, camera, mask)
    known = np.isfinite(found)
    assert known.sum() > 0.98 * mask.sum()
    np.testing.assert_allclose(np.log(found[known]).mean(), 0, atol=1e-9)
    scale = np.exp(np.log(expected[known]).mean())
    np.testing.assert_allclose(scale * found[known], expected[known], rtol=1e-6 if X64 else 1e-3)
    assert np.ptp(expected[known]) > 0.5
    # Another field of view makes another surface of it: rays count.
    wider = eqx.tree_at(lambda c: c.field_of_view, camera, jnp.asarray(0.7, DTYPE))
    other = depth_from_normals(seen.normal, wider, mask)
    assert np.nanmax(np.abs(other / found - 1)) > 0.01


UP = np.broadcast_to([0.0, 0.0, 1.0], (4, 5, 3))


@pytest.mark.parametrize(
    ("field", "arguments", "message"),
    [
        (UP[..., :2], {}, r"normals must have shape \(rows, columns, 3\), got \(4, 5, 2\)"),
        (UP[0], {}, r"got \(5, 3\)"),
        (UP[:0], {}, r"got \(0, 5, 3\)"),
        (UP, {"mask": np.ones((5, 4), bool)}, r"the shape of the normals, \(4, 5\), got \(5, 4\)"),
        (UP, {"mask": np.zeros((4, 5), bool)}, "the mask is empty: there is no surface"),
        (UP, {"spacing": 0.0}, "spacing must be a finite number above 0, got 0.0"),
        (UP, {"spacing": float("inf")}, "spacing must be a finite number above 0, got inf"),
        (UP, {"horizon": 1.0}, r"horizon must be in \[0, 1\), got 1.0"),
        (-UP, {}, "no pixel has a normal that is turned to the viewer by more than the horizon, 0.01"),
        (np.nan * UP, {}, "no pixel has a normal that is turned to the viewer"),
    ],
)
def test_what_is_refused(field, arguments, message):
    with pytest.raises(ValueError, match=message):
        height_from_normals(field, **arguments)


TILTED = OrthographicCamera((0.5, -0.7, 0.6), (0.2, 0.9, 0.1), height=3.0, resolution=(60, 45))
"""Right, up and towards are no axes of the world."""


def test_a_tilted_camera():
    """Of a result, whose normals are in the world: heights are those along the view, whatever the world is."""
    x, y = grid(60, 45, 0.05)
    z = 0.3 * np.sin(2 * x) * np.cos(3 * y) + 0.1 * x
    slopes = 0.6 * np.cos(2 * x) * np.cos(3 * y) + 0.1, -0.9 * np.sin(2 * x) * np.sin(3 * y)
    towards = np.asarray([0.5, -0.7, 0.6])
    right = np.cross([0.2, 0.9, 0.1], towards)
    axes = np.stack([vector / np.linalg.norm(vector) for vector in (right, np.cross(towards, right), towards)])
    world = normals(*slopes) @ axes
    mask = disc(60, 45)
    found = height_from_normals(world, mask, camera=TILTED, spacing=0.05)
    tolerance = 1e-3 if X64 else 1.1e-3  # second order in the spacing: 0.05² / 12 of third derivatives up to 6
    np.testing.assert_allclose(found, centred(np.where(mask, z, 0), mask), atol=tolerance)
    # Heights of the same vectors, taken for those of a camera on +z, are others.
    other = height_from_normals(world, mask, spacing=0.05)
    assert np.nanmax(np.abs(other - found)) > 0.3 or np.isnan(other[mask]).any()


def test_a_result_of_a_tilted_camera():
    """A matte ball under lights far away, as it is solved: heights are those of the ball above a plane across the
    view."""
    turn = rotation(3)
    given = near_ball(None, brdf=Lambert(0.6), world=turn, size=40)
    found = lambertian(given, "robust").normals  # without the shadows, exact but for float32
    step = 2.05 / 40  # the image is that high
    heights = height_from_normals(given.image(found), given.mask, camera=given.camera, spacing=step)
    x, y = grid(40, 40, step)
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    inner = np.isfinite(heights) & (z > 0.2)
    assert inner.sum() > 1000
    error = (heights - heights[inner].mean() - z + z[inner].mean())[inner]
    assert np.abs(error).max() < 2e-3  # chords of a sphere are exact; normals err by 1e-4
    untold = height_from_normals(given.image(found), given.mask, spacing=step)
    assert not np.allclose(untold[inner], heights[inner], atol=0.1)


def test_what_is_refused_of_a_pinhole():
    with pytest.raises(ValueError, match=r"the resolution of the camera, \(60, 80\), got \(4, 5\)"):
        depth_from_normals(UP, perspective())
    with pytest.raises(ValueError, match="the camera must be far away"):
        height_from_normals(UP, camera=perspective(4, 5))
    with pytest.raises(ValueError, match="distance must be a finite number above 0, got -1"):
        depth_from_normals(UP, perspective(4, 5), distance=-1.0)


def test_a_single_pixel_and_flat_ground():
    assert height_from_normals(UP[:1, :1]).tolist() == [[0.0]]
    assert np.array_equal(height_from_normals(UP), np.zeros((4, 5)))


def test_a_solver_that_does_not_converge_says_so(monkeypatch):
    monkeypatch.setattr("hshjax.stereo._poisson.ITERATIONS", 3)
    _, p, q = SURFACES["sphere"](*grid(40, 50, 0.05))
    with pytest.raises(RuntimeError, match=r"heights of 40 x 40 pixels did not converge in 3 iterations: residual"):
        height_from_normals(normals(p, q), disc(40, 50), spacing=0.05)


@pytest.mark.slow
def test_a_megapixel_takes_seconds():
    """Time grows no faster than 12 times from 0.1 to 1 megapixel, where a factor of 10 would be linear."""

    def seconds(count):
        x, y = grid(count, count, 2 / count)
        mask = np.hypot(x, y) < 0.97
        rise = np.sqrt(1 - np.minimum(x**2 + y**2, 0.97**2))
        start = time.process_time()
        found = height_from_normals(normals(-x / rise, -y / rise), mask, spacing=2 / count)
        assert np.nanmax(np.abs(found - centred(rise, mask))) < 0.01
        return time.process_time() - start

    small, large = seconds(360), seconds(1140)
    assert large < 30
    assert large < 25 * small


def test_the_ball_of_diligent_is_round(data):
    """Its measured normals, integrated, against the sphere of its outline."""
    ball = read_diligent(data / "diligent/ballPNG")
    found = height_from_normals(ball.image(ball.truth), ball.mask)
    seen = np.isfinite(found)
    rows, columns = np.nonzero(ball.mask)
    radius = (np.ptp(rows) + 1) / 2
    y = (rows.min() + rows.max()) / 2 - np.arange(found.shape[0])[:, None]
    x = np.arange(found.shape[1]) - (columns.min() + columns.max()) / 2
    expected = np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0))
    error = found[seen] - (expected[seen] - expected[seen].mean())
    assert np.sqrt(np.mean(error**2)) < 0.02 * radius


def test_nothing_of_this_runs_on_a_device():
    """Float32 is jax's default, and heights are in float64 all the same."""
    z, p, q = SURFACES["plane"](*grid(10, 10, 0.1))
    found = height_from_normals(jax.device_put(jnp.asarray(normals(p, q), jnp.float32)), spacing=0.1)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, centred(z), atol=1e-6)
