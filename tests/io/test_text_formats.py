"""Laws of all readers of text: what they refuse and what they still read, and that each knows its own format."""

import os
import re
import time
import tracemalloc

import numpy as np
import pytest

from hshjax.io import FileFormatError
from hshjax.io._text import MAX_BYTES
from hshjax.samples import Samples
from tests.io.hostile import SAME, beginning, flipped, hostile_variants, outcome, part, same
from tests.io.text_formats import FORMATS

COUNTED = ("astm", "zemax")
"""Formats that count their samples: nothing is read of a file that was cut off."""

each_format = pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)


@pytest.fixture
def whole(form, tmp_path) -> Samples:
    (tmp_path / "whole").write_bytes(form.content)
    return form.read(tmp_path / "whole")


@each_format
def test_hostile_variants(form, whole, tmp_path):
    """Refused, or what the file says: all of it, or the lines before a cut."""
    for name, content in hostile_variants(form.content, header=form.header, flips=0).items():
        found = outcome(form.read, tmp_path / "a.txt", content)
        if name in SAME:
            assert same(found, whole), name
        elif name.startswith("cut") and content.endswith(b"\n") and isinstance(found, Samples):
            assert form.name not in COUNTED, name
            assert beginning(found, whole), name
        elif name == "no last line end" and form.name == "zemax":
            assert same(found, whole)  # DataEnd says that nothing is missing
        elif name == "the last byte cut off" and form.name == "zemax":
            assert same(found, whole)
        elif name == "the first byte cut off" and form.content.startswith(b"#"):
            # Of a comment or of words about the measurement; of others the keyword is gone.
            assert isinstance(found, FileFormatError) or same(found, whole), name
        elif name == "the first byte cut off" and form.name == "astm":
            assert same(found, whole)
        elif name.startswith("nan for number") and form.name == "csv":
            # Of a value: a spreadsheet says so that nothing was measured, and the row is left out.
            assert isinstance(found, FileFormatError) or (part(found, whole) and found.size == whole.size - 1), name
        else:
            assert isinstance(found, FileFormatError), (name, found)


@each_format
def test_every_line_end_of_a_cut_file(form, whole, tmp_path):
    """Cut exactly between lines, a file is the file of its first samples, or is refused."""
    ends = [match.end() for match in re.finditer(rb"\n", form.content)]
    read = 0
    for end in ends[:-1]:
        found = outcome(form.read, tmp_path / "a.txt", form.content[:end])
        if isinstance(found, Samples):
            assert form.name not in COUNTED
            assert beginning(found, whole)
            read += 1
    assert read > 0 or form.name in COUNTED


def check_flip(form, whole, tmp_path, place: int) -> None:
    """A digit may have become another, or a blank; anything else is noticed, or does not matter."""
    content = flipped(form.content, place)
    before, after = form.content[place // 8 : place // 8 + 1], content[place // 8 : place // 8 + 1]
    found = outcome(form.read, tmp_path / "a.txt", content)
    if re.fullmatch(rb"[0-9]", before) and re.fullmatch(rb"[0-9 #]", after):
        return
    where = f"{before!r} -> {after!r} at {place // 8}: {content.decode('latin-1').splitlines()}"
    assert isinstance(found, FileFormatError) or part(found, whole), where
    if isinstance(found, Samples):
        assert found.isotropic == whole.isotropic, where
        assert found.size >= whole.size - 1, where


@each_format
def test_flipped_bits(form, whole, tmp_path):
    for place in np.random.default_rng(0).choice(8 * len(form.content), 300, replace=False).tolist():
        check_flip(form, whole, tmp_path, place)


@pytest.mark.slow
@each_format
def test_every_flipped_bit(form, whole, tmp_path):
    for place in range(8 * len(form.content)):
        check_flip(form, whole, tmp_path, place)


@each_format
def test_each_format_knows_its_own(form):
    for other in FORMATS:
        for content in (other.content, b"\xef\xbb\xbf" + other.content, other.content.replace(b"\n", b"\r\n")):
            assert form.module.sniff(content) == (form is other)
            assert form.module.sniff(content[: other.header + 20]) == (form is other)
    for content in (
        b"",
        b"\0" * 64,
        b"# a comment only\n",
        b"tensor_file\0\1\0",
        b"a,b\n1,2\n",
        b"\xff\xfe#\0D\0I\0M\0",
    ):
        assert not form.module.sniff(content)


@each_format
def test_negative_values(form, tmp_path):
    """Kept, made 0, or masked; counted in each case."""
    (tmp_path / "a.txt").write_bytes(form.content)
    size, found = form.read(tmp_path / "a.txt").size, form.measured(tmp_path / "a.txt").found
    # A value of the last sample that is above the horizon becomes negative, where none is.
    content = form.content
    if not found.negative:
        old, new = {
            "alta": (b" 0.125\n", b" -0.125\n"),
            "fred": (b"0.0671\n", b"-0.0671\n"),
            "zemax": (b"6.5e-02 2.1", b"-6.5e-02 2.1"),
        }[form.name]
        assert content.count(old) == 1
        content = content.replace(old, new)
    (tmp_path / "a.txt").write_bytes(content)
    kept, clipped, masked = (form.measured(tmp_path / "a.txt", negatives=n) for n in ("keep", "clip", "mask"))
    assert [m.found.negative for m in (kept, clipped, masked)] == [1, 1, 1]
    assert [m.data.size for m in (kept, clipped, masked)] == [size] * 3
    value = np.asarray(kept.data.value)
    assert (value < 0).sum() == 1
    np.testing.assert_array_equal(clipped.data.value, np.maximum(value, 0))
    np.testing.assert_array_equal(masked.data.value, value)
    np.testing.assert_array_equal(
        masked.data.weight, np.where(np.any(value < 0, axis=1), 0, np.asarray(kept.data.weight))
    )
    assert masked.found.masked == {"a negative value": 1}
    assert np.isclose(
        masked.found.invalid_share, (1 + sum(masked.found.dropped.values())) / masked.found.entries, rtol=1e-12
    )


@each_format
def test_other_words_for_negatives_are_refused(form, tmp_path, unchecked):
    (tmp_path / "a.txt").write_bytes(form.content)
    with pytest.raises(ValueError, match="negatives is one of keep, clip, mask, got 'drop'"):
        form.read(tmp_path / "a.txt", negatives="drop")


@each_format
def test_a_huge_file_is_refused_before_it_is_read(form, tmp_path):
    """5 GB, of which the disk holds nothing: within a second and without memory."""
    path = tmp_path / "huge.txt"
    with open(path, "wb") as file:
        file.write(form.content)
        file.truncate(5 * 10**9)
    tracemalloc.start()
    begin = time.process_time()
    with pytest.raises(FileFormatError, match=r"huge.txt: file size: expected at most 512 MiB of text, got 4768 MiB"):
        form.read(path)
    seconds, (_, peak) = time.process_time() - begin, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert seconds < 1
    assert peak < 1e6


@each_format
def test_zeros_are_refused_at_the_start(form, tmp_path):
    """A file below the limit, of zeros: told from its first bytes, not after half a gigabyte."""
    path = tmp_path / "zeros.txt"
    with open(path, "wb") as file:
        file.truncate(MAX_BYTES)
    tracemalloc.start()
    with pytest.raises(
        FileFormatError, match=r"byte 0: expected text in UTF-8 .*, got a zero byte: UTF-16, or no text"
    ):
        form.read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1e6


@each_format
def test_what_is_no_regular_file(form, tmp_path):
    with pytest.raises(IsADirectoryError):
        form.read(tmp_path)
    with pytest.raises(FileNotFoundError):
        form.read(tmp_path / "gone.txt")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FileFormatError, match="pipe: file: expected a regular file, got a pipe or a device"):
        form.read(tmp_path / "pipe")


COMMON = {
    "empty": (lambda content: b"", r"file: expected text, got 0 bytes"),
    "blanks": (lambda content: b"\n \n\n", r"file: expected text, got blanks only"),
    "UTF-16": (lambda content: content.decode().encode("utf-16"), r"byte 0: expected text in UTF-8 .*, got UTF-16"),
    "UTF-32": (lambda content: content.decode().encode("utf-32"), r"byte 0: expected text in UTF-8 .*, got UTF-32"),
    "UTF-16 without mark": (
        lambda content: content.decode().encode("utf-16-le"),
        r"byte 1: expected text in UTF-8 .*, got a zero byte: UTF-16, or no text",
    ),
    "Latin-1": (lambda content: content + b"\xb0\n", r"byte \d+: expected text in UTF-8 .*, got other bytes"),
    "a bell": (lambda content: content + b"\a\n", r"byte \d+: expected text, got the control character 7"),
    "a lone return": (
        lambda content: content.replace(b"\n", b"\n\r ", 1),
        r"line 2: expected no carriage return within a line, got one",
    ),
    "digits of another script": (
        lambda content: re.sub(rb"(.*[.])[0-9]", rb"\1" + "\u0661".encode(), content, count=1, flags=re.DOTALL),
        r"line \d+, column \d+: expected a number, got",
    ),
}
"""Refused by all alike, with the message."""


@each_format
@pytest.mark.parametrize("case", COMMON)
def test_messages_that_are_common(case, form, tmp_path):
    change, message = COMMON[case]
    content = change(form.content)
    assert content != form.content
    (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(FileFormatError, match=f"a.txt: {message}"):
        form.read(tmp_path / "a.txt")


@each_format
def test_decimal_commas_are_named(form, tmp_path):
    content = hostile_variants(form.content, flips=0)["decimal commas"]
    (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"line \d+.*(decimal point \(replace commas|commas stand for decimal)"):
        form.read(tmp_path / "a.txt")


@each_format
def test_a_cut_last_line_is_named(form, tmp_path):
    (tmp_path / "a.txt").write_bytes(form.content[:-3])
    count = form.content.count(b"\n")
    message = rf"line {count}: expected a line end \(this last line may have been cut off; add a line end if it is"
    with pytest.raises(FileFormatError, match=message):
        form.read(tmp_path / "a.txt")


@each_format
def test_numbers_that_are_not_finite_are_named_with_line_and_column(form, tmp_path):
    """In the last number of the file."""
    value = form.content.removesuffix(b"DataEnd\n").split()[-1].rsplit(b",", 1)[-1]
    start = form.content.rindex(value)
    line = form.content.count(b"\n", 0, start) + 1
    row = form.content.splitlines()[line - 1]
    column = len(row.split(b"," if b"," in row else None))
    for word in (b"nan", b"inf", b"-Infinity", b"1e39"):
        (tmp_path / "a.txt").write_bytes(form.content[:start] + word + form.content[start + len(value) :])
        message = rf"line {line}, column {column}: expected a finite number \(of float32\), got '{word.decode()}'"
        with pytest.raises(FileFormatError, match=message):
            form.read(tmp_path / "a.txt")


@each_format
def test_old_line_ends(form, whole, tmp_path):
    (tmp_path / "a.txt").write_bytes(form.content.replace(b"\n", b"\r"))
    assert same(form.read(tmp_path / "a.txt"), whole)
