"""The reflectance equation against Mitsuba 3: spheres under an environment map, differences in units of its noise."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

import hshjax
from experiments import peers
from experiments.config import DataPath, RecipeConfig, local_path
from experiments.peers.interpolation import mitsuba_radiance, refined
from experiments.recipes._blocks import square_blocks
from experiments.recipes._material import Exchanged
from experiments.record import Record
from hshjax import plotting
from hshjax._typing import PairFunction
from hshjax.io import read_exr, read_rgl

ALBEDO = 0.5

WITHIN = "share within 3 standard errors"
BIAS = "mean [its standard error]"

Looks = Mapping[str, tuple[np.ndarray, dict[str, Any]]]
"""Name of a look at a sphere -> the map of its light, and other inputs than those of the sphere."""


class Config(RecipeConfig):
    """The light, the materials, and how finely each side looks."""

    recipe: Literal["mitsuba_spheres"]
    environment: Annotated[DataPath, Field(description="environment map, .exr")] = "$HSHJAX_DATA/envmaps/venice.exr"
    height: Annotated[int, Field(ge=4, description="rows of the map after averaging over blocks")] = 32
    alphas: Annotated[tuple[float, ...], Field(description="roughness of the GGX spheres")] = (0.2, 0.4)
    materials: Annotated[tuple[DataPath, ...], Field(description="measured materials, .bsdf")] = ()
    size: Annotated[int, Field(ge=4, le=256, description="pixels across a sphere")] = 48
    spp: Annotated[int, Field(ge=16, description="samples of Mitsuba at each point")] = 4096
    refine: Annotated[int, Field(ge=4, multiple_of=4, description="our map is finer than Mitsuba's by this factor")] = 8
    min_cosine: Annotated[float, Field(ge=0, lt=1, description="pixels seen under a smaller cosine do not count")] = 0.1
    variant: Annotated[Literal["llvm_ad_rgb", "scalar_rgb"], Field(description="of Mitsuba; scalar needs no LLVM")] = (
        "llvm_ad_rgb"
    )


def run(config: Config, record: Record) -> None:
    record.paragraph(
        f"Mitsuba {_version()} estimates the radiance of a unit sphere at the centres of {config.size} x {config.size} "
        f"pixels from {config.spp} independent samples each (`direct`: light and BSDF sampling, balance heuristic), "
        "and the standard error of every value from the scatter of its samples. `hshjax.reflect` sums the same light "
        f"times the same BRDF. The map is `{config.environment}`, negative values set to 0, averaged over blocks down "
        f"to {2 * config.height} x {config.height} pixels: averages over few bright pixels would have long-tailed "
        "noise, whose standard error cannot be told from its samples."
    )
    record.paragraph(
        "Both sides see one light. Mitsuba stretches the rows of a map so that the first and last lie at the poles; "
        f"`hshjax.EnvironmentMap` does not. So ours is Mitsuba's interpolated light on a grid {config.refine} times as "
        "fine. Mitsuba's `roughconductor` with material `none` is `hshjax.GGX(1, alpha)`: F = 1, Smith's G as a "
        "product, not height-correlated. Its `measured` takes the direction towards the eye for the tables' direction "
        "of incidence, for its paths begin there. Measured tables are not reciprocal, so our BRDF is called with "
        "exchanged arguments; the last column of the table shows what happens otherwise."
    )
    compare(config, record, _cases(config))


def compare(
    config: Config,
    record: Record,
    cases: dict[str, tuple[PairFunction, dict[str, Any]]],
    looks: Looks = MappingProxyType({}),
) -> dict[str, dict[str, dict[str, np.ndarray]]]:
    """Spheres of our BRDFs, and of the materials by which they are described to `experiments/peers/mitsuba_scenes.py`.

    Mitsuba has further `looks` at each sphere on the way: it takes longer to start and to compile than to look.

    Returns what `ask` says, by label and name of the look; that of the comparison is "compared".
    """
    light = environment(config)
    maps = [hshjax.EnvironmentMap(refined(light, k), up="y") for k in (config.refine, config.refine // 2)]
    directions = record.rng("directions").normal(size=(10_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    normals, inside = sphere(config.size)
    counts = normals[:, 2] > config.min_cosine

    rows, panels, found, radiance = [], {}, {}, mitsuba_radiance(light, directions)
    all_looks = {"compared": (light, {}), **looks}
    for label, (brdf, inputs) in record.progress(cases.items(), "spheres"):
        # Seeds of their own: equal samples would give similar materials equal noise, and all rows one mean difference.
        seeded = inputs | {"seed": int(record.rng(f"mitsuba {label}").integers(2**16))}
        found[label] = record.stage(f"mitsuba {label}", ask, config, seeded, all_looks, directions)
        peer = found[label]["compared"]
        ours = record.stage(f"ours {label}", _ours, brdf, maps, normals, inputs["bsdf"] == "measured")
        scores = Scores(ours["radiance"], peer["mean"][inside], peer["error"][inside], counts)
        rows.append(
            {"BSDF": label}
            | scores.row()
            | {
                "half as fine: 99 % change by less than [standard errors]": scores.change(ours["coarse"], 0.99),
                "half as fine: largest change [standard errors]": scores.change(ours["coarse"], 1.0),
                "half as fine: change of the mean [its standard error]": scores.bias(ours["coarse"]),
                "share, arguments not exchanged": scores.share(ours["table"]) if "table" in ours else None,
            }
        )
        panels[label] = [_image(x, inside) for x in (peer["mean"][inside], ours["radiance"], scores.score)]
        lights = np.max(np.abs(peer["radiance"] - radiance) / radiance)

    record.table(
        "table",
        rows,
        "Differences ours - Mitsuba at the centres of pixels whose normal is seen under a cosine above "
        f"{config.min_cosine:g}, three channels each. Agrees: at least 99 % within 3 standard errors (99.73 % of "
        "normal noise are), and the mean over pixels within 3 of its own standard error, in the worst channel. "
        "Half as fine: what our sum over pixels changes with a coarser map, a bound of its error. The largest changes "
        "are at the rim, where highlights of measured materials are about two degrees wide.",
    )
    record.figure(
        "spheres",
        _figure(panels),
        "Mitsuba, ours at the same exposure, their difference in standard errors of Mitsuba (green channel), and all "
        "such differences (bars) against normal noise (line).",
    )
    record.metric("spheres that agree", sum(row["agrees"] for row in rows), note=f"of {len(rows)}")
    record.metric("smallest share within 3 standard errors", min(row[WITHIN] for row in rows))
    record.metric("largest mean difference", max(abs(row[BIAS]) for row in rows), "its standard error")
    record.metric(
        "light, largest relative difference", lights, note="Mitsuba's interpolation against our formula of it"
    )
    return found


class Scores(NamedTuple):
    """Two pictures of a sphere, `(n, 3)` at points: `ours`, and Mitsuba's with its standard error; `counts` `(n,)`."""

    ours: np.ndarray
    mean: np.ndarray
    error: np.ndarray
    counts: np.ndarray

    @property
    def score(self) -> np.ndarray:
        """Differences in standard errors `(n, 3)`."""
        return (self.ours - self.mean) / self.error

    def share(self, ours: np.ndarray) -> float:
        """Of the values, those within 3 standard errors."""
        return float(np.mean(np.abs((ours - self.mean) / self.error)[self.counts] < 3))

    def change(self, coarse: np.ndarray, quantile: float) -> float:
        """How much ours changes [standard errors], in this quantile of the values."""
        return float(np.quantile(np.abs((self.ours - coarse) / self.error)[self.counts], quantile))

    def bias(self, other: np.ndarray) -> float:
        """Mean difference over points in its standard error, of the worst channel: points are independent."""
        mean = (self.ours - other)[self.counts].sum(0)
        return _worst(mean / np.sqrt((self.error[self.counts] ** 2).sum(0)))

    def row(self) -> dict[str, Any]:
        within, bias, score = self.share(self.ours), self.bias(self.mean), self.score[self.counts]
        return {
            "values": score.size,
            WITHIN: within,
            "standard deviation [standard errors]": float(score.std()),
            "largest [standard errors]": float(np.abs(score).max()),
            BIAS: bias,
            "mean, relative": _worst((self.ours - self.mean)[self.counts].mean(0) / self.mean[self.counts].mean(0)),
            "median relative standard error": float(np.median((self.error / self.mean)[self.counts])),
            "agrees": within >= 0.99 and abs(bias) <= 3,
        }


def _worst(values: np.ndarray) -> float:
    """The one of largest size, with its sign."""
    return float(values[np.argmax(np.abs(values))])


def _version() -> str:
    return peers.PEERS["mitsuba"][0].partition("==")[2]


def _cases(config: Config) -> dict[str, tuple[PairFunction, dict[str, Any]]]:
    """Label -> our BRDF, and what describes it to `experiments/peers/mitsuba_scenes.py`."""
    cases = {"lambert": (hshjax.Lambert(ALBEDO), {"bsdf": "lambert", "reflectance": np.full(3, ALBEDO)})}
    for alpha in config.alphas:
        cases[f"ggx {alpha:g}"] = (hshjax.GGX(1.0, alpha), {"bsdf": "ggx", "alpha": alpha})
    for text in config.materials:
        path = local_path(text)
        cases[path.stem.removesuffix("_rgb")] = (read_rgl(path), {"bsdf": "measured", "path": str(path.absolute())})
    return cases


def environment(config: Config) -> np.ndarray:
    """The map that Mitsuba gets, `(height, 2 height, 3)`."""
    return averaged(np.asarray(read_exr(local_path(config.environment))), config.height)


def averaged(image: np.ndarray, height: int) -> np.ndarray:
    """Means over square blocks of an image, `(height, any, 3)`; negative values, which no light has, as 0.

    **Raises:** ValueError where blocks do not fit.
    """
    return square_blocks(np.maximum(image, 0), height).mean((1, 3))


def sphere(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals at the centres of pixels `(n, 3)`, and which pixels `(size, size)`; as `plotting.sphere` has them."""
    step = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(step, -step)
    inside = x * x + y * y < 1
    x, y = x[inside], y[inside]
    return np.stack([x, y, np.sqrt(1 - x * x - y * y)], -1), inside


def ask(
    config: Config, inputs: dict[str, Any], looks: Looks, directions: np.ndarray
) -> dict[str, dict[str, np.ndarray]]:
    """What `experiments/peers/mitsuba_sphere.py` says at each look at a sphere; `inputs` are its material and `seed`.

    The library's own material needs an environment that has both: this one, with the extra `mitsuba`.
    """
    common = {
        "directions": directions, "strategy": "both", "variant": config.variant, "size": config.size,
        "spp": config.spp,
    }  # fmt: skip
    several = [common | inputs | {"environment": image} | other for image, other in looks.values()]
    answers = peers.run_each(
        "mitsuba", "mitsuba_sphere", several, llvm=config.variant.startswith("llvm"), here=inputs["bsdf"] == "hshjax"
    )
    return dict(zip(looks, answers, strict=True))


def _ours(
    brdf: PairFunction, maps: list[hshjax.EnvironmentMap], normals: np.ndarray, table: bool
) -> dict[str, np.ndarray]:
    points, view = jnp.asarray(normals, float), jnp.asarray([0.0, 0.0, 1.0])
    used = Exchanged(brdf) if table else brdf
    fine, coarse = (np.asarray(hshjax.reflect(used, light, points, view)) for light in maps)
    return {"radiance": fine, "coarse": coarse} | (
        {"table": np.asarray(hshjax.reflect(brdf, maps[1], points, view))} if table else {}
    )


def _image(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    image = np.full((*inside.shape, 3), np.nan)
    image[inside] = values
    return image


def _figure(panels: dict[str, list[np.ndarray]]) -> Any:
    figure, grid = plt.subplots(
        len(panels), 4, figsize=(8, 1.9 * len(panels)), squeeze=False, layout="constrained",
        gridspec_kw={"width_ratios": (1, 1, 1.2, 1.3)},
    )  # fmt: skip
    for axes, (label, (mean, ours, score)) in zip(grid, panels.items(), strict=True):
        factor = plotting.exposure(mean)
        for ax, image in zip(axes[:2], (mean, ours), strict=True):
            ax.imshow(plotting.display(image, factor), interpolation="nearest")
        shown = axes[2].imshow(score[..., 1], cmap="RdBu_r", vmin=-4, vmax=4, interpolation="nearest")
        figure.colorbar(shown, ax=axes[2], shrink=0.8, ticks=(-3, 0, 3))
        for ax in axes[:3]:
            ax.set(xticks=[], yticks=[], frame_on=False)
        axes[0].set_ylabel(label, fontsize=8)
        scores = score[~np.isnan(score)]
        axes[3].hist(np.clip(scores, -5, 5), bins=np.linspace(-5, 5, 41), density=True, color=plotting.COLOURS[5])
        x = np.linspace(-5, 5, 201)
        axes[3].plot(x, np.exp(-x * x / 2) / np.sqrt(2 * np.pi), color="black", lw=1)
        axes[3].set(yscale="log", ylim=(1e-4, 1), xticks=(-3, 0, 3))
        axes[3].tick_params(labelsize=7)
        axes[3].spines[["top", "right"]].set_visible(False)
    for ax, title in zip(grid[0], ("Mitsuba", "ours", "difference [std. errors]", "their density"), strict=True):
        ax.set_title(title, fontsize=9)
    return figure
