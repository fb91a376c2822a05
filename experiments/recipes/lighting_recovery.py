"""Light from one image of a known shape and material: lamps, series and maps; what is determined, and what is not."""

import itertools
from collections.abc import Callable
from typing import Annotated, Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment, nnls

import hshjax
from experiments.config import DataPath, RecipeConfig, local_path
from experiments.recipes._blocks import square_blocks
from experiments.recipes._linear_inverse import Tikhonov, gradient_energy
from experiments.recipes._material import hsh_series
from experiments.recipes._paper import BLUE, ORANGE, PURPLE, RED, plain
from experiments.record import Record
from hshjax import (
    GGX,
    AbstractTerm,
    DirectionalLight,
    EnvironmentMap,
    HarmonicLight,
    Lambert,
    LinearBRDF,
    OrthographicCamera,
    SphericalHarmonics,
    fit,
    plotting,
    reflect,
)
from hshjax.geometry import normalized
from hshjax.io import read_exr, read_rgl

VIEW = (0.0, 0.0, 1.0)
UP = (0.0, 1.0, 0.0)
NEAR = 1.001
"""A start has found the best optimum where its loss is below this times the least."""
MISSED = 2.0
"""A fit whose loss is above this times that of noise alone has not found its lamps."""
RANK = 1e3
"""Singular values below this many roundings of the largest count as 0."""
OWN = (RED, PURPLE, ORANGE, BLUE)
"""Colours of measured materials."""
FLAT = 0.1
"""What the prior of a map adds to n(n+1): so little holds its mean."""


class Config(RecipeConfig):
    recipe: Literal["lighting_recovery"]
    environment: Annotated[DataPath, Field(description="environment map, .exr, y up")]
    folder: Annotated[DataPath | None, Field(description="measured materials, *.bsdf; absent: none")] = None
    face: Annotated[DataPath | None, Field(description="scan of a head, .npz; absent: the sphere alone")] = None
    every: Annotated[int, Field(ge=1, description="take every n-th measured material")] = 1
    slopes: Annotated[tuple[float, ...], Field(description="roughness of the GGX surfaces")] = (0.1, 0.2, 0.4, 0.8)
    order: Annotated[int, Field(ge=1, description="order of HSH that materials are fitted by")] = 8
    degree: Annotated[int, Field(ge=2, description="degree of the rule that samples a material")] = 48
    size: Annotated[int, Field(ge=8, description="rows of an image")] = 28
    noise: Annotated[float, Field(gt=0, description="its standard deviation, of the mean radiance of the image")] = 0.01
    lamps: Annotated[tuple[int, ...], Field(description="lamps that burn at once, a case each")] = (1, 3)
    trials: Annotated[int, Field(ge=1, description="random sets of lamps, of each number")] = 2
    starts: Annotated[int, Field(ge=1, description="random starts of each fit of lamps")] = 2
    candidates: Annotated[int, Field(ge=1, description="random directions that a pursuit looks for lamps in")] = 500
    pixels: Annotated[int, Field(ge=4, description="pixels, drawn by lot, that lamps are fitted to")] = 150
    truth_order: Annotated[int, Field(ge=1, description="order of the series that lights the scene")] = 24
    series: Annotated[tuple[int, ...], Field(min_length=1, description="orders of the series that are recovered")] = (
        2, 4, 6, 8, 10, 12,
    )  # fmt: skip
    tolerance: Annotated[float, Field(gt=0, description="noise, of the light's norm, up to which it is determined")] = (
        0.1
    )
    draws: Annotated[int, Field(ge=2, description="draws of the noise that errors of series are measured on")] = 16
    height: Annotated[int, Field(ge=4, description="rows of the maps that are recovered")] = 32
    rule: Annotated[
        Literal["gcv", "discrepancy"], Field(description="how the weight of the maps' prior is found, from data alone")
    ] = "gcv"


def run(config: Config, record: Record) -> None:
    surfaces, materials, light = _surfaces(config), _materials(config), _light(config)
    visible = ", ".join(f"{name} {int(np.sum(_mask(normals)))}" for name, normals in surfaces.items())
    record.paragraph(
        f"Light from one image of a known shape of a known material, seen from one side (pixels: {visible}). Gaussian "
        f"noise of {config.noise:.1%} of the image's mean is added to every value. Materials are series of HSH of "
        f"order {config.order}, fitted in norm A; they make the images and invert them, so that errors of the material "
        "are no part of this study. Lambert and GGX are grey, of albedo and specular 1; such a series blurs lobes of "
        "slopes below some 0.2. Attached shadows only: parts of the surface neither shade nor light each other."
    )
    lamps = _all(config, record, materials, surfaces, "lamps", _recover_lamps)
    series = _all(config, record, materials, surfaces, "series", _recover_series, light)
    maps = _all(config, record, materials, surfaces, "map", _recover_map, light)
    _report_lamps(config, record, lamps)
    _report_series(config, record, series)
    _report_maps(config, record, maps)
    record.heading("Pictures")
    for surface, normals in surfaces.items():
        record.figure(
            f"lights {surface}", _draw_lights(config, surface, normals, light, series, maps),
            f"Images of the {surface} with noise, each at its own exposure, and the light that was found in them: as a "
            "series of the order in brackets, the largest that is determined, and as a map. First row: the light "
            f"itself, as a series of order {max(config.series)}, and whole. In the middle of a map lies the direction "
            "of the eye, up at its top, right (+x) at its left; its edges lie behind the object. One exposure for all.",
        )  # fmt: skip
    record.figure(
        "errors", _draw_errors(config, series, maps),
        "Left: error of the whole light, orders that are left out counted in, of least squares of each order; dots: "
        "what the noise alone would make, as predicted. Right: error of the map in each order by itself, and as "
        "predicted (dotted); at 1 an order is not seen. Grey: what the best series of an order leaves out.",
    )  # fmt: skip


def _all(
    config: Config, record: Record, materials: dict, surfaces: dict, what: str, recover: Callable, *arguments: Any
) -> dict[tuple[str, str], dict[str, Any]]:
    """Results by (surface, material), a stage each."""
    results = {}
    cases = [(surface, material) for surface in surfaces for material in materials]
    for surface, material in record.progress(cases, what):
        name = f"{what} {surface} {material}"
        given = config, record.rng(name), materials[material], surfaces[surface]
        results[surface, material] = record.stage(name, recover, *given, *arguments)
    return results


def _surfaces(config: Config) -> dict[str, np.ndarray]:
    """Normals `(rows, columns, 3)` of what is seen along -z; zero where nothing is."""
    ball = OrthographicCamera(VIEW, UP, resolution=(config.size, config.size))
    surfaces = {"sphere": np.asarray(hshjax.sphere(ball).normal)}
    if config.face is not None:
        scan = np.load(local_path(config.face))
        centre, resolution = (-0.05, 1.55, 0.0), (config.size, round(0.8 * config.size))
        camera = OrthographicCamera(VIEW, UP, centre=centre, height=5.0, resolution=resolution)
        surfaces["face"] = np.asarray(
            hshjax.mesh(camera, scan["points"], scan["faces"], normals=scan["normals"]).normal
        )
    return surfaces


def _mask(normals: np.ndarray) -> np.ndarray:
    """Pixels whose surface is turned towards the eye."""
    return normals[..., 2] > 0


def _materials(config: Config) -> dict[str, LinearBRDF]:
    known = {f"GGX {slope:g}": GGX(1.0, slope) for slope in config.slopes} | {"Lambert": Lambert(1.0)}
    if config.folder is not None:
        for path in sorted(local_path(config.folder).glob("*.bsdf"))[:: config.every]:
            known[path.stem.removesuffix("_rgb")] = read_rgl(path)
    return {name: hsh_series(brdf, config.order, config.degree) for name, brdf in known.items()}


def _light(config: Config) -> HarmonicLight:
    """The light that is looked for: of higher order than any series that is fitted to it."""
    image = np.asarray(read_exr(local_path(config.environment)))
    rows, columns, _ = image.shape
    largest = max(1, rows // (4 * config.truth_order))
    block = max(size for size in range(1, largest + 1) if rows % size == columns % size == 0)
    blocks = square_blocks(image, rows // block)
    return HarmonicLight.from_environment(EnvironmentMap(blocks.mean((1, 3)), up="y"), config.truth_order)


def _image(
    config: Config, rng: np.random.Generator, brdf: LinearBRDF, points: jax.Array, light: HarmonicLight
) -> tuple[np.ndarray, float, Callable[[int], np.ndarray]]:
    """The image without noise `(n, 3)`, the noise's standard deviation, and draws of noise `(draws, n, 3)`."""
    clean = np.asarray(reflect(brdf, light, points, jnp.asarray(VIEW, points.dtype)), np.float64)
    sigma = config.noise * float(clean.mean())
    return clean, sigma, lambda count: sigma * rng.standard_normal((count, *clean.shape))


# Lamps


class _Misfit(AbstractTerm):
    """What points under several lamps at once lack of their image, in standard deviations of its noise."""

    brdf: LinearBRDF
    normals: jax.Array
    image: jax.Array
    sigma: jax.Array

    def __call__(self, lamps: DirectionalLight):
        return (_lit(self.brdf, self.normals, lamps) - self.image) / self.sigma


@eqx.filter_jit
def _lit(brdf: LinearBRDF, normals: jax.Array, lamps: DirectionalLight) -> jax.Array:
    """Radiance `(n, channels)` under a batch of lamps, all of them burning."""
    view = jnp.asarray(VIEW, normals.dtype)
    return jnp.sum(jax.vmap(lambda lamp: reflect(brdf, lamp, normals, view))(lamps), axis=0)


@eqx.filter_jit
def _fit_lamps(misfit: _Misfit, start: DirectionalLight) -> tuple[DirectionalLight, jax.Array]:
    """The lamps from one start, their directions of length 1, and the loss."""
    found = fit(start, {"data": misfit}, throw=False, max_steps=60)
    return eqx.tree_at(lambda lamps: lamps.direction, found.model, normalized(found.model.direction)), found.loss


@eqx.filter_jit
def _deviations(misfit: _Misfit, lamps: DirectionalLight) -> jax.Array:
    """Standard deviations to first order, of direction [rad] and irradiance, `(lamps, 2)`."""
    slope = jax.jacfwd(misfit)(lamps)
    slope = jnp.concatenate([slope.direction, slope.irradiance], axis=-1).reshape(misfit.image.size, -1)
    # A direction's length does not count: to first order there is no information along it.
    covariance = jnp.linalg.pinv(slope.T @ slope, rtol=1e-12, hermitian=True)
    return jnp.sqrt(jnp.sum(jnp.diag(covariance).reshape(-1, 2, 3), axis=-1))


def _recover_lamps(
    config: Config, rng: np.random.Generator, brdf: LinearBRDF, normals: np.ndarray
) -> dict[str, dict[str, np.ndarray]]:
    """By the number of lamps: errors of the best fit and their standard deviations `(trials, lamps)`.

    `losses` `(trials, starts + 1)` over their expectation: of random starts, and of the one by pursuit.
    """
    seen = normals[_mask(normals)]
    seen = jnp.asarray(rng.permutation(seen)[: config.pixels])
    brdf = LinearBRDF(brdf.basis, jnp.broadcast_to(brdf.coefficients, (brdf.basis.count, 3)), brdf.target)
    unit = jnp.ones((1, 3))
    candidates = _directions(rng, (config.candidates,))
    atoms = np.stack([_lit(brdf, seen, jax.vmap(DirectionalLight)(jnp.asarray(w[None]), unit)) for w in candidates])
    results = {}
    for count in config.lamps:
        rows = []
        for _ in range(config.trials):
            true = jax.vmap(DirectionalLight)(
                jnp.asarray(_directions(rng, (count,))), jnp.asarray(rng.uniform(1, 3, (count, 3)))
            )
            clean = np.asarray(_lit(brdf, seen, true))
            sigma = config.noise * clean.mean()
            image = clean + sigma * rng.standard_normal(clean.shape)
            misfit = _Misfit(brdf, seen, jnp.asarray(image), jnp.asarray(sigma))
            starts = [_scaled(brdf, seen, image, w) for w in _directions(rng, (config.starts, count))]
            chosen, power = pursuit(atoms, image, count)
            starts.append(jax.vmap(DirectionalLight)(jnp.asarray(candidates[chosen]), jnp.asarray(power)))
            fits = [_fit_lamps(misfit, start) for start in starts]
            losses = np.array([float(loss) for _, loss in fits])
            best, _ = fits[np.argmin(losses)]
            row = _judged(best, true, np.asarray(_deviations(misfit, best)))
            rows.append(row | {"losses": losses / ((image.size - 5 * count) / 2)})
        results[str(count)] = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
    return results


def _scaled(brdf: LinearBRDF, normals: jax.Array, image: np.ndarray, directions: np.ndarray) -> DirectionalLight:
    """Lamps of one irradiance, that which suits the image best."""
    lamps = jax.vmap(DirectionalLight)(jnp.asarray(directions), jnp.ones(directions.shape))
    shown = np.asarray(_lit(brdf, normals, lamps))
    scale = max(np.sum(shown * image), 0) / max(np.sum(shown**2), np.finfo(shown.dtype).tiny)
    return eqx.tree_at(lambda lamps: lamps.irradiance, lamps, scale * lamps.irradiance)


def pursuit(atoms: np.ndarray, image: np.ndarray, count: int) -> tuple[list[int], np.ndarray]:
    """Which of the images `(candidates, n, channels)` of lamps of irradiance 1 add up to `image`, and their powers.

    One lamp after another, the one that explains most of what is left, then the powers of all anew: orthogonal matching
    pursuit with powers >= 0, `(count, channels)`.
    """
    square = np.sum(atoms**2, axis=1)
    chosen, left = [], image
    for _ in range(count):
        gain = np.maximum(np.einsum("anc,nc->ac", atoms, left), 0) ** 2 / np.maximum(square, np.finfo(float).tiny)
        gain[chosen] = -1
        chosen.append(int(np.argmax(np.sum(gain, axis=1))))
        power = np.stack([nnls(atoms[chosen, :, c].T, image[:, c])[0] for c in range(image.shape[1])], axis=1)
        left = image - np.einsum("anc,ac->nc", atoms[chosen], power)
    return chosen, power


def _directions(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Random directions `(*shape, 3)` up to 100° from the eye's: some lamps stand behind."""
    z, phi = rng.uniform(np.cos(np.radians(100)), 1, shape), rng.uniform(0, 2 * np.pi, shape)
    rim = np.sqrt(1 - z * z)
    return np.stack([rim * np.cos(phi), rim * np.sin(phi), z], axis=-1)


def _judged(found: DirectionalLight, true: DirectionalLight, deviation: np.ndarray) -> dict[str, np.ndarray]:
    """Errors of lamps, each compared with the true one that it stands for: none has a name."""
    power, power_true = np.asarray(found.irradiance), np.asarray(true.irradiance)
    apart = np.linalg.norm(np.asarray(found.direction)[:, None] - np.asarray(true.direction)[None], axis=-1)
    own, other = linear_sum_assignment(apart)
    size = np.linalg.norm(power_true[other], axis=-1)
    return {
        "direction": np.degrees(2 * np.arcsin(np.minimum(apart[own, other] / 2, 1))),
        "predicted direction": np.degrees(deviation[own, 0]),
        "irradiance": np.linalg.norm(power[own] - power_true[other], axis=-1) / size,
        "predicted irradiance": deviation[own, 1] / size,
    }


# Series


def _recover_series(
    config: Config, rng: np.random.Generator, brdf: LinearBRDF, normals: np.ndarray, light: HarmonicLight
) -> dict[str, Any]:
    """Least squares of every order 0 ... max(series), in arrays by order; errors are relative to the light's norm."""
    points = jnp.asarray(normals[_mask(normals)])
    clean, sigma, noise = _image(config, rng, brdf, points, light)
    images = np.concatenate([clean[None], clean[None] + noise(config.draws)])
    truth = np.asarray(light.coefficients)
    orders = np.arange(max(config.series) + 1)
    unit = HarmonicLight(jnp.eye((orders[-1] + 1) ** 2))
    found = np.zeros((orders.size, len(images), *unit.coefficients.shape[:1], 3))
    variance, condition = np.zeros(orders.size), np.zeros(orders.size)
    unseen, combinations = np.zeros(orders.size, int), []
    for channels in np.split(np.arange(3), brdf.channels):  # a grey material is one design for all
        view = jnp.asarray(VIEW, points.dtype)
        part = LinearBRDF(brdf.basis, brdf.coefficients[:, channels[:1]], brdf.target)
        rotation, design = np.linalg.qr(np.asarray(reflect(part, unit, points, view), np.float64))
        data = np.einsum("nk,dnc->kdc", rotation, images[..., channels], optimize=True)
        for order in orders:
            count = (order + 1) ** 2
            u, s, vt = np.linalg.svd(design[:, :count], full_matrices=False)
            kept = s > RANK * np.finfo(points.dtype).eps * s[0]
            inverse = (vt[kept].T / s[kept]) @ u[:, kept].T
            found[order, :, :count, channels] = np.einsum("kn,ndc->cdk", inverse, data, optimize=True)
            variance[order] += len(channels) * np.sum((sigma / s[kept]) ** 2) if kept.all() else np.inf
            condition[order] = max(condition[order], s[0] / s[-1] if kept.all() else np.inf)
            unseen[order] = max(unseen[order], np.sum(~kept))
        weakest = np.linalg.norm(truth[:, channels], axis=0).min()
        combinations.append(np.sum(s > sigma / (config.tolerance * weakest)))
    norm = np.linalg.norm(truth)
    target = np.stack([np.where(np.arange(len(unit.coefficients)) < (n + 1) ** 2, 1, 0) for n in orders])
    short = found - target[:, None, :, None] * truth[: len(unit.coefficients)]
    error = np.sqrt(np.sum(short[:, 1:] ** 2, axis=(2, 3)).mean(1)) / norm
    spread = np.sqrt(np.sum((found[:, 1:] - found[:, :1]) ** 2, axis=(2, 3)).mean(1)) / norm
    left_out = np.sqrt([np.sum(truth[(n + 1) ** 2 :] ** 2) for n in orders]) / norm
    determined = np.sqrt(variance) / norm <= config.tolerance
    order = int(np.argmin(determined)) - 1 if not determined.all() else int(orders[-1])
    return {
        "order": orders, "unknowns": (orders + 1) ** 2, "condition": condition, "unseen": unseen,
        "predicted": np.sqrt(variance) / norm, "noise": spread,
        "aliased": np.linalg.norm(short[:, 0], axis=(1, 2)) / norm,
        "error": error, "left out": left_out, "whole": np.hypot(error, left_out),
        "determined": order, "combinations": int(min(combinations)),
        "coefficients": found[max(order, 0), 1], "image": images[1],
    }  # fmt: skip


# Maps


@eqx.filter_jit
def _emitters(brdf: LinearBRDF, points: jax.Array, height: int) -> jax.Array:
    """Radiance of points `(n, channels, pixels)` from each pixel of a map of radiance 1."""
    view = jnp.asarray(VIEW, points.dtype)
    black = jnp.zeros((height, 2 * height, 1), points.dtype)

    def of_point(normal):
        def radiance(image):
            return reflect(brdf, EnvironmentMap(image, up="y"), normal[None], view)[0]

        # It is linear in the light: its transpose, not a picture for each pixel of the map.
        rows = jax.vmap(jax.linear_transpose(radiance, black))(jnp.eye(brdf.channels, dtype=points.dtype))[0]
        return rows.reshape(brdf.channels, -1)

    return jax.lax.map(of_point, points)


def _recover_map(
    config: Config, rng: np.random.Generator, brdf: LinearBRDF, normals: np.ndarray, light: HarmonicLight
) -> dict[str, Any]:
    """A map under the prior exp(-∫|∇L|²/2τ²), its errors over the sphere and by order, next to those it predicts."""
    points = jnp.asarray(normals[_mask(normals)])
    clean, sigma, noise = _image(config, rng, brdf, points, light)
    data = clean + noise(1)[0]
    grid = EnvironmentMap(np.zeros((config.height, 2 * config.height, 3)), up="y")
    direction = grid.direction.reshape(-1, 3)
    solid = np.repeat(grid.solid_angle, 2 * config.height)
    truth = np.asarray(light(jnp.asarray(direction)), np.float64)
    basis = SphericalHarmonics(min(config.height // 2 - 1, max(config.series)))
    rows = np.asarray(basis(jnp.asarray(direction)), np.float64) * solid[:, None]
    rows = np.linalg.solve(rows.T @ (rows / solid[:, None]), rows.T)
    degree = np.array([n for n, _ in basis.modes])
    energy = gradient_energy(config.height, 2 * config.height) + FLAT * np.diag(solid)
    root = np.linalg.cholesky(energy).T

    design = np.asarray(_emitters(brdf, points, config.height), np.float64)
    solvers = [Tikhonov.of(design[:, channel], root) for channel in range(design.shape[1])]
    found, best, weights = np.zeros_like(truth), np.zeros_like(truth), []
    pixels, modes, misfit = 0.0, np.zeros(degree.size), 0.0
    for channel in range(3):
        own = min(channel, len(solvers) - 1)
        solver, image = solvers[own], data[:, channel]
        gcv = config.rule == "gcv"
        weight = solver.cross_validated(image) if gcv else solver.discrepancy(image, sigma)
        weights.append(weight / solver.squares[-1])
        found[:, channel] = solver.solution(image, weight)
        tried = solver.solution(image, solver.weights())
        least = np.argmin(solid @ (tried - truth[:, channel : channel + 1]) ** 2)
        best[:, channel] = tried[:, least]
        pixels += np.sum(solver.variance(np.diag(np.sqrt(solid)), weight, sigma))
        modes += solver.variance(rows, weight, sigma)
        misfit += np.mean((design[:, own] @ found[:, channel] - image) ** 2) / (3 * sigma**2)

    def relative(wrong, where=True):
        share = np.where(where, solid, 0)
        return float(np.sqrt(np.sum(share @ wrong**2) / np.sum(share @ truth**2)))

    def by_order(squares):
        return np.sqrt(np.bincount(degree, squares) / np.bincount(degree, np.sum((rows @ truth) ** 2, axis=1)))

    front = direction[:, 2] > 0
    return {
        "weight": float(np.exp(np.mean(np.log(weights)))), "misfit": float(misfit),
        "error": relative(found - truth), "predicted": float(np.sqrt(pixels / np.sum(solid @ truth**2))),
        "front": relative(found - truth, front), "behind": relative(found - truth, ~front),
        "best": relative(best - truth), "negative": float(solid @ np.mean(found < 0, axis=1) / (4 * np.pi)),
        "order errors": by_order(np.sum((rows @ (found - truth)) ** 2, axis=1)), "order predicted": by_order(modes),
        "map": found.reshape(grid.radiance.shape), "truth": truth.reshape(grid.radiance.shape),
    }  # fmt: skip


# The report


def _report_lamps(config: Config, record: Record, results: dict[tuple[str, str], dict[str, Any]]) -> None:
    rows = []
    for (surface, material), by_count in results.items():
        for count, result in by_count.items():
            least = result["losses"].min(axis=1, keepdims=True)
            found = result["losses"] < NEAR * least
            rows.append({
                "surface": surface, "BRDF": material, "lamps": int(count),
                "direction [deg], median": float(np.median(result["direction"])),
                "predicted [deg]": float(np.median(result["predicted direction"])),
                "worst [deg]": float(np.max(result["direction"])),
                "irradiance, median": float(np.median(result["irradiance"])),
                "predicted": float(np.median(result["predicted irradiance"])),
                "worst": float(np.max(result["irradiance"])),
                "random starts that found the best": float(np.mean(found[:, :-1])),
                "pursuits that did": float(np.mean(found[:, -1])),
                "sets missed": int(np.sum(least > MISSED)),
            })  # fmt: skip
    record.heading("Lamps")
    record.paragraph(
        "Lamps far away that burn at once, at random directions up to 100° from the eye's, each with an irradiance in "
        f"three channels, fitted by `hshjax.fit` to {config.pixels} pixels drawn by lot. Starts are {config.starts} "
        "random sets of directions, and one by pursuit: of "
        f"{config.candidates} directions the one whose lamp explains most of the image, then the next. An image is no "
        "linear function of the directions: the narrower the lobe, the nearer a start must be, and with several lamps "
        "one may come to stand for two."
    )
    record.table(
        "lamps", rows,
        f"Errors of the best start over all lamps of {config.trials} random sets; of irradiance relative, its channels "
        "together. Predicted: standard deviation by the slope of the image at the fit, median. Starts that found the "
        f"best: a loss within {NEAR - 1:.1%} of the least. Missed: sets whose least loss is above {MISSED:g} times "
        "that of noise alone.",
    )  # fmt: skip
    for count in dict.fromkeys(row["lamps"] for row in rows):
        own = [row for row in rows if row["lamps"] == count]
        for key, name, unit in (
            ("direction [deg], median", "direction", "deg"), ("irradiance, median", "irradiance", ""),
            ("random starts that found the best", "random starts that found the best", ""),
            ("pursuits that did", "pursuits that found the best", ""),
        ):  # fmt: skip
            record.metric(f"{count} lamps: {name}", np.median([row[key] for row in own]), unit, "median of the table")
        record.metric(f"{count} lamps: sets missed", sum(row["sets missed"] for row in own))


def _report_series(config: Config, record: Record, results: dict[tuple[str, str], dict[str, Any]]) -> None:
    summary, rows = [], []
    shown = (2, 4, 8)
    for (surface, material), result in results.items():
        order = result["determined"]
        at = max(order, 0)
        summary.append({
            "surface": surface, "BRDF": material, "determined up to order": order,
            "its error": float(result["error"][at]), "with what is left out": float(result["whole"][at]),
            "order of the least such error": int(np.argmin(result["whole"])),
            f"combinations of {result['unknowns'][-1]} determined": result["combinations"],
            **{f"condition, order {n}": float(result["condition"][n]) for n in shown if n < len(result["order"])},
            "unseen, largest order": int(result["unseen"][-1]),
        })  # fmt: skip
        rows += [
            {
                "surface": surface, "BRDF": material, "order": n,
                **{key: result[key][n] for key in ("unknowns", "unseen", "condition")},
                "noise, predicted": result["predicted"][n], "noise, measured": result["noise"][n],
                "aliased": result["aliased"][n], "error": result["error"][n], "left out": result["left out"][n],
            }
            for n in config.series
        ]  # fmt: skip
        record.metric(f"{surface} {material}: determined up to order", order)
        record.metric(f"{surface} {material}: error there", result["error"][at], note="relative to the light")
    record.heading("Series of spherical harmonics")
    record.paragraph(
        f"Light from all around: `{config.environment}` as a series of order {config.truth_order}. Series of lower "
        "order are fitted by linear least squares without any prior, so every fit meets orders that it does not have. "
        f"A fit is called determined where its noise, predicted by σ² tr (AᵀA)⁻¹, is below {config.tolerance:.0%} of "
        "the light's norm, in L2 over the sphere. Where A has no full rank the light of least norm is taken, and the "
        "prediction is infinite. A surface of Lambert does not see odd orders above 1 at all (7 of the 25 combinations "
        "up to order 4, 18 of 49 up to order 6), and hardly the even ones above 4; from one side only half of the "
        "normals are seen, so that even low orders are not told apart as well as by a whole sphere."
    )
    record.table(
        "determined", summary,
        "Errors are relative to the norm of the light, of three channels together. Determined combinations: singular "
        f"values above σ / ({config.tolerance:g} |light|), of the fit of order {max(config.series)}, in the worst "
        "channel; unseen: singular values that are zero to rounding.",
    )  # fmt: skip
    record.table(
        "series", rows,
        f"Every fit. Measured noise: of {config.draws} draws. Aliased: the error without noise, made by the orders "
        "that are not fitted. Error: of the coefficients that are fitted, noise and all. Left out: norm of the orders "
        "that are not. All relative to the norm of the light.",
    )  # fmt: skip


def _report_maps(config: Config, record: Record, results: dict[tuple[str, str], dict[str, Any]]) -> None:
    rows = [
        {
            "surface": surface, "BRDF": material, "error": result["error"], "predicted": result["predicted"],
            "in front": result["front"], "behind": result["behind"], "with the best weight": result["best"],
            "weight": result["weight"], "misfit": result["misfit"], "negative": result["negative"],
        }
        for (surface, material), result in results.items()
    ]  # fmt: skip
    for row in rows:
        record.metric(f"{row['surface']} {row['BRDF']}: error of the map", row["error"], note="relative")
    pixels = f"{2 * config.height} x {config.height}"
    rule = "generalised cross-validation" if config.rule == "gcv" else "the discrepancy principle"
    record.heading("Maps")
    record.paragraph(
        f"A map of {pixels} pixels from the same image, more unknowns than values: least |A x - b|² + λ ∫|∇L|² dω, the "
        f"gradient by finite volumes on the sphere, for each channel. λ is found by {rule}, without the truth; the "
        "table has the error with the best λ beside it, which nobody knows. The prediction takes the prior for the "
        "law that the light was drawn from. What no datum tells, the prior fills with what is smooth: it is no more "
        "than the mean of all lights that would look alike."
    )
    record.table(
        "maps", rows,
        "Relative errors in L2 over the sphere, in front of the object (from where the eye looks) and behind it. "
        "Misfit: mean square of the residual over the noise's variance. Weight: λ over the largest squared singular "
        "value. Negative: the share of the sphere where the map is below 0, which nothing forbids.",
    )  # fmt: skip


def _draw_lights(
    config: Config, surface: str, normals: np.ndarray, light: HarmonicLight, series: dict, maps: dict
) -> Any:
    directions = jnp.asarray(EnvironmentMap(np.zeros((32, 64, 3)), up="y").direction)

    def lat_long(coefficients):
        return np.asarray(HarmonicLight(jnp.asarray(coefficients))(directions))

    materials = list(dict.fromkeys(material for _, material in series))
    whole = lat_long(light.coefficients)
    factor = plotting.exposure(whole)
    figure, axes = plt.subplots(
        len(materials) + 1, 3, figsize=(6.4, 1.05 * (len(materials) + 1)), squeeze=False, layout="constrained",
        gridspec_kw={"width_ratios": (1.1, 2, 2)},
    )  # fmt: skip
    for ax in axes.ravel():
        ax.set(xticks=[], yticks=[], frame_on=False)
    largest = lat_long(light.coefficients[: (max(config.series) + 1) ** 2])
    panels = [("the light", None, "", largest, whole)]
    for material in materials:
        found = series[surface, material]
        image = np.full((*normals.shape[:2], 3), np.nan)
        image[_mask(normals)] = found["image"]
        order, of_series = f"[{found['determined']}]", lat_long(found["coefficients"])
        panels.append((material.replace("_", " "), image, order, of_series, maps[surface, material]["map"]))
    for (left, middle, right), (material, image, order, of_series, of_map) in zip(axes, panels, strict=True):
        left.set_ylabel(material, fontsize=7, rotation=0, ha="right")
        if image is not None:
            left.imshow(plotting.display(image, plotting.exposure(image)), interpolation="nearest")
        middle.set_ylabel(order, fontsize=7, rotation=0, ha="right")
        middle.imshow(plotting.display(of_series, factor), interpolation="nearest")
        right.imshow(plotting.display(of_map, factor), interpolation="nearest")
    for ax, title in zip(axes[0], (surface, "as a series", "as a map"), strict=True):
        ax.set_title(title, fontsize=8)
    return figure


def _draw_errors(config: Config, series: dict, maps: dict) -> Any:
    surfaces = list(dict.fromkeys(surface for surface, _ in series))
    figure, axes = plt.subplots(
        len(surfaces), 2, figsize=(9, 3.3 * len(surfaces)), squeeze=False, layout="constrained"
    )  # fmt: skip
    materials = list(dict.fromkeys(material for _, material in series))
    colours = [*plt.get_cmap("viridis")(np.linspace(0, 0.9, len(config.slopes))), "black", *OWN]
    for surface, (left, right) in zip(surfaces, axes, strict=True):
        for material, colour in zip(materials, itertools.cycle(colours), strict=False):
            found, mapped = series[surface, material], maps[surface, material]
            style = {"color": colour, "lw": 1.3, "label": material.replace("_", " ")}
            left.semilogy(found["order"], found["whole"], "-", **style)
            finite = np.isfinite(found["predicted"])
            left.semilogy(found["order"][finite], found["predicted"][finite], ".", color=colour, ms=4)
            right.semilogy(mapped["order errors"], "-", **style)
            right.semilogy(mapped["order predicted"], ":", color=colour, lw=1.3)
        left.semilogy(found["order"], found["left out"], color="0.6", lw=3, zorder=0)
        left.axhline(config.tolerance, color="0.5", ls="--", lw=0.8)
        left.set(title=f"{surface}: series up to an order", xlabel="order", ylabel="relative error", ylim=(3e-4, 30))
        right.set(title=f"{surface}: map, order by order", xlabel="order", ylim=(3e-3, 3))
        right.axhline(1, color="0.5", ls="--", lw=0.8)
        for ax in (left, right):
            plain(ax)
    axes[0, 1].legend(frameon=False, fontsize=7, ncols=2)
    return figure
