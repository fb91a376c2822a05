"""Configurations: a TOML file and overrides become a typed, frozen config, or an error that names the key.

One key decides the type: `recipe = "name"` selects `Config` of experiments/recipes/name.py.
"""

import difflib
import hashlib
import json
import os
import re
import tomllib
import types
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from experiments import recipes

DATA_VARIABLE = "HSHJAX_DATA"


class ConfigError(ValueError):
    """A configuration that cannot be run; the message names file, key and remedy."""


class Section(BaseModel):
    """A table of a configuration: unknown keys are errors, values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class RecipeConfig(Section):
    """What every recipe takes. A recipe narrows `recipe` to its own name and adds fields with descriptions."""

    recipe: str
    name: Annotated[str, Field(pattern=r"^[\w.-]+$", description="name of the run; default: stem of the file")]
    seed: Annotated[int, Field(ge=0, lt=2**32, description="root of all random numbers of the run")] = 0
    dtype: Annotated[Literal["float64", "float32"], Field(description="precision of directions and results")] = (
        "float64"
    )
    devices: Annotated[int, Field(ge=1, description="of JAX: results are the same on any number, to rounding")] = 1


def local_path(text: str) -> Path:
    """The path that a configuration means: "$HSHJAX_DATA/rgl/x.bsdf" lies in the folder of that variable.

    The text itself stays in the config, so that a run has the same hash on every machine.

    **Raises:** ValueError where the variable is not set or nothing lies at the path.
    """
    prefix = f"${DATA_VARIABLE}"
    path = Path(text)
    if path.parts[:1] == (prefix,):
        folder = os.environ.get(DATA_VARIABLE)
        if not folder:
            raise ValueError(f"{text} needs the environment variable {DATA_VARIABLE}, the folder of measured data")
        path = Path(folder, *path.parts[1:])
    if not path.exists():
        raise ValueError(f"{text}: nothing lies at {path}")
    return path


def _checked_path(text: str) -> str:
    local_path(text)
    return text


DataPath = Annotated[str, AfterValidator(_checked_path)]
"""A file or folder that must exist, in the current folder or under "$HSHJAX_DATA/"; it lies at `local_path(...)`."""


_OVERRIDE = re.compile(r"(?P<key>[A-Za-z_][\w-]*(\.[A-Za-z_][\w-]*)*)=(?P<value>.*)", re.DOTALL)
_BARE_WORD = re.compile(r"[A-Za-z_$./][\w$./+-]*")


def is_override(argument: str) -> bool:
    """Whether a command-line argument is `key.sub=value` rather than a file."""
    return _OVERRIDE.fullmatch(argument) is not None


def parse_override(argument: str) -> tuple[list[str], Any]:
    """`fit.order=8` -> (["fit", "order"], 8).

    The value is TOML: 8, 1e-3, true, "text", [1, 2], {a = 1}. A bare word (letters, digits and _ $ . / + -, the first
    no digit) that is no TOML value is a string, so that `basis=hsh` and `path=$HSHJAX_DATA/x` need no further quotes.

    **Raises:** ConfigError where the value is neither.
    """
    match = _OVERRIDE.fullmatch(argument)
    if match is None:
        raise ConfigError(f"an override is key.sub=value, got {argument!r}")
    text = match["value"].strip()
    try:
        parsed = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError as error:
        if _BARE_WORD.fullmatch(text):
            return match["key"].split("."), text
        raise ConfigError(
            f"{argument}: {text!r} is no TOML value ({error}); a string needs quotes: '\"...\"'"
        ) from None
    if parsed.keys() != {"value"}:
        raise ConfigError(f"{argument}: one value expected, got {text!r}")
    return match["key"].split("."), parsed["value"]


def apply_override(table: dict[str, Any], keys: list[str], value: Any) -> None:
    """Sets a nested key in place; absent tables are made.

    **Raises:** ConfigError where a key on the way holds a value, not a table.
    """
    for depth, key in enumerate(keys[:-1]):
        table = table.setdefault(key, {})
        if not isinstance(table, dict):
            raise ConfigError(f"{'.'.join(keys)}: {'.'.join(keys[: depth + 1])} is a value, not a table")
    table[keys[-1]] = value


def load(path: Path, overrides: list[str] = []) -> RecipeConfig:  # noqa: B006 (never written to)
    """The typed config of a TOML file under overrides (`key.sub=value`).

    **Raises:** ConfigError with every problem of the file, one a line.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    for override in overrides:
        apply_override(table, *parse_override(override))
    table.setdefault("name", path.stem)
    try:
        return resolve(table)
    except ConfigError as error:
        raise ConfigError("\n".join(f"{path}: {line}" for line in str(error).splitlines())) from None


def resolve(table: dict[str, Any]) -> RecipeConfig:
    """The typed config of a table.

    **Raises:** ConfigError with every problem, one a line.
    """
    known = recipes.available()
    name = table.get("recipe")
    if name not in known:
        said = "no recipe given" if name is None else f"unknown recipe {name!r}"
        raise ConfigError(f"{said}{_nearest(str(name), known)}; recipes: {', '.join(known)}")
    model = recipes.load(name).Config
    try:
        # Through JSON: there, strict validation refuses "3" for 3 and still takes an array for a tuple.
        return model.model_validate_json(json.dumps(table), strict=True)
    except ValidationError as error:
        raise ConfigError("\n".join(_explain(model, problem) for problem in error.errors())) from None
    except TypeError as error:  # dates and times, which TOML has and JSON has not
        raise ConfigError(f"a value is neither number, string, boolean, array nor table: {error}") from None


def as_table(config: RecipeConfig) -> dict[str, Any]:
    """The resolved config as plain TOML types; a None is an absent key."""
    return config.model_dump(mode="json", exclude_none=True)


HOW = ("devices",)
"""Keys that say how a study is run and not what it is: its hash does not depend on them."""


def digest(config: RecipeConfig) -> str:
    """Eight hexadecimal digits that depend on every resolved value but `HOW`, and not on the order of keys."""
    table = {key: value for key, value in as_table(config).items() if key not in HOW}
    canonical = json.dumps(table, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(canonical.encode()).hexdigest()[:8]


def _nearest(key: str, candidates: list[str]) -> str:
    close = difflib.get_close_matches(key, candidates, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""


def _explain(model: type[BaseModel], problem: Any) -> str:
    """One line for one problem that pydantic found: the full path of the key, what was expected, what was there."""
    location = problem["loc"]
    key = ".".join(str(part) for part in location)
    match problem["type"]:
        case "extra_forbidden":
            parent = ".".join(str(part) for part in location[:-1])
            valid = [f"{parent}.{field}" if parent else field for field in _fields_at(model, location[:-1])]
            return f"unknown key {key!r}{_nearest(key, valid)}" + (f" (valid: {', '.join(valid)})" if valid else "")
        case "missing":
            return f"missing key {key!r}"
        case "value_error":
            return f"{key}: {problem['ctx']['error']}" if key else str(problem["ctx"]["error"])
        case _:
            expected = problem["msg"].removeprefix("Input should be ")
            return f"{key}: expected {expected}, got {json.dumps(problem['input'])}"


def _fields_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Keys of the table at a location; those of all alternatives where the table is a union."""
    models = [model]
    for part in location:
        annotations = [m.model_fields[part].annotation for m in models if part in m.model_fields]
        if annotations:  # otherwise the index of an array or the tag of a union, which stay inside the same models
            models = [found for annotation in annotations for found in _models_in(annotation)]
    return list(dict.fromkeys(field for m in models for field in m.model_fields))


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) is Literal:
        return []
    return [found for part in get_args(annotation) for found in _models_in(part)]


def describe(model: type[BaseModel], prefix: str = "") -> list[tuple[str, str, str, str]]:
    """(key, type, default, description) of every field, tables flattened to dotted keys."""
    rows = []
    for name, field in model.model_fields.items():
        annotation = field.annotation
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            rows += describe(annotation, f"{prefix}{name}.")
            continue
        default = "required" if field.is_required() else repr(field.get_default(call_default_factory=True))
        rows.append((f"{prefix}{name}", _short(annotation), default, field.description or ""))
    return rows


def _short(annotation: Any) -> str:
    """A type as a reader of TOML needs it: no constraints, no modules."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is Ellipsis:
        return "..."
    if annotation is types.NoneType:
        return "absent"
    if origin is Annotated:
        return _short(arguments[0])
    if origin is Literal:
        return " | ".join(repr(value) for value in arguments)
    if origin in (Union, types.UnionType):
        return " | ".join(_short(part) for part in arguments)
    name = getattr(origin or annotation, "__name__", str(annotation))
    return f"{name}[{', '.join(_short(part) for part in arguments)}]" if arguments else name
