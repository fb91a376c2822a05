"""Pictures of materials as spheres, beside each other."""

from pathlib import Path
from typing import Any


def shown(data: Any, fitted: Any) -> list[Any]:
    """What spheres can show: scattered samples have no value everywhere."""
    from hshjax.samples import Samples

    return [fitted] if isinstance(data, Samples) else [data, fitted]


def save_spheres(path: Path, *brdfs: Any) -> None:
    """Spheres side by side, all exposed as the first one; of other than 1 or 3 channels the middle one, in grey."""
    import numpy as np

    from hshjax import plotting
    from hshjax.io._images import write_png

    images = [displayable(plotting.sphere(brdf)) for brdf in brdfs]
    shown = plotting.display(np.concatenate(images, axis=1), _exposure(images[0]))
    write_png(path, np.rint(255 * shown).astype(np.uint8))


def _exposure(image: Any) -> float:
    """`plotting.exposure`; by the brightest pixel where fewer than one in twenty have light, 1 for a black sphere: a
    picture is no reason to lose a fit."""
    import numpy as np

    from hshjax import plotting

    for quantile in (0.95, 1.0):
        if np.quantile(image[~np.isnan(image).any(axis=-1)].max(axis=-1), quantile) > 0:
            return plotting.exposure(image, quantile)
    return 1.0


def displayable(image: Any) -> Any:
    """An image of 1 or 3 channels: of another number the middle one."""
    middle = image.shape[-1] // 2
    return image if image.shape[-1] in (1, 3) else image[..., middle : middle + 1]
