"""Tables of numbers in text: the parser below the readers."""

import re
import time

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hshjax.io import FileFormatError
from hshjax.io._text import BLOCK, Lines, head_lines, read_lines

finite = st.floats(width=32, allow_nan=False, allow_infinity=False)


@given(st.lists(st.tuples(finite, finite, finite), min_size=1), st.sampled_from([None, ","]))
def test_numbers_come_back(rows, separator):
    """Every float32, in Python's shortest form, exactly."""
    lines = Lines("a", [(separator or "\t ").join(map(repr, row)) for row in rows])
    np.testing.assert_array_equal(lines.table(range(1, len(rows) + 1), 3, separator), np.asarray(rows))


FORMS = ("1", "+1", "-1", "1.", ".5", "01", "1e3", "1E+03", "-1.5e-3", "0.000000000000000000000000000001", "-0")


@pytest.mark.parametrize("token", FORMS)
def test_forms_of_numbers(token):
    assert Lines("a", [token]).table([1], 1)[0, 0] == float(token)
    assert Lines("a", [token]).numbers(1, [token])[0] == float(token)


NO_NUMBERS = ("1_0", "0x10", "1e", "e1", ".", "-", "1.2.3", "1+2j", "True", "1d5", "'1'", '"1"', "1%", "--1", "½")


@pytest.mark.parametrize("token", NO_NUMBERS)
def test_what_is_no_number(token):
    """By the fast parser and by the one for words of a header."""
    lines = Lines("a", ["0", token])
    with pytest.raises(FileFormatError, match=re.escape(f"a: line 2, column 1: expected a number, got {token!r}")):
        lines.table([1, 2], 1)
    with pytest.raises(FileFormatError, match=re.escape(f"a: line 2: expected a number, got {token!r}")):
        lines.numbers(2, [token])


@pytest.mark.parametrize("token", ["-1", "0", "1.0", "1e3", "2147483648", "1_0", "٣", "", "+1"])
def test_what_is_no_count(token):
    with pytest.raises(FileFormatError, match="a: line 1: expected a whole number of at least 1"):
        Lines("a", [""]).count(1, token)


def test_lines_are_exact_in_long_files():
    """Beyond the first block, with blank lines between."""
    rows = ["1 2", ""] * (2 * BLOCK)
    lines = Lines("a", rows)
    numbers = lines.filled()
    assert lines.table(numbers, 2).shape == (2 * BLOCK, 2)
    for wrong, message in (
        ("1 2 3", "line 50001: expected 2 numbers, got 3 in '1 2 3'"),
        ("1 2,5", r"line 50001, column 2: expected a decimal point \(replace commas in numbers by points\), got '2,5'"),
        ("nan 2", r"line 50001, column 1: expected a finite number \(of float32\), got 'nan'"),
        ("1 x", "line 50001, column 2: expected a number, got 'x'"),
    ):
        rows[50000] = wrong
        with pytest.raises(FileFormatError, match=message):
            lines.table(numbers, 2)


def test_a_million_digits_and_a_letter():
    """Refused as fast as any, for what looks like a number is not tried in every way."""
    begin = time.process_time()
    for token in (10**6 * "1" + "x", 10**6 * "1" + "." + 10**6 * "1" + "x", 10**6 * "1" + ",x"):
        with pytest.raises(FileFormatError, match=r"expected a number, got '1+\.\.\.'"):
            Lines("a", [token]).table([1], 1)
    assert time.process_time() - begin < 1


def test_only_line_ends_end_lines(tmp_path):
    """Not the separators that Unicode and Python's splitlines have, too."""
    (tmp_path / "a").write_bytes("# a\u2028b\u0085c\r\n1\n".encode())
    assert read_lines(tmp_path / "a").lines == ["# a\u2028b\u0085c", "1"]


def test_a_word_may_close_a_file(tmp_path):
    (tmp_path / "a").write_bytes(b"1\nEnd")
    assert read_lines(tmp_path / "a", closed_by="End").lines == ["1", "End"]
    (tmp_path / "a").write_bytes(b"1\nEn")
    with pytest.raises(FileFormatError, match="line 2: expected a line end"):
        read_lines(tmp_path / "a", closed_by="End")


def test_a_long_file_is_read_beyond_the_first_look(tmp_path):
    """Bytes that are no text are told by their place in the file."""
    content = 20000 * b"1.5 2.5\n"
    (tmp_path / "a").write_bytes(content)
    assert len(read_lines(tmp_path / "a").lines) == 20000
    (tmp_path / "a").write_bytes(content + b"\0")
    with pytest.raises(FileFormatError, match="a: byte 160000: expected text in UTF-8"):
        read_lines(tmp_path / "a")
    (tmp_path / "a").write_bytes(content + b"1\r2\n")
    with pytest.raises(FileFormatError, match="line 20001: expected no carriage return within a line"):
        read_lines(tmp_path / "a")


def test_heads_are_never_refused():
    assert head_lines(b"\xff\xfea\0") == ["ÿþa\0"]
    assert head_lines(b"\xef\xbb\xbfa\r\nb\rc") == ["a", "b", "c"]
