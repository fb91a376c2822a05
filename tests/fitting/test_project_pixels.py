"""Series over the direction of the light in every pixel: against least squares of each by itself, and bad tiles."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis, SphericalHarmonics
from hshjax.fitting import TileError, project_pixels
from hshjax.fitting._tiles import Tile, known_values
from tests.helpers import DTYPE, TOLERANCE, X64, assert_close, directions

BASIS = HSH(2)
LIGHTS = np.asarray(directions(0, 20, min_z=0.2))
ROWS = np.asarray(BASIS(jnp.asarray(LIGHTS)))
PIXELS = 103


def photographs(seed=0, pixels=PIXELS, channels=3):
    return np.random.default_rng(seed).uniform(0, 1, (pixels, len(LIGHTS), channels)).astype(DTYPE)


def expected(values, weight=None, gamma=None):
    """One pixel and channel after the other."""
    root = np.sqrt(np.ones(len(LIGHTS)) if weight is None else weight)
    rows = root[:, None] * ROWS.astype(np.float64)
    values = np.where(root[:, None] > 0, values, 0) * root[:, None]
    if gamma is not None:
        rows = np.concatenate([rows, np.diag(np.sqrt(gamma))])
        values = np.concatenate([values, np.zeros((len(values), len(gamma), values.shape[2]))], axis=1)
    found = [np.linalg.lstsq(rows, pixel.astype(np.float64), rcond=None)[0] for pixel in values]
    return np.stack(found)


def same(fit, values, **settings):
    """Within rounding: of a condition number of some tens in float32."""
    assert_close(fit.coefficients, expected(values, **settings), tolerance=TOLERANCE if X64 else 1e-3)


@pytest.mark.parametrize("ridge", [0.0, 0.1])
def test_every_pixel_is_least_squares_of_its_own(ridge):
    values, weight = photographs(), np.random.default_rng(1).uniform(0, 2, len(LIGHTS))
    weight[3] = 0
    values[:, 3] = np.nan
    orders = np.array([n for n, _ in BASIS.modes])
    settings = {"ridge": ridge, "prior": "spectral"} if ridge else {}
    gamma = ridge * (orders * (orders + 1.0)) ** 2 if ridge else None
    fit = project_pixels(BASIS, LIGHTS, values, weight=weight, rows=40, **settings)
    same(fit, values, weight=weight, gamma=gamma)
    used = np.where(weight[:, None] > 0, values, 0)
    left = used - np.einsum("lk,pkc->plc", ROWS, fit.coefficients)
    size, error = (np.sqrt(np.einsum("l,plc->c", weight, part**2)) for part in (used, left))
    assert_close(fit.residual / size, error / size)
    assert_close(fit.relative, error / size)


def test_relit_pixels_are_those_of_the_photographs():
    true = np.random.default_rng(0).normal(size=(PIXELS, BASIS.count, 2)).astype(DTYPE)
    values = np.einsum("lk,pkc->plc", ROWS, true)
    fit = project_pixels(BASIS, LIGHTS, values)
    assert_close(fit.coefficients, true, tolerance=TOLERANCE if X64 else 1e-4)
    assert_close(
        fit.relit(directions(5)), np.asarray(BASIS(directions(5))) @ true, tolerance=TOLERANCE if X64 else 1e-4
    )
    assert fit.relit(directions(5), slice(2, 7)).shape == (5, 2)
    assert np.all(fit.relative < (1e-12 if X64 else 1e-5))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, ">u2", np.float16, np.float32, ">f4"])
def test_values_of_cameras(dtype):
    values = (photographs() * (200 if np.dtype(dtype).kind == "u" else 1)).astype(dtype)
    fit = project_pixels(BASIS, LIGHTS, values)
    assert fit.coefficients.dtype == (np.float32 if np.dtype(dtype).kind == "f" else DTYPE)
    scale = np.abs(fit.coefficients).max()
    assert_close(fit.coefficients / scale, expected(values) / scale, tolerance=1e-4)


def test_tiles_of_any_sizes_and_no_known_number():
    values = photographs()
    ends = [0, 1, 50, 51, PIXELS]
    tiles = [values[a:b] for a, b in itertools.pairwise(ends)]
    whole = project_pixels(BASIS, LIGHTS, values)
    for source in (tiles, iter(tiles)):
        assert_close(project_pixels(BASIS, LIGHTS, source).coefficients, whole.coefficients)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, DTYPE])
def test_what_is_masked_is_missing(dtype):
    values = (200 * photographs()).astype(dtype)
    masked = np.zeros(values.shape, bool)
    masked[::3, 4, 1] = True
    fit = project_pixels(BASIS, LIGHTS, np.ma.masked_array(values, masked), rows=40)
    missing = values.astype(DTYPE)
    missing[masked] = np.nan
    expected = project_pixels(BASIS, LIGHTS, missing)
    assert_close(fit.coefficients / 200, expected.coefficients / 200, tolerance=TOLERANCE if X64 else 1e-3)
    assert fit.partial == expected.partial == len(values[::3])


@pytest.mark.parametrize("dtype", [np.longdouble, ">f8"])
def test_numbers_that_jax_has_not(dtype):
    values = photographs()
    got = project_pixels(BASIS, LIGHTS, values.astype(dtype)).coefficients
    assert_close(got, project_pixels(BASIS, LIGHTS, values).coefficients)


def test_memory_in_any_order_and_counts_of_numpy(tmp_path, unchecked):
    values = photographs()
    expected = project_pixels(BASIS, LIGHTS, values).coefficients
    for source in (np.asfortranarray(values), values.transpose(1, 0, 2).copy().transpose(1, 0, 2), values[::-1][::-1]):
        out = np.zeros(expected.shape[::-1], DTYPE).T
        project_pixels(BASIS, LIGHTS, source, rows=np.int64(40), out=out)
        assert_close(out, expected)
    tiles = iter([values[:50], values[50:]])
    got = project_pixels(BASIS, LIGHTS, tiles, pixels=np.int64(PIXELS), out=tmp_path / "out.npy")
    assert_close(got.coefficients, expected)


class Lazy:
    """As of h5py or zarr: a shape, slices, and nothing else. Counts what is read, and may break."""

    def __init__(self, values, broken=None):
        self.values, self.shape, self.read, self.broken = values, values.shape, [], broken

    def __getitem__(self, rows):
        if rows.start == self.broken:
            raise OSError("the disk is gone")
        self.read.append((rows.start, rows.stop))
        return self.values[rows]


def test_a_file_has_its_name_when_it_is_whole(tmp_path):
    values, out = photographs(), tmp_path / "coefficients.npy"
    with pytest.raises(OSError, match="the disk is gone") as caught:
        project_pixels(BASIS, LIGHTS, Lazy(values, broken=60), rows=20, out=out, every=0.0)
    assert caught.value.__notes__ == ["while tile 3 of pixels was read"]
    assert [one.name for one in tmp_path.iterdir()] == [".coefficients.npy.unfinished"]
    source, said = Lazy(values), []
    fit = project_pixels(BASIS, LIGHTS, source, rows=20, out=out, on_tile=lambda *which: said.append(which))
    assert source.read[1:] == [(40, 60), (60, 80), (80, 100), (100, PIXELS)], "after a look at the first pixel"
    assert said == [(3, 6), (4, 6), (5, 6)]
    assert [one.name for one in tmp_path.iterdir()] == [out.name]
    assert isinstance(fit.coefficients, np.memmap)
    same(fit, values)
    np.testing.assert_array_equal(np.load(out), fit.coefficients)
    assert_close(fit.residual, project_pixels(BASIS, LIGHTS, values).residual)


def test_an_array_of_the_callers_and_a_checkpoint(tmp_path):
    values, out = photographs(), np.zeros((PIXELS, BASIS.count, 3), DTYPE)
    settings = {"rows": 20, "out": out, "checkpoint": tmp_path, "every": 0.0}
    with pytest.raises(OSError, match="the disk is gone"):
        project_pixels(BASIS, LIGHTS, Lazy(values, broken=60), **settings)
    assert not out[60:].any()
    source = Lazy(values)
    same(project_pixels(BASIS, LIGHTS, source, rows=20, out=out, checkpoint=tmp_path), values)
    assert source.read[1:] == [(40, 60), (60, 80), (80, 100), (100, PIXELS)]
    assert not list(tmp_path.iterdir())


def test_a_zarr_of_tensorstore(tmp_path):
    tensorstore = pytest.importorskip("tensorstore")

    def store(name, shape):
        chunks = {"chunks": [20, *shape[1:]], "shape": shape, "dtype": np.dtype(DTYPE).str}
        place = {"driver": "file", "path": str(tmp_path / name)}
        return tensorstore.open({"driver": "zarr", "kvstore": place, "metadata": chunks}, create=True).result()

    source, out = store("values", photographs().shape), store("coefficients", (PIXELS, BASIS.count, 3))
    source[:] = photographs()
    fit = project_pixels(BASIS, LIGHTS, source, rows=20, out=out)
    assert fit.coefficients is out
    same(fit, photographs())


def test_another_call_does_not_go_on_with_a_file(tmp_path):
    values, out = photographs(), tmp_path / "coefficients.npy"
    with pytest.raises(OSError, match="the disk is gone"):
        project_pixels(BASIS, LIGHTS, Lazy(values, broken=60), rows=20, out=out, every=0.0)
    for changed, words in {
        "tiles": {"rows": 30},
        "basis": {"basis": HSH(1)},
        "lights": {"lights": LIGHTS[::-1].copy()},
        "kind": {"source": values[:, :, :2]},
        "pixels": {"source": values[:60]},
    }.items():
        call = {"basis": BASIS, "lights": LIGHTS, "source": values, "rows": 20, "out": out} | words
        with pytest.raises(ValueError, match=f"another run, whose {changed} was"):
            project_pixels(**call)
    (tmp_path / ".coefficients.npy.unfinished" / "coefficients.npy").unlink()
    for there in ("is not there", "is there"):
        with pytest.raises(
            ValueError, match=rf"tiles are done and lacks coefficients.npy, .*, to {out}, which {there}"
        ):
            project_pixels(BASIS, LIGHTS, values, rows=20, out=out)
        out.touch()


def bad(kind):
    """Two tiles, the second of which is not in order."""
    first, second = photographs()[:50], photographs()[50:]
    if kind == "lights":
        second = second[:, :19]
    elif kind == "channels":
        second = second[:, :, :2]
    elif kind == "dtype":
        second = second.astype(np.float16)
    elif kind == "infinite":
        second[3, 4, 1] = np.inf
    elif kind == "words":
        second = second.astype(str)
    elif kind == "axes":
        second = second[0]
    return [first, second]


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("lights", r"expected \(pixels, 20 lights, channels\), got \(53, 19, 3\)"),
        ("channels", "expected 3 channels of .* as of the first, got 2"),
        ("dtype", "expected 3 channels of .* as of the first, got 3 channels of float16"),
        ("infinite", "1 values are infinite in .*, the first of pixel 53 under light 4: make them NaN"),
        ("words", "expected real numbers, got <U"),
        ("axes", r"got \(20, 3\)"),
    ],
)
def test_the_error_names_the_tile(kind, message, tmp_path):
    out = tmp_path / "coefficients.npy"
    with pytest.raises(TileError, match=f"tile 1: .*{message}") as caught:
        project_pixels(BASIS, LIGHTS, bad(kind), out=out, pixels=PIXELS)
    assert caught.value.tile == 1
    assert not out.exists()


def test_a_source_of_another_length(tmp_path):
    out = tmp_path / "coefficients.npy"
    with pytest.raises(TileError, match="tile 1: expected 103 pixels in all, got 50 up to here"):
        project_pixels(BASIS, LIGHTS, bad("none")[:1], out=out, pixels=PIXELS)
    assert not out.exists()
    with pytest.raises(TileError, match="tile 1: expected 60 pixels in all, got 103 with this tile"):
        project_pixels(BASIS, LIGHTS, bad("none"), out=np.zeros((60, BASIS.count, 3), DTYPE))
    shorter = Lazy(photographs())
    shorter.values = shorter.values[:70]
    with pytest.raises(TileError, match="tile 3: expected 20 pixels from 60 on, got 10"):
        project_pixels(BASIS, LIGHTS, shorter, rows=20)
    with pytest.raises(TileError, match=r"tile 0: .*got \(0, 20, 0\)"):
        project_pixels(BASIS, LIGHTS, [])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"lights": 2 * LIGHTS}, "light 0 is not of unit length"),
        ({"lights": -LIGHTS}, "light 0 is below the horizon"),
        ({"lights": LIGHTS[:, :2]}, r"directions \(lights, 3\)"),
        ({"lights": LIGHTS[:8], "source": photographs()[:, :8]}, "8 lights do not determine the 9 functions"),
        ({"lights": np.tile(LIGHTS[:1], (20, 1))}, "the lights do not determine the 9 functions: condition number"),
        ({"weight": np.ones(3)}, "one number for each of 20 lights"),
        ({"weight": -np.ones(20)}, "finite, >= 0, and not all 0"),
        ({"source": photographs()[0]}, r"must be \(pixels, 20 lights, channels\)"),
        ({"rows": 0}, "at least 1, got 0"),
        ({"pixels": 4}, "this one has 103, got 4"),
        ({"pixels": 0, "source": iter([photographs()])}, "pixels must be at least 1, got 0"),
        ({"ridge": np.inf}, "ridge must be finite and >= 0, got inf"),
        ({"ridge": 1.0, "prior": np.full(9, np.inf)}, "prior must be finite and >= 0, got inf for mode 0"),
        ({"ridge": 1.0, "prior": np.ones(4)}, r"one number for each of the 9 modes, got shape \(4,\)"),
        ({"out": np.zeros((3, 9, 3))}, r"out must be \(pixels, functions, channels\), \(103, 9, 3\) here, got \(3, 9"),
        ({"out": np.zeros((PIXELS, 9, 3), int)}, "out must hold floating values, got int64"),
        ({"out": "."}, "out must be the path of a file, and . is a folder"),
        ({"out": "x.zarr"}, "becomes a .npy file, got x.zarr"),
        ({"out": 250 * "x"}, "must leave room for .x*.unfinished, which has 262 bytes, 255 at most"),
        ({"checkpoint": "here"}, "a checkpoint is for an `out`"),
        ({"prior": "spectral"}, "ridge > 0"),
        ({"verify": "some"}, "verify must be one of last, all, got 'some'"),
    ],
)
def test_calls_that_make_no_sense(changed, message, unchecked):
    call = {"basis": BASIS, "lights": LIGHTS, "source": photographs()} | changed
    with pytest.raises(ValueError, match=message):
        project_pixels(**call)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"source": "stack.npy"}, "got a path: np.load"),
        ({"source": None}, "must be an array, or yield tiles of one, got NoneType"),
        ({"out": [1, 2]}, "out must be an array, a path or None, got list"),
        ({"rows": 2.5}, "'float' object cannot be interpreted as an integer"),
        ({"mesh": 4}, r"must be a mesh of jax, such as device_mesh\(4\), got 4"),
        ({"basis": IsotropicBasis(HSH(1))}, r"functions of one direction, .* got IsotropicBasis\("),
    ],
)
def test_arguments_of_another_kind(changed, message, unchecked):
    call = {"basis": BASIS, "lights": LIGHTS, "source": photographs()} | changed
    with pytest.raises(TypeError, match=message):
        project_pixels(**call)


def test_a_file_of_tiles_needs_their_number(tmp_path):
    with pytest.raises(ValueError, match="needs to know the number of pixels"):
        project_pixels(BASIS, LIGHTS, iter([photographs()]), out=tmp_path / "out.npy")


def test_lights_all_around():
    fit = project_pixels(SphericalHarmonics(2), -LIGHTS, photographs())
    assert fit.coefficients.shape == (PIXELS, 9, 3)


def test_values_that_the_dtype_of_the_fit_does_not_hold():
    values = np.ones((2, 3, 1))
    values[1, :2, 0] = 1e300, np.nan
    message = "1 values are infinite in float32, the first of pixel 11 under light 0"
    with pytest.raises(TileError, match=message):
        known_values(Tile(0, 10, values), np.dtype(np.float32), np.array([True, True, True]))
    found, known = known_values(Tile(0, 10, values), np.dtype(np.float32), np.array([False, True, True]))
    assert found.dtype == np.float32
    np.testing.assert_array_equal(known, [[True, True, True], [False, False, True]])
