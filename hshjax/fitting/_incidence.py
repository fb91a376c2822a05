"""Rules over the direction of incidence, for one direction of exit after another. On the host, in float64.

Two ways to cover what is incident. By its own angles: for functions that are smooth in wi. By lobes: nodes are dense
where wi and wo mirror each other, and where wi = wo, so that a highlight costs the same whatever its width, and so does
a lobe back to the light. The two places have a chart each, polar coordinates of the half vector about the normal and of
wi about wo, and smooth weights that sum to 1 share out the pairs between them. For an eye at polar angle θ_o, a chart's
azimuth φ and γ = 2 θ_h or the angle between wi and wo, light comes from above a cone z_i > low as long as

    γ < δ + arccos(low / r),   r = |(cos θ_o, sin θ_o cos φ)|,   δ the polar angle of that pair:

nodes fill that range, and no integrand is cut off between them.
"""

from typing import Literal, NamedTuple

import numpy as np

Way = Literal["directions", "lobes"]
Chart = Literal["directions", "half vectors", "about wo"]
WAYS: dict[Way, tuple[Chart, ...]] = {"directions": ("directions",), "lobes": ("half vectors", "about wo")}
"""The charts that cover the hemisphere together."""


class Nodes(NamedTuple):
    """Of a product rule: φ [radians], the fraction x of the range of the other variable, and weights dφ dx; `(n,)`."""

    phi: np.ndarray
    x: np.ndarray
    weight: np.ndarray


def incidence_nodes(chart: Chart, degree: int) -> Nodes:
    """2 degree x 2 degree nodes: Gauss in a variable u that x is a polynomial of, by equispaced φ or t.

    Of lobes the range jumps where cos φ = 0, in the limit of grazing exits. Either half of the circle has nodes of its
    own, equispaced in a t that makes the integrand vanish at both ends, with two derivatives.
    """
    u, weight = np.polynomial.legendre.leggauss(2 * degree)
    u, weight = (u + 1) / 2, weight / 2
    # A quarter of a step off the mirror plane: of a bilateral function no node sees what another one has seen.
    if chart == "directions":  # square roots of z_i are polynomials in u
        x, slope = u**2, 2 * u
        phi = 2 * np.pi * (np.arange(2 * degree) + 0.25) / (2 * degree)
        turn = np.full(phi.size, np.pi / degree)
    else:  # u³ towards the lobe, (1 - u)² towards the horizon, where z_i is proportional to 1 - x
        x, slope = u**3 * (4 - 3 * u), 12 * u**2 * (1 - u)
        t = (np.arange(degree) + 0.25) / degree
        half = np.pi * (t**3 * (10 - 15 * t + 6 * t**2) - 0.5)
        phi, turn = np.r_[half, half + np.pi], np.tile(np.pi * 30 * (t * (1 - t)) ** 2 / degree, 2)
    return Nodes(np.tile(phi, u.size), np.repeat(x, phi.size), np.outer(weight * slope, turn).ravel())


def exit_nodes(degree: int, azimuths: int, low: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """z_o above `low`, φ_o, and weights dω_o, `(n,)`: Gauss in v, z_o = low + (1 - low) v², by equispaced φ."""
    v, weight = np.polynomial.legendre.leggauss(degree)
    v, weight = (v + 1) / 2, weight / 2
    phi = 2 * np.pi * np.arange(azimuths) / azimuths
    weight = (1 - low) * 2 * v * weight * 2 * np.pi / azimuths
    return np.repeat(low + (1 - low) * v**2, azimuths), np.tile(phi, degree), np.repeat(weight, azimuths)


def incident(
    chart: Chart, cosine: np.ndarray, turn: np.ndarray, nodes: Nodes, low: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """wi `(exits, nodes, 3)`, wo `(exits, 3)` of those cosines and azimuths, and weights dω_i `(exits, nodes)`.

    Weights are those of the chart's share of the pairs: they sum to dω_i over the charts of a way.
    """
    z, sine = cosine[:, None], np.sqrt((1 - cosine) * (1 + cosine))[:, None]
    cos, sin = np.cos(nodes.phi), np.sin(nodes.phi)
    if chart == "directions":
        up = np.broadcast_to(low + (1 - low) * nodes.x, (cosine.size, nodes.x.size))
        rim = np.sqrt((1 - up) * (1 + up))
        wi, measure = np.stack([rim * cos, rim * sin, up], axis=-1), np.full_like(up, 1 - low)
    else:
        tilt = sine * cos
        largest = np.arctan2(tilt, z) + np.arccos(low / np.hypot(z, tilt))
        if chart == "half vectors":
            theta = largest / 2 * nodes.x
            rim, up = np.sin(theta), np.cos(theta)
            facing = tilt * rim + z * up
            wi = np.stack([2 * facing * rim * cos - sine, 2 * facing * rim * sin, 2 * facing * up - z], axis=-1)
            measure = largest / 2 * rim * 4 * facing  # dω_i = 4 cos θ_d dω_h
        else:  # φ = 0 is where the normal lies
            rim, up = np.sin(largest * nodes.x), np.cos(largest * nodes.x)
            wi = np.stack([sine * up - z * rim * cos, rim * sin, z * up + tilt * rim], axis=-1)
            measure = largest * rim
        share = _share_about_wo(wi, np.concatenate([sine, 0 * sine, z], axis=-1)[:, None])
        measure = measure * (share if chart == "about wo" else 1 - share)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = np.stack([cos * wi[..., 0] - sin * wi[..., 1], sin * wi[..., 0] + cos * wi[..., 1], wi[..., 2]], axis=-1)
    wo = np.stack([(sine * cos)[:, 0], (sine * sin)[:, 0], cosine], axis=-1)
    return turned, wo, measure * nodes.weight


def _share_about_wo(wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
    """From 1 at wi = wo to 0 where they mirror each other, each to eighth order in the distance from there.

    A narrow lobe in the middle of one chart must not be seen by the nodes of the other: its share is (width / 2θ_o)⁸.
    Distances are relative to each other, for the two places meet at the normal.
    """
    from_mirror = np.sum((wi + wo)[..., :2] ** 2, axis=-1)
    q = from_mirror / (from_mirror + np.sum((wi - wo) ** 2, axis=-1))
    return q**4 * (35 + q * (-84 + q * (70 - 20 * q)))
