"""Published networks that stand in for databases of measured materials (Neural-BRDF: Sztrajman, Rainer, Ritschel,
Weyrich, Computer Graphics Forum 40(4), 2021): 675 weights each, smooth fits of the measurements, not these."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array


def read_surrogates(path: Path) -> dict[str, "Surrogate"]:
    """The networks of a file, by material."""
    with np.load(path) as file:
        layers = [(file[f"layer{k}_kernel"], file[f"layer{k}_bias"]) for k in (1, 2, 3)]
        return {
            str(name): Surrogate([(kernel[i], bias[i]) for kernel, bias in layers])
            for i, name in enumerate(file["names"])
        }


class Surrogate:
    """ρ(wi, wo) [sr^-1], RGB: exp(network) - 1 of the half vector, turned to φ_h = 0, and the difference vector.

    In the dtype of the directions.
    """

    def __init__(self, layers: list[tuple[np.ndarray, np.ndarray]]):
        self.layers = [(jnp.asarray(kernel, float), jnp.asarray(bias, float)) for kernel, bias in layers]

    def __call__(self, wi: Array, wo: Array) -> Array:
        return _evaluate(self.layers, wi, wo)


@jax.jit
def _evaluate(layers, wi, wo):
    x = _rusinkiewicz(wi, wo)
    for k, (kernel, bias) in enumerate(layers):
        x = x @ kernel.astype(x.dtype)
        x = x + jnp.broadcast_to(bias.astype(x.dtype), x.shape)
        if k < len(layers) - 1:
            x = jax.nn.relu(x)
    return jnp.expm1(x)


def _rusinkiewicz(wi: Array, wo: Array) -> Array:
    """(h, d) `(*batch, 6)`: h with φ_h = 0, d the incident direction in the frame in which h is the pole.

    Source: Rusinkiewicz, A New Change of Variables for Efficient BRDF Representation, EGWR 1998.
    """
    h = wi + wo
    h = h / jnp.linalg.norm(h, axis=-1, keepdims=True)
    rim = jnp.hypot(h[..., 0], h[..., 1])
    cosine, sine = (jnp.where(rim > 0, h[..., k] / jnp.where(rim > 0, rim, 1), 1 - k) for k in (0, 1))
    # wi turned by -φ_h about the normal, then by -θ_h about y.
    x, y = cosine * wi[..., 0] + sine * wi[..., 1], cosine * wi[..., 1] - sine * wi[..., 0]
    z = wi[..., 2]
    d = [h[..., 2] * x - rim * z, y, rim * x + h[..., 2] * z]
    return jnp.stack([rim, jnp.zeros_like(rim), h[..., 2], *d], axis=-1)
