"""Normals and lights at once, from one to twelve images of a known material: how many images does it take?"""

import itertools
import time
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field, field_validator
from scipy.sparse import diags_array
from scipy.sparse.linalg import spsolve

from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._bundle import (
    Equations,
    Linear,
    descend,
    differences,
    equations,
    free_slopes,
    looked_up,
    normals_of,
    radiance,
    sines,
    slopes_of_heights,
    uncertainty,
)
from experiments.recipes._material import hsh_series
from experiments.record import Record
from hshjax import LinearBRDF, plotting
from hshjax.io import read_rgl

METHODS = {"normals": "each normal by itself", "heights": "heights, whose border is known"}
STEEPEST = 1.5
"""Slopes up to this are looked for, and lights with a slope up to this away from the eye."""
KNOWN = 0.1
"""A combination of the lights' slopes and logarithms is determined where its standard deviation is below this."""
FITS = 1.2
"""Heights that start from the normals are taken where their loss is below this times what noise makes of it."""
REACH = 0.2
"""How far the slopes of heights are looked for, where images do not tell, as a standard deviation."""
NEAR = 1.01
"""A start agrees with the best where its loss is below this times the least."""
ORDERS = (2, 4, 8, 16)
"""Of the sines that heights are found in, one after another, when they start from the dome."""
ODD = 5.0
"""A pixel is explained where its loss is below this times what noise makes of it."""
SOLVED = 0.95
"""Share of pixels that a solution explains."""


class Config(RecipeConfig):
    recipe: Literal["joint_recovery"]
    material: Annotated[DataPath, Field(description="measured material, .bsdf")]
    order: Annotated[int, Field(ge=1, description="order of HSH that it is fitted by")] = 6
    degree: Annotated[int, Field(ge=2, description="degree of the rule that samples it")] = 48
    size: Annotated[int, Field(ge=9, description="nodes along a side of the height field")] = 41
    bumps: Annotated[int, Field(ge=0, description="random bumps and dents on a dome")] = 7
    images: Annotated[tuple[int, ...], Field(min_length=1, description="numbers of images, a case each")] = (
        1, 2, 3, 4, 6, 12,
    )  # fmt: skip
    noise: Annotated[float, Field(gt=0, description="its standard deviation, of the mean radiance of an image")] = 0.01
    starts: Annotated[int, Field(ge=1, description="random starts of the lights")] = 2
    stride: Annotated[int, Field(ge=1, description="starts are compared on every n-th pixel either way")] = 2
    rounds: Annotated[int, Field(ge=1, description="of looking up normals and descending, at most")] = 8

    @field_validator("images")
    @classmethod
    def _rising(cls, images):
        if images[0] < 1 or any(a >= b for a, b in itertools.pairwise(images)):
            raise ValueError(f"numbers of images must be positive and rise, got {list(images)}")
        return images


def run(config: Config, record: Record) -> None:
    brdf = _material(config)
    scene = record.stage("scene", _scene, config, record.rng("scene"), brdf)
    cases = [(count, method) for count in config.images for method in METHODS]
    results = {}
    for count, method in record.progress(cases, "numbers of images, two ways each"):
        start = results.get((count, "normals"))
        rng = record.rng(f"{method} {count}")
        results[count, method] = record.stage(
            f"{method} {count}", _SOLVERS[method], config, rng, brdf, scene, count, start
        )
    rows = [_row(config, count, method, result, scene) for (count, method), result in results.items()]
    _explain(config, record)
    solved = {
        method: [row["images"] for row in rows if row["unknown"] == method and row["solved"]] for method in METHODS
    }
    record.paragraph(
        f"Solved: at least {SOLVED:.0%} of the pixels are explained, and no number of the lights is left open but the "
        "turn about the view. "
        + "; ".join(
            f"{what}, from {', '.join(map(str, solved[method])) or 'no number of'} images"
            for method, what in METHODS.items()
        )
        + ". Where it says no, either no start came to an optimum that explains the images (loss far above 1), or "
        "many other normals and lights would explain them as well (lights open)."
    )
    for method, counts in solved.items():
        record.metric(f"fewest images, {method}", min(counts, default=None))
    record.table(
        "recovery", rows,
        "Errors: angles in degrees, mean over pixels or images; irradiance relative, its channels together. Truth-"
        "aligned: with the rotation and mirror image about the view that suit the truth best, instead of those found "
        "by integrability. Predicted: standard deviation by the slopes at the solution, median over pixels; it knows "
        "of one optimum only. Lights open: combinations of the 5 numbers of each light with a deviation above "
        f"{KNOWN:g}; one rotation of everything about the view belongs to them where normals are free. Explained: "
        f"share of pixels whose loss is below {ODD:g} times what noise makes of it; loss: all over its expectation. "
        "Starts that agree: within 1 % of the least loss. Seconds: of all starts, on a machine that others may use.",
    )  # fmt: skip
    record.figure("normals", _draw(config, scene, results), _CAPTION)
    for row in rows:
        name = f"{row['images']} images, {row['unknown']}"
        record.metric(f"{name}: normals", row["normals [deg]"], "deg")
        record.metric(f"{name}: light", row["light [deg]"], "deg")
        record.metric(f"{name}: solved", row["solved"])


def _explain(config: Config, record: Record) -> None:
    record.paragraph(
        f"A height field of {config.size} x {config.size} nodes, a dome with bumps and dents, seen from above. Image k "
        "is lit by one lamp far away, of unknown direction and unknown irradiance in three channels. The material is "
        f"known: `{config.material}`, a series of HSH of order {config.order} (norm A), which makes the images, too. "
        f"Noise of {config.noise:.1%} of an image's mean is added. Attached shadows only."
    )
    record.paragraph(
        "Two ways. **Normals**: two slopes of each pixel by itself, and five numbers of each light. From random lights "
        "and the dome alone as a guess, lights are fitted to the guess; then slopes are looked up pixel by pixel among "
        "all up to a limit, and both descend together by Levenberg-Marquardt with the pixels eliminated, in turns; "
        "pixels that are not explained yet count less. **Heights**: normals are those of heights (`hshjax."
        "height_field`, as in the truth, so that the grid makes no error), whose outer ring is known to be 0. They "
        "start from the heights whose slopes are nearest to those found by the first way; where that does not fit, "
        "from the dome and random lights as well, in products of sines up to orders "
        f"{', '.join(map(str, ORDERS))}, until a start fits. Stuck pixels are looked up as before, the heights of the "
        "nearest slopes taken, and so on in turns."
    )
    record.paragraph(
        "What cannot be known. One image has one to two independent numbers a pixel (its channels are mixtures of two "
        "colours, of body and highlight), no more than the unknown normal: free normals are not determined by it. Of a "
        "known Lambert surface any number of images leaves a common rotation of all normals and lights in space open "
        "(for unknown albedo: any linear map; of heights, the bas-relief maps). A highlight is fixed to the eye, which "
        "leaves rotations about the view and mirror images that hold it: a BRDF that is isotropic and bilateral sees "
        "no difference. They are undone without the truth: slopes of a surface have no curl. Then a last pair is left, "
        "the surface and its reflection in depth (bumps for dents) with every light turned half around the view; no "
        "image without cast shadows tells them apart, and zero heights at the border do not either. It is decided by "
        "one bit from outside: on the whole, the surface bulges towards the eye."
    )


# The scene


def _material(config: Config) -> LinearBRDF:
    return hsh_series(read_rgl(local_path(config.material)), config.order, config.degree)


def _window(size: int) -> np.ndarray:
    """1 in the middle, 0 along the border: the dome that starts begin with, but for its height."""
    x = np.linspace(-1, 1, size)
    return (1 - x**2) * (1 - x**2)[:, None]


def _spacing(config: Config) -> float:
    return 2 / (config.size - 1)


def _scene(config: Config, rng: np.random.Generator, brdf: LinearBRDF) -> dict[str, Any]:
    """Slopes `(P, 2)`, lights `(K, 5)`, images `(K, P, 3)` and the deviation of their noise `(K, P, 1)`."""
    x, y = np.meshgrid(np.linspace(-1, 1, config.size), np.linspace(1, -1, config.size))
    relief = np.full_like(x, 0.45)
    for _ in range(config.bumps):
        centre, height, width = rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.3, 0.3), rng.uniform(0.22, 0.4)
        relief += height * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * width**2))
    heights = _window(config.size) * relief
    matrix = slopes_of_heights(config.size, _spacing(config))
    slopes = (matrix @ heights[1:-1, 1:-1].ravel()).reshape(2, -1).T
    lights = _random_lights(rng, max(config.images))
    clean = np.stack([radiance(brdf, jnp.asarray(slopes), jnp.asarray(light)) for light in lights])
    sigma = np.broadcast_to(config.noise * clean.mean(axis=(1, 2), keepdims=True), (*clean.shape[:2], 1))
    return {
        "heights": heights, "slopes": slopes, "lights": lights, "sigma": sigma,
        "images": clean + sigma * rng.standard_normal(clean.shape),
    }  # fmt: skip


def _random_lights(rng: np.random.Generator, count: int) -> np.ndarray:
    """`(count, 5)`: up to 45° from the eye, of irradiances from 1 to e."""
    rim, turn = np.sqrt(rng.uniform(0.05, 1, count)), rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([rim * np.cos(turn), rim * np.sin(turn), rng.uniform(0, 1, (count, 3))])


# Solvers


def _dome(config: Config) -> np.ndarray:
    """Heights of a dome half as high as wide, the first guess of every shape."""
    return 0.5 * _window(config.size)[1:-1, 1:-1].ravel()


def _some(config: Config) -> np.ndarray:
    """Which pixels `(P,)` starts are compared on."""
    some = np.zeros((config.size, config.size), bool)
    some[:: config.stride, :: config.stride] = True
    return some.ravel()


def _weighed(found, count: int) -> np.ndarray:
    """Deviations of the noise are multiplied by this `(P, 1)`: pixels that are not explained count less (Cauchy)."""
    return np.sqrt(1 + found.losses / max(np.median(found.losses), 1.5 * count))[:, None]


def _solve_normals(
    config: Config, rng: np.random.Generator, brdf: LinearBRDF, scene: dict[str, Any], count: int, _: None
) -> dict[str, Any]:
    begin = time.perf_counter()
    images, sigma = scene["images"][:count], scene["sigma"][:count]
    guess = (slopes_of_heights(config.size, _spacing(config)) @ _dome(config)).reshape(2, -1).T
    some = _some(config)
    tried = [
        _alternate(
            config, brdf, images[:, some], sigma[:, some], guess[some], _random_lights(rng, count), config.rounds
        )
        for _ in range(config.starts)
    ]
    losses = np.array([loss for *_, loss in tried])
    _, lights, _ = tried[np.argmin(losses)]
    slopes = looked_up(brdf, images, sigma, guess, lights, steepest=STEEPEST)
    slopes, lights, _ = _alternate(config, brdf, images, sigma, slopes, lights, 2, fit_lights=False)
    losses_there = equations(brdf, images, sigma, slopes, lights).losses
    slopes, lights = upright(slopes, lights, config.size, losses_there < ODD * 1.5 * count)
    return _outcome(brdf, images, sigma, free_slopes(len(slopes)), slopes.T.ravel(), lights, 1) | {
        "starts": len(tried), "agreed": float(np.mean(losses < NEAR * losses.min())),
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def _alternate(config, brdf, images, sigma, slopes, lights, rounds, fit_lights=True) -> tuple[Any, np.ndarray, float]:
    """Slopes and lights by looking up and descending in turns, until that does not help any more; and the loss."""
    matrix, count = free_slopes(len(slopes)), len(images)
    if fit_lights:
        _, lights, _ = descend(brdf, images, sigma, matrix, slopes.T.ravel(), lights, steps=15, held=True)
    best, least = None, np.inf
    for _ in range(rounds):
        slopes = looked_up(brdf, images, sigma, slopes, lights, steepest=STEEPEST)
        weight = _weighed(equations(brdf, images, sigma, slopes, lights), count)
        x, lights, _ = descend(brdf, images, sigma * weight, matrix, slopes.T.ravel(), lights, steps=8)
        slopes = x.reshape(2, -1).T
        found = equations(brdf, images, sigma, slopes, lights)
        robust = float(np.sum(np.log1p(found.losses / (1.5 * count))))
        if best is None or robust < least:
            best = slopes, lights, found.loss
        if robust > (1 - 1e-3) * least:
            break
        least = robust
    return best


def _solve_heights(
    config: Config, rng: np.random.Generator, brdf: LinearBRDF, scene: dict[str, Any], count: int, normals: dict
) -> dict[str, Any]:
    begin = time.perf_counter()
    images, sigma = scene["images"][:count], scene["sigma"][:count]
    matrix = slopes_of_heights(config.size, _spacing(config))
    nearest = spsolve((matrix.T @ matrix).tocsc(), matrix.T @ normals["slopes"].T.ravel())
    tried = []
    for start in range(config.starts + 1):
        if start == 0:
            x, lights = nearest, normals["lights"]
        else:
            x, lights = _from_dome(config, brdf, images, sigma, _random_lights(rng, count))
        tried.append(_settled(config, brdf, images, sigma, matrix, x, lights))
        if _fits(tried[-1], images):
            break
    losses = np.array([found.loss for *_, found in tried])
    x, lights, _ = tried[np.argmin(losses)]
    if np.sum(x) < 0:  # dents for bumps
        x, lights = -x, lights * [-1, -1, 1, 1, 1]
    return _outcome(brdf, images, sigma, matrix, x, lights, 0) | {
        "starts": len(tried), "agreed": float(np.mean(losses < NEAR * losses.min())),
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip


def _descend_heights(
    brdf, images, sigma, matrix: Linear, x: np.ndarray, lights: np.ndarray, steps: int = 15
) -> tuple[np.ndarray, np.ndarray, Equations]:
    """By weights for pixels that are not explained yet, anew twice, then without."""
    for _ in range(2):
        found = equations(brdf, images, sigma, (matrix @ x).reshape(2, -1).T, lights)
        x, lights, _ = descend(brdf, images, sigma * _weighed(found, len(images)), matrix, x, lights, steps=steps)
    return descend(brdf, images, sigma, matrix, x, lights, steps=steps)


def _from_dome(config: Config, brdf, images, sigma, lights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lights alone, then low orders of the shape with them, on some of the pixels."""
    matrix, heights, some = slopes_of_heights(config.size, _spacing(config)), _dome(config), _some(config)
    part = images[:, some], sigma[:, some]
    rows = matrix[np.concatenate([some, some])]
    _, lights, _ = descend(brdf, *part, rows, heights, lights, steps=15, held=True)
    for order in (order for order in ORDERS if order < config.size - 2):
        basis = sines(config.size, order)
        x = np.linalg.lstsq(basis, heights)[0]
        x, lights, _ = _descend_heights(brdf, *part, rows @ basis, x, lights, 8)
        heights = basis @ x
    return heights, lights


def _fits(found: tuple[np.ndarray, np.ndarray, Equations], images: np.ndarray) -> bool:
    return found[2].loss < FITS * images.size / 2


def _settled(
    config: Config, brdf, images, sigma, matrix: Linear, x: np.ndarray, lights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Equations]:
    """Heights and lights: descended; then pixels looked up one by one, the nearest heights, and down again, in turns.

    A pixel alone finds its way out of an optimum that its neighbours would hold it in.
    """
    best = _descend_heights(brdf, images, sigma, matrix, x, lights)
    for _ in range(config.rounds):
        if _fits(best, images):
            break
        x, lights, _ = best
        slopes = (matrix @ x).reshape(2, -1).T
        slopes = looked_up(brdf, images, sigma, slopes, lights, steepest=STEEPEST, reach=REACH)
        found = equations(brdf, images, sigma, slopes, lights)
        weight = np.tile(1 / _weighed(found, len(images))[:, 0] ** 2, 2)
        x = spsolve((matrix.T @ diags_array(weight) @ matrix).tocsc(), matrix.T @ (weight * slopes.T.ravel()))
        trial = _descend_heights(brdf, images, sigma, matrix, x, lights, 8)
        if trial[2].loss > 0.98 * best[2].loss:
            break
        best = trial
    return best


_SOLVERS = {"normals": _solve_normals, "heights": _solve_heights}


def _outcome(brdf, images, sigma, matrix: Linear, x: np.ndarray, lights: np.ndarray, gauge: int) -> dict[str, Any]:
    slopes = (matrix @ x).reshape(2, -1).T
    found = equations(brdf, images, sigma, slopes, lights)
    predicted, deviations = uncertainty(found, matrix, slopes, np.arange(0, len(slopes), 5), gauge)
    expected = images[:, 0].size / 2
    return {
        "slopes": slopes, "lights": lights, "unknowns": x.size + lights.size,
        "loss": found.loss / (expected * len(slopes)), "explained": float(np.mean(found.losses < ODD * expected)),
        "predicted": float(np.degrees(np.median(predicted))), "open": int(np.sum(deviations > KNOWN)),
    }  # fmt: skip


def upright(
    slopes: np.ndarray, lights: np.ndarray, size: int, counts: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes `(P, 2)` and lights, mirrored and turned about the view as the slopes of a surface that bulges upwards.

    A turn by φ takes the curl c and the divergence d of the slopes to c cos φ - d sin φ, which should vanish. Nodes
    next to a pixel that does not count are left out, and the fifth of the others where c and d are largest: there
    neighbours are of different optima.
    """
    along = differences(size).toarray()
    counts = np.ones((size, size)) if counts is None else counts.reshape(size, size)
    alone = ~counts.astype(bool)
    near = np.abs(along) > 0
    clear = ~(alone | (near @ alone > 0) | (alone @ near.T > 0))
    if not clear.any():
        clear[:] = True
    best = None
    for mirror in (1, -1):
        p, q = np.moveaxis((slopes * [1, mirror]).reshape(size, size, 2), -1, 0)
        curl, divergence = -along @ p - q @ along.T, p @ along.T - along @ q
        large = np.hypot(curl, divergence)
        pair = np.stack([curl, -divergence])[:, clear & (large <= np.quantile(large[clear], 0.8))]
        value, vector = np.linalg.eigh(pair @ pair.T)
        if best is None or value[0] / value[1] < best[0]:
            best = value[0] / value[1], mirror, vector[:, 0]
    _, mirror, (cos, sin) = best
    turn = np.array([[1, 0], [0, mirror]]) @ np.array([[cos, sin], [-sin, cos]])
    x = np.linspace(-1, 1, size)
    outwards = np.stack(np.meshgrid(x, -x), axis=-1).reshape(-1, 2)
    if np.sum(outwards * (slopes @ turn)) > 0:
        turn = -turn
    return slopes @ turn, np.column_stack([lights[:, :2] @ turn, lights[:, 2:]])


# The report


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between unit vectors `(n, 3)` [degrees]."""
    return np.degrees(2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=-1) / 2, 1)))


def _errors(slopes: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Of normals [degrees]."""
    return _angles(*(np.asarray(normals_of(jnp.asarray(s))) for s in (slopes, truth)))


def _aligned(slopes: np.ndarray, truth: np.ndarray) -> float:
    """Mean error of the normals after the turn and mirror image about the view that suit the truth best."""
    means = []
    for mirror in (1, -1):
        mirrored = slopes * [1, mirror]
        unit, true = (s / np.sqrt(1 + np.sum(s**2, axis=1, keepdims=True)) for s in (mirrored, truth))
        phi = np.arctan2(np.sum(unit[:, 0] * true[:, 1] - unit[:, 1] * true[:, 0]), np.sum(unit * true))
        turn = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        means.append(np.mean(_errors(mirrored @ turn, truth)))
    return float(min(means))


def _row(config: Config, count: int, method: str, result: dict[str, Any], scene: dict[str, Any]) -> dict[str, Any]:
    lights, true = result["lights"], scene["lights"][:count]
    toward = [np.column_stack([x[:, :2], np.ones(count)]) for x in (lights, true)]
    toward = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in toward]
    power, power_true = np.exp(lights[:, 2:]), np.exp(true[:, 2:])
    errors = _errors(result["slopes"], scene["slopes"])
    solved = result["explained"] >= SOLVED and result["open"] <= (method == "normals")
    return {
        "images": count, "unknown": method, "values": 3 * count * len(errors), "unknowns": result["unknowns"],
        "normals [deg]": float(errors.mean()), "median": float(np.median(errors)),
        "truth-aligned": _aligned(result["slopes"], scene["slopes"]), "predicted": result["predicted"],
        "light [deg]": float(_angles(*toward).mean()),
        "irradiance": float(np.mean(np.linalg.norm(power - power_true, axis=1) / np.linalg.norm(power_true, axis=1))),
        "lights open": result["open"], "explained": result["explained"], "loss": result["loss"],
        "starts": result["starts"], "that agree": result["agreed"] if result["starts"] > 1 else None,
        "seconds": round(float(result["seconds"]), 1), "solved": bool(solved),
    }  # fmt: skip


_CAPTION = (
    "Image k at its own exposure. Normals found (x, y, z as red, green, blue) and their errors, by either way, from "
    "the first k images; left: the true normals."
)


def _draw(config: Config, scene: dict[str, Any], results: dict[tuple[int, str], dict[str, Any]]) -> Any:
    square = (config.size, config.size)
    columns = len(config.images) + 1
    figure, axes = plt.subplots(
        5, columns, figsize=(1.12 * columns + 0.6, 5.8), layout="constrained", squeeze=False
    )  # fmt: skip
    for ax in axes.ravel():
        ax.set(xticks=[], yticks=[], frame_on=False)

    def normals(slopes):
        return np.asarray(normals_of(jnp.asarray(slopes))).reshape(*square, 3) / 2 + 0.5

    axes[0, 0].set_ylabel("image k", fontsize=8)
    for row, method in ((1, "normals"), (3, "heights")):
        axes[row, 0].imshow(normals(scene["slopes"]), interpolation="nearest")
        axes[row, 0].set_title("truth", fontsize=8)
        axes[row, 0].set_ylabel(method, fontsize=8)
        axes[row + 1, 0].set_ylabel("error", fontsize=8)
    for column, count in enumerate(config.images, 1):
        image = scene["images"][count - 1].reshape(*square, 3)
        axes[0, column].imshow(plotting.display(image, plotting.exposure(image)), interpolation="nearest")
        axes[0, column].set_title(f"k = {count}", fontsize=8)
        for row, method in ((1, "normals"), (3, "heights")):
            found = results[count, method]
            error = _errors(found["slopes"], scene["slopes"])
            axes[row, column].imshow(normals(found["slopes"]), interpolation="nearest")
            shown = axes[row + 1, column].imshow(error.reshape(square), vmin=0, vmax=10, cmap="magma")
            axes[row + 1, column].set_xlabel(f"{error.mean():.2g}°", fontsize=8)
    figure.colorbar(shown, ax=axes[2:, :], shrink=0.5, label="error [degrees]", extend="max")
    return figure
