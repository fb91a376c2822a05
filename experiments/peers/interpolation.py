"""How Mitsuba's `envmap` interpolates, in NumPy: so that both sides of a comparison see the same light.

Like `hshjax.EnvironmentMap(image, up="y")`, columns run from -z over +x, centres at half pixels, and wrap around. But
rows are stretched: the first and the last lie AT the poles, row i at polar angle π i / (height - 1), where ours lie
half a pixel from them, π (i + 1/2) / height. So one image is another light in each, not only between pixels.
"""

import numpy as np


def mitsuba_radiance(image: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Radiance `(*batch, channels)` that comes from unit directions `(*batch, 3)` under an image `(height, width,
    channels)`, in float64; bilinear, +y up. Mitsuba 3.9.1 gives this to float32 rounding of the position in the image.
    """
    image, w = np.asarray(image, np.float64), np.asarray(w, np.float64)
    height, width, _ = image.shape
    row = np.arctan2(np.hypot(w[..., 0], w[..., 2]), w[..., 1]) / np.pi * (height - 1)
    column = np.arctan2(w[..., 0], -w[..., 2]) / (2 * np.pi) * width - 0.5
    top, left = np.clip(np.floor(row).astype(int), 0, height - 2), np.floor(column).astype(int)
    down, over = (row - top)[..., None], (column - left)[..., None]

    def along(i):
        return (1 - over) * image[i, left % width] + over * image[i, (left + 1) % width]

    return (1 - down) * along(top) + down * along(top + 1)


def refined(image: np.ndarray, factor: int) -> np.ndarray:
    """Mitsuba's light for `hshjax.EnvironmentMap(..., up="y")`, `((height - 1) factor, width factor, channels)`.

    Its values at the centres of that map's pixels. With an even factor no edge of Mitsuba's bilinear patches runs
    through a pixel, so that the map's sum converges as 1 / factor².
    """
    height, width, channels = image.shape
    rows, columns = (height - 1) * factor, width * factor
    theta = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2 * np.pi * (np.arange(columns) + 0.5) / columns
    x, z = np.sin(theta)[:, None] * np.sin(turn), -np.sin(theta)[:, None] * np.cos(turn)
    y = np.broadcast_to(np.cos(theta)[:, None], x.shape)
    return mitsuba_radiance(image, np.stack([x, y, z], -1)).reshape(rows, columns, channels)
