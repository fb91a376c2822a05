"""The recipes: one module each, found by being here.

A recipe module has a docstring whose first line says what the study shows, a `Config(RecipeConfig)` whose field
`recipe` is `Literal["<module name>"]`, and `run(config, record)`. Modules that begin with an underscore are shared
code.
"""

import ast
import importlib
import pkgutil
from pathlib import Path
from types import ModuleType


def available() -> list[str]:
    """Names of the recipes, sorted; nothing is imported."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def summary(name: str) -> str:
    """First line of a recipe's docstring; the module is read, not imported, so that `--help` is quick."""
    path = next(path for folder in __path__ if (path := Path(folder) / f"{name}.py").is_file())
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return docstring.partition("\n")[0]


def load(name: str) -> ModuleType:
    """The module of a recipe.

    **Raises:** TypeError where the module does not follow the pattern.
    """
    module = importlib.import_module(f"{__name__}.{name}")
    for attribute in ("Config", "run"):
        if not hasattr(module, attribute):
            raise TypeError(f"recipe {name} must define {attribute}, see {__name__}")
    literal = getattr(module.Config.model_fields["recipe"].annotation, "__args__", ())
    if literal != (name,):
        raise TypeError(f'Config.recipe of recipe {name} must be Literal["{name}"], got {literal}')
    return module
