"""OpenEXR images."""

import struct

import numpy as np
import pytest

from hshjax.io import FileFormatError, exr_channels, read_exr, write_exr
from tests.io.hostile_binary import refused, replaced, written


def image(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("shape", [(5, 7, 3), (5, 7, 4), (1, 1, 3), (6, 2, 1), (40, 33, 3)])
def test_float32_comes_back_exactly(shape, tmp_path):
    pixels = image(*shape)
    pixels[0, 0, 0] = np.inf
    write_exr(tmp_path / "a.exr", pixels)
    read = read_exr(tmp_path / "a.exr")
    assert read.dtype == np.float32
    assert np.array_equal(read, pixels)


def test_a_plane_is_one_channel(tmp_path):
    write_exr(tmp_path / "a.exr", image(3, 4))
    assert exr_channels(tmp_path / "a.exr") == ("Y",)
    assert np.array_equal(read_exr(tmp_path / "a.exr")[..., 0], image(3, 4))


def test_half_is_rounded_to_half(tmp_path):
    write_exr(tmp_path / "a.exr", image(5, 7, 3), half=True)
    assert np.array_equal(read_exr(tmp_path / "a.exr"), image(5, 7, 3).astype(np.float16).astype(np.float32))


def test_named_channels(tmp_path):
    path, pixels = tmp_path / "a.exr", image(5, 7, 3)
    write_exr(path, pixels, ("normal.Z", "depth", "albedo"))
    assert exr_channels(path) == ("albedo", "depth", "normal.Z")
    assert np.array_equal(read_exr(path), pixels[..., [2, 1, 0]])
    assert np.array_equal(read_exr(path, ("depth", "albedo")), pixels[..., [1, 2]])
    with pytest.raises(FileFormatError, match=r"a.exr: channel 'R': expected this channel, got 'albedo', 'depth'"):
        read_exr(path, ("R",))


def test_overwrites_whole_and_leaves_nothing_beside(tmp_path):
    write_exr(tmp_path / "a.exr", image(5, 7, 3))
    write_exr(tmp_path / "a.exr", 2 * image(5, 7, 3))
    assert np.array_equal(read_exr(tmp_path / "a.exr"), 2 * image(5, 7, 3))
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.parametrize(
    ("pixels", "channels", "match"),
    [
        (image(5), None, r"got \(5,\) of float32"),
        (np.zeros((4, 4, 3), np.uint8), None, "of uint8"),
        (image(0, 4, 3), None, r"\(0, 4, 3\)"),
        (image(4, 4, 2), None, "2 channels needs"),
        (image(4, 4, 2), ("a", "a"), "2 different names"),
        (image(4, 4, 2), ("a",), "2 different names"),
        (np.full((2, 2, 3), 1e300), None, "1e[+]300"),
    ],
)
def test_what_cannot_be_written_is_said(pixels, channels, match, tmp_path):
    with pytest.raises(ValueError, match=match):
        write_exr(tmp_path / "a.exr", pixels, channels)
    assert not list(tmp_path.iterdir())


def test_missing_folder(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_exr(tmp_path / "no" / "a.exr", image(2, 2, 3))


@pytest.mark.parametrize("name", ["venice", "studio", "sunset"])
def test_real_environment_maps(name, data):
    path = data / f"envmaps/{name}.exr"
    pixels = read_exr(path)
    assert exr_channels(path) == ("R", "G", "B")
    assert pixels.shape == (256, 512, 3)
    assert pixels.dtype == np.float32
    assert np.all(np.isfinite(pixels))
    assert pixels.mean() > 0.1
    # Skies are blue: the order of channels is not alphabetical.
    if name == "venice":
        assert abs(pixels.max() - 8.6) < 0.05
        assert pixels[:40, :, 2].mean() > pixels[:40, :, 0].mean()


def test_files_that_are_no_images(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing"):
        read_exr(tmp_path / "missing.exr")
    with pytest.raises(IsADirectoryError):
        read_exr(tmp_path)
    for content, got in ((b"", "an empty file"), (b"\x89PNG\r\n", "PNG")):
        (tmp_path / "a.exr").write_bytes(content)
        with pytest.raises(FileFormatError, match=f"a.exr: byte 0: expected an OpenEXR file.*{got}"):
            read_exr(tmp_path / "a.exr")


@pytest.mark.parametrize("keep", [4, 8, 60, 200, 330, 400, -1])
def test_truncated_images_are_refused(keep, tmp_path):
    write_exr(tmp_path / "a.exr", image(40, 33, 3))
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(content[:keep])
    with pytest.raises(FileFormatError, match=r"a\.exr: (header|pixels)"):
        read_exr(tmp_path / "a.exr")


def test_corrupt_pixels_are_refused(tmp_path):
    # Pixels that compress: noise is stored as it is, without a checksum, and any bytes are then pixels.
    write_exr(tmp_path / "a.exr", np.linspace(0, 1, 40 * 33 * 3, dtype=np.float32).reshape(40, 33, 3))
    content = bytearray((tmp_path / "a.exr").read_bytes())
    content[-300:-200] = b"\xff" * 100
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"a\.exr: pixels: expected intact pixels"):
        read_exr(tmp_path / "a.exr")


def test_names_that_are_no_text_are_refused(tmp_path):
    write_exr(tmp_path / "a.exr", image(4, 4, 2), ("depth", "other"))
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(content.replace(b"depth", b"dep\xd8h"))
    for read in (exr_channels, read_exr):
        with pytest.raises(FileFormatError, match=r"a\.exr: (header: expected names|pixels: expected intact)"):
            read(tmp_path / "a.exr")


def test_an_absurd_size_is_refused(tmp_path):
    write_exr(tmp_path / "a.exr", image(4, 4, 1))
    content = (tmp_path / "a.exr").read_bytes()
    window = struct.pack("<4i", 0, 0, 3, 3)
    assert content.count(window) == 2
    (tmp_path / "a.exr").write_bytes(content.replace(window, struct.pack("<4i", 0, 0, 2**30, 2**30)))
    with pytest.raises(FileFormatError, match=r"a\.exr"):
        read_exr(tmp_path / "a.exr")


def test_integer_channels_are_refused(tmp_path):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"id": np.arange(6, dtype=np.uint32).reshape(2, 3)}).write(str(tmp_path / "a.exr"))
    with pytest.raises(FileFormatError, match="channel 'id': expected half or float pixels, got uint32"):
        read_exr(tmp_path / "a.exr")


def test_images_of_several_parts_are_refused(tmp_path):
    import OpenEXR

    parts = [OpenEXR.Part({}, {"Y": image(2, 3)}, name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    with pytest.raises(FileFormatError, match="parts: expected 1, got 2"):
        read_exr(tmp_path / "a.exr")


def test_a_window_that_lies(tmp_path):
    """Nothing is allocated for it."""
    path = tmp_path / "a.exr"
    write_exr(path, np.ones((8, 9, 3), np.float32))
    content = path.read_bytes()
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4 + 8
    for corner in ((2**20, 2**20), (2**27, 7), (8, 2**27)):
        error = refused(read_exr, written(path, replaced(content, at, "<2i", *corner)))
        assert "header" in str(error)
    assert read_exr(written(path, content)).shape == (8, 9, 3)
