"""The scenes of `_stereo_scenes` by Mitsuba's path tracer: with light from one part of a surface to another."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments import peers
from experiments.recipes._stereo_lights import directional
from experiments.recipes._stereo_materials import Material
from experiments.recipes._stereo_meshes import Shape, seen
from experiments.recipes._stereo_scenes import parts
from hshjax import DirectionalLight
from hshjax.photographs import Photographs

NAMES = (
    "bowl/lambert",
    "grooves/lambert",
    "corner/glossy:0.4",
    "vase/glossy:0.2",
    "folds/glossy:0.3",
    "pillars/lambert",
)
"""Scenes that need no data."""


def mitsuba_scenes(
    names: Sequence[str] = NAMES,
    *,
    size: int = 96,
    lights: int | DirectionalLight = 32,
    layout: str = "patch",
    spread: float = 0.0,
    seed: int = 0,
    depth: int = 8,
    spp: int = 256,
    folder: Path | None = None,
    variant: str = "llvm_ad_rgb",
) -> dict[str, Photographs]:
    """Photographs by name, as `_stereo_scenes.scenes` takes names, sizes, lights and seeds; of one material each.

    - `depth`: surfaces and lights that a path meets; 2 is direct light, without chance.
    - `spp`: samples a value; 256 for 96 x 96 x 32 values take half a minute on two cores.
    - `folder`: where results are kept and looked for; None: nowhere. - `variant`: of Mitsuba; `scalar_rgb`, which needs
      no LLVM, is a hundred times as slow.

    **Raises:** ValueError for unknown names and materials that Mitsuba cannot be told of; `peers.PeerUnavailableError`
    where Mitsuba cannot be had.
    """
    chosen = directional(lights, layout, spread, seed) if isinstance(lights, int) else lights
    return {
        name: traced(
            *parts(name, seed), chosen, size=size, seed=seed, depth=depth, spp=spp, folder=folder, variant=variant,
            note=name,
        )[0]
        for name in names
    }  # fmt: skip


def traced(
    shape: Shape,
    material: Material,
    lights: DirectionalLight,
    *,
    size: int = 96,
    seed: int = 0,
    depth: int = 8,
    spp: int = 256,
    folder: Path | None = None,
    variant: str = "llvm_ad_rgb",
    note: str = "",
) -> tuple[Photographs, np.ndarray]:
    """Photographs, and the standard error of every value `(pixels, lights, 3)`; 0 for direct light.

    The mask is that of `_stereo_scenes.photographs`, the true normals are those that Mitsuba shades with.
    """
    if material.mitsuba is None:
        raise ValueError(f"Mitsuba cannot be told of the material of {note or 'this scene'}")
    mask, _, position = seen(shape, size)
    inputs = material.mitsuba | {
        "variant": variant, "depth": depth, "spp": 1 if depth <= 2 else spp, "seed": seed,
        "vertices": shape.vertices, "normals": shape.normals, "faces": shape.faces, "points": position[:, :2],
        "directions": np.asarray(lights.direction, np.float64), "irradiance": _three(lights),
    }  # fmt: skip
    found = _answer(inputs, folder)
    notes = (f"synthetic, {note}: Mitsuba {_version()}, paths of depth {depth}, {inputs['spp']} samples a value",)
    values, normal = found["mean"].astype(np.float32), found["normal"].astype(np.float64)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Photographs(values, mask, lights, None, normal, notes), found["error"]


def _answer(inputs: dict[str, Any], folder: Path | None) -> dict[str, np.ndarray]:
    """What Mitsuba says, or said when it was asked before."""
    if folder is None:
        return _ask(inputs)
    digest = hashlib.sha256(_version().encode())
    for key, value in sorted(inputs.items()):
        array = np.asarray(value)
        digest.update(f"{key} {array.dtype} {array.shape}".encode() + array.tobytes())
    kept = folder / f"mitsuba-{digest.hexdigest()[:16]}.npz"
    if not kept.exists():
        folder.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part.npz")
        np.savez(part, **_ask(inputs))
        part.replace(kept)
    with np.load(kept) as file:
        return {key: file[key] for key in file.files}


def _ask(inputs: dict[str, Any]) -> dict[str, np.ndarray]:
    return peers.run("mitsuba", "mitsuba_photographs", inputs, llvm=inputs["variant"].startswith("llvm"))


def _three(lights: DirectionalLight) -> np.ndarray:
    """Irradiances `(lights, 3)`."""
    irradiance = np.asarray(lights.irradiance, np.float64)
    return np.broadcast_to(irradiance if irradiance.ndim == 2 else irradiance[:, None], (len(irradiance), 3))


def _version() -> str:
    return peers.PEERS["mitsuba"][0].partition("==")[2]
