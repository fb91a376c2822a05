"""How much a compressed file may become: a few bytes that unpack to gigabytes would exhaust a machine."""

from os import PathLike

from hshjax.io.errors import FileFormatError

ALWAYS = 128 * 2**20
"""Bytes that any file may become."""

RATIO = 30
"""Beyond that, bytes for each one stored: images and tables compress to a tenth; only constant ones to a thousandth."""


def check_expansion(path: str | PathLike, where: str, expanded: int, stored: int) -> None:
    """Before anything is unpacked, from what the headers say.

    **Raises:** FileFormatError where `expanded` bytes are more than `allowed` of `stored` ones.
    """
    if expanded > allowed(stored):
        most = f"at most {allowed(stored)} bytes out of {stored} that are stored"
        raise FileFormatError(path, where, most, f"{expanded} (a file that inflates so much is refused)")


def allowed(stored: int) -> int:
    """Bytes that so many stored ones may become."""
    return max(ALWAYS, RATIO * stored)
