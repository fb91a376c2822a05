"""The floors of the house plan, read from the imports: a module imports only lower floors, or its own package."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

FLOORS = {
    "_typing": 0,
    "_fields": 0,
    "_special": 0,
    "geometry": 0,
    "quadrature": 0,
    "metrics": 0,
    "bases": 1,
    "samples": 1,
    "brdfs": 2,
    "lighting": 3,
    "camera": 3,
    "surface": 3,
    "photographs": 3,
    "io": 3,
    "reflectance": 4,
    "fitting": 5,
    "stereo": 6,
    "plotting": 7,
    "cli": 7,
}
"""Floor of every top-level module or package of hshjax."""

SAME_FLOOR = {
    "_fields": {"_typing"},
    "_special": {"_typing"},
    "geometry": {"_typing"},
    "quadrature": {"_typing", "_special", "geometry"},
    "metrics": {"_typing", "_special", "geometry", "quadrature"},
    "surface": {"camera"},
    "photographs": {"camera", "lighting"},
    "io": {"photographs", "lighting", "surface"},
    "cli": {"plotting"},
}
"""The only imports that stay on one floor, each in one direction."""

LAZY = {
    "OpenEXR",
    "PIL",
    "drjit",
    "embreex",
    "imagecodecs",
    "jaxopt",
    "matplotlib",
    "mitsuba",
    "pydantic",
    "rich",
    "scipy",
    "trimesh",
    "typer",
}
"""Heavy or optional: imported inside the function that needs them, so that `import hshjax` is quick without them."""

FORBIDDEN = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve"}
"""A file that can run code when it is read."""


def imports(source: str, package: str, *, lazy: bool) -> set[str]:
    """Absolute dotted names that a source imports; `lazy` includes the imports inside functions.

    `from a.b import c` gives "a.b.c": whether c is a module or a name, its first two parts tell the floor.
    `package` is the dotted package of the file, for relative imports.
    """
    found = set()
    todo: list[ast.AST] = [ast.parse(source)]
    while todo:
        node = todo.pop()
        if not lazy and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parts, *([node.module] if node.module else [])])
            found |= {f"{base}.{alias.name}" for alias in node.names}
        todo.extend(ast.iter_child_nodes(node))
    return found


def top_level_names(path: Path, *, lazy: bool) -> set[str]:
    """First parts of what a file imports."""
    source = path.read_text(encoding="utf-8")
    return {name.split(".")[0] for name in imports(source, dotted_package(path), lazy=lazy)}


def dotted_package(path: Path) -> str:
    """The package that a file belongs to: hshjax.bases for hshjax/bases/_hsh.py and hshjax/bases/__init__.py."""
    return ".".join(path.parent.relative_to(ROOT).parts)


def room(path: Path) -> str:
    """Top-level module or package of hshjax that a file belongs to; "" for hshjax/__init__.py."""
    first = path.relative_to(ROOT / "hshjax").parts[0]
    return "" if first == "__init__.py" else first.removesuffix(".py")


def layer_errors(path: Path, source: str) -> list[str]:
    """What is wrong with the imports of one file of hshjax, one line each."""
    here = room(path)
    if here and here not in FLOORS:
        return [f"hshjax.{here} has no floor: give it one in tests/test_layers.py"]
    errors = []
    for name in sorted(imports(source, dotted_package(path), lazy=True)):
        parts = name.split(".")
        if parts[0] in ("experiments", "tests", "benchmarks"):
            errors.append(f"hshjax never imports {parts[0]}, got {name}")
        if parts[0] != "hshjax" or not here:  # hshjax/__init__.py is the roof: it names everything
            continue
        there = parts[1] if len(parts) > 1 else ""
        if there not in FLOORS:
            errors.append(f"imports {name}, which has no floor (import from the module, not from hshjax itself)")
        elif there != here and FLOORS[there] >= FLOORS[here] and there not in SAME_FLOOR.get(here, ()):
            errors.append(f"floor {FLOORS[here]} imports {name} of floor {FLOORS[there]}")
    return errors


LIBRARY = sorted((ROOT / "hshjax").rglob("*.py"))
FOLDERS = ("hshjax", "experiments", "tests", "benchmarks")
ALL_FILES = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


def names(paths):
    return [str(path.relative_to(ROOT)) for path in paths]


@pytest.mark.parametrize("path", LIBRARY, ids=names(LIBRARY))
def test_a_module_imports_only_lower_floors(path):
    assert layer_errors(path, path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("file", "source", "message"),
    [
        ("bases/_hsh.py", "from hshjax.fitting import fit", "floor 1 imports hshjax.fitting.fit of floor 5"),
        ("bases/_hsh.py", "def f():\n    import hshjax.stereo", "floor 1 imports hshjax.stereo of floor 6"),
        ("bases/_hsh.py", "from hshjax import fit", "no floor"),
        ("bases/_hsh.py", "from ..fitting import fit", "floor 1 imports hshjax.fitting.fit of floor 5"),
        ("samples.py", "from hshjax.bases import HSH", "floor 1 imports hshjax.bases.HSH of floor 1"),
        ("_typing.py", "from hshjax.geometry import dot", "floor 0"),
        ("cli.py", "import experiments.config", "never imports experiments"),
        ("attic.py", "", "hshjax.attic has no floor"),
    ],
)
def test_a_wrong_import_is_seen(file, source, message):
    """The check itself: without this, a parser that finds nothing would pass every file."""
    (error,) = layer_errors(ROOT / "hshjax" / file, source)
    assert message in error


def test_right_imports_pass():
    source = "import jax\nfrom hshjax.geometry import dot\nfrom hshjax.bases._base import Chart\nfrom ._shr import SHR"
    assert layer_errors(ROOT / "hshjax" / "bases" / "_hsh.py", source) == []


def modules_reached_by_import() -> dict[str, Path]:
    """Dotted name -> file of every module of hshjax that `import hshjax` executes."""
    reached: dict[str, Path] = {}
    todo = ["hshjax"]
    while todo:
        name = todo.pop()
        base = ROOT.joinpath(*name.split("."))
        path = base / "__init__.py" if (base / "__init__.py").is_file() else base.with_suffix(".py")
        if name in reached or not path.is_file():
            continue
        reached[name] = path
        for found in imports(path.read_text(encoding="utf-8"), dotted_package(path), lazy=False):
            parts = found.split(".")
            todo.extend(".".join(parts[:k]) for k in range(1, len(parts) + 1) if parts[0] == "hshjax")
    return reached


def test_heavy_modules_are_imported_where_they_are_used():
    for name, path in modules_reached_by_import().items():
        heavy = top_level_names(path, lazy=False) & LAZY
        assert not heavy, f"{name} imports {heavy} at module level; import inside the function instead"


@pytest.mark.parametrize("path", ALL_FILES, ids=names(ALL_FILES))
def test_no_file_imports_pickle(path):
    assert not top_level_names(path, lazy=True) & FORBIDDEN


def test_library_imports_only_its_declared_dependencies():
    """So that a plain install has them, or an extra: `experiments` on floor 7, `mesh` for surfaces, `photographs` and
    `mitsuba` for files. Import and package names agree, but for Pillow's."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    def package_names(requirements):
        return {re.split(r"[^\w.-]", requirement)[0] for requirement in requirements}

    declared = package_names(project["dependencies"])
    extras = {name: package_names(found) for name, found in project["optional-dependencies"].items()}
    assert {"jax", "numpy"} <= declared
    for path in LIBRARY:
        allowed = declared | (extras["experiments"] if FLOORS.get(room(path)) == 7 else set())
        allowed |= extras["mesh"] if room(path) == "surface" else set()
        allowed |= extras["photographs"] | extras["mitsuba"] if room(path) == "io" else set()
        found = {"pillow" if name == "PIL" else name for name in top_level_names(path, lazy=True)}
        assert found - set(sys.stdlib_module_names) - {"hshjax"} <= allowed, path
