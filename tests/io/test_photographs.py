"""Folders with light files, archives, layers: what is read, what is said about it, and what is refused."""

import io
import shutil
import zipfile

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from hshjax.io import (
    FileFormatError,
    read_light_positions,
    read_photograph_folder,
    read_photograph_layers,
    read_photographs,
    read_photographs_npz,
    write_exr,
)
from hshjax.io._images import write_png
from hshjax.lighting import DirectionalLight, PointLight
from tests.helpers import DTYPE, assert_close

SHAPE = ROWS, COLUMNS = 4, 6
NAMES = ("left side.png", "b.png", "a.png")
VECTORS = np.array([[-0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1.0]])


def noise(dtype, *shape: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    if np.dtype(dtype).kind == "f":
        return rng.random(shape).astype(dtype)
    return rng.integers(0, np.iinfo(dtype).max, shape, dtype)  # without the top of the range


def light_file(path, names=NAMES, vectors=VECTORS, count=None):
    lines = [f"{name} {' '.join(map(str, vector))}" for name, vector in zip(names, vectors, strict=True)]
    path.write_text("\n".join([str(len(names) if count is None else count), *lines]) + "\n")


def write(path, pixels):
    if pixels.dtype.kind == "f":
        write_exr(path, pixels)
    else:
        write_png(path, pixels)


def folder(path, images, mask=None, **kwargs):
    path.mkdir()
    for name, image in zip(NAMES, images, strict=True):
        write(path / name, image)  # OpenEXR under the name of a PNG: the kind is the file's
    light_file(path / "dome.lp", **kwargs)
    if mask is not None:
        write_png(path / "mask.png", np.where(mask, 255, 0).astype(np.uint8))
    return path


def has(photographs, note: str) -> bool:
    return any(note in line for line in photographs.notes)


# --- light files ------------------------------------------------------------------------------------------------------


def test_a_light_file(tmp_path):
    path = tmp_path / "a.lp"
    path.write_bytes(
        b"\xef\xbb\xbf 3 \r\n\r\nC:\\photos of it\\left side.jpg -0.5 1e-1\t.8\r\n"
        b'"/home/x/b.JPG"\t0 0 1\r\nc.png  +1 -2 -3 \r\n'
    )
    names, vectors = read_light_positions(path)
    assert names == ("left side.jpg", "b.JPG", "c.png")
    assert vectors.tolist() == [[-0.5, 0.1, 0.8], [0, 0, 1], [1, -2, -3]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "line 1: expected the number of lights, got nothing"),
        (b"a.png 0 0 1", "line 1: expected the number of lights, got 'a.png 0 0 1'"),
        (b"-1\n", "line 1: expected the number of lights, got '-1'"),
        (b"0\n", "lines: expected 1 after the first, which says so, got 0"),
        (b"2\na.png 0 0 1\n", "lines: expected 2 after the first, which says so, got 1"),
        (b"1\na.png 0 0 1\nb.png 0 0 1", "lines: expected 1 after the first, which says so, got 2"),
        (b"1\n\na.png 0 1", "line 3: expected a name and three finite numbers .*, got 'a.png 0 1'"),
        (b"1\n0 0 1", "line 2: expected a name and three"),
        (b"1\na.png 0 0 x", "line 2: expected a name and three"),
        (b"1\na.png 0 0 nan", "line 2: expected a name and three finite"),
        (b"1\na.png 0 0 1e999", "line 2: expected a name and three finite"),
        (b"1\na.png 0 0 0.0", "line 2: expected a name and three finite numbers that are not all zero"),
        (b"2\na.png 0 0 1\nx/a.png 0 1 1", "line 3: expected a name that no other line has, got 'a.png'"),
        (b"1\na\xff.png 0 0 1", "byte 3: expected text in UTF-8"),
        (b"1\n\x89PNG\r\n\x1a\n\x00 0 0 1", "expected"),
    ],
)
def test_malformed_light_files(content, message, tmp_path):
    (tmp_path / "a.lp").write_bytes(content)
    with pytest.raises(FileFormatError, match=f"a.lp: .*{message}"):
        read_light_positions(tmp_path / "a.lp")


# --- folders ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
def test_images_of_every_kind(dtype, channels, tmp_path):
    images = noise(dtype, 3, *SHAPE, channels)
    mask = noise(np.uint8, *SHAPE) > 100
    scale = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    path = folder(tmp_path / "a", images, mask)
    photographs = read_photograph_folder(path)
    assert photographs.values.dtype == np.float32
    np.testing.assert_allclose(photographs.values, images[:, mask].transpose(1, 0, 2) / scale, rtol=1e-6)
    assert isinstance(photographs.lights, DirectionalLight)
    assert photographs.lights.direction.dtype == DTYPE
    assert_close(photographs.lights.direction, VECTORS)
    assert_close(photographs.lights.irradiance, np.ones(3))
    assert has(photographs, "Light file dome.lp: 3 lights.")
    assert has(photographs, f"3 photographs of 4 x 6 pixels, {mask.sum()} of them in the mask, channels: {channels}.")
    for same in (path, path / "dome.lp"):
        assert np.array_equal(read_photographs(same).values, photographs.values)


def test_without_a_mask_every_pixel_counts(tmp_path):
    photographs = read_photograph_folder(folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE)))
    assert photographs.mask.all()
    assert has(photographs, "No mask.png: every pixel is taken to see the object.")


def test_srgb_is_decoded_where_it_is_said(tmp_path):
    images = np.zeros((3, 16, 16), np.uint8) + np.arange(256, dtype=np.uint8).reshape(16, 16)
    path = folder(tmp_path / "a", images)
    linear = read_photograph_folder(path, saturated="keep")
    decoded = read_photograph_folder(path, encoding="srgb", saturated="keep")
    np.testing.assert_allclose(linear.values[:, 1, 0], np.arange(256) / 255, rtol=1e-6)
    # Encoded again by the standard's other formula.
    value = decoded.values[:, 1, 0].astype(float)
    again = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(again, np.arange(256) / 255, atol=1e-6)
    assert has(linear, "8-bit values, divided by 255, taken as linear in light.")
    assert has(decoded, "8-bit values, divided by 255, taken as encoded by sRGB, and decoded.")
    with pytest.raises(ValueError, match=r'encoding "srgb" is one of integers, and .*left side.png holds float32'):
        read_photograph_folder(folder(tmp_path / "b", noise(np.float32, 3, *SHAPE)), encoding="srgb")


def test_jpeg(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE, 3))
    pixels = np.full((*SHAPE, 3), (200, 100, 50), np.uint8)
    for name in NAMES:
        Image.fromarray(pixels).save(path / name, "JPEG", quality=100)
    np.testing.assert_allclose(
        read_photograph_folder(path).values * 255, np.broadcast_to((200, 100, 50), (24, 3, 3)), atol=1.5
    )


def test_jpeg_that_wants_to_be_turned_is_left_as_it_is_and_noted(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE, 3))
    pixels = np.broadcast_to(np.arange(COLUMNS, dtype=np.uint8)[:, None] * 20, (*SHAPE, 3))
    for name, way in zip(NAMES, (6, 1, 3), strict=True):
        exif = Image.Exif()
        exif[0x0112] = way
        Image.fromarray(pixels).save(path / name, "JPEG", quality=100, subsampling=0, exif=exif)
    photographs = read_photograph_folder(path)
    assert photographs.mask.shape == SHAPE
    assert has(photographs, "EXIF asks for 2 images to be turned (left side.png, a.png): they are as stored.")
    np.testing.assert_allclose(photographs.image(photographs.values[:, 0]) * 255, pixels, atol=4)


def test_a_truncated_jpeg(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE, 3))
    for name in NAMES:
        Image.fromarray(noise(np.uint8, 60, 80, 3)).save(path / name, "JPEG")
    content = (path / "b.png").read_bytes()
    for keep, place in ((3, "header"), (40, "header"), (len(content) // 2, "pixels"), (len(content) - 2, "pixels")):
        (path / "b.png").write_bytes(content[:keep])
        with pytest.raises(FileFormatError, match=f"b.png: {place}: expected an intact"):
            read_photograph_folder(path)


def test_saturated_values(tmp_path):
    images = noise(np.uint8, 3, *SHAPE)
    images[1, 2, 3] = 255
    path = folder(tmp_path / "a", images)
    dropped, kept = read_photograph_folder(path), read_photograph_folder(path, saturated="keep")
    assert np.argwhere(np.isnan(dropped.values)).tolist() == [[2 * COLUMNS + 3, 1, 0]]
    assert kept.values[2 * COLUMNS + 3, 1, 0] == 1
    assert has(dropped, "Saturated, at 255: 1 of 72 values (1.39%), NaN here.")
    assert has(kept, "Saturated, at 255: 1 of 72 values (1.39%), kept.")


def test_a_camera_that_saturates_below_the_top_is_mentioned(tmp_path):
    light = np.random.default_rng(0).exponential(1500, (3, 40, 40))
    path = folder(tmp_path / "a", np.minimum(light, 4095).astype(np.uint16))
    assert has(read_photograph_folder(path), "The largest value, 0.06249 of the range, occurs")
    path = folder(tmp_path / "b", np.minimum(light, 60000).astype(np.uint16))
    assert not has(read_photograph_folder(path), "The largest value")


def test_values_that_are_not_finite(tmp_path):
    images = noise(np.float32, 3, *SHAPE, 3)
    images[0, 0, 0] = np.nan
    images[1, 1, 1, 2] = np.inf
    images[2, 2, 2, 0] = -0.5
    photographs = read_photograph_folder(folder(tmp_path / "a", images))
    assert np.isnan(photographs.values).sum() == 4
    assert photographs.values.min() == -0.5 or np.nanmin(photographs.values) == -0.5
    assert has(photographs, f"Not finite, NaN here: 4 of {images.size} values (1.85%).")


def test_lights_nearby(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE), vectors=2 * VECTORS)
    photographs = read_photographs(path, near=0.25)
    assert isinstance(photographs.lights, PointLight)
    assert_close(photographs.lights.position, 0.5 * VECTORS)
    assert_close(photographs.lights.intensity, np.ones(3))
    assert has(photographs, "Lights are nearby, at 0.25 times the positions")
    for near in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="near must be a finite number above 0"):
            read_photograph_folder(path, near=near)


def test_directions_of_other_lengths_and_lights_behind(tmp_path):
    vectors = VECTORS * np.array([[1], [2], [-3.0]])
    photographs = read_photograph_folder(folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE), vectors=vectors))
    assert_close(photographs.lights.direction, VECTORS * np.array([[1], [1], [-1.0]]))
    assert has(photographs, "1 of 3 lights are not in front of the object (z <= 0): kept.")
    assert has(photographs, "2 of 3 directions had lengths from 1 to 3: brought to 1; lights are taken as far away.")


def test_without_a_light_file_nothing_is_known_of_the_lights(tmp_path):
    images = noise(np.uint8, 3, *SHAPE)
    path = folder(tmp_path / "a", images)
    (path / "dome.lp").unlink()
    photographs = read_photographs(path)
    assert photographs.lights is None
    assert has(photographs, "No light file (*.lp): nothing is known of the lights.")
    order = np.argsort(NAMES)
    np.testing.assert_allclose(photographs.values[..., 0], images.reshape(3, -1)[order].T / 255, rtol=1e-6)
    with pytest.raises(FileFormatError, match=r"light files \(\*.lp\): expected one, with the positions"):
        read_photographs(path, near=1.0)


def test_images_that_the_light_file_leaves_out_are_named(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE))
    write_png(path / "preview.png", noise(np.uint8, 2, 2))
    photographs = read_photographs(path)
    assert photographs.count == 3
    assert has(photographs, "1 images are not in the light file and are left out: preview.png.")


def test_one_photograph(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE))
    light_file(path / "dome.lp", NAMES[:1], VECTORS[:1])
    photographs = read_photographs(path)
    assert photographs.values.shape == (24, 1, 1)
    assert photographs.lights.direction.shape == (1, 3)
    assert has(photographs, "One photograph: by itself it does not determine normals.")


def test_photographs_without_light_or_without_anything(tmp_path):
    images = noise(np.uint8, 3, *SHAPE)
    images[0], images[1] = 0, 255
    photographs = read_photographs(folder(tmp_path / "a", images))
    assert any(
        note.startswith("No light inside the mask in 1 photo") and "left side.png." in note
        for note in photographs.notes
    )
    assert any(
        note.startswith("Nothing is known of any pixel in 1") and note.endswith("b.png.") for note in photographs.notes
    )
    images[2] = 0
    with pytest.raises(
        FileFormatError, match=r"left side.png: images: expected light in at least one .*, got none in 3"
    ):
        read_photographs(folder(tmp_path / "b", images))


def remove(name):
    return lambda path: (path / name).unlink()


def image(name, *shape, dtype=np.uint8):
    return lambda path: write_png(path / name, noise(dtype, *shape))


def cut(name):
    return lambda path: (path / name).write_bytes((path / name).read_bytes()[:-20])


def empty(path):
    for file in path.iterdir():
        file.unlink()


MALFORMED = {
    "an image too few": (remove("a.png"), "dome.lp: light 3: expected an image in .*a, got 'a.png', not there"),
    "a light too few": (lambda path: light_file(path / "dome.lp", count=2), "lines: expected 2 after the first"),
    "another name": (lambda path: light_file(path / "dome.lp", ("A.png", "b.png", "a.png")), "got 'A.png', not there"),
    "two light files": (
        lambda path: light_file(path / "b.LP"),
        r"light files \(\*.lp\): expected one, got b.LP, dome.lp",
    ),
    "no images": (empty, "images: expected at least one of .png, .jpg, .jpeg, .exr, got none"),
    "another size": (
        image("b.png", 4, 5),
        r"b.png: image: expected .* = \(4, 6, 1\) of uint8, as .*left side.png, got \(4, 5, 1\) of uint8",
    ),
    "other channels": (image("b.png", 4, 6, 3), r"b.png: image: .*got \(4, 6, 3\) of uint8"),
    "other bits": (image("b.png", 4, 6, dtype=np.uint16), r"b.png: image: .*got \(4, 6, 1\) of uint16"),
    "a mask of another size": (
        image("mask.png", 6, 4),
        r"mask.png: size: expected \(rows, columns\) = \(4, 6\), those of .*left side.png, got \(6, 4\)",
    ),
    "an empty mask": (
        lambda path: write_png(path / "mask.png", np.zeros(SHAPE, np.uint8)),
        "mask.png: mask: expected pixels that see",
    ),
    "a truncated image": (cut("b.png"), "b.png: pixels: expected an intact image"),
    "a truncated mask": (
        lambda path: (path / "mask.png").write_bytes((path / "b.png").read_bytes()[:-20]),
        "mask.png: pixels",
    ),
    "text for an image": (lambda path: (path / "b.png").write_text("b.png"), "b.png: byte 0: expected an image"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_folders(case, tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE))
    change, message = MALFORMED[case]
    change(path)
    with pytest.raises(FileFormatError, match=message):
        read_photograph_folder(path)


def test_one_of_two_light_files_can_be_named(tmp_path):
    path = folder(tmp_path / "a", noise(np.uint8, 3, *SHAPE))
    light_file(path / "other.lp", NAMES[::-1], VECTORS)
    assert_close(read_photographs(path / "dome.lp").values, read_photographs(path / "other.lp").values[:, ::-1])


# --- archives ---------------------------------------------------------------------------------------------------------


def archive(path, **changes):
    """An archive of all that is known, with changes; None leaves an array out."""
    arrays = {
        "images": noise(np.uint16, 3, *SHAPE, 3),
        "mask": noise(np.uint8, *SHAPE) > 100,
        "lights": VECTORS,
        "irradiance": np.array([1.0, 2.0, 3.0]),
        "normals": np.broadcast_to([0.0, 0.6, 0.8], (*SHAPE, 3)),
    }
    np.savez(path, **{key: value for key, value in (arrays | changes).items() if value is not None})
    return arrays | changes


def test_an_archive(tmp_path):
    arrays = archive(tmp_path / "a.npz")
    photographs = read_photographs(tmp_path / "a.npz")
    mask = arrays["mask"]
    np.testing.assert_allclose(photographs.values, arrays["images"][:, mask].transpose(1, 0, 2) / 65535, rtol=1e-6)
    assert np.array_equal(photographs.mask, mask)
    assert_close(photographs.lights.direction, VECTORS)
    assert_close(photographs.lights.irradiance, [1, 2, 3])
    assert_close(photographs.truth, np.broadcast_to([0, 0.6, 0.8], (mask.sum(), 3)))
    assert photographs.notes[0] == "Archive of arrays: images, mask, lights, irradiance, normals."


def test_an_archive_of_images_alone(tmp_path):
    images = noise(np.float64, 3, *SHAPE)
    images[1, 2, 3] = np.nan
    np.savez_compressed(tmp_path / "a.npz", images=images, comment=np.array("by hand"))
    photographs = read_photographs_npz(tmp_path / "a.npz")
    np.testing.assert_allclose(photographs.values[..., 0], images.reshape(3, -1).T, rtol=1e-6)
    assert photographs.lights is None
    assert photographs.truth is None
    assert photographs.mask.all()
    assert has(photographs, "Arrays that are not read: comment.")
    assert has(photographs, "No array 'lights' or 'positions': nothing is known of the lights.")
    assert has(photographs, "Not finite, NaN here: 1 of 72 values")


def test_an_archive_of_lights_nearby(tmp_path):
    archive(tmp_path / "a.npz", lights=None, positions=5 * VECTORS, irradiance=noise(np.float64, 3, 3) + 1)
    lights = read_photographs(tmp_path / "a.npz").lights
    assert isinstance(lights, PointLight)
    assert_close(lights.position, 5 * VECTORS)
    assert lights.intensity.shape == (3, 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": None}, r"array 'images': expected this array, got \['irradiance'"),
        ({"images": noise(np.uint8, *SHAPE)}, r"array 'images': expected 3 or 4 axes, got shape \(4, 6\)"),
        (
            {"images": np.zeros((3, *SHAPE), np.int16)},
            "array 'images': expected unsigned integers or floats, got int16",
        ),
        ({"images": np.zeros((3, *SHAPE), np.uint32)}, "array 'images': expected 8 or 16 bits, or floats, got uint32"),
        ({"images": np.zeros((0, *SHAPE))}, r"array 'images': expected no empty axis, got \(0, 4, 6, 1\)"),
        ({"images": np.full((3, *SHAPE), np.nan)}, "expected light in at least one of them, got none in 3"),
        ({"images": np.zeros((3, *SHAPE))}, "expected light in at least one of them, got none in 3"),
        ({"images": np.array([None])}, "archive: expected arrays of numbers .*, without pickle, got Object arrays"),
        ({"mask": np.zeros(SHAPE, bool)}, "array 'mask': expected pixels that see the object, not 0, got none"),
        ({"mask": np.ones((6, 4), bool)}, r"array 'mask': expected \(4, 6\), got shape \(6, 4\)"),
        ({"mask": np.ones(SHAPE)}, "array 'mask': expected bool or unsigned integers or integers, got float64"),
        ({"lights": VECTORS[:2]}, r"array 'lights': expected \(3, 3\), got shape \(2, 3\)"),
        ({"lights": VECTORS * [[0], [1], [1]]}, "light 1: expected a finite vector that is not zero"),
        ({"lights": VECTORS * [[np.nan], [1], [1]]}, "light 1: expected a finite vector"),
        ({"positions": VECTORS}, "expected 'lights' far away or 'positions' of lights nearby, got both"),
        ({"lights": None}, "array 'irradiance': expected directions or positions beside it, got neither"),
        (
            {"irradiance": np.ones((3, 2))},
            r"array 'irradiance': expected \(3,\) or \(3, 1\) or \(3, 3\), got shape \(3, 2\)",
        ),
        ({"irradiance": np.array([1.0, 0, 1])}, "array 'irradiance': expected finite numbers above 0"),
        ({"normals": np.ones((4, 6))}, "array 'normals': expected "),
    ],
)
def test_malformed_archives(changes, message, tmp_path):
    archive(tmp_path / "a.npz", **changes)
    with pytest.raises(FileFormatError, match=f"a.npz.*: {message}"):
        read_photographs(tmp_path / "a.npz")


@pytest.mark.parametrize("keep", [30, 500, -30])
def test_truncated_archives(keep, tmp_path):
    archive(tmp_path / "a.npz")
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:keep])
    with pytest.raises(FileFormatError, match=r"a\.npz: archive: expected an intact one"):
        read_photographs(tmp_path / "a.npz")


def test_a_damaged_archive_is_found_by_its_checksums(tmp_path):
    archive(tmp_path / "a.npz")
    content = bytearray((tmp_path / "a.npz").read_bytes())
    content[400] ^= 1
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"a\.npz: archive: expected an intact one"):
        read_photographs(tmp_path / "a.npz")


def test_an_archive_that_calls_itself_encrypted(tmp_path):
    archive(tmp_path / "a.npz")
    content = bytearray((tmp_path / "a.npz").read_bytes())
    content[content.rindex(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"a\.npz: archive: expected an intact one .* encrypted"):
        read_photographs(tmp_path / "a.npz")


@pytest.mark.parametrize("key", ["images", "lights"])
def test_a_member_of_an_archive_that_is_no_array(tmp_path, key):
    arrays = archive(tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:  # numpy gives bytes without its magic word as they are
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, array)
            file.writestr(f"{name}.npy", b"text" if name == key else content.getvalue())
    with pytest.raises(FileFormatError, match=rf"a\.npz: array '{key}': expected an array"):
        read_photographs(tmp_path / "a.npz")


def test_one_array_is_no_archive(tmp_path):
    np.save(tmp_path / "a.npy", np.ones((3, *SHAPE)))
    with pytest.raises(FileFormatError, match="byte 0: expected an archive of arrays"):
        read_photographs_npz(tmp_path / "a.npy")


# --- layers -----------------------------------------------------------------------------------------------------------


def test_layers_of_one_image(tmp_path):
    pixels = noise(np.float32, *SHAPE, 7)
    channels = ["z.R", "z.G", "z.B", "a.R", "a.G", "a.B", "depth"]
    write_exr(tmp_path / "stack.exr", pixels, channels)
    light_file(tmp_path / "stack.lp", ("z", "a"), VECTORS[:2])
    photographs = read_photographs(tmp_path / "stack.exr")
    assert np.array_equal(photographs.values, pixels[..., :6].reshape(24, 2, 3))
    assert_close(photographs.lights.direction, VECTORS[:2])
    assert has(photographs, "1 channels are not in the light file and are left out: depth.")
    assert has(photographs, "Light file stack.lp: 2 layers of stack.exr.")
    mask = noise(np.uint8, *SHAPE) > 100
    write_png(tmp_path / "mask.png", mask.astype(np.uint8))
    masked = read_photograph_layers(tmp_path / "stack.exr", near=2.0)
    assert np.array_equal(masked.values, pixels[mask][:, :6].reshape(-1, 2, 3))
    assert_close(masked.lights.position, 2 * VECTORS[:2])


def test_a_channel_a_light(tmp_path):
    pixels = noise(np.float32, *SHAPE, 3)
    write_exr(tmp_path / "stack.exr", pixels, ("c", "a", "b"))
    light_file(tmp_path / "stack.lp", ("c", "a", "b"))
    assert np.array_equal(read_photograph_layers(tmp_path / "stack.exr").values, pixels.reshape(24, 3, 1))


def test_layers_that_disagree_with_the_light_file(tmp_path):
    write_exr(tmp_path / "stack.exr", noise(np.float32, *SHAPE, 3), ("a", "b.R", "b.G"))
    with pytest.raises(FileNotFoundError, match=r"stack\.lp"):
        read_photographs(tmp_path / "stack.exr")
    light_file(tmp_path / "stack.lp", ("a", "b"), VECTORS[:2])
    with pytest.raises(FileFormatError, match=r"layer 'b': expected the channel b, or b.R, b.G, b.B, got a, b.G, b.R"):
        read_photographs(tmp_path / "stack.exr")


# --- any --------------------------------------------------------------------------------------------------------------


def test_other_files_and_options_without_a_use(tmp_path):
    (tmp_path / "a.txt").write_text("12 lights")
    with pytest.raises(
        FileFormatError, match=r"a\.txt: byte 0: expected a folder of images, a light file .*, got b'12 l'"
    ):
        read_photographs(tmp_path / "a.txt")
    with pytest.raises(FileNotFoundError):
        read_photographs(tmp_path / "nothing")
    archive(tmp_path / "a.npz")
    with pytest.raises(ValueError, match="an archive of arrays says itself where lights are, got near=1"):
        read_photographs(tmp_path / "a.npz", near=1.0)
    write_exr(tmp_path / "a.exr", noise(np.float32, *SHAPE, 3))
    with pytest.raises(ValueError, match='OpenEXR is linear in light, got encoding="srgb"'):
        read_photographs(tmp_path / "a.exr", encoding="srgb")


def test_an_unknown_encoding(unchecked, tmp_path):
    with pytest.raises(ValueError, match='encoding must be "linear" or "srgb", got \'gamma\''):
        read_photograph_folder(tmp_path, encoding="gamma")


# --- real data --------------------------------------------------------------------------------------------------------


def test_the_matte_sphere(data):
    """Its normals follow from its outline: x right and y up, or the error is tens of degrees."""
    photographs = read_photographs(data / "uw_stereo/gray.npz")
    assert has(photographs, "8-bit values")
    rows, columns = np.nonzero(photographs.mask)
    radius = np.sqrt(photographs.pixels / np.pi)
    x, y = (columns - columns.mean()) / radius, (rows.mean() - rows) / radius
    rim = np.hypot(x, y)
    truth = np.stack([x, y, np.sqrt(np.maximum(1 - rim**2, 0))], -1) / np.maximum(rim, 1)[:, None]
    grey = np.nan_to_num(photographs.values, nan=1.0) @ (0.299, 0.587, 0.114)
    scaled = np.linalg.lstsq(np.asarray(photographs.lights.direction, float), grey.T, rcond=None)[0].T
    for mirrored, expected in (((1, 1, 1), (5.5, 6.5)), ((-1, 1, 1), (30, 180)), ((1, -1, 1), (30, 180))):
        cosine = np.sum(scaled * mirrored * truth, axis=-1) / np.linalg.norm(scaled, axis=-1)
        assert expected[0] < np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < expected[1]


def test_a_real_folder_with_a_light_file_made_for_it(data, tmp_path):
    """The DiLiGenT cat as a dome tool would leave it: the same values as by its own reader."""
    source = data / "diligent/catPNG"
    names = (source / "filenames.txt").read_text().split()[::8]
    directions = np.loadtxt(source / "light_directions.txt")[::8]
    for name in (*names, "mask.png"):
        shutil.copy(source / name, tmp_path / name)
    light_file(tmp_path / "cat.lp", names, directions)
    mine, theirs = read_photographs(tmp_path), read_photographs(source)
    assert np.array_equal(mine.values, theirs.values[:, ::8])
    assert jnp.array_equal(mine.lights.direction, theirs.lights.direction[::8])
    assert mine.notes[-1] == "Saturated, at 65535: 0 of 1627200 values (0.00%), NaN here."
