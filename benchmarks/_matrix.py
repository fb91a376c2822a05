"""What `benchmarks.evaluators` measures: one case a row, and what each takes at the least."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from hshjax import HSH, IsotropicBasis, Zernike

PEERS = {"HSH": "sphericart-jax", "Zernike": "zernipax", "IsotropicBasis": "forming rows"}
"""What a basis is compared with; pairs with the product of this library's own design rows and coefficients."""

VERBS = ("evaluate", "by coefficients", "by directions", "rows")


@dataclass(frozen=True)
class Case:
    """A row. `points` are pairs for `IsotropicBasis`. `verb`: one of `VERBS`; `by ...` are gradients of a sum."""

    verb: str
    basis: str
    order: int
    points: int = 100_000
    channels: int = 3
    dtype: str = "float32"

    @property
    def functions(self) -> int:
        return self.made().count

    @property
    def item_bytes(self) -> int:
        return 4 if self.dtype == "float32" else 8

    def made(self):
        """The basis."""
        single = {"HSH": HSH, "Zernike": Zernike, "IsotropicBasis": HSH}[self.basis](self.order)
        return IsotropicBasis(single) if self.basis == "IsotropicBasis" else single

    def multiply_adds(self) -> float:
        """Multiply-adds (an addition or a product alone counts as one) that the formula takes for one point.

        - Of the recurrence, three a radial function; a design row, one more a function.
        - Of the sum, one a function and channel, cosine and sine of a radial function sharing the azimuth.
        - Of the gradient by coefficients, the rows and one a function and channel; by directions, the recurrence and
          its derivative by z (six), and three derivatives of the series, in x, y, z.
        - Of pairs: two recurrences, two a function for R_n R_p + R_p R_n, one for the azimuth where rows are made, one
          a function and channel.
        """
        basis = self.made()
        if self.basis == "IsotropicBasis":
            radial = 2 * 3 * sum(basis.basis.radial_counts())
            return radial + basis.count * (2 + (self.verb == "rows") + (self.verb != "rows") * self.channels)
        radial = sum(basis.radial_counts())
        match self.verb:
            case "rows":
                return 3 * radial + basis.count
            case "evaluate":
                return 3 * radial + basis.count * self.channels
            case "by coefficients":
                return 3 * radial + basis.count * (1 + self.channels)
            case "by directions":
                return 6 * radial + 3 * basis.count
        raise ValueError(f"verb must be one of {VERBS}, got {self.verb!r}")

    def bytes(self) -> float:
        """Bytes that go in and out for one point, at the least."""
        directions = 6 if self.basis == "IsotropicBasis" else 3
        results = {
            "rows": self.functions, "evaluate": self.channels, "by coefficients": self.channels, "by directions":
            directions + self.channels,
        }[self.verb]  # fmt: skip
        return self.item_bytes * (directions + results)


def smoke() -> Iterator[Case]:
    """Two tiny cases."""
    yield Case("evaluate", "HSH", 1, points=64)
    yield Case("evaluate", "IsotropicBasis", 0, points=64)


def asked() -> Iterator[Case]:
    """The cases of the figures that are to be reached."""
    for dtype in ("float32", "float64"):
        for order in (8, 16, 32):
            yield Case("evaluate", "HSH", order, dtype=dtype)
    for order in (8, 16):
        yield Case("by coefficients", "HSH", order)
        yield Case("by directions", "HSH", order)
    for points in (20_000, 50_000):  # results below and above the size from which memory is asked of the system anew
        for order in (4, 8, 16):
            yield Case("rows", "HSH", order, points=points)
    yield Case("evaluate", "HSH", 16, points=20_000)
    yield Case("rows", "Zernike", 8, dtype="float64")
    yield Case("evaluate", "Zernike", 8, dtype="float64")
    yield Case("evaluate", "Zernike", 8)
    yield Case("evaluate", "IsotropicBasis", 8)


def selection() -> Iterator[Case]:
    """What is run by default: the figures, and cost against one thing at a time, from order 8 on."""
    yield from asked()
    evaluate = Case("evaluate", "HSH", 8)
    yield from (replace(evaluate, order=order) for order in (0, 2, 4, 24))
    yield replace(evaluate, order=64, points=10_000)
    yield from (replace(evaluate, points=points) for points in (100, 1000, 10_000, 1_000_000))
    yield from (replace(evaluate, channels=channels) for channels in (1, 8, 64))


def full() -> Iterator[Case]:
    """Every verb and dtype against order, points and channels."""
    yield from selection()
    for dtype in ("float32", "float64"):
        for basis in ("HSH", "Zernike"):
            for verb in VERBS if basis == "HSH" else ("evaluate", "rows"):
                start = Case(verb, basis, 8, dtype=dtype)
                for order in (0, 1, 2, 4, 8, 12, 16, 24, 32, 48, 64):
                    yield replace(start, order=order, points=100_000 if order <= 32 else 10_000)
                for points in (100, 1000, 10_000, 1_000_000, *((10_000_000,) if verb == "evaluate" else ())):
                    yield replace(start, points=points)
                if verb != "rows":
                    yield from (replace(start, channels=channels) for channels in (1, 2, 4, 8, 16, 32, 64))
        for order in (2, 4, 8, 12, 16):
            for verb in ("evaluate", "rows", "by coefficients", "by directions"):
                yield Case(verb, "IsotropicBasis", order, dtype=dtype, points=100_000 if order <= 8 else 20_000)


def distinct(cases: Iterator[Case]) -> list[Case]:
    return list(dict.fromkeys(cases))
