"""A ball under lights nearby, wherever camera and world are turned."""

import jax
import jax.numpy as jnp
import numpy as np

import hshjax
from hshjax.photographs import Photographs
from hshjax.stereo import angular_errors
from tests.stereo.cases import directions

SIZE, LIGHTS = 20, 12
EYE = 5.0
PLASTIC = hshjax.Lambert(0.6) + hshjax.GGX(0.08, 0.35)
QUICK = {"pixels": 200, "rounds": 4, "sweeps": 1}


def camera(eye=None, world=None, scale=1.0, aim=0.0, size=SIZE):
    """Sees [-1, 1]² of the plane z = 0, from a distance or (None) from far away, and aims at z = `aim`; all turned by
    a rotation `world`."""
    axes = scale * (np.eye(3) if world is None else world)
    up, along = axes[:, 1], axes[:, 2]
    if eye is None:
        return hshjax.OrthographicCamera(along, up, centre=aim * along, height=2.05 * scale, resolution=(size, size))
    angle = 2 * np.arctan(1.025 / eye)
    return hshjax.PerspectiveCamera(eye * along, aim * along, up, field_of_view=angle, resolution=(size, size))


def ball(distance, eye=None, *, brdf=PLASTIC, world=None, scale=1.0, strength=1.0, size=SIZE, aim=None) -> Photographs:
    """The sphere of radius `scale` about the origin, its true normals with it. `distance` of lights from the origin;
    None: far away. `aim`: what the camera says of the mean depth; None: the truth."""
    seen = hshjax.sphere(camera(eye, world, scale, size=size), radius=scale)
    mask = np.asarray(jnp.any(seen.normal != 0, axis=-1))
    normals, positions = seen.normal[mask].astype(jnp.float32), seen.position[mask].astype(jnp.float32)
    vectors = directions(LIGHTS) if world is None else directions(LIGHTS) @ np.asarray(world, np.float32).T
    strength = np.broadcast_to(np.asarray(strength, np.float32), (LIGHTS,))
    if distance is None:
        lights = jax.vmap(hshjax.DirectionalLight)(jnp.asarray(vectors), jnp.asarray(strength))
    else:
        radius = np.float32(scale * distance)
        lights = jax.vmap(hshjax.PointLight)(jnp.asarray(radius * vectors), jnp.asarray(radius**2 * strength))
    view = camera(eye, world, scale, size=size)

    def image(light):
        return hshjax.reflect(brdf, light, normals, view, positions=positions)

    values = np.moveaxis(np.asarray(jax.vmap(image)(lights), np.float32), 0, 1)
    along = (np.eye(3) if world is None else world)[:, 2]
    height = np.asarray(positions, float) @ along / scale
    if aim is None:
        aim = height.mean() if eye is None else eye - np.exp(np.log(eye - height).mean())
    return Photographs(values, mask, lights, camera(eye, world, scale, aim, size), np.asarray(normals))


def places(photographs, eye=None):
    """Where the pixels see the ball, untouched by how the world is turned or scaled."""
    return np.asarray(hshjax.sphere(camera(eye)).position)[photographs.mask]


def mean_error(found, photographs):
    return np.nanmean(angular_errors(found.normals, photographs.truth))


def rotation(seed=0):
    """Of the world, at random."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)
