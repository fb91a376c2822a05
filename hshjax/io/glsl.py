"""Fitted models as source text of shaders: GLSL ES 3.00 (WebGL 2, OpenGL ES 3), which is GLSL from 3.30 on as well."""

from os import PathLike
from typing import Any

import equinox as eqx
import numpy as np

from hshjax.io._formula import Formula, Vector, formula, terms
from hshjax.io._glsl_names import BUILT_IN, is_glsl_name
from hshjax.io._replace import replacing

INDENT = "    "

_SUM, _PRODUCT, _ATOM = 1, 2, 3
"""How tightly an expression binds."""


def glsl_source(brdf: eqx.Module, *, name: str = "hshjax_brdf", clamp: bool = True) -> str:
    """A function `vec3 name(vec3 wi, vec3 wo)` that evaluates a fitted model, ready to be pasted into a shader.

    It returns ρ [sr^-1], the cosine not included, of unit directions in the local frame (normal +z), both away from the
    surface; 0 where one lies below the horizon. One channel is returned three times. Coefficients are constants of the
    text, which has one line for each: 165 for HSH of order 8, 50 for a compact model; no array, no loop, no branch but
    that at the horizon. It needs `precision highp float`: tests in a browser hold it to 1e-4 of the value plus 1e-5 of
    the model's largest one.

    - `brdf`: a `LinearBRDF`, an `ExpBRDF` or a `LogLinearBRDF` of one or three channels, over the bases that
      `hshjax.io.mitsuba.register` names.
    - `clamp`: negative values, which series of ρ may have, count as 0.

    **Raises:** ValueError for other models and counts of channels, a `name` that is none in GLSL or that the function
    or its shader needs otherwise (a keyword, a type, a function of the language, `main`), and coefficients beyond
    single precision.
    """
    if not is_glsl_name(name) or name in BUILT_IN or name == "main":
        raise ValueError(f"a function of GLSL cannot be called {name!r}")
    found = formula(brdf)
    if found.channels not in (1, 3):
        raise ValueError(f"a shader takes models of 1 or 3 channels, got {found.channels}")
    kind = "vec3" if found.channels == 3 else "float"
    on = _Glsl()
    on.lines.append(f"{kind} series = {kind}(0.0);")
    for t, norm, value in terms(found.basis, _vector("wi"), _vector("wo"), on):
        constant = norm * found.coefficients[t] * (1.0 if isinstance(value, _Expression) else value)
        scaled = f" * {_bound(value, _PRODUCT + 1)}" if isinstance(value, _Expression) else ""
        on.lines.append(f"series += {_constant(constant)}{scaled};")
    on.part("The BRDF of the series")
    result = _linked(found)
    if clamp and not found.exponential:
        result = f"max({result}, 0.0)"
    on.lines.append(f"return {result};" if kind == "vec3" else f"return vec3({result});")
    lines = [
        f"// {type(brdf).__name__} over {found.basis.count} functions ({type(found.basis).__name__}), "
        f"{found.channels} channel{'s' if found.channels > 1 else ''}: written by hshjax.",
        "// BRDF [sr^-1] without the cosine, of unit directions away from the surface, whose normal is +z.",
        f"vec3 {name}(vec3 wi, vec3 wo) {{",
        f"{INDENT}if (!(wi.z > 0.0 && wo.z > 0.0)) return vec3(0.0);",
        *(INDENT + line if line else "" for line in on.lines),
        "}",
    ]
    return "\n".join(lines) + "\n"


def write_glsl(path: str | PathLike, brdf: eqx.Module, *, name: str = "hshjax_brdf", clamp: bool = True) -> None:
    """Write `glsl_source` to a file, in ASCII; written beside and renamed. **Raises:** as `glsl_source`; OSError."""
    text = glsl_source(brdf, name=name, clamp=clamp)
    with replacing(path) as beside:
        beside.write_text(text, encoding="ascii")


def _vector(name: str) -> Vector:
    return _Expression(f"{name}.x"), _Expression(f"{name}.y"), _Expression(f"{name}.z")


def _linked(found: Formula) -> str:
    """ρ as an expression of `series`."""
    if found.low is not None and found.high is not None:
        inner = "series"
        for function, bound in (("max", found.low), ("min", found.high)):
            if np.all(np.isfinite(bound)):
                inner = f"{function}({inner}, {_constant(bound)})"
            elif np.any(np.isfinite(bound)):
                raise ValueError(f"bounds of ln rho must be finite in all channels or in none, got {bound}")
        return f"exp({inner})"
    if found.exponent == 1:
        return "series / (wi.z * wo.z)"
    return "series / sqrt(wi.z * wo.z)" if found.exponent else "series"


def _constant(values: np.ndarray) -> str:
    """A number, or a vec3."""
    texts = [_number(value) for value in values]
    return texts[0] if len(texts) == 1 else f"vec3({', '.join(texts)})"


def _number(value: Any) -> str:
    """The shortest decimal of this number in single precision, always with a point or an exponent."""
    with np.errstate(over="ignore"):
        single = np.float32(value)
    if not np.isfinite(single):
        raise ValueError(f"numbers of a shader must be finite in single precision, got {value}")
    return str(single)


class _Expression:
    """A float of a shader; operators write text, with brackets where the order of evaluation needs them."""

    def __init__(self, text: str, binding: int = _ATOM):
        self.text, self.binding = text, binding

    def __add__(self, other):
        if not isinstance(other, _Expression) and other < 0:
            return self - -other
        return _Expression(f"{self.text} + {_bound(other, _PRODUCT)}", _SUM)

    def __radd__(self, other):
        return _Expression(f"{_number(other)} + {_bound(self, _PRODUCT)}", _SUM)

    def __sub__(self, other):
        return _Expression(f"{self.text} - {_bound(other, _PRODUCT)}", _SUM)

    def __rsub__(self, other):
        return _Expression(f"{_number(other)} - {_bound(self, _PRODUCT)}", _SUM)

    def __mul__(self, other):
        return _Expression(f"{_bound(self, _PRODUCT)} * {_bound(other, _ATOM)}", _PRODUCT)

    def __rmul__(self, other):
        return _Expression(f"{_number(other)} * {_bound(self, _ATOM)}", _PRODUCT)

    def __truediv__(self, other):
        return _Expression(f"{_bound(self, _PRODUCT)} / {_bound(other, _ATOM)}", _PRODUCT)

    def __rtruediv__(self, other):
        return _Expression(f"{_number(other)} / {_bound(self, _ATOM)}", _PRODUCT)

    def __neg__(self):
        return _Expression(f"-{_bound(self, _ATOM)}", _PRODUCT)

    def __lt__(self, other):
        return _Expression(f"{self.text} < {_bound(other, _SUM)}", 0)

    def __gt__(self, other):
        return _Expression(f"{self.text} > {_bound(other, _SUM)}", 0)


def _bound(value: Any, binding: int) -> str:
    """An operand, in brackets where it binds less tightly than it has to."""
    if not isinstance(value, _Expression):
        text = _number(value)
        return f"({text})" if value < 0 else text
    return value.text if value.binding >= binding else f"({value.text})"


class _Glsl:
    """`hshjax.io._formula.Arithmetic` that writes lines of a shader."""

    def __init__(self):
        self.lines: list[str] = []
        self._names: set[str] = set()

    def sqrt(self, x: Any) -> Any:
        return _Expression(f"sqrt({_bound(x, 0)})")

    def log(self, x: Any) -> Any:
        return _Expression(f"log({_bound(x, 0)})")

    def select(self, condition: Any, yes: Any, no: Any) -> Any:
        return _Expression(f"({condition.text} ? {_bound(yes, _SUM)} : {_bound(no, _SUM)})")

    def keep(self, name: str, value: Any) -> Any:
        if not isinstance(value, _Expression):
            return value
        if name in self._names:
            raise ValueError(f"the name {name} is given twice in one formula")
        self._names.add(name)
        self.lines.append(f"float {name} = {value.text};")
        return _Expression(name)

    def part(self, title: str) -> None:
        self.lines += ["", f"// {title}"]
