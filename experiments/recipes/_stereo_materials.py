"""Materials of known reflectance for synthetic photometric stereo: sums of BRDFs whose shares may vary over a surface.

`material("kind")` or `material("kind:argument")`:

| kind | is |
|---|---|
| `lambert` | one colour |
| `glossy:0.2` | Lambert and a GGX lobe of that roughness |
| `metal:0.3` | the lobe alone |
| `cook_torrance:0.25` | Lambert and a Beckmann lobe of that slope |
| `textured`, `textured:0.2` | Lambert of many colours, smooth and in patches; under a lobe |
| `two:0.2` | one part is `lambert`, the other `glossy` |
| `rgl:paper_white` | compact fit of a measured file of `$HSHJAX_DATA/rgl` |
| `table:paper_white` | that file itself, as Mitsuba evaluates it |
| `merl:gold-paint` | compact fit of a network of `$HSHJAX_DATA/merl_surrogate` |

A table has no one value where the eye is exactly on the normal (flat parts of reliefs): of satin_rosaline, values there
change by some percent with the azimuth of a tangent that is anybody's choice. Fits do not have that.
"""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import hshjax
from experiments.config import local_path
from experiments.recipes._material import Exchanged
from experiments.recipes._surrogate import read_surrogates
from hshjax._typing import PairFunction
from hshjax.io import read_rgl

BODY = np.array([0.6, 0.5, 0.4])
"""Albedo of body colours."""

GLOSS = 0.3
"""Of what falls on a glossy material, its lobe's share; the rest meets the body."""

Share = Callable[[np.ndarray, np.random.Generator], np.ndarray]
"""Positions `(n, 3)` -> factors `(n, 1)` or `(n, channels)`."""


class Layer(NamedTuple):
    """A BRDF times a share that varies with position; None: the same everywhere, 1."""

    brdf: PairFunction
    share: Share | None = None


class Material(NamedTuple):
    """The sum of layers; `mitsuba`: what tells `experiments/peers/mitsuba_scenes.py` of it, None where it cannot be."""

    layers: tuple[Layer, ...]
    mitsuba: dict[str, Any] | None = None


def material(name: str) -> Material:
    """A material by its name, see above.

    **Raises:** ValueError for an unknown name, and where the data are missing.
    """
    kind, _, argument = name.partition(":")
    if kind not in KINDS:
        raise ValueError(f"the kind of a material must be one of {', '.join(KINDS)}, got {name!r}")
    return KINDS[kind](argument)


def _lambert(argument: str) -> Material:
    if argument:
        raise ValueError(f"lambert takes no argument, got {argument!r}")
    return Material((Layer(hshjax.Lambert(BODY)),), {"bsdf": "lambert", "reflectance": BODY})


def _glossy(argument: str) -> Material:
    alpha = _number(argument, 0.2)
    brdf = hshjax.Lambert((1 - GLOSS) * BODY) + hshjax.GGX(GLOSS, alpha)
    mitsuba = {"bsdf": "glossy", "reflectance": BODY, "alpha": alpha, "share": GLOSS}
    return Material((Layer(brdf),), mitsuba)


def _metal(argument: str) -> Material:
    alpha = _number(argument, 0.3)
    return Material((Layer(hshjax.GGX(np.ones(3), alpha)),), {"bsdf": "ggx", "alpha": alpha})


def _cook_torrance(argument: str) -> Material:
    brdf = hshjax.CookTorrance(diffuse=(1 - GLOSS) * BODY, specular=GLOSS, slope=_number(argument, 0.25))
    return Material((Layer(brdf),))


def _textured(argument: str) -> Material:
    if not argument:
        return Material((Layer(hshjax.Lambert(np.ones(3)), _colours),))
    body = Layer(hshjax.Lambert(np.full(3, 1 - GLOSS)), _colours)
    return Material((body, Layer(hshjax.GGX(GLOSS, _number(argument, 0.2)))))


def _two(argument: str) -> Material:
    (matte,), (glossy,) = material("lambert").layers, material(f"glossy:{argument}").layers
    return Material(
        (
            Layer(matte.brdf, lambda p, rng: 1.0 - (_waves(p, rng, 1) > 0)),
            Layer(glossy.brdf, lambda p, rng: 1.0 * (_waves(p, rng, 1) > 0)),
        )
    )


def _rgl(argument: str) -> Material:
    return Material((Layer(_compact(_file(argument), None)),))


def _table(argument: str) -> Material:
    path = _file(argument)
    return Material((Layer(Exchanged(read_rgl(path))),), {"bsdf": "measured", "path": str(path.absolute())})


def _merl(argument: str) -> Material:
    return Material((Layer(_compact(local_path("$HSHJAX_DATA/merl_surrogate/merl_surrogate.npz"), argument)),))


KINDS: dict[str, Callable[[str], Material]] = {
    "lambert": _lambert, "glossy": _glossy, "metal": _metal, "cook_torrance": _cook_torrance, "textured": _textured,
    "two": _two, "rgl": _rgl, "table": _table, "merl": _merl,
}  # fmt: skip


def _number(text: str, default: float) -> float:
    return float(text) if text else default


def _file(name: str) -> Path:
    """An RGL file by its name, which may leave out what follows: `paper_white`, `satin_rosaline`, `napoli`."""
    files = [path for path in sorted(local_path("$HSHJAX_DATA/rgl").glob("*.bsdf")) if name in path.stem]
    if not name or len(files) != 1:
        raise ValueError(f"{name!r} names {len(files)} files of $HSHJAX_DATA/rgl, it must be one")
    return files[0]


@lru_cache(maxsize=32)
def _compact(path: Path, name: str | None) -> PairFunction:
    """The fit in 150 numbers: of a measured file, or of one of a file of networks."""
    if name is None:
        return hshjax.fit_compact(read_rgl(path)).model
    networks = read_surrogates(path)
    if name not in networks:
        raise ValueError(f"no {name!r} in {path.name}; there are {', '.join(networks)}")
    return hshjax.fit_compact(networks[name]).model


def _waves(position: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Smooth random functions of position, about 0 and with a size of 1: `(n, count)`."""
    frequency, phase = rng.normal(size=(3, 4 * count)) * 3.0, rng.uniform(0, 2 * np.pi, 4 * count)
    waves = np.sin(position @ frequency + phase)
    return waves.reshape(len(position), count, 4).sum(-1) / np.sqrt(2)


def _colours(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Albedos in [0.15, 0.9] `(n, 3)`: smooth changes times patches with sharp borders."""
    smooth = 0.6 + 0.3 * np.tanh(_waves(position, rng, 3))
    return np.where(_waves(position, rng, 3) > 0.4, 0.5, 1.0) * smooth
