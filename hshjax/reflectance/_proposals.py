"""Densities to draw incident directions from, in the local frames of points `(n, ...)`."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hshjax._typing import Array, Float, Real
from hshjax.geometry import dot, half_vector, to_local, to_world, upper
from hshjax.lighting import EnvironmentMap


class AbstractProposal(eqx.Module):
    """A density of incident directions, for points that are seen from `wo` and whose frames are `turn`."""

    @abc.abstractmethod
    def draw(self, key: Array, wo: Float[Array, "n 3"], turn: Float[Array, "n 3 3"]) -> Float[Array, "n 3"]:
        """A direction for each point; it may lie below the horizon."""

    @abc.abstractmethod
    def density(self, wi: Float[Array, "n k 3"], wo: Float[Array, "n 3"], turn: Float[Array, "n 3 3"]) -> Real:
        """The density [sr^-1] of directions above the horizon, `(n, k)`."""


class CosineProposal(AbstractProposal):
    """z / π."""

    def draw(self, key, wo, turn):
        square, phi = _two(key, wo)
        return _about_the_normal(jnp.sqrt(1 - square), phi)

    def density(self, wi, wo, turn):
        return upper(wi[..., 2]) / np.pi


class LobeProposal(AbstractProposal):
    """Mirror directions of `wo` about facets that are distributed like D z_h of GGX.

    Source: Walter et al., Microfacet Models for Refraction through Rough Surfaces (2007), eqs. 33 to 39.
    """

    roughness: Float[Array, ""]

    def draw(self, key, wo, turn):
        u, phi = _two(key, wo)
        square = self.roughness.astype(wo.dtype) ** 2
        h = _about_the_normal(jnp.sqrt((1 - u) / (1 + (square - 1) * u)), phi)
        return 2 * dot(h, wo)[:, None] * h - wo

    def density(self, wi, wo, turn):
        wo = jnp.broadcast_to(wo[:, None], wi.shape)
        h = half_vector(wi, wo)
        square = self.roughness.astype(wo.dtype) ** 2
        z = h[..., 2]
        facets = square * upper(z) / (np.pi * (1 + (square - 1) * z * z) ** 2)
        return facets / (4 * dot(h, wo))


class MapProposal(AbstractProposal):
    """The pixels of an environment map by their power, evenly within a pixel."""

    environment: EnvironmentMap

    @property
    def share(self) -> Float[Array, "height width"]:
        """Of the power of all pixels, each the mean of what is bilinear in it."""
        radiance = jnp.sum(jnp.abs(self.environment.radiance), axis=-1)
        rows = jnp.pad(radiance, ((1, 1), (0, 0)), mode="edge")
        mean = 0.75 * radiance + 0.125 * (rows[:-2] + rows[2:])
        mean = 0.75 * mean + 0.125 * (jnp.roll(mean, 1, axis=1) + jnp.roll(mean, -1, axis=1))
        power = mean * jnp.asarray(self.environment.solid_angle, radiance.dtype)[:, None]
        total = jnp.sum(power)
        return jnp.where(total > 0, power / jnp.where(total > 0, total, 1), 1 / power.size)

    def draw(self, key, wo, turn):
        height, width, _ = self.environment.radiance.shape
        which, within = jax.random.split(key)
        index = jax.random.choice(which, height * width, (wo.shape[0],), p=self.share.ravel())
        down, over = jax.random.uniform(within, (2, wo.shape[0]), wo.dtype)
        edges = jnp.asarray(np.cos(np.pi * np.arange(height + 1) / height), wo.dtype)
        row = index // width
        above = edges[row] + down * (edges[row + 1] - edges[row])
        column = (index % width).astype(wo.dtype) + over
        w = self.environment.towards(jnp.arccos(above), 2 * np.pi * column / width)
        return to_local(turn, w)

    def density(self, wi, wo, turn):
        height, width, _ = self.environment.radiance.shape
        w = to_world(turn[:, None], wi)
        theta, around = self.environment.polar(w)
        row = jnp.minimum((theta / np.pi * height).astype(int), height - 1)
        column = jnp.minimum((around / (2 * np.pi) * width).astype(int), width - 1)
        omega = jnp.asarray(self.environment.solid_angle, wi.dtype)
        return (self.share.astype(wi.dtype)[row, column]) / omega[row]


def _two(key: Array, like: Float[Array, "n 3"]) -> tuple[Array, Array]:
    """A number in [0, 1) and an azimuth for each point."""
    u = jax.random.uniform(key, (2, like.shape[0]), like.dtype)
    return u[0], 2 * np.pi * u[1]


def _about_the_normal(z: Float[Array, " n"], phi: Float[Array, " n"]) -> Float[Array, "n 3"]:
    rim = jnp.sqrt(upper((1 - z) * (1 + z)))
    return jnp.stack([rim * jnp.cos(phi), rim * jnp.sin(phi), z], axis=-1)
