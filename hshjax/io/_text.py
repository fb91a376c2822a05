"""Text files of numbers: opened, checked and parsed in one place, with the line of everything that is wrong.

What every text format refuses: what is no regular file or longer than `MAX_BYTES`; an empty file; UTF-16, UTF-32 and
other bytes that are no text in UTF-8 (its byte order mark is allowed); carriage returns that end no line; a last line
without a line end, which may have been cut off. Numbers are decimal, with a point, and finite in float32, in which the
library may keep them.
"""

import os
import re
import stat
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hshjax.io.errors import FileFormatError

MAX_BYTES = 512 * 2**20
"""Of a text file: about five million samples. Reading takes some five times that in memory."""

HEAD = 2**16
BLOCK = 2**14
"""Lines that are parsed at once: what is wrong is looked for in one block, line by line."""

# Possessive: a line of a million digits and a letter is refused as fast as another.
NUMBER = re.compile(r"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[eE][+-]?\d++)?", re.ASCII)
COMMA = re.compile(r"[+-]?\d*+,\d++(?:[eE][+-]?\d++)?", re.ASCII)
NOT_FINITE = re.compile(r"[+-]?(nan|inf|infinity)", re.IGNORECASE)
CONTROL = bytes([*range(32), 127]).translate(None, b"\t\n\r")
LONE_RETURN = re.compile(rb"\r(?!\n|\Z)")
LARGEST = float(np.finfo(np.float32).max)
MARKS = {b"\xff\xfe\0\0": "UTF-32", b"\0\0\xfe\xff": "UTF-32", b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}
MARK = b"\xef\xbb\xbf"


def shown(text: str) -> str:
    """Text for a message, in quotes and short."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


@dataclass(frozen=True)
class Lines:
    """The lines of a text file, without their line ends. Numbers of lines and columns count from 1."""

    path: str | os.PathLike
    lines: Sequence[str]

    def error(self, number: int, expected: str, got: str, column: int | None = None) -> FileFormatError:
        """The error for a line, and a column of it."""
        where = f"line {number}" if column is None else f"line {number}, column {column}"
        return FileFormatError(self.path, where, expected, got)

    def filled(self, first: int = 1, comment: str | None = None) -> list[int]:
        """Numbers of the lines from `first` on that hold more than blanks, without those that begin with `comment`."""
        return [
            number
            for number, line in enumerate(self.lines[first - 1 :], first)
            if line.strip() and not (comment and line.startswith(comment))
        ]

    def table(self, numbers: Sequence[int], columns: int, separator: str | None = None) -> np.ndarray:
        """The numbers of these lines `(len(numbers), columns)` in float64; `separator` None stands for blanks.

        **Raises:** FileFormatError, naming line and column, for another count of columns and for what is not a finite
        decimal number.
        """
        blocks = [
            self._block(numbers[start : start + BLOCK], columns, separator) for start in range(0, len(numbers), BLOCK)
        ]
        return np.concatenate(blocks) if blocks else np.empty((0, columns))

    def numbers(self, number: int, tokens: Sequence[str]) -> np.ndarray:
        """Words of a line as finite numbers."""
        for token in tokens:
            self._check(number, token)
        return np.asarray([float(token) for token in tokens])

    def count(self, number: int, token: str, least: int = 1) -> int:
        """A word as a whole number of at most nine digits, at least `least`."""
        if not re.fullmatch(r"[0-9]{1,9}", token) or int(token) < least:
            raise self.error(number, f"a whole number of at least {least}", shown(token))
        return int(token)

    def _block(self, numbers: Sequence[int], columns: int, separator: str | None) -> np.ndarray:
        chosen = [self.lines[number - 1] for number in numbers]
        try:
            if not all(map(str.isascii, chosen)):
                raise ValueError("digits of other scripts")
            values = np.loadtxt(chosen, np.float64, comments=None, delimiter=separator, ndmin=2)
            if values.shape != (len(chosen), columns):
                raise ValueError("another count of rows or columns")
        except ValueError as error:
            # numpy parses a hundred times as fast as Python, but does not tell lines and columns of the file.
            raise self._wrong(numbers, columns, separator) from error
        wrong = ~(np.abs(values) <= LARGEST)
        if wrong.any():
            row, column = map(int, np.argwhere(wrong)[0])
            token = self.lines[numbers[row] - 1].split(separator)[column].strip()
            raise self.error(numbers[row], "a finite number (of float32)", shown(token), column + 1)
        return values

    def _check(self, number: int, token: str, column: int | None = None) -> None:
        if NUMBER.fullmatch(token) and abs(float(token)) <= LARGEST:
            return
        if COMMA.fullmatch(token):
            expected = "a decimal point (replace commas in numbers by points)"
        elif NOT_FINITE.fullmatch(token) or NUMBER.fullmatch(token):
            expected = "a finite number (of float32)"
        else:
            expected = "a number"
        raise self.error(number, expected, shown(token), column)

    def _wrong(self, numbers: Sequence[int], columns: int, separator: str | None) -> FileFormatError:
        """The error for the first of these lines that is no row of so many numbers."""
        for number in numbers:
            line = self.lines[number - 1]
            tokens = [token.strip() for token in line.split(separator)]
            if len(tokens) != columns:
                hint = ""
                if separator == "," and len(tokens) > columns:
                    hint = " (if commas stand for decimal points, replace them)"
                return self.error(number, f"{columns} numbers{hint}", f"{len(tokens)} in {shown(line)}")
            for column, token in enumerate(tokens, 1):
                try:
                    self._check(number, token, column)
                except FileFormatError as error:
                    return error
        return self.error(numbers[0], f"rows of {columns} numbers from here on", "others")


def read_lines(path: str | os.PathLike, *, closed_by: str | None = None) -> Lines:
    """The lines of a text file, checked as the module says.

    `closed_by`: a word that ends files of this format; the last line may then lack its line end if it is this word.

    **Raises:** FileFormatError; OSError where the file cannot be opened.
    """
    status = os.stat(path)
    # A directory is left to `open`, whose error is the usual one; a pipe would make it wait for ever.
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise FileFormatError(path, "file", "a regular file", "a pipe or a device")
    if stat.S_ISREG(status.st_mode):
        _check_size(path, status.st_size)
    with open(path, "rb") as file:
        head = file.read(HEAD)
        _check_bytes(path, head, 0)
        rest = file.read()
    _check_size(path, len(head) + len(rest))
    _check_bytes(path, rest, len(head))
    return _split(path, (head + rest).removeprefix(MARK), closed_by)


def _check_size(path: str | os.PathLike, size: int) -> None:
    if size > MAX_BYTES:
        expected = f"at most {MAX_BYTES // 2**20} MiB of text"
        raise FileFormatError(path, "file size", expected, f"{size / 2**20:.0f} MiB")


def _check_bytes(path: str | os.PathLike, content: bytes, offset: int) -> None:
    """That these bytes from `offset` on are text, as far as control characters tell."""
    save = "text in UTF-8 (save it again so)"
    if not offset and not content:
        raise FileFormatError(path, "file", "text", "0 bytes")
    if not offset:
        for mark, name in MARKS.items():
            if content.startswith(mark):
                raise FileFormatError(path, "byte 0", save, name)
    if len(content.translate(None, CONTROL)) == len(content):
        return
    place = min(found for byte in CONTROL if (found := content.find(byte)) >= 0)
    if content[place] == 0:
        raise FileFormatError(path, f"byte {offset + place}", save, "a zero byte: UTF-16, or no text")
    raise FileFormatError(path, f"byte {offset + place}", "text", f"the control character {content[place]}")


def _split(path: str | os.PathLike, content: bytes, closed_by: str | None) -> Lines:
    if b"\r" in content and b"\n" in content:
        lone = LONE_RETURN.search(content)
        if lone:
            number = content.count(b"\n", 0, lone.start()) + 1
            raise FileFormatError(path, f"line {number}", "no carriage return within a line", "one")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, f"byte {error.start}", "text in UTF-8 (save it again so)", "other bytes") from error
    # Not `splitlines`, which splits at more than line ends.
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    last = lines.pop()
    if last:
        lines.append(last)
        if closed_by is None or last.strip() != closed_by:
            expected = "a line end (this last line may have been cut off; add a line end if it is whole)"
            raise FileFormatError(path, f"line {len(lines)}", expected, shown(last))
    if not any(map(str.strip, lines)):
        raise FileFormatError(path, "file", "text", "blanks only")
    return Lines(path, lines)


def head_lines(head: bytes) -> list[str]:
    """The lines of the first kilobytes of any file, for a look at its format: decoded byte by byte, never refused."""
    text = head.removeprefix(MARK).decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
