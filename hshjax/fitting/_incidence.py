"""Rules over the direction of incidence, for one direction of exit after another. On the host, in float64.

Two ways to cover what is incident. By its own angles: for functions that are smooth in wi. By half vectors: nodes are
dense where wi and wo mirror each other, so that a highlight costs the same whatever its width. For an eye at polar
angle θ_o and half vectors at azimuth φ from it, light comes from above a cone z_i > low as long as

    θ_h < [δ + arccos(low / r)] / 2,   r = |(cos θ_o, sin θ_o cos φ)|,   δ the polar angle of that pair:

nodes fill that range, and no integrand is cut off between them.
"""

from typing import Literal, NamedTuple

import numpy as np

Way = Literal["directions", "half vectors"]
WAYS: tuple[Way, ...] = ("directions", "half vectors")


class Nodes(NamedTuple):
    """Of a product rule: φ [radians], the fraction x of the range of the other variable, and weights dφ dx; `(n,)`."""

    phi: np.ndarray
    x: np.ndarray
    weight: np.ndarray


def incidence_nodes(way: Way, degree: int) -> Nodes:
    """2 degree x 2 degree nodes: equispaced in φ, Gauss in a variable u that x is a polynomial of."""
    # A quarter of a step off the mirror plane: of a bilateral function no node sees what another one has seen.
    phi = 2 * np.pi * (np.arange(2 * degree) + 0.25) / (2 * degree)
    u, weight = np.polynomial.legendre.leggauss(2 * degree)
    u, weight = (u + 1) / 2, weight / 2
    if way == "directions":  # square roots of z_i are polynomials in u
        x, slope = u**2, 2 * u
    else:  # u³ towards the highlight, (1 - u)² towards the horizon, where z_i is proportional to 1 - x
        x, slope = u**3 * (4 - 3 * u), 12 * u**2 * (1 - u)
    return Nodes(
        np.tile(phi, u.size), np.repeat(x, phi.size), np.repeat(weight * slope * 2 * np.pi / phi.size, phi.size)
    )


def exit_nodes(degree: int, azimuths: int, low: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """z_o above `low`, φ_o, and weights dω_o, `(n,)`: Gauss in v, z_o = low + (1 - low) v², by equispaced φ."""
    v, weight = np.polynomial.legendre.leggauss(degree)
    v, weight = (v + 1) / 2, weight / 2
    phi = 2 * np.pi * np.arange(azimuths) / azimuths
    weight = (1 - low) * 2 * v * weight * 2 * np.pi / azimuths
    return np.repeat(low + (1 - low) * v**2, azimuths), np.tile(phi, degree), np.repeat(weight, azimuths)


def incident(
    way: Way, cosine: np.ndarray, turn: np.ndarray, nodes: Nodes, low: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """wi `(exits, nodes, 3)`, wo `(exits, 3)` of those cosines and azimuths, and weights dω_i `(exits, nodes)`."""
    z, sine = cosine[:, None], np.sqrt((1 - cosine) * (1 + cosine))[:, None]
    cos, sin = np.cos(nodes.phi), np.sin(nodes.phi)
    if way == "directions":
        up = np.broadcast_to(low + (1 - low) * nodes.x, (cosine.size, nodes.x.size))
        rim = np.sqrt((1 - up) * (1 + up))
        wi, measure = (rim * cos, rim * sin, up), np.full_like(up, 1 - low)
    else:
        tilt = sine * cos
        largest = (np.arctan2(tilt, z) + np.arccos(low / np.hypot(z, tilt))) / 2
        theta = largest * nodes.x
        rim, up = np.sin(theta), np.cos(theta)
        facing = tilt * rim + z * up
        wi = (2 * facing * rim * cos - sine, 2 * facing * rim * sin, 2 * facing * up - z)
        measure = largest * rim * 4 * facing  # dω_i = 4 cos θ_d dω_h
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = np.stack([cos * wi[0] - sin * wi[1], sin * wi[0] + cos * wi[1], wi[2]], axis=-1)
    wo = np.stack([(sine * cos)[:, 0], (sine * sin)[:, 0], cosine], axis=-1)
    return turned, wo, measure * nodes.weight
