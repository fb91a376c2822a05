"""What happens to files: cut off, flipped bits, other encodings, numbers that are none.

`hostile_variants` makes the table from the bytes of a good file, text or not; `outcome` reads one and holds what every
reader of the library owes: a FileFormatError of one sentence that names the file, or something sound, within a second.
"""

import re
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from hshjax.brdfs import AbstractBRDF, AngleTable, HalfVectorTable
from hshjax.io import FileFormatError
from hshjax.io.measured import Measured
from hshjax.io.read_material import Material
from hshjax.photographs import Photographs
from hshjax.samples import Samples

PARTS = 64
NUMBER = re.compile(rb"(?<![\w.])[+-]?\d+\.\d+(?:[eE][+-]?\d+)?(?![\w.])")
NOT_FINITE = ("nan", "inf", "-inf", "1e999")
SECONDS = 1.0
"""Of processor time, far more than the milliseconds that a small file takes."""

LENGTH = 1000
"""Characters of a sentence, the path among them."""

SAME = ("CRLF", "UTF-8 with its mark")
"""Variants of a text file that are as good as the file."""


def hostile_variants(content: bytes, *, header: int | None = None, flips: int = 64, seed: int = 0) -> dict[str, bytes]:
    """Variants of a good file, by what was done to it.

    - `header`: where its samples begin, for the variant without any.
    - `flips`: how many single bits to flip, at places drawn by `seed`: see `flipped` for all.

    Of a text file (no zero byte, and UTF-8) also: some of its numbers with a point replaced by what is not finite,
    other encodings, decimal commas, other line ends, and a last line without one.
    """
    rng = np.random.default_rng(seed)
    size = len(content)
    variants = {"empty": b"", "twice": 2 * content, "zeros at the end": content + bytes(16), "zeros": bytes(size)}
    variants |= {f"cut at {k}/{PARTS}": content[: k * size // PARTS] for k in range(1, PARTS)}
    variants |= {"the last byte cut off": content[:-1], "the first byte cut off": content[1:]}
    for place in rng.choice(8 * size, min(flips, 8 * size), replace=False).tolist():
        variants[f"bit {place % 8} of byte {place // 8}"] = flipped(content, place)
    if header is not None:
        variants["no samples"] = content[:header]
    if is_text(content):
        variants |= _text_variants(content, rng)
    return variants


def flipped(content: bytes, place: int) -> bytes:
    """With one bit of `8 * len(content)` flipped."""
    changed = bytearray(content)
    changed[place // 8] ^= 1 << place % 8
    return bytes(changed)


def is_text(content: bytes) -> bool:
    try:
        return "\0" not in content.decode("utf-8")
    except UnicodeDecodeError:
        return False


def _text_variants(content: bytes, rng: np.random.Generator) -> dict[str, bytes]:
    text = content.decode("utf-8")
    numbers = list(NUMBER.finditer(content))
    variants = {
        "UTF-16": text.encode("utf-16"),
        "UTF-16 without its mark": text.encode("utf-16-le"),
        "UTF-16, big-endian": b"\xfe\xff" + text.encode("utf-16-be"),
        "UTF-32": text.encode("utf-32"),
        "UTF-8 with its mark": b"\xef\xbb\xbf" + content,
        "Latin-1": content[: len(content) // 2] + b"\xb0" + content[len(content) // 2 :],
        "CRLF": content.replace(b"\n", b"\r\n"),
        "a zero byte": content[: len(content) // 3] + b"\0" + content[len(content) // 3 :],
        "no last line end": content.rstrip(b"\n"),
        "decimal commas": NUMBER.sub(lambda number: number[0].replace(b".", b","), content),
    }
    for word in NOT_FINITE:
        for k in rng.choice(len(numbers), min(4, len(numbers)), replace=False).tolist():
            start, end = numbers[k].span()
            variants[f"{word} for number {k}"] = content[:start] + word.encode() + content[end:]
    return variants


def outcome(read: Callable[[Path], object], path: Path, content: bytes | None = None) -> object:
    """What a reader makes of a file, with this content if it is given: what it returns, or the FileFormatError.

    Any other exception passes through, as the failure that it is. What it returns must be sound: see `assert_sound`.
    """
    if content is not None:
        path.write_bytes(content)
    begin = time.process_time()
    try:
        result = read(path)
    except FileFormatError as error:
        message = str(error)
        assert message.startswith(f"{path}: "), message
        assert "\n" not in message, repr(message)
        assert "expected" in message, message
        assert len(message) < LENGTH, message[:300]
        result = error
    seconds = time.process_time() - begin
    assert seconds < SECONDS, f"{seconds:.2f} s"
    if not isinstance(result, FileFormatError):
        assert_sound(result)
    return result


def assert_sound(result: object) -> None:
    """What a reader owes of anything that it returns; a type that is not known here fails.

    Samples: at least one; finite, unit, above the horizon, of weights that are none or some. Tables: finite where
    measured, which is somewhere; other BRDFs: finite arrays. Photographs: NaN is unknown, nothing is infinite,
    something is known. Images, arrays and tensors are as they are stored, whatever that is: some, of numbers.
    """
    if isinstance(result, Measured | Material):
        result = result.data
    if isinstance(result, Samples):
        wi, wo, value, weight = (np.asarray(a) for a in (result.wi, result.wo, result.value, result.weight))
        assert result.size > 0, "no samples"
        assert all(np.all(np.isfinite(a)) for a in (wi, wo, value, weight)), "samples that are not finite"
        for w in (wi, wo):
            np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1, atol=1e-5)
            assert np.all(w[:, 2] > 0), "a direction below the horizon"
        assert np.all(weight >= 0), "a negative weight"
    elif isinstance(result, HalfVectorTable | AngleTable):
        values = np.asarray(result.values)
        there = np.ones(values.shape[:-1], bool) if result.measured is None else np.asarray(result.measured)
        assert there.any(), "no node is measured"
        assert np.all(np.isfinite(values[there])), "a measured node is not finite"
    elif isinstance(result, AbstractBRDF):
        for leaf in jax.tree.leaves(result):
            assert np.all(np.isfinite(np.asarray(leaf))), "an array of the model is not finite"
    elif isinstance(result, Photographs):
        assert not np.any(np.isinf(result.values)), "an infinite value"
        assert np.any(np.isfinite(result.values)), "nothing is known"
        for leaf in jax.tree.leaves(result.lights):
            assert np.all(np.isfinite(np.asarray(leaf))), "a light is not finite"
    else:
        for array in result.values() if isinstance(result, dict) else [result]:
            assert isinstance(array, np.ndarray), f"a {type(array).__name__}"
            assert array.dtype.kind in "uif", array.dtype
            assert array.size or isinstance(result, dict), "an empty array"


def rows(samples: Samples) -> list[tuple[float, ...]]:
    """Samples as comparable rows."""
    columns = [np.asarray(a, float) for a in (samples.wi, samples.wo, samples.value, samples.weight[:, None])]
    # Adding 0 makes the zeros of one sign.
    return [tuple(row) for row in (np.round(np.concatenate(columns, axis=1), 6) + 0.0).tolist()]


def same(one: object, other: Samples) -> bool:
    return isinstance(one, Samples) and rows(one) == rows(other) and one.isotropic == other.isotropic


def beginning(one: object, other: Samples) -> bool:
    """Whether `one` holds the first of the samples of the other, and no others."""
    return isinstance(one, Samples) and rows(one) == rows(other)[: one.size]


def part(one: object, other: Samples) -> bool:
    """Whether `one` holds samples of the other, in their order, and no others."""
    if not isinstance(one, Samples):
        return False
    rest = iter(rows(other))
    return all(row in rest for row in rows(one))
