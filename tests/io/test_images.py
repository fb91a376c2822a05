"""Images as stored, against an encoder written out here and against Pillow where that is exact."""

import io
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from hshjax.io import FileFormatError, write_exr
from hshjax.io._images import read_image, read_mask, write_png


def png(pixels: np.ndarray, colour: int, extra: bytes = b"") -> bytes:
    """A PNG by the letter of its specification (ISO/IEC 15948): no filter, one chunk of pixels, big-endian."""
    rows, columns = pixels.shape[:2]
    big = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(rows, -1)
    lines = b"".join(b"\0" + line.tobytes() for line in big)
    header = struct.pack(">IIBBBBB", columns, rows, 8 * pixels.dtype.itemsize, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND")


def chunk(name: bytes, body: bytes = b"") -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def noise(dtype, *shape: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


COLOURS = {1: 0, 3: 2, 2: 4, 4: 6}
"""Channels and colour type."""


@pytest.mark.parametrize("channels", COLOURS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_is_read_exactly(dtype, channels, tmp_path):
    pixels = noise(dtype, 7, 5, channels)
    if channels in (2, 4):
        pixels[..., -1] = np.iinfo(dtype).max
    # A gamma that a viewer would apply.
    (tmp_path / "a.png").write_bytes(png(pixels, COLOURS[channels], chunk(b"gAMA", struct.pack(">I", 45455))))
    read = read_image(tmp_path / "a.png")
    assert read.dtype == dtype
    assert np.array_equal(read, pixels[..., : 3 if channels > 2 else 1])


def test_every_16_bit_value_comes_back(tmp_path):
    pixels = np.arange(2**16, dtype=np.uint16)[::-1].reshape(256, 256)
    pixels = np.stack([pixels, pixels.T, pixels[::-1]], axis=-1)
    write_png(tmp_path / "a.png", pixels)
    assert np.array_equal(read_image(tmp_path / "a.png"), pixels)
    # Why Pillow does not do: the day this fails it may.
    assert np.asarray(Image.open(tmp_path / "a.png")).dtype == np.uint8


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_jpeg_as_pillow_reads_it(mode, tmp_path):
    smooth = np.add.outer(np.arange(64), np.arange(48)).astype(np.uint8)
    Image.fromarray(np.stack([smooth, 2 * smooth, 255 - smooth], -1)).convert(mode).save(tmp_path / "a.jpg", quality=95)
    expected = np.asarray(Image.open(tmp_path / "a.jpg"))
    read = read_image(tmp_path / "a.jpg").astype(int)
    assert np.abs(read - expected.reshape(read.shape)).max() <= 1  # two inverse transforms may round apart


def test_the_kind_is_found_in_the_file_and_not_in_its_name(tmp_path):
    pixels = np.random.default_rng(0).normal(size=(4, 5, 3)).astype(np.float32)
    write_exr(tmp_path / "a.png", pixels)
    assert np.array_equal(read_image(tmp_path / "a.png"), pixels)


def test_palettes_are_looked_up(tmp_path):
    image = Image.fromarray(noise(np.uint8, 6, 5, 3)).quantize(16)
    image.save(tmp_path / "a.png")
    assert np.array_equal(read_image(tmp_path / "a.png"), np.asarray(image.convert("RGB")))


def damaged() -> dict[str, tuple[bytes, str]]:
    whole, picture = png(noise(np.uint16, 30, 40, 3), 2), io.BytesIO()
    Image.fromarray(noise(np.uint8, 100, 100, 3)).save(picture, "JPEG", progressive=True)
    jpeg, cmyk = picture.getvalue(), io.BytesIO()
    Image.fromarray(noise(np.uint8, 9, 9, 4), "CMYK").save(cmyk, "JPEG")
    spoiled = bytearray(whole)
    spoiled[200] ^= 1
    transparent = noise(np.uint8, 3, 3, 4)
    transparent[..., -1] = [[255, 255, 0], [255, 255, 255], [254, 255, 255]]
    return {
        "empty": (b"", "byte 0: expected an image: PNG, JPEG or OpenEXR, got an empty file"),
        "text": (b"P6 3 3 255", "byte 0: expected an image"),
        "png signature": (whole[:8], "pixels: expected an intact image"),
        "png header": (whole[:40], "pixels: expected an intact image"),
        "png half": (whole[: len(whole) // 2], "pixels: expected an intact image"),
        "png a bit": (bytes(spoiled), "pixels: expected an intact image"),
        "png size": (
            whole[:8] + chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 16, 2, 0, 0, 0)),
            "header: expected at most .* inflates so much",
        ),
        "jpeg start": (jpeg[:100], "expected"),
        "jpeg half": (jpeg[: len(jpeg) // 2], "pixels: expected an intact image, got .* truncated"),
        "jpeg end": (jpeg[:-2], "pixels: expected an intact image, got .* truncated"),
        "cmyk": (cmyk.getvalue(), "pixels: expected an intact image, got .* colours CMYK, neither grey nor RGB"),
        "alpha": (png(transparent, 6), "alpha channel: expected opaque pixels, got 2 that are not"),
    }


@pytest.mark.parametrize("case", damaged())
def test_damaged_files_are_refused(case, tmp_path):
    content, message = damaged()[case]
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(FileFormatError, match=f"a.png: .*{message}"):
        read_image(tmp_path / "a.png")


def test_missing_files_stay_os_errors(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_image(tmp_path / "a.png")


def test_masks(tmp_path):
    path = tmp_path / "mask.png"
    write_png(path, np.array([[0, 127, 128, 255]], np.uint8))
    assert read_mask(path).tolist() == [[False, False, True, True]]
    write_png(path, np.array([[0, 1]], np.uint8))  # as some tools write it
    assert read_mask(path).tolist() == [[False, True]]
    cut_out = np.full((1, 3, 4), 255, np.uint8)  # white, and cut out by transparency
    cut_out[0, :, 3] = [255, 0, 60]
    path.write_bytes(png(cut_out, 6))
    assert read_mask(path).tolist() == [[True, False, False]]
    write_png(path, np.zeros((3, 3), np.uint8))
    with pytest.raises(
        FileFormatError, match=r"mask.png: mask: expected pixels that see the object, above 0, got none"
    ):
        read_mask(path)
    write_exr(path, np.ones((2, 2)))
    with pytest.raises(FileFormatError, match="expected 8 or 16 bits, got float32"):
        read_mask(path)
