"""A measured material against HSH, Zernike and SHR at chosen orders: errors, lobes, spheres."""

from typing import Annotated, Literal

from pydantic import Field

import hshjax
from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._material import FitSection, PictureSection, study, verdict
from experiments.record import Record
from hshjax.io import read_rgl


class Config(RecipeConfig):
    """Which file, and how it is fitted."""

    recipe: Literal["material_fit"]
    file: Annotated[DataPath, Field(description='measured material (RGL .bsdf): a path, or "$HSHJAX_DATA/..."')]
    fit: FitSection = FitSection(ridge=1e-5)
    pictures: PictureSection = PictureSection()


def run(config: Config, record: Record) -> None:
    brdf = read_rgl(local_path(config.file))
    record.paragraph(
        f"`{config.file}`: {brdf.description}. Channels {', '.join(brdf.channel_names)}. {brdf.unmeasured} entries of "
        "the table were not measured; values near grazing are extrapolated in the file. Norm E leaves them out."
    )
    rows = study(record, "material", brdf, config.fit, config.pictures)

    # Beyond the 80° of norm E tables are extrapolated, and their two sides disagree most.
    rule = hshjax.isotropic_pair_rule(32)
    inside = hshjax.NORMS["E"].judge_weight(rule.wi, rule.wo) > 0
    whole = hshjax.reciprocity_error(brdf, rule)
    part = hshjax.reciprocity_error(brdf, rule._replace(weight=rule.weight * inside))
    record.metric("reciprocity violation, all angles", whole.relative, note="of the measurement")
    record.metric("reciprocity violation, up to 80 degrees", part.relative, note="of the measurement")
    record.heading("What the paper claims, and what was measured")
    record.paragraph(
        "The paper claims a compact representation of arbitrary BRDFs, better by HSH than by Zernike functions at "
        f"equal order. {verdict('This material', rows, config.fit.norm)} The measurement violates reciprocity by "
        f"{float(whole.relative):.2g} (relative, weight cos θi cos θo, all angles) and {float(part.relative):.2g} up "
        "to 80°; no reciprocal model can come nearer to it than half of that. A product basis follows a smooth "
        "material; on a sharp highlight it leaves an error that falls slowly with the order, and it rings."
    )
    best = min(rows.values(), key=lambda row: row[f"error, norm {config.fit.norm}"])
    record.metric("best basis", f"{best['basis']} {best['order']}", note=f"in norm {config.fit.norm}")
