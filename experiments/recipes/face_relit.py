"""A scanned head of measured material, relit: closed form under order 8 against Lambert and quadrature (Fig. 1)."""

from typing import Annotated, Any, Literal, NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

import hshjax
from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._blocks import square_blocks
from experiments.recipes._material import Norm, joint_error, negative_share
from experiments.record import Record
from hshjax import DirectionalLight, EnvironmentMap, HarmonicLight, Lambert, Scene, Surface, plotting, render
from hshjax._typing import PairFunction
from hshjax.io import read_exr, read_rgl, write_exr

NEGATIVE = (0.0, 0.447, 0.698)
"""Colour of pixels of negative radiance."""

MODELS = ("Lambert", "fitted", "measured")

Direction = tuple[float, float, float]


class Config(RecipeConfig):
    """The head, its material, the lights, and how finely the reference looks."""

    recipe: Literal["face_relit"]
    scan: Annotated[DataPath, Field(description="head, .npz: points, faces, normals; y up, seen along -z")] = (
        "$HSHJAX_DATA/face/LeePerrySmith_decoded.npz"
    )
    material: Annotated[DataPath, Field(description="measured material, .bsdf")]
    order: Annotated[int, Field(ge=0, description="order of HSH")] = 8
    norm: Annotated[Norm, Field(description="norm that the fit minimises, see docs/norms.md")] = "D"
    degree: Annotated[int, Field(ge=2, description="degree of the rule that samples the material")] = 32
    directions: Annotated[
        tuple[Direction, ...], Field(min_length=1, description="towards distant lights; x right, y up, z to the eye")
    ]
    environments: Annotated[tuple[DataPath, ...], Field(min_length=1, description="environment maps, .exr")]
    light_order: Annotated[int, Field(ge=0, description="order of the light in the pictures")] = 8
    light_orders: Annotated[tuple[int, ...], Field(description="orders of the light that are compared")] = (2, 4, 8, 16)
    resolution: Annotated[tuple[int, int], Field(description="rows and columns of the pictures")] = (640, 512)
    every: Annotated[int, Field(ge=1, description="the reference sees every n-th row and column")] = 6
    height: Annotated[int, Field(ge=4, description="rows of the map for the reference, averaged over blocks")] = 32
    max_theta: Annotated[float, Field(gt=0, le=90, description="largest angle that differences count [degrees]")] = 80.0


def run(config: Config, record: Record) -> None:
    table = read_rgl(local_path(config.material))
    material = record.stage("material", _material, config, table)
    pairs = hshjax.IsotropicBasis(hshjax.HSH(config.order))
    fitted = hshjax.LinearBRDF(pairs, jnp.asarray(material["coefficients"]), hshjax.NORMS[config.norm].target)
    brdfs = {"Lambert": Lambert(jnp.asarray(material["albedo"])), "fitted": fitted, "measured": table}
    head = _head(config)
    few = head.every(config.every)

    lamps = [DirectionalLight(jnp.asarray(towards), np.pi) for towards in config.directions]
    stored = {local_path(text).stem: np.asarray(read_exr(local_path(text)), float) for text in config.environments}
    maps = {name: np.maximum(radiance, 0) for name, radiance in stored.items()}
    series = [_series(radiance, config.light_order) for radiance in maps.values()]
    names = [*(f"distant {k + 1}" for k in range(len(lamps))), *maps]

    pictures = {
        model: head.images(brdf, lamps) + (head.images(brdf, series) if model != "measured" else [])
        for model, brdf in record.progress(brdfs.items(), "pictures")
    }
    references = {}
    for name, radiance in record.progress(maps.items(), "reference"):
        references[name] = record.stage(f"reference {name}", _reference, config, few, table, fitted, radiance)
        pictures["measured"].append(references[name]["measured"])
    rows = [
        _row(config, head, name, {model: images[k] for model, images in pictures.items()}, references.get(name))
        for k, name in enumerate(names)
    ]
    orders = record.stage("orders", _orders, config, head, fitted, maps, references)

    _describe(config, record, table, material, head, few, stored)
    record.figure(
        "pictures",
        _figure(names, pictures),
        "Columns: lights, each at one exposure, that of its measured picture; sRGB. Rows: Lambert of the same albedo, "
        f"the fit of order {config.order}, the measured table. Environments: the light of order {config.light_order} "
        "in the first two rows; the map itself in the last one, by quadrature at every "
        f"{config.every}. row and column. Pixels of negative radiance, which a truncated light or fit may cause, are "
        "blue.",
    )
    record.table(
        "differences",
        rows,
        "Relative differences (root mean square over pixels and channels, of that of the measured picture). BRDF fit: "
        f"against the table, under the same light. Truncation: the light of order {config.light_order} against the "
        "map, both under the fit. Together: fit and truncated light against table and map, which is what the pictures "
        f"show. Over pixels seen at up to {config.max_theta:g}°, of environments at every {config.every}. row and "
        "column; PSNR of what is displayed, at all angles. Negative: share of the head's pixels with a channel below "
        "0, in the picture, by quadrature of the fit, and of the table.",
    )
    record.table(
        "orders", orders,
        "By the light's order, under the fit: relative difference of the closed form from the sum over the map, and "
        "share of the head's pixels with a channel below 0.",
    )  # fmt: skip
    record.paragraph(_verdict(rows, references))
    for row in rows:
        name = row["light"]
        record.metric(f"{name}: fit", row["BRDF fit"], note="relative, against the table")
        if name in references:
            record.metric(f"{name}: truncation", row["truncation"], note="relative, against the map")
            record.metric(f"{name}: together", row["together"], note="relative")
            record.metric(f"{name}: map half as fine", references[name]["change"], note="relative, of the reference")
        record.metric(f"{name}: Lambert", row["Lambert"], note="relative")
        record.metric(f"{name}: PSNR", row["PSNR [dB]"], "dB", "of the fit")
        record.metric(f"{name}: negative pixels", row["negative"], note="share, fitted")
    record.metric("pixels of the head", int(head.mask.sum()))
    record.metric("pixels whose normal turns away", head.turned_away, note="black")
    record.metric(f"fit, norm {config.norm}", material["error"], note="relative, all channels")

    for model, images in pictures.items():
        for name, image in zip(names, images, strict=True):
            seen = ~np.isnan(image[..., :1])
            stem = f"{name} {model}".lower().replace(" ", "-")
            write_exr(record.folder / f"{stem}.exr", np.concatenate([np.where(seen, image, 0), seen], -1))


class Head(NamedTuple):
    """The pixels that see it: what is rendered is these alone. `mask` `(rows, columns)` says where they are."""

    mask: np.ndarray
    surface: Surface
    camera: hshjax.OrthographicCamera

    def every(self, step: int) -> "Head":
        """Every `step`-th row and column of the picture."""
        chosen = np.zeros_like(self.mask)
        chosen[::step, ::step] = True
        normal, position = (a[chosen[self.mask]] for a in (self.surface.normal, self.surface.position))
        return Head(self.mask[::step, ::step], Surface(normal, position), self.camera)

    def radiance(self, brdf: PairFunction, lights: list) -> np.ndarray:
        """`(lights, n, 3)` at the pixels of the mask."""
        return np.asarray(render(Scene(brdf, lights, self.surface, self.camera)))

    def image(self, values: np.ndarray) -> np.ndarray:
        """`(rows, columns, 3)`, NaN where there is no head."""
        image = np.full((*self.mask.shape, 3), np.nan)
        image[self.mask] = values
        return image

    def images(self, brdf: PairFunction, lights: list) -> list[np.ndarray]:
        """Of a BRDF, under one light after another."""
        return [self.image(values) for values in self.radiance(brdf, lights)]

    @property
    def cosine(self) -> np.ndarray:
        """Between normals and the eye, `(n,)`."""
        return np.asarray(self.surface.normal @ self.camera.view(None))

    @property
    def turned_away(self) -> int:
        """Pixels whose interpolated normal points away from the eye: they are black."""
        return int(np.sum(self.cosine <= 0))

    def facing(self, max_theta: float) -> np.ndarray:
        """Pixels seen at up to an angle [degrees], `(rows, columns)`."""
        facing = np.zeros_like(self.mask)
        facing[self.mask] = self.cosine >= np.cos(np.radians(max_theta))
        return facing


def _head(config: Config) -> Head:
    camera = hshjax.OrthographicCamera(
        jnp.asarray([0.0, 0.0, 1.0]), jnp.asarray([0.0, 1.0, 0.0]), centre=jnp.asarray([-0.05, 1.55, 0.0]),
        height=5.0, resolution=config.resolution,
    )  # fmt: skip
    with np.load(local_path(config.scan)) as scan:
        points, normals = (jnp.asarray(scan[key], float) for key in ("points", "normals"))
        seen = hshjax.mesh(camera, points, scan["faces"], normals=normals)
    mask = np.asarray(seen.mask)
    return Head(mask, Surface(seen.normal[mask], seen.position[mask]), camera)


def _material(config: Config, table: PairFunction) -> dict[str, Any]:
    pairs = hshjax.IsotropicBasis(hshjax.HSH(config.order))
    samples = hshjax.Samples.from_function(table, hshjax.isotropic_pair_rule(config.degree))
    model = hshjax.project(pairs, samples, norm=config.norm, reciprocity=False).model
    value = np.asarray(model(samples.wi, samples.wo))
    cosines = (samples.weight * samples.wi[:, 2] * samples.wo[:, 2])[:, None]
    return {
        "coefficients": np.asarray(model.coefficients),
        "albedo": np.asarray(jnp.sum(cosines * samples.value, axis=0) / np.pi),
        "error": joint_error(value, samples, config.norm),
        "negative": negative_share(value, samples),
    }


def _series(light: np.ndarray, order: int) -> HarmonicLight:
    return HarmonicLight.from_environment(EnvironmentMap(light, up="y"), order)


def _averaged(light: np.ndarray, height: int) -> EnvironmentMap:
    """Means over square blocks, weighted by solid angle: every block keeps its power.

    **Raises:** ValueError where blocks do not fit.
    """
    blocks = square_blocks(light, height)
    block = blocks.shape[1]
    weight = EnvironmentMap(light, up="y").solid_angle.reshape(height, block, 1, 1, 1)
    return EnvironmentMap(np.sum(weight * blocks, (1, 3)) / np.sum(weight * block, (1, 3)), up="y")


def _negative_power(radiance: np.ndarray) -> float:
    """Of a map's power, what is negative in the file."""
    power = EnvironmentMap(radiance, up="y").solid_angle[:, None, None] * radiance
    return float(-np.minimum(power, 0).sum() / power.sum())


def _reference(config: Config, few: Head, table: PairFunction, fitted: PairFunction, radiance: np.ndarray) -> dict:
    fine, coarse = (_averaged(radiance, height) for height in (config.height, config.height // 2))
    (measured,), (exact,), (again,) = (
        few.images(brdf, [light]) for brdf, light in ((table, fine), (fitted, fine), (table, coarse))
    )
    facing = few.facing(config.max_theta)
    return {
        "measured": measured, "fitted": exact,
        "change": _difference(again[facing], measured[facing], measured[facing]),
    }  # fmt: skip


def _orders(config: Config, head: Head, fitted: PairFunction, maps: dict, references: dict) -> list[dict[str, Any]]:
    facing = head.facing(config.max_theta)[:: config.every, :: config.every]
    rows = []
    for order in config.light_orders:
        # All of the head, though few of its pixels are compared: that is compiled already where it is the pictures'.
        images = head.images(fitted, [_series(radiance, order) for radiance in maps.values()])
        row: dict[str, Any] = {"order": order}
        for name, image in zip(maps, images, strict=True):
            exact = references[name]["fitted"][facing]
            row[name] = _difference(image[:: config.every, :: config.every][facing], exact, exact)
            row[f"{name}, negative"] = _negative(image[head.mask])
        rows.append(row)
    return rows


def _row(
    config: Config, head: Head, name: str, pictures: dict[str, np.ndarray], reference: dict[str, Any] | None
) -> dict[str, Any]:
    """Differences under one light; `reference` for an environment."""
    step = config.every if reference else 1
    facing = head.facing(config.max_theta)[::step, ::step]
    images = {model: pictures[model][::step, ::step] for model in ("Lambert", "fitted")}
    images["measured"] = pictures["measured"]
    images["exact"] = reference["fitted"] if reference else images["fitted"]
    factor = plotting.exposure(images["measured"])

    def difference(ours, other):
        return _difference(*(images[model][facing] for model in (ours, other, "measured")))

    whole = pictures["fitted"][head.mask]
    return {
        "light": name,
        "BRDF fit": difference("exact", "measured"),
        "truncation": difference("fitted", "exact") if reference else None,
        "together": difference("fitted", "measured"),
        "PSNR [dB]": plotting.psnr(images["fitted"], images["measured"], factor),
        "Lambert": difference("Lambert", "measured"),
        "Lambert's PSNR [dB]": plotting.psnr(images["Lambert"], images["measured"], factor),
        "negative": _negative(whole),
        "smallest / mean": float(whole.min() / whole.mean()),
        "negative, quadrature": _negative(images["exact"][head.mask[::step, ::step]]) if reference else None,
        "negative, table": _negative(images["measured"][head.mask[::step, ::step]]),
    }


def _difference(ours: np.ndarray, other: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(np.sum((ours - other) ** 2) / np.sum(reference**2)))


def _negative(values: np.ndarray) -> float:
    return float(np.mean(np.any(values < 0, axis=-1)))


def _describe(
    config: Config, record: Record, table: Any, material: dict, head: Head, few: Head, stored: dict[str, np.ndarray]
) -> None:
    record.paragraph(
        "The paper's Fig. 1 shows a mean face under a distant light. This is its counterpart, of a measured material: "
        "Infinite, 3D Head Scan by Lee Perry-Smith, based on a work at www.triplegangers.com, [CC BY 3.0]"
        "(https://creativecommons.org/licenses/by/3.0/), without its textures, seen by an orthographic camera at "
        f"{config.resolution[0]} x {config.resolution[1]} pixels, {int(head.mask.sum())} of them on the head. "
        f"{head.turned_away} of these, at silhouettes, are black, for their interpolated normals point away from the "
        "eye. There are attached shadows only: no cast ones, and no light from one part of the head to another."
    )
    albedo = ", ".join(f"{a:.3g}" for a in material["albedo"])
    record.paragraph(
        f"Material: `{config.material}` ({table.description}). Fitted: its projection on the isotropic Helmholtz basis "
        f"of HSH of order {config.order}, norm {config.norm} ({hshjax.NORMS[config.norm].meaning}), relative error "
        f"{material['error']:.3g}; {material['negative']:.2g} of its energy is negative. Lambert: the table's "
        f"hemispherical albedo, {albedo}. Seen at grazing angles the table is extrapolated and grows without bound, "
        f"and some pixels of silhouettes would outweigh all others: differences count up to {config.max_theta:g}°."
    )
    directions = "; ".join(f"{k + 1}: {tuple(towards)}" for k, towards in enumerate(config.directions))
    lost = ", ".join(f"{_negative_power(radiance):.2g} of the power of {name}" for name, radiance in stored.items())
    record.paragraph(
        f"Lights: distant ones of irradiance π, towards {directions} (x to the right, y up, z to the eye); and "
        f"environment maps, of which `HarmonicLight.from_environment` keeps {(config.light_order + 1) ** 2} numbers a "
        f"channel, the orders up to {config.light_order}. Under these `reflect` is in closed form for Lambert and the "
        "fit. The reference sums table and map over all pixels of the map, averaged down to "
        f"{2 * config.height} x {config.height}, at {int(few.mask.sum())} pixels of the head. Negative values in the "
        f"files of the maps count as 0 everywhere: {lost}."
    )


def _verdict(rows: list[dict[str, Any]], references: dict[str, Any]) -> str:
    said = [
        f"**{row['light']}**: {row['together']:.2g} ({row['PSNR [dB]']:.3g} dB), {row['BRDF fit']:.2g} by the fit "
        f"alone and {row['truncation']:.2g} by the truncation alone; Lambert {row['Lambert']:.2g}"
        for row in rows
        if row["light"] in references
    ]
    changes = ", ".join(f"{reference['change']:.2g} ({name})" for name, reference in references.items())
    return (
        f"The closed form differs from the reference by: {'; '.join(said)}. The losses need not add up: they may point "
        f"the same way or not. A map half as fine changes the reference by {changes}: so much may be its own error."
    )


def _figure(names: list[str], pictures: dict[str, list[np.ndarray]]) -> Any:
    rows, columns = pictures["Lambert"][0].shape[:2]
    figure, grid = plt.subplots(
        len(MODELS), len(names), figsize=(1.6 * len(names), 1.6 * len(MODELS) * rows / columns), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for k, name in enumerate(names):
        factor = plotting.exposure(pictures["measured"][k])
        for ax, model in zip(grid[:, k], MODELS, strict=True):
            image = pictures[model][k]
            shown = plotting.display(image, factor)
            shown[np.any(image < 0, axis=-1)] = NEGATIVE
            ax.imshow(shown, interpolation="nearest")
            ax.set(xticks=[], yticks=[], frame_on=False)
        grid[0, k].set_title(name, fontsize=9)
    for ax, model in zip(grid[:, 0], MODELS, strict=True):
        ax.set_ylabel(model, fontsize=9)
    return figure
