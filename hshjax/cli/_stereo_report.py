"""report.html of `hshjax stereo`: one file that needs no other, no script and no network."""

import importlib.metadata
from pathlib import Path
from typing import Any, NamedTuple

from hshjax.cli import _stereo_pictures as pictures
from hshjax.cli._page import Picture, environment
from hshjax.cli._stereo_metrics import Solved
from hshjax.lighting import DirectionalLight


class Section(NamedTuple):
    """A picture under a heading."""

    heading: str
    caption: str
    picture: Picture


def write_report(path: Path, solved: Solved, name: str, options: dict[str, Any]) -> None:
    """The report of a solution of what is called `name`."""
    stages = [(stage.name, f"{stage.seconds:.1f}", _figures(stage.figures)) for stage in solved.stereo.history]
    page = environment(__file__).get_template("stereo.html").render(
        name=name, options=options, facts=solved.words(), sections=_sections(solved), stages=stages,
        notes=solved.photographs.notes, version=importlib.metadata.version("hshjax"),
    )  # fmt: skip
    path.write_text(page, encoding="utf-8")


def _figures(figures: dict[str, float]) -> str:
    return ", ".join(f"{key} {value:.3g}" for key, value in figures.items()) or "–"


def _sections(solved: Solved) -> list[Section]:
    given, searched = solved.photographs.lights, solved.metrics["lights_known"] == "unknown"
    compared = given if searched and isinstance(given, DirectionalLight) else None
    return [
        Section(
            "Normals and albedo",
            "Red, green and blue: x (right), y (up), z (towards the viewer). Albedo: π times the BRDF for light at "
            "45 degrees and an eye on the normal (CIE's geometry 45:0, without highlights), up to the scale of the "
            "photographs.",
            Picture(pictures.normals(solved)),
        ),
        Section(
            "How sure",
            "Angular error, where true normals are known; standard deviation of normals as the residuals predict it, "
            "which knows nothing of light from other parts of the object; what the model leaves of the values that "
            "count; values that fit neither shading nor shadow. Scales end at the 98 % quantile.",
            Picture(pictures.maps(solved)),
        ),
        Section(
            "Photographs and predictions",
            "Photographs, images rendered from normals, materials and lights, and four times their difference, each "
            "column at one exposure. Unknown values (saturated ones) are white in photographs. Cast shadows are not "
            "predicted.",
            Picture(pictures.comparison(solved)),
        ),
        Section(
            "Under new lights",
            "Rendered by the reflectance equation under lights of equal irradiance that no photograph has, without "
            "light that strays and without cast shadows. Far from all lights of the photographs materials are "
            "extrapolated.",
            Picture(pictures.relit(solved)),
        ),
        Section(
            "Lights",
            "Directions of lights on the hemisphere, of those nearby from the middle of the object, seen along the "
            "view; circles: angles from it. "
            + ("Circles: what the files say, dots: what was found." if compared else "As they are used."),
            Picture(pictures.lights(solved, compared)),
        ),
        Section(
            "Materials",
            "Square root of the BRDF over its largest value, against the angle of the eye in the plane of incidence; "
            "light comes from the left, where the ticks are. Values below 0 are drawn as 0.",
            Picture(pictures.lobes(solved)),
        ),
    ]
