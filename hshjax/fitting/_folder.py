"""Many materials, one call: every file of a folder is fitted by itself, and what is finished stays finished."""

import inspect
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import AbstractBRDF
from hshjax.fitting._by_turns import by_turns, check_devices
from hshjax.fitting._compare import Comparison, compare
from hshjax.fitting._folder_plan import Plan, planned
from hshjax.fitting._folder_results import digest, settled, sweep, write_result
from hshjax.fitting._folder_summary import line, row, summary, write_summary
from hshjax.fitting._material import MaterialFit, MaterialModel, check_settings, fit_material
from hshjax.fitting._programs import few_programs
from hshjax.io.folder import Listed
from hshjax.io.measured import Findings, Negatives, check_negatives
from hshjax.io.read_material import read_material
from hshjax.samples import Samples


class FolderItem(NamedTuple):
    """A fitted material of a folder: its file, what was read, and what was found."""

    path: Path
    name: str
    model: MaterialModel
    data: AbstractBRDF | Samples
    findings: Findings | None
    fit: MaterialFit
    errors: Comparison


class FolderFit(NamedTuple):
    """What `fit_folder` has done.

    - `rows`: of summary.csv, a dict a file in the order of names; `status` is "done", "failed" or "skipped", `reason`
      says why. - `summary`: what summary.json holds.
    """

    rows: tuple[dict[str, Any], ...]
    summary: dict[str, Any]

    @property
    def counts(self) -> dict[str, int]:
        """How many files have which status."""
        return self.summary["counts"]


Finish = Callable[[Path, FolderItem], dict[str, Any]]
"""Writes further files of a result into the folder it is given, and returns the figures of its metrics.json."""

Watch = Callable[[int, int, dict[str, Any] | None], None]
"""Called with the number of files that are done, how many are to be, and the row of the last one: None before any."""


def fit_folder(
    folder: str | PathLike,
    out: str | PathLike,
    model: MaterialModel = "linear",
    *,
    recursive: bool = False,
    negatives: Negatives = "keep",
    devices: Sequence[Any] | None = None,
    force: bool = False,
    finish: Finish | None = None,
    watch: Watch | None = None,
    **settings: Any,
) -> FolderFit:
    """`fit_material` for every material of a folder, a folder of results for each: `out`/NAME with model.hshjax and
    metrics.json, where NAME is that of the file, suffix included.

    A result that is there and of the same options, version of hshjax and content of the file (SHA-256) is not made
    again: an interrupted call goes on where it was. `out` also gets summary.csv and summary.json, at once and whatever
    ends the call. A file that cannot be read or fitted does not stop the others; it is in the summary, as is what is no
    material.

    - `recursive`: folders within, too; results keep the tree. - `negatives`: as `read_material` takes it.
    - `devices`: materials go round over them. - `force`: what is there and another result is fitted anew and replaced.
    - `finish`, `watch`: see `Finish` and `Watch`. - `settings`: those of `fit_material`, for all alike.

    **Raises:** ValueError for settings that fit no material, a folder without materials, results of other options
    (unless `force`), results that would lie where the materials do; OSError where something cannot be written.
    """
    check_negatives(negatives)
    check_devices(devices)
    source, target = Path(folder), Path(out)
    settings = _bound(model, settings)
    check_settings(model, *(settings[name] for name in ("basis", "norm", "ridge", "constraints")))
    said = {name: str(value) if name == "basis" else value for name, value in settings.items()}
    options = settled(said | {"negatives": negatives})
    plan = planned(source, target, options, recursive=recursive, force=force)
    target.mkdir(exist_ok=True)
    sweep(target)
    rows = dict(plan.rows)

    def one(listed: Listed) -> dict[str, Any]:
        few_programs()  # samples of another number compile their own
        return _fitted(listed, target / listed.name, options, negatives, settings, finish)

    def told() -> dict[str, Any]:
        content = summary(source, options, [rows[name] for name in sorted(rows)])
        write_summary(target, content)
        return content

    told()  # before hours of work: where nothing can be written, this fails, and who is killed has said what is missing
    try:
        _fit_all(one, plan, rows, devices, watch)
    finally:
        content = told()
    return FolderFit(tuple(content["materials"]), content)


def _bound(model: str, settings: dict[str, Any]) -> dict[str, Any]:
    """All settings of `fit_material`, those that were not given too."""
    bound = inspect.signature(fit_material).bind(None, model, **settings)
    bound.apply_defaults()
    found = dict(bound.arguments)
    for name in ("data", "on_step"):
        del found[name]
    return found | {"basis": IsotropicBasis(HSH(8)) if found["basis"] is None else found["basis"]}


def _fit_all(
    one: Callable[[Listed], dict[str, Any]],
    plan: Plan,
    rows: dict[str, dict[str, Any]],
    devices: Sequence[Any] | None,
    watch: Watch | None,
) -> None:
    """Fills in `rows` as materials are done."""
    if watch is not None:
        watch(0, len(plan.todo), None)

    def kept(listed: Listed) -> dict[str, Any]:
        rows[listed.name] = one(listed)  # by the thread itself: after Ctrl-C nobody asks it
        return rows[listed.name]

    with closing(by_turns(kept, plan.todo, devices)) as results:
        for count, (_, found) in enumerate(results, 1):
            if watch is not None:
                watch(count, len(plan.todo), found)


def _fitted(
    listed: Listed,
    place: Path,
    options: dict[str, Any],
    negatives: Negatives,
    settings: dict[str, Any],
    finish: Finish | None,
) -> dict[str, Any]:
    """The row of a material that has been fitted, or could not be."""
    begin = time.perf_counter()
    try:
        sha256 = digest(listed.path)
        data, findings = read_material(listed.path, negatives=negatives)
        fit = fit_material(data, **settings)
        errors = compare(fit.samples, fit.model)
    except Exception as error:
        return row(listed.name, "failed", _of_material(error))
    item = FolderItem(listed.path, listed.name, settings["model"], data, findings, fit, errors)
    found = line(listed.format, settings["model"], fit, errors, time.perf_counter() - begin)
    whence = options | {"file": listed.name, "sha256": sha256}
    try:
        write_result(place, fit.model, lambda beside: (finish or _figures)(beside, item), found, whence)
    except Exception as error:
        if isinstance(error, OSError):  # a full disk is no property of a material
            raise
        return row(listed.name, "failed", _of_material(error))
    return row(listed.name, "done", figures=found)


def _figures(beside: Path, item: FolderItem) -> dict[str, Any]:
    """The figures of a result, where nobody has more to say."""
    errors = {f"relative_error_{norm}": value for norm, value in item.errors.errors.items()}
    return {**errors, "log_error": item.errors.log_error, "albedo": item.errors.albedo, "fit_notes": item.fit.notes}


def _of_material(error: Exception) -> str:
    """The sentence of an error that a material may cause; another one is raised again, for it is the program's."""
    if isinstance(error, NotImplementedError | RecursionError):  # RuntimeErrors as well
        raise error
    if isinstance(error, OSError | ValueError | RuntimeError | MemoryError):  # those of jax are RuntimeErrors
        return " ".join(str(error).split()) or type(error).__name__
    raise error
