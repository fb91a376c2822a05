"""MATLAB files as scipy writes them, and damaged ones."""

import numpy as np
import pytest
import scipy.io
from scipy import sparse

from hshjax.io import FileFormatError
from hshjax.io._mat import read_mat_floats


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(5, 7, 3), (1, 1), (2, 1), (4, 0), (3, 2, 1, 2)])
@pytest.mark.parametrize("name", ["N", "Normal", "Normal_gt"])  # names of up to four letters are stored otherwise
def test_what_scipy_writes(name, shape, dtype, compressed, tmp_path):
    array = np.random.default_rng(0).normal(size=shape).astype(dtype)
    others = {
        "text": "abc", "a": np.arange(5), "s": {"x": 1.0, "y": "z"}, "c": np.ones(2) * 1j, "m": sparse.eye(3),
        "z": np.array([1, "b", [2]], object), "flag": True,
    }  # fmt: skip
    scipy.io.savemat(tmp_path / "a.mat", others | {name: array} | {"last": 1.5}, do_compression=compressed)
    read = read_mat_floats(tmp_path / "a.mat", name)
    assert read.dtype == dtype
    assert np.array_equal(read, array)
    assert read_mat_floats(tmp_path / "a.mat", "last").tolist() == [[1.5]]


@pytest.mark.parametrize("value", ["text", np.arange(5), np.ones(2) * 1j, {"x": 1.0}, sparse.eye(3), True])
def test_other_classes_are_refused(value, tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"N": value})
    with pytest.raises(FileFormatError, match=r"a.mat: data: .*: N is of class \d+, not of real floats"):
        read_mat_floats(tmp_path / "a.mat", "N")


def test_what_is_no_such_file(tmp_path):
    path = tmp_path / "a.mat"
    for content in (b"", b"x" * 300, b"\x89HDF\r\n\x1a\n" + 200 * b"\0"):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=r"a\.mat: header: expected a MATLAB file of version 5 to 7"):
            read_mat_floats(path, "N")
    scipy.io.savemat(path, {"N": np.ones(3)}, format="4")
    with pytest.raises(FileFormatError, match="header: expected a MATLAB file of version 5 to 7"):
        read_mat_floats(path, "N")
    scipy.io.savemat(path, {"N": np.ones(3)})
    with pytest.raises(FileFormatError, match="field 'M': expected this field, got 'N'"):
        read_mat_floats(path, "M")
    with pytest.raises(FileNotFoundError):
        read_mat_floats(tmp_path / "b.mat", "N")


@pytest.mark.parametrize("compressed", [False, True])
def test_damage_is_refused_or_harmless(compressed, tmp_path):
    """Of every byte, and at every length: nothing but FileFormatError, and no other shape."""
    path, array = tmp_path / "a.mat", np.arange(12.0).reshape(2, 3, 2) + 0.5
    scipy.io.savemat(path, {"N": array}, do_compression=compressed)
    content = path.read_bytes()
    refused = 0
    for place in range(124, len(content)):
        for damaged in (
            content[:place],
            *(content[:place] + bytes([b]) + content[place + 1 :] for b in (0, 1, 77, 255)),
        ):
            path.write_bytes(damaged)
            try:
                assert read_mat_floats(path, "N").size == 12
            except FileFormatError:
                refused += 1
    assert refused > len(content) - 124


def test_normals_of_the_benchmark(data):
    path = data / "diligent/catPNG/Normal_gt.mat"
    assert np.array_equal(read_mat_floats(path, "Normal_gt"), scipy.io.loadmat(path)["Normal_gt"])
