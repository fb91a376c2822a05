"""Folders in the layout of DiLiGenT: small ones made here, and the benchmark's own."""

import shutil

import numpy as np
import pytest
import scipy.io

from hshjax.io import FileFormatError, read_diligent, read_photographs
from hshjax.io._images import write_png
from hshjax.photographs import LUMA
from tests.helpers import DTYPE, assert_close

ROWS, COLUMNS, LIGHTS = 6, 5, 4


def folder(path, *, top=60000):
    """A folder of random images; returns them as written, `(lights, rows, columns, 3)`."""
    rng = np.random.default_rng(1)
    images = rng.integers(0, top, (LIGHTS, ROWS, COLUMNS, 3), np.uint16)
    path.mkdir()
    names = [f"{9 - k:03d}.png" for k in range(LIGHTS)]  # not in the order of the alphabet
    for name, image in zip(names, images, strict=True):
        write_png(path / name, image)
    (path / "filenames.txt").write_text("\n".join(names) + "\n")
    np.savetxt(path / "light_directions.txt", unit(rng.normal((0, 0, 4), size=(LIGHTS, 3))), fmt="%.4f")
    np.savetxt(path / "light_intensities.txt", rng.uniform(1, 3, (LIGHTS, 3)), fmt="%.4f")
    mask = rng.random((ROWS, COLUMNS)) < 0.6
    write_png(path / "mask.png", np.where(mask, 255, 0).astype(np.uint8))
    normals = np.where(mask[..., None], unit(rng.normal(size=(ROWS, COLUMNS, 3))), 0)
    scipy.io.savemat(path / "Normal_gt.mat", {"Normal_gt": normals})
    return images, mask, normals


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def test_what_was_written_is_read(tmp_path):
    images, mask, normals = folder(tmp_path / "a")
    photographs = read_diligent(tmp_path / "a")
    expected = images[:, mask].transpose(1, 0, 2) / 65535
    np.testing.assert_allclose(photographs.values, expected, rtol=1e-7)
    assert np.array_equal(photographs.mask, mask)
    assert np.array_equal(
        photographs.image(photographs.values[:, 2]), np.where(mask[..., None], images[2], 0) / np.float32(65535)
    )
    assert_close(photographs.truth, normals[mask])
    directions = np.loadtxt(tmp_path / "a/light_directions.txt")
    assert photographs.lights.direction.dtype == DTYPE
    assert_close(photographs.lights.direction, unit(directions))
    assert_close(photographs.lights.irradiance, np.loadtxt(tmp_path / "a/light_intensities.txt"))
    assert photographs.camera is None
    assert photographs.notes[0] == "DiLiGenT layout, with true normals of Normal_gt.mat."
    assert read_photographs(tmp_path / "a").notes == photographs.notes


def test_saturated_values_are_dropped_kept_and_counted(tmp_path):
    images, mask, _ = folder(tmp_path / "a")
    row, column = np.argwhere(mask)[3]
    images[2, row, column, 1] = 65535
    outside = tuple(np.argwhere(~mask)[0])
    images[2][outside] = 65535  # does not count
    write_png(tmp_path / "a/007.png", images[2])
    dropped, kept = read_diligent(tmp_path / "a"), read_diligent(tmp_path / "a", saturated="keep")
    assert np.argwhere(np.isnan(dropped.values)).tolist() == [[3, 2, 1]]
    assert kept.values[3, 2, 1] == 1
    total = mask.sum() * LIGHTS * 3
    assert f"Saturated, at 65535: 1 of {total} values ({1 / total:.2%}), NaN here." in dropped.notes
    assert f"Saturated, at 65535: 1 of {total} values ({1 / total:.2%}), kept." in kept.notes


def test_an_unknown_word_is_refused(unchecked, tmp_path):
    with pytest.raises(ValueError, match='saturated must be "drop" or "keep", got \'clip\''):
        read_diligent(tmp_path / "a", saturated="clip")


def test_true_normals_are_optional(tmp_path):
    folder(tmp_path / "a")
    (tmp_path / "a/Normal_gt.mat").unlink()
    photographs = read_diligent(tmp_path / "a")
    assert photographs.truth is None
    assert photographs.notes[0] == "DiLiGenT layout, without true normals."


def test_a_true_normal_that_is_zero_is_not_known(tmp_path):
    _, mask, normals = folder(tmp_path / "a")
    normals[tuple(np.argwhere(mask)[2])] = 0
    scipy.io.savemat(tmp_path / "a/Normal_gt.mat", {"Normal_gt": normals})
    truth = read_diligent(tmp_path / "a").truth
    assert np.isnan(truth[2]).all()
    assert np.isnan(truth).any(axis=1).sum() == 1


def text(name, content):
    return lambda path: (path / name).write_text(content)


def image(name, pixels):
    return lambda path: write_png(path / name, pixels)


def cut(name):
    return lambda path: (path / name).write_bytes((path / name).read_bytes()[:-40])


def mat(**fields):
    return lambda path: scipy.io.savemat(path / "Normal_gt.mat", fields)


BLACK = np.zeros((ROWS, COLUMNS, 3), np.uint16)
FOUR = "009.png\n008.png\n007.png\n006.png"

MALFORMED = {
    "a direction too few": (
        text("light_directions.txt", "0 0 1\n" * 3),
        "light_directions.txt: lines: expected 4, one for each image of filenames.txt, got 3",
    ),
    "an intensity too many": (
        text("light_intensities.txt", "1 1 1\n" * 5),
        "light_intensities.txt: lines: expected 4, .* got 5",
    ),
    "two intensities": (
        text("light_intensities.txt", "1 2\n" * 4),
        "light_intensities.txt: lines: expected one number or three numbers each, got 4 lines of 2",
    ),
    "decimal commas": (text("light_directions.txt", "0,5 0,1 0,8\n" * 4), "expected three numbers .* 4 lines of 6"),
    "no directions": (text("light_directions.txt", ""), "light_directions.txt: lines: expected 4, .* got 0"),
    "words": (text("light_directions.txt", "0 0 up\n" * 4), "light_directions.txt: lines: expected three numbers each"),
    "ragged": (
        text("light_directions.txt", "0 0 1\n0 1\n0 0 1\n0 0 1"),
        "light_directions.txt: lines: expected three numbers",
    ),
    "nan": (text("light_directions.txt", "0 0 nan\n" * 4), "light 1: expected finite numbers, got .*nan"),
    "a zero direction": (
        text("light_directions.txt", "0 0 1\n0 0 0\n0 0 1\n0 0 1"),
        "light 2: expected a finite vector that is not zero",
    ),
    "a dark light": (
        text("light_intensities.txt", "1 1 1\n" * 3 + "1 0 1"),
        "light 4: expected numbers above 0, got 0",
    ),
    "no names": (text("filenames.txt", "\n"), "filenames.txt: lines: expected the name of an image each, got none"),
    "a missing image": (
        text("filenames.txt", FOUR.replace("007", "001")),
        "filenames.txt: line 3: expected the name of an image in the same folder, got '001.png'",
    ),
    "an image twice": (
        text("filenames.txt", FOUR.replace("007", "008")),
        "filenames.txt: lines: expected different names, got 1 repeated",
    ),
    "an image of 8 bits": (
        image("008.png", BLACK.astype(np.uint8)),
        r"008.png: image: expected .* of uint16, as .*009.png, got \(6, 5, 3\) of uint8",
    ),
    "a grey image": (image("008.png", BLACK[..., 0]), r"expected .* = \(6, 5, 3\) of uint16, .* got \(6, 5, 1\)"),
    "another size": (
        image("008.png", BLACK[1:]),
        r"008.png: image: expected \(rows, columns, channels\) = \(6, 5, 3\) of uint16, as .*009.png, got \(5, 5, 3\)",
    ),
    "a mask of another size": (
        image("mask.png", np.full((4, 5), 255, np.uint8)),
        r"Normal_gt.mat: .*expected shape \(4, 5, 3\), as the mask",
    ),
    "an empty mask": (
        image("mask.png", np.zeros((ROWS, COLUMNS), np.uint8)),
        "mask.png: mask: expected pixels that see the object, above 0, got none",
    ),
    "a truncated image": (cut("008.png"), "008.png: pixels: expected an intact image"),
    "truncated normals": (cut("Normal_gt.mat"), "Normal_gt.mat: data: expected elements whose types and sizes fit"),
    "no normals in the file": (mat(other=np.ones(3)), "Normal_gt.mat: field 'Normal_gt': expected this field"),
    "normals of another size": (
        mat(Normal_gt=np.ones((4, 4, 3))),
        r"expected shape \(6, 5, 3\), as the mask, got \(4, 4, 3\)",
    ),
    "normals that are none": (text("Normal_gt.mat", "x" * 300), "Normal_gt.mat: header: expected a MATLAB file"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_folders_are_refused(case, tmp_path):
    folder(tmp_path / "a")
    change, message = MALFORMED[case]
    change(tmp_path / "a")
    with pytest.raises(FileFormatError, match=message):
        read_diligent(tmp_path / "a")


def test_a_mask_of_another_size_without_normals(tmp_path):
    folder(tmp_path / "a")
    (tmp_path / "a/Normal_gt.mat").unlink()
    write_png(tmp_path / "a/mask.png", np.full((4, 5), 255, np.uint8))
    with pytest.raises(
        FileFormatError, match=r"mask.png: size: expected \(rows, columns\) = \(6, 5\), .*009.png, got \(4, 5\)"
    ):
        read_diligent(tmp_path / "a")


def test_black_images(tmp_path):
    folder(tmp_path / "a")
    write_png(tmp_path / "a/008.png", BLACK)
    note = read_diligent(tmp_path / "a").notes[-1]
    assert note.startswith("No light inside the mask in 1 photographs: ")
    assert note.endswith("008.png.")
    for name in FOUR.split():
        write_png(tmp_path / "a" / name, BLACK)
    with pytest.raises(FileFormatError, match="images: expected light in at least one of them, got none in 4"):
        read_diligent(tmp_path / "a")


def test_true_normals_stand_in_a_text_too(tmp_path):
    """A line a pixel, row by row: of the image, or of the mask."""
    _, mask, normals = folder(tmp_path / "a")
    (tmp_path / "a/Normal_gt.mat").unlink()
    for lines in (normals.reshape(-1, 3), normals[mask]):
        np.savetxt(tmp_path / "a/normal.txt", lines)
        photographs = read_photographs(tmp_path / "a")
        assert_close(photographs.truth, normals[mask])
        assert photographs.notes[0] == "DiLiGenT layout, with true normals of normal.txt."
    np.savetxt(tmp_path / "a/normal.txt", normals[mask][1:])
    expected = f"normal.txt: lines: expected 30, one for each pixel of 6 x 5, or {mask.sum()} of the mask, got"
    with pytest.raises(FileFormatError, match=expected):
        read_photographs(tmp_path / "a")


def test_names_differ_in_case_and_in_folders_before_them(tmp_path):
    folder(tmp_path / "a")
    expected = read_photographs(tmp_path / "a")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    for name in FOUR.split():
        (tmp_path / "b" / name).rename(tmp_path / "b" / name.upper())
    for name in ("mask.png", "Normal_gt.mat", "light_directions.txt", "filenames.txt"):
        (tmp_path / "b" / name).rename(tmp_path / "b" / name.title())
    got = read_photographs(tmp_path / "b")
    assert np.array_equal(got.values, expected.values)
    assert np.array_equal(got.truth, expected.truth)
    (tmp_path / "a/filenames.txt").write_text(FOUR.replace("008", "./008").replace("007", "C:\\ball\\007"))
    assert np.array_equal(read_photographs(tmp_path / "a").values, expected.values)


def test_without_a_list_images_come_in_the_order_of_their_names(tmp_path):
    folder(tmp_path / "a")
    expected = read_photographs(tmp_path / "a")
    (tmp_path / "a/filenames.txt").unlink()
    write_png(tmp_path / "a/Normal_gt.png", np.zeros((ROWS, COLUMNS, 3), np.uint8))  # which is no photograph
    got = read_photographs(tmp_path / "a")
    assert np.array_equal(got.values, expected.values[:, ::-1])
    assert "No filenames.txt: images are taken in the order of their names." in got.notes
    write_png(tmp_path / "a/010.png", BLACK)
    with pytest.raises(FileFormatError, match="expected 5, one for each image of the folder, by name, got 4"):
        read_photographs(tmp_path / "a")


@pytest.mark.parametrize("kind", ["8 bits", "one channel", "one intensity"])
def test_images_and_intensities_of_other_kinds(kind, tmp_path):
    images, mask, _ = folder(tmp_path / "a")
    intensities = np.loadtxt(tmp_path / "a/light_intensities.txt")
    if kind == "8 bits":
        images = (images >> 8).astype(np.uint8)
    if kind == "one channel":
        images, intensities = images[..., :1], intensities @ np.asarray(LUMA)[:, None]
    if kind == "one intensity":
        intensities = intensities[:, :1]
        np.savetxt(tmp_path / "a/light_intensities.txt", intensities)
    for name, pixels in zip(FOUR.split(), images, strict=True):
        write_png(tmp_path / "a" / name, pixels[..., 0] if kind == "one channel" else pixels)
    photographs = read_photographs(tmp_path / "a")
    expected = images[:, mask].transpose(1, 0, 2) / np.iinfo(images.dtype).max
    np.testing.assert_allclose(photographs.values, expected, rtol=1e-7)
    assert_close(photographs.lights.irradiance, intensities)


def test_what_the_layout_lacks_is_said(tmp_path):
    lacks = {
        "mask.png": "No mask.png: every pixel is taken to see the object.",
        "light_intensities.txt": "No light_intensities.txt: every light is taken to have the same, 1.",
        "light_directions.txt": "No light_directions.txt: nothing is known of the lights.",
    }
    _, _, normals = folder(tmp_path / "a")
    for name, note in lacks.items():
        shutil.copytree(tmp_path / "a", tmp_path / name)
        (tmp_path / name / name).unlink()
        photographs = read_photographs(tmp_path / name)
        assert note in photographs.notes
        assert (photographs.lights is None) == (name == "light_directions.txt")
        known = normals[photographs.mask]
        assert_close(photographs.truth, np.where(np.any(known, axis=-1, keepdims=True), known, np.nan))


@pytest.mark.parametrize(("name", "expected"), [("ball", 4.09), ("cat", 8.41), ("reading", 19.78)])
def test_lambertian_least_squares_errs_as_published(name, expected, data):
    """Directions, normals, values and intensities at once: with x, y or z mirrored the error is tens of degrees."""
    photographs = read_diligent(data / f"diligent/{name}PNG", saturated="keep")
    grey = np.minimum(photographs.values / np.asarray(photographs.lights.irradiance), 1) @ LUMA
    scaled = np.linalg.lstsq(np.asarray(photographs.lights.direction, float), grey.T, rcond=None)[0].T
    cosine = np.sum(unit(scaled) * photographs.truth, axis=-1)
    error = np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()
    assert abs(error - expected) < 0.005


def test_the_ball_is_seen_with_x_right_y_up_and_z_towards_the_viewer(data):
    photographs = read_diligent(data / "diligent/ballPNG")
    rows, columns = np.nonzero(photographs.mask)
    centre, radius = (rows.min() + rows.max()) / 2, (rows.max() - rows.min()) / 2
    x, y = (columns - (columns.min() + columns.max()) / 2) / radius, (centre - rows) / radius
    np.testing.assert_allclose(photographs.truth[:, 0], x, atol=0.03)
    np.testing.assert_allclose(photographs.truth[:, 1], y, atol=0.03)
    assert photographs.truth[:, 2].min() >= 0
