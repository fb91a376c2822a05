"""Normal maps there and back, their conventions by hand, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.io import FileFormatError, exr_channels, read_exr, read_normals, write_exr, write_normals
from hshjax.io._images import read_image, write_png
from tests.helpers import directions


def hemisphere() -> np.ndarray:
    """Normals all over the hemisphere, with two pixels of which nothing is known."""
    normals = np.array(directions(3, 40, 30))
    normals[2, 3], normals[4, 5] = 0, np.nan
    return normals


def degrees(a, b):
    a, b = a / np.linalg.norm(a, axis=-1, keepdims=True), b / np.linalg.norm(b, axis=-1, keepdims=True)
    return np.degrees(2 * np.arcsin(np.linalg.norm(a.astype(float) - b, axis=-1) / 2))


@pytest.mark.parametrize("convention", ["opengl", "directx", "camera"])
@pytest.mark.parametrize(("name", "bits", "bound"), [("a.exr", 16, 1e-5), ("a.png", 16, 0.0016), ("a.PNG", 8, 0.4)])
def test_there_and_back(name, bits, bound, convention, tmp_path):
    normals = hemisphere()
    write_normals(tmp_path / name, normals, convention, bits=bits)
    read = read_normals(tmp_path / name, convention)
    assert read.dtype == np.float32
    assert np.argwhere(np.isnan(read).any(-1)).tolist() == [[2, 3], [4, 5]]
    known = ~np.isnan(read[..., 0])
    assert degrees(read[known], normals[known]).max() < bound
    np.testing.assert_allclose(np.linalg.norm(read[known], axis=-1), 1, atol=1e-6)


@pytest.mark.parametrize(
    ("convention", "expected"), [("opengl", (0.6, 0, 0.8)), ("directx", (0.6, 0, 0.8)), ("camera", (0.6, 0, -0.8))]
)
def test_to_the_right(convention, expected, tmp_path):
    write_normals(tmp_path / "a.exr", np.array([[[0.6, 0.0, 0.8]]]), convention)
    assert exr_channels(tmp_path / "a.exr") == ("R", "G", "B")
    np.testing.assert_allclose(read_exr(tmp_path / "a.exr")[0, 0], expected, atol=1e-7)


@pytest.mark.parametrize(("convention", "green"), [("opengl", 163), ("directx", 92), ("camera", 92)])
def test_upwards(convention, green, tmp_path):
    write_normals(tmp_path / "a.png", np.array([[[0.0, 0.28, 0.96], [0, 0, 0]]]), convention, bits=8)
    blue = 5 if convention == "camera" else 250
    assert read_image(tmp_path / "a.png").tolist() == [[[128, green, blue], [0, 0, 0]]]


def test_a_sphere_is_lit_from_above_in_opengl(tmp_path):
    """Green is brighter above the middle of a ball: how one tells the conventions apart by eye."""
    y, x = np.mgrid[0.9:-0.9:41j, -0.9:0.9:41j]
    rim = x**2 + y**2
    ball = np.where(rim[..., None] < 1, np.stack([x, y, np.sqrt(np.maximum(1 - rim, 0))], -1), 0)
    for convention, above in (("opengl", True), ("directx", False), ("camera", False)):
        write_normals(tmp_path / "a.png", ball, convention)
        green = read_image(tmp_path / "a.png")[:, 20, 1].astype(int)
        assert (green[8] > green[32]) == above


def test_backgrounds_of_other_programs_are_not_known(tmp_path):
    pixels = np.full((2, 3, 3), (128, 128, 255), np.uint8)
    pixels[0] = [[0, 0, 0], [255, 255, 255], [128, 128, 128]]
    write_png(tmp_path / "a.png", pixels)
    read = read_normals(tmp_path / "a.png")
    assert np.isnan(read[0]).all()
    assert degrees(read[1], np.array([0, 0, 1.0])).max() < 0.4


@pytest.mark.parametrize(
    ("normals", "arguments", "message"),
    [
        (np.ones((3, 3, 2)), {}, r"normals must be floats \(rows, columns, 3\), got \(3, 3, 2\)"),
        (np.ones((3, 3)), {}, r"got \(3, 3\)"),
        (np.ones((3, 3, 3), int), {}, "of int64"),
        (np.array([[[0, 0, 1.0], [0, 0, 1.1]]]), {}, r"1 have not, the first \[0.0, 0.0, 1.1\] at row 0, column 1"),
        (np.array([[[0, np.nan, 1.0]]]), {}, "length 1, or be zero or NaN: 1 have not"),
        (np.array([[[0, np.inf, 1.0]]]), {}, "length 1, or be zero or NaN: 1 have not"),
        (np.array([[[0, 0, 1.0]]]), {"convention": "unity"}, "convention must be one of opengl, directx, camera, got"),
        (np.array([[[0, 0, 1.0]]]), {"bits": 12}, "bits must be 8 or 16, got 12"),
        (np.array([[[0, 0, 1.0]]]), {"name": "a.tif"}, "normals are written as .exr or .png, got 'a.tif'"),
    ],
)
def test_what_cannot_be_written(normals, arguments, message, unchecked, tmp_path):
    name = arguments.pop("name", "a.png")
    with pytest.raises(ValueError, match=message):
        write_normals(tmp_path / name, normals, **arguments)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_read(tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, np.ones((3, 3)))
    with pytest.raises(FileFormatError, match=r"a.exr: channels: expected 3, got 1"):
        read_normals(path)
    write_exr(path, np.zeros((3, 3, 3)))
    with pytest.raises(FileFormatError, match=r"a.exr: pixels: expected vectors of length 1, to 0.1, got none"):
        read_normals(path)
    write_normals(path, hemisphere(), "camera")
    with pytest.raises(FileFormatError, match=r"towards the viewer by the convention 'opengl', got 1198 of 1198 that"):
        read_normals(path)
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(FileFormatError, match="expected an intact image"):
        read_normals(tmp_path / "a.png")


def test_arrays_of_a_surface_are_taken(tmp_path):
    write_normals(tmp_path / "a.exr", np.asarray(jnp.asarray(hemisphere())))
    assert read_normals(tmp_path / "a.exr").shape == (40, 30, 3)
