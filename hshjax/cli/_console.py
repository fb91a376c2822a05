"""What the commands of `hshjax` share: where they print, how they end, what they refuse to replace."""

import functools
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

try:
    import typer
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text
except ModuleNotFoundError as missing:
    sys.exit(f"the hshjax command needs {missing.name}: pip install 'hshjax[experiments]'")

# No markup: paths and what files say of themselves may hold brackets.
console = Console(highlight=False, markup=False)
complaints = Console(highlight=False, markup=False, stderr=True)

BAD_INPUT, BAD_USAGE, INTERRUPTED = 1, 2, 130
"""Exit codes beside 0: a file that cannot be read, used or written; options that make no sense (those of typer too);
Ctrl-C."""


class Misuse(ValueError):
    """Options that make no sense, whatever the files hold."""


def failure(message: str, status: int = BAD_INPUT) -> Exception:
    """Prints what is wrong; raise what is returned, which ends the command."""
    complaints.print(Text("error:", style="bold red"), message, soft_wrap=True)
    return typer.Exit(status)


def guarded(command: Callable[..., None]) -> Callable[..., None]:
    """The command, ending with a sentence where an input, the machine's memory or the user stops it.

    What these exceptions do not cover is a fault of the program, and shows where it is.
    """

    @functools.wraps(command)
    def run(*arguments, **options):
        try:
            command(*arguments, **options)
        except KeyboardInterrupt:
            # It may have been while the last names were given, or after that.
            raise failure("interrupted: every file is as it was, or whole", INTERRUPTED) from None
        except MemoryError:
            raise failure("this needs more memory than there is") from None
        except (typer.Exit, typer.Abort, NotImplementedError, RecursionError):
            raise  # RuntimeErrors as well
        except Misuse as error:
            raise failure(str(error), BAD_USAGE) from error
        except (OSError, ValueError, ImportError, RuntimeError) as error:  # those of jax are RuntimeErrors
            raise failure(sentence(error)) from error

    return run


def sentence(error: BaseException) -> str:
    """What an exception says, or its name where it says nothing; of the system's, without their numbers."""
    if isinstance(error, OSError) and error.filename is not None and error.filename2 is None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__


def check_targets(
    *files: Path | None,
    force: bool,
    sources: Sequence[Path | None] = (),
    folder: Path | None = None,
    names: Sequence[str] = (),
) -> None:
    """Before any work: exits where a result could not be written, or would replace something without `force`.

    `files` are written, and those of `names` in `folder`, which may be there and empty; None is none. No two of them
    may be the same, and none may be one of `sources`, `force` or not.
    """
    targets = [file for file in files if file is not None]
    for target in targets if folder is None else [*targets, folder]:
        if not target.absolute().parent.is_dir():
            raise failure(f"{target}: there is no folder {target.absolute().parent}")
    if folder is not None and folder.exists() and not folder.is_dir():
        raise failure(f"{folder} is a file: --out takes a folder, or a name that ends as that of a file does")
    for target in targets:
        if target.is_dir():
            raise failure(f"{target} is a folder: this is written into a file")
    written = targets if folder is None else [*targets, *(folder / name for name in names)]
    for k, target in enumerate(written):
        if any(source is not None and _same(target, source) for source in sources):
            raise failure(f"{target} is what is read: results go into another file")
        if any(_same(target, other) for other in written[:k]):
            raise failure(f"{target} would be written twice: results go into different files")
    for target in targets:
        if target.exists() and not force:
            raise failure(f"{target} is there already: --force replaces files of the same names")
    if folder is not None and folder.exists() and any(folder.iterdir()) and not force:
        raise failure(f"{folder} is there and not empty: --force replaces files of the same names")


def _same(one: Path, other: Path) -> bool:
    """Whether two names mean one file, which need not be there; links are followed."""
    return one.resolve() == other.resolve() or (one.exists() and other.exists() and one.samefile(other))


class Figures:
    """What a command found, once for people and once for scripts: a table, or an object of JSON."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._words: dict[str, str] = {}

    def add(self, key: str, value: Any, label: str | None = None, words: str | None = None) -> None:
        """A figure: `value` as JSON takes it under `key`; `words` (the value itself) in the table at `label` (the key).

        Infinite and NaN become null: JSON has no such numbers.
        """
        value = _plain(value)
        self._values[key] = value
        self._words[key.replace("_", " ") if label is None else label] = _words(value) if words is None else words

    @property
    def values(self) -> dict[str, Any]:
        """The figures for scripts."""
        return dict(self._values)

    def json(self) -> str:
        """All of them, as text that ends with a new line."""
        return json.dumps(self._values, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

    def show(self, title: str, *, as_json: bool) -> None:
        """On standard output: the table under a title, or JSON and nothing else."""
        if as_json:
            typer.echo(self.json(), nl=False)
            return
        table = Table(title=Text(title), title_justify="left", show_header=False)
        for name, value in self._words.items():
            table.add_row(Text(name), Text(value))
        console.print(table)


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy and jax as those of Python."""
    if isinstance(value, dict):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return "; ".join(f"{key}: {_words(part)}" for key, part in value.items())
    if isinstance(value, list):
        return ", ".join(map(_words, value))
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else str(value)
