"""The container: what it gives back, and what it says about damaged files."""

import re
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from hshjax.io import FileFormatError, read_tensor_file, write_tensor_file
from tests.io.hostile_binary import placed_variants, refused, sparse, written
from tests.io.tensor_files import CODES, packed

TENSORS = {
    **{name: np.arange(6).reshape(2, 3).astype(name) for name in CODES},
    "scalar": np.float32(2.5).reshape(()),
    "empty": np.zeros((0, 4), np.float64),
    "größe": np.ones(3, np.int16),
}


def test_every_type_and_shape_comes_back(tmp_path):
    (tmp_path / "a").write_bytes(packed(TENSORS))
    read = read_tensor_file(tmp_path / "a")
    assert list(read) == list(TENSORS)
    for name, tensor in TENSORS.items():
        assert read[name].dtype == tensor.dtype
        assert read[name].shape == tensor.shape
        assert np.array_equal(read[name], tensor)


def test_what_is_written_comes_back(tmp_path):
    write_tensor_file(tmp_path / "a", TENSORS | {"big-endian": np.arange(3, dtype=">i4"), "a slice": np.arange(9)[::2]})
    read = read_tensor_file(tmp_path / "a")
    assert list(read) == [*TENSORS, "big-endian", "a slice"]
    for name, tensor in TENSORS.items():
        assert read[name].dtype == tensor.dtype
        assert np.array_equal(read[name], tensor)
        assert read[name].shape == tensor.shape
    assert read["big-endian"].tolist() == [0, 1, 2]
    assert read["a slice"].tolist() == [0, 2, 4, 6, 8]


@pytest.mark.parametrize("wrong", [np.array(["a"]), np.array([1j]), np.array([True]), np.zeros((1,) * 33)])
def test_what_is_not_written(wrong, tmp_path):
    with pytest.raises(ValueError, match="a tensor must be"):
        write_tensor_file(tmp_path / "a", {"wrong": wrong})
    assert not list(tmp_path.iterdir())


def test_gigabytes_of_nothing(tmp_path):
    assert "expected a tensor_file" in str(refused(read_tensor_file, sparse(tmp_path / "a", b"")))
    error = refused(read_tensor_file, sparse(tmp_path / "a", packed(TENSORS)))
    assert "size: expected at most 2147483648 bytes, got 5000000000" in str(error)


def test_hostile_files_are_read_or_refused(tmp_path):
    for name, content in placed_variants(packed(TENSORS), counts={"fields": 14}).items():
        error = refused(read_tensor_file, written(tmp_path / "a", content))
        if name.startswith("fields") and name != "fields = 0":
            assert error is not None, name
            assert "number of fields" in error.where


def test_tensors_are_read_only_views(tmp_path):
    (tmp_path / "a").write_bytes(packed(TENSORS))
    with pytest.raises(ValueError, match="read-only"):
        read_tensor_file(tmp_path / "a")["float32"][0, 0] = 1


def entry(name: bytes = b"a", dimensions: int | None = None, code: int = 1, offset: int = 100, shape=(2,)) -> bytes:
    dimensions = len(shape) if dimensions is None else dimensions
    return struct.pack("<H", len(name)) + name + struct.pack(f"<HBQ{len(shape)}Q", dimensions, code, offset, *shape)


def container(*entries: bytes, count: int | None = None, size: int = 200) -> bytes:
    count = len(entries) if count is None else count
    return (b"tensor_file\0\1\0" + struct.pack("<I", count) + b"".join(entries)).ljust(size, b"\7")


MALFORMED = {
    "an empty file": (b"", "byte 0", "an empty file"),
    "another format": (b"\x89PNG\r\n\x1a\n" + bytes(40), "byte 0", "PNG"),
    "a later version": (b"tensor_file\0\2\1" + bytes(40), "byte 12, version", "2.1"),
    "an end within the count": (b"tensor_file\0\1\0\1\0", "byte 14, number of fields", "the end after 2"),
    "an absurd count": (container(count=2**32 - 1), "byte 14, number of fields", "4294967295"),
    "an end within a shape": (container(entry(dimensions=20), size=60), "field 'a', shape", "the end after"),
    "too many dimensions": (container(entry(dimensions=33)), "byte 21, field 'a', dimensions", "33"),
    "the invalid type": (container(entry(code=0)), "byte 23, field 'a', type", "got 0"),
    "an unknown type": (container(entry(code=12)), "byte 23, field 'a', type", "got 12"),
    "a name that is no text": (container(entry(b"\xff\xfe")), "byte 20, field 0, name", "xff"),
    "a name twice": (container(entry(), entry()), "byte 40, field 1", "'a' again"),
    "data past the end": (container(entry(offset=199)), "field 'a'", "from byte 199"),
    "data in the header": (container(entry(offset=10)), "field 'a'", "from byte 10"),
    "an offset past the end": (container(entry(offset=2**63)), "field 'a'", f"from byte {2**63}"),
    "a product beyond 64 bits": (container(entry(shape=(2**40, 2**40))), "field 'a'", str(2**40)),
    "a product that is 0 modulo 2^64": (container(entry(shape=(2**32, 2**32))), "field 'a'", str(2**32)),
    "an empty tensor of absurd shape": (container(entry(shape=(0, 2**63))), "field 'a'", str(2**63)),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_files_are_refused_with_the_place(case, tmp_path):
    content, where, got = MALFORMED[case]
    path = tmp_path / "broken.bsdf"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_tensor_file(path)
    assert caught.value.file == str(path)
    assert where in caught.value.where
    assert got in str(caught.value)
    assert re.search("broken.bsdf: .*: expected .*, got ", str(caught.value))


def test_the_file_system_keeps_its_own_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing"):
        read_tensor_file(tmp_path / "missing")
    with pytest.raises(IsADirectoryError):
        read_tensor_file(tmp_path)


def read_or_refuse(path, content: bytes):
    path.write_bytes(content)
    try:
        tensors = read_tensor_file(path)
    except FileFormatError:
        return
    assert sum(t.nbytes for t in tensors.values()) <= len(tensors) * len(content)


FUZZ = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FUZZ
@given(st.data())
def test_damaged_files_are_read_or_refused(tmp_path, data):
    content = bytearray(packed(TENSORS))
    for _ in range(data.draw(st.integers(0, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    read_or_refuse(tmp_path / "a", bytes(content[: data.draw(st.integers(0, len(content)))]))


@FUZZ
@given(st.binary(max_size=200))
def test_anything_after_the_magic_is_read_or_refused(tmp_path, content):
    read_or_refuse(tmp_path / "a", b"tensor_file\0\1\0" + content)
