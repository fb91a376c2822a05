"""What a reader says about a file that it cannot take."""

from os import PathLike

LONGEST = 300
"""Characters of a part of a message."""


class FileFormatError(ValueError):
    """A file is not what its reader expects.

    - `file`: its path.
    - `where`: the field, byte or line.
    - `expected`, `got`: both sides, in words.

    Missing files, directories and denied access stay the OSError that they are.
    """

    def __init__(self, file: str | PathLike, where: str, expected: str, got: str):
        # All four go to `args`, so that the error survives a process boundary.
        super().__init__(str(file), where, expected, got)
        self.file, self.where, self.expected, self.got = str(file), where, expected, got

    def __str__(self) -> str:
        return f"{self.file}: {_short(self.where)}: expected {_short(self.expected)}, got {_short(self.got)}"


def _short(words: str) -> str:
    """On one line; what is quoted from a file may be as long as it."""
    words = " ".join(words.split())
    return words if len(words) <= LONGEST else f"{words[:LONGEST]}..."
