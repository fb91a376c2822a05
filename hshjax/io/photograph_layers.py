"""Photographs in one OpenEXR image with a layer a light, and a light file beside it."""

from os import PathLike
from pathlib import Path

import numpy as np

from hshjax.io._images import read_mask
from hshjax.io._photographs import assemble, make_lights
from hshjax.io.errors import FileFormatError
from hshjax.io.exr import COLOUR_ORDER, exr_channels, read_exr
from hshjax.io.light_positions import MASK, read_light_positions
from hshjax.photographs import Photographs


def read_photograph_layers(path: str | PathLike, *, near: float | None = None) -> Photographs:
    """Photographs of `NAME.exr`, whose lights stand in `NAME.lp` (`read_light_positions`): there, names are layers.

    Layer `a` is the channel `a`, or the channels `a.R`, `a.G` and `a.B`. `mask.png` in the same folder says which
    pixels see the object; without it all do. `near` as in `read_photograph_folder`.

    **Raises:** FileFormatError where layers and light file disagree, or a file is damaged; OSError where one of the two
    cannot be opened.
    """
    path = Path(path)
    light_file, mask_file = path.with_suffix(".lp"), path.with_name(MASK)
    names, vectors = read_light_positions(light_file)
    channels = exr_channels(path)
    layers = [_layer(path, name, channels) for name in names]
    used = {channel for layer in layers for channel in layer}
    lights, notes = make_lights(light_file, vectors, near=near)
    notes.insert(0, f"Light file {light_file.name}: {len(names)} layers of {path.name}.")
    others = [channel for channel in channels if channel not in used]
    if others:
        notes.append(f"{len(others)} channels are not in the light file and are left out: {', '.join(others[:3])}.")
    mask = read_mask(mask_file) if mask_file.exists() else None
    if mask is None:
        notes.append(f"No {MASK}: every pixel is taken to see the object.")
    # One decoding for all: the library decodes whole files.
    pixels = read_exr(path, [channel for layer in layers for channel in layer])
    ends = np.cumsum([len(layer) for layer in layers])
    return assemble(
        zip((f"{path}: layer {name!r}" for name in names), np.split(pixels, ends[:-1], axis=-1), strict=True),
        len(names),
        lights=lights,
        mask=mask,
        mask_file=mask_file,
        notes=notes,
    )


def _layer(path: Path, name: str, channels: tuple[str, ...]) -> list[str]:
    colours = [f"{name}.{colour}" for colour in COLOUR_ORDER[:3]]
    if name in channels:
        return [name]
    if set(colours) <= set(channels):
        return colours
    raise FileFormatError(path, f"layer {name!r}", f"the channel {name}, or {', '.join(colours)}", ", ".join(channels))
