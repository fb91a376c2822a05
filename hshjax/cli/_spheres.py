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
    shown = plotting.display(np.concatenate(images, axis=1), plotting.exposure(images[0]))
    write_png(path, np.rint(255 * shown).astype(np.uint8))


def displayable(image: Any) -> Any:
    """An image of 1 or 3 channels: of another number the middle one."""
    middle = image.shape[-1] // 2
    return image if image.shape[-1] in (1, 3) else image[..., middle : middle + 1]
