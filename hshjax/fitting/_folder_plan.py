"""What there is to do in a folder of materials: which results are there, which are missing, which are in the way."""

from pathlib import Path
from typing import Any, NamedTuple

from hshjax.fitting._folder_results import SUMMARY, difference, digest, finished, refusal
from hshjax.fitting._folder_summary import REPORT, TABLE, TOTALS, foreign_summary, row
from hshjax.io.folder import Listed, list_materials


class Plan(NamedTuple):
    """- `todo`: what is to be fitted. - `rows`: of everything in the folder, by name, as it is before that."""

    todo: list[Listed]
    rows: dict[str, dict[str, Any]]


def planned(folder: Path, out: Path, settings: dict[str, Any], *, recursive: bool, force: bool) -> Plan:
    """The plan of a call, before anything is written.

    **Raises:** ValueError where there is no material, and for what would have to be replaced without `force`; with it,
    too, where what would be replaced is a file, or the folder that is read.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file: the results of a folder go into a folder")
    top, end = folder.resolve(), out.resolve()
    if top == end:
        raise ValueError(f"{out} is what is read: results go into another folder")
    listed = list_materials(folder, recursive=recursive, without=out)
    plan = Plan([], {})
    others = [found] if (found := foreign_summary(out)) else []
    for name in (TABLE, TOTALS, REPORT):
        if (out / name).is_dir():
            raise ValueError(f"{out / name} is a folder, where a file of that name is to be written")
    for one in listed:
        if one.kind != "material":
            status = "failed" if one.kind == "unreadable" else "skipped"
            plan.rows[one.name] = row(one.name, status, one.reason)
            continue
        if one.name in (TABLE, TOTALS, REPORT):
            why = f"its result would lie where {one.name} of the folder does: give the file another name"
            plan.rows[one.name] = row(one.name, "failed", why)
            continue
        place = out / one.name
        if top.is_relative_to(end / one.name):
            raise ValueError(f"the result of {one.name} would replace what is read: results go into another folder")
        for above in (place, *place.parents[: one.name.count("/")]):
            if (above.exists() or above.is_symlink()) and not above.is_dir():
                what = "a file" if above.exists() else "a link to nothing"
                raise ValueError(f"{above} is {what}: the results of a folder go into another folder")
        before, other = _before(place, settings, one.path)
        if other:
            others.append(other)
        if before is None:
            plan.todo.append(one)
            plan.rows[one.name] = row(one.name, "missing", "not fitted yet", {"format": one.format})
        else:
            plan.rows[one.name] = row(one.name, "done", figures=before[SUMMARY])
    if not any(one.kind == "material" for one in listed):
        what = f"none among {len(listed)}" if listed else "nothing"
        first = f", the first is {listed[0].name}: {listed[0].reason}" if listed else ""
        raise ValueError(f"{folder}: expected at least one material, got {what}{first}")
    if others and not force:
        raise ValueError(refusal(others))
    return plan


def _before(place: Path, settings: dict[str, Any], path: Path) -> tuple[dict[str, Any] | None, str]:
    """The metrics of a result that is there and the same; else None, and what is there instead, if anything."""
    try:
        found = finished(place)
    except ValueError as error:
        return None, str(error)
    if found is None:
        return None, ""
    other = difference(found, settings, lambda: digest(path))
    return (None, f"{place} {other}") if other else (found, "")
