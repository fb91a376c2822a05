"""Which files of a folder are materials: by what they hold, not by their names."""

from os import PathLike
from pathlib import Path
from typing import Literal, NamedTuple

from hshjax.io import model
from hshjax.io.errors import FileFormatError
from hshjax.io.read_measured import FORMATS, HEAD, measured_format

MODEL = "saved model"
"""The format of what `save_model` wrote."""


class Listed(NamedTuple):
    """Something in a folder.

    - `path`: where it is. - `name`: from the folder on, with "/" between parts: no two have the same.
    - `kind`: "material": its first bytes are those of one, which is not yet to say that it can be read; "other": a file
      of another kind, one that is hidden, a folder that is not looked into; "unreadable": it could not be opened.
    - `format`: of a material, in words. - `reason`: of everything else, why it is none.
    """

    path: Path
    name: str
    kind: Literal["material", "other", "unreadable"]
    format: str = ""
    reason: str = ""


def list_materials(
    folder: str | PathLike, *, recursive: bool = False, without: str | PathLike | None = None
) -> list[Listed]:
    """All that lies in a folder, in the order of names; nothing is left out, nothing read beyond its first bytes.

    - `recursive`: look into folders, too, but for hidden ones, links to folders and `without`.

    **Raises:** OSError where the folder itself cannot be read.
    """
    top = Path(folder)
    own = None if without is None else Path(without).resolve()
    found: list[Listed] = []
    todo = [top]
    while todo:
        here = todo.pop()
        try:
            paths = sorted(here.iterdir())
        except OSError as error:
            if here == top:
                raise
            found.append(Listed(here, _name(here, top), "unreadable", reason=_said(error)))
            continue
        for path in paths:
            why = _passed_over(path, recursive, own)
            if why:
                found.append(Listed(path, _name(path, top), "other", reason=why))
            elif path.is_dir():
                todo.append(path)
            else:
                found.append(_file(path, _name(path, top)))
    return sorted(found, key=lambda one: one.name)


def _name(path: Path, top: Path) -> str:
    """Bytes that are no UTF-8 as escapes: so named, a file cannot be written about."""
    return path.relative_to(top).as_posix().encode("utf-8", "backslashreplace").decode("utf-8")


def _passed_over(path: Path, recursive: bool, own: Path | None) -> str:
    """Why something is not looked at; "" where it is."""
    if path.name.startswith("."):
        return "hidden"
    if path.is_dir():
        if path.resolve() == own:
            return "the folder of the results"
        if not recursive:
            return "a folder: --recursive, or recursive=True, looks into it"
        return "a link to a folder" if path.is_symlink() else ""
    # A pipe would be waited for, linked to or not; a broken link says itself what it is when it is opened.
    return "" if path.is_file() or not path.exists() else "neither file nor folder"


def _file(path: Path, name: str) -> Listed:
    if not path.as_posix().endswith(name):
        return Listed(path, name, "unreadable", reason="a name that is no UTF-8: give it another one")
    try:
        with path.open("rb") as file:
            saved = model.sniff(file.read(HEAD))
        words = MODEL if saved else FORMATS[measured_format(path)].words
    except FileFormatError as error:
        return Listed(path, name, "other", reason=f"no material: {error.got}")
    except OSError as error:
        return Listed(path, name, "unreadable", reason=_said(error))
    return Listed(path, name, "material", words)


def _said(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
