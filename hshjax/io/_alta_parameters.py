"""ALTA's parametrisations of a pair of directions, each as a function from its coordinates to wi and wo.

Names, order and meaning are those of ALTA (`core/params.h`, `core/params.cpp`): angles in radians, the view vector is
wo, the light vector wi; of vectors the view comes first, of angles the light, unless the name says otherwise. Where
`to_cartesian` and `from_cartesian` of ALTA contradict each other (STEREOGRAPHIC, STARK_3D, NEUMANN_3D: view and light
exchanged, or vectors that are not unit), the definition in words decides, which `from_cartesian` follows.

Coordinates that leave the pair open stand for one pair of those that have them; `note` says which. Pairs that do not
exist come out as NaN.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hshjax.io._directions import from_half_and_difference, mirrored, polar

Pair = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Parametrisation:
    """What the columns of a file mean.

    - `columns`: how many coordinates; `pair(x)`: wi, wo `(n, 3)` of coordinates `(n, columns)`.
    - `isotropic`: whether only φ_i - φ_o is in them.
    - `cosines`, `angles`, `vectors`: columns that are cosines, columns or pairs of columns that are polar angles
      [radians] (of a pair the length), and columns at which unit vectors begin.
    - `note`: what was decided, "" where the coordinates say it all.
    """

    columns: int
    pair: Callable[[np.ndarray], Pair]
    isotropic: bool = True
    cosines: tuple[int, ...] = ()
    angles: tuple[int | tuple[int, int], ...] = ()
    vectors: tuple[int, ...] = ()
    note: str = ""


def _projected(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The direction whose θ cos φ and θ sin φ these are."""
    return polar(np.hypot(x, y), np.arctan2(y, x))


def _rusinkiewicz(theta_h: np.ndarray, phi_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> Pair:
    return from_half_and_difference(theta_h, phi_h, polar(theta_d, phi_d))


def _same(h: np.ndarray) -> Pair:
    """wi = wo = h: θ_d = 0."""
    return h, h


def _mirror(k: np.ndarray) -> Pair:
    """wi = k and wo its mirror direction: the back vector is k."""
    return k, mirrored(k)


def _normal(wo: np.ndarray) -> Pair:
    """Light along the normal."""
    return np.broadcast_to([0.0, 0.0, 1.0], wo.shape), wo


def _vector_half_and_difference(x: np.ndarray) -> Pair:
    h, d = x[:, :3], x[:, 3:]
    return from_half_and_difference(np.arctan2(np.hypot(h[:, 0], h[:, 1]), h[:, 2]), np.arctan2(h[:, 1], h[:, 0]), d)


def _barycentric(x: np.ndarray) -> Pair:
    """α = (1 - wi·wo)/2 = sin²θ_d and σ = (1 - h_z²)(1 - α) = sin²θ_h cos²θ_d (Stark et al. 2005)."""
    alpha, sigma = x[:, 0], x[:, 1]
    theta_d = np.arcsin(_root(alpha))
    # α = 1: wi = -wo lie on the horizon, and any half vector in between will do.
    theta_h = np.arcsin(_root(np.where(alpha < 1, sigma / np.where(alpha < 1, 1 - alpha, 1), sigma)))
    return _rusinkiewicz(theta_h, np.zeros_like(theta_h), theta_d, np.full_like(theta_d, np.pi / 2))


def _root(square: np.ndarray) -> np.ndarray:
    """Of a square in [0, 1], to rounding; NaN of any other number."""
    inside = (square >= -1e-9) & (square <= 1 + 1e-9)
    return np.sqrt(np.where(inside, np.clip(square, 0, 1), np.nan))


def _back_projected(x: np.ndarray) -> Pair:
    """θ_l and the back vector k, the bisector of wo and the mirror direction r of wi: wo = 2 (k·r) k - r."""
    wi, k = polar(x[:, 0], 0.0), _projected(x[:, 1], x[:, 2])
    r = mirrored(wi)
    return wi, 2 * np.sum(k * r, axis=1, keepdims=True) * k - r


def _retro_projected(x: np.ndarray) -> Pair:
    """θ_l and wo by its angle from wi and the azimuth around wi, 0 towards the normal."""
    wi = polar(x[:, 0], 0.0)
    towards = np.stack([-np.cos(x[:, 0]), np.zeros(len(x)), np.sin(x[:, 0])], axis=-1)
    local = _projected(x[:, 1], x[:, 2])
    return wi, local[:, 2:] * wi + local[:, :1] * towards + local[:, 1:2] * (0.0, 1.0, 0.0)


def _stark(length: np.ndarray, half: np.ndarray, phi: np.ndarray) -> Pair:
    """|H| along the surface, |B| and φ_B - φ_H of H = (wi + wo)/2 and B = (wi - wo)/2, which are orthogonal."""
    height = _root(1 - length**2 - half**2)
    along, up = height, -length * np.cos(phi)
    norm = np.hypot(along, up)
    # Both are 0 where H lies along the surface and B across: B then does, too.
    along, up = np.where(norm > 0, along, 1) / np.where(norm > 0, norm, 1), up / np.where(norm > 0, norm, 1)
    h = np.stack([length, np.zeros_like(length), height], axis=-1)
    b = half[:, None] * np.stack([along * np.cos(phi), along * np.sin(phi), up], axis=-1)
    return h + b, h - b


def _neumann(length: np.ndarray, half: np.ndarray, phi: np.ndarray) -> Pair:
    """The lengths of H and B along the surface, and φ_B - φ_H."""
    x, y = half * np.cos(phi), half * np.sin(phi)
    return _lifted(length + x, y), _lifted(length - x, -y)


def _lifted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([x, y, _root(1 - x**2 - y**2)], axis=-1)


def _stereographic(p: np.ndarray) -> np.ndarray:
    """The direction w whose w_x / (1 + w_z) and w_y / (1 + w_z) these are."""
    square = np.sum(p**2, axis=1, keepdims=True)
    return np.concatenate([2 * p, 1 - square], axis=1) / (1 + square)


RETRO = "stands for wi = wo = h (theta_d = 0), as in ALTA's own conversion."
ACROSS = "leaves phi_d open: pi/2, wi and wo at one height."

PARAMETRISATIONS = {
    "COS_TH": Parametrisation(1, lambda x: _same(polar(np.arccos(x[:, 0]), 0.0)), cosines=(0,), note=f"COS_TH {RETRO}"),
    "COS_TK": Parametrisation(
        1,
        lambda x: _mirror(polar(np.arccos(x[:, 0]), 0.0)),
        cosines=(0,),
        note="COS_TK stands for mirror pairs of directions: wo and the mirror direction of wi are the back vector.",
    ),
    "COS_TLV": Parametrisation(
        1,
        lambda x: _normal(polar(np.arccos(x[:, 0]), 0.0)),
        cosines=(0,),
        note="COS_TLV stands for light along the normal, as in ALTA's own conversion.",
    ),
    "COS_TLR": Parametrisation(
        1,
        lambda x: _normal(polar(-np.arccos(x[:, 0]), 0.0)),
        cosines=(0,),
        note="COS_TLR stands for light along the normal, as in ALTA's own conversion.",
    ),
    "COS_TH_TD": Parametrisation(
        2,
        lambda x: _rusinkiewicz(np.arccos(x[:, 0]), np.zeros(len(x)), np.arccos(x[:, 1]), np.full(len(x), np.pi / 2)),
        cosines=(0, 1),
        note=f"COS_TH_TD {ACROSS} ALTA's own conversion takes 0, where wo may lie below the horizon.",
    ),
    "RUSIN_TH_TD": Parametrisation(
        2,
        lambda x: _rusinkiewicz(x[:, 0], np.zeros(len(x)), x[:, 1], np.full(len(x), np.pi / 2)),
        angles=(0, 1),
        note=f"RUSIN_TH_TD {ACROSS} So does ALTA's own conversion.",
    ),
    "ISOTROPIC_TV_PROJ_DPHI": Parametrisation(
        2,
        lambda x: _normal(_projected(x[:, 0], x[:, 1])),
        angles=((0, 1),),
        note="ISOTROPIC_TV_PROJ_DPHI stands for light along the normal, as in ALTA's own conversion.",
    ),
    "STARK_2D": Parametrisation(
        2,
        lambda x: _stark(x[:, 0], x[:, 1], np.full(len(x), np.pi / 2)),
        note="STARK_2D leaves phi_B - phi_H open: pi/2, as in ALTA's own conversion.",
    ),
    "NEUMANN_2D": Parametrisation(
        2,
        lambda x: _neumann(x[:, 0], x[:, 1], np.full(len(x), np.pi / 2)),
        note="NEUMANN_2D leaves phi_B - phi_H open: pi/2, as in ALTA's own conversion.",
    ),
    "BARYCENTRIC_ALPHA_SIGMA": Parametrisation(2, _barycentric, note=f"BARYCENTRIC_ALPHA_SIGMA {ACROSS}"),
    "RUSIN_TH_TD_PD": Parametrisation(
        3, lambda x: _rusinkiewicz(x[:, 0], np.zeros(len(x)), x[:, 1], x[:, 2]), angles=(0, 1)
    ),
    "RUSIN_TH_PH_TD": Parametrisation(
        3,
        lambda x: _rusinkiewicz(x[:, 0], x[:, 1], x[:, 2], np.full(len(x), np.pi / 2)),
        isotropic=False,
        angles=(0, 2),
        note=f"RUSIN_TH_PH_TD {ACROSS} ALTA's own conversion takes 0, where wo may lie below the horizon.",
    ),
    "RUSIN_VH": Parametrisation(3, _same, isotropic=False, vectors=(0,), note=f"RUSIN_VH {RETRO}"),
    "SCHLICK_VK": Parametrisation(
        3,
        _mirror,
        isotropic=False,
        vectors=(0,),
        note="SCHLICK_VK stands for mirror pairs of directions: wi is the back vector, wo its mirror direction.",
    ),
    "ISOTROPIC_TV_TL_DPHI": Parametrisation(3, lambda x: (polar(x[:, 1], x[:, 2]), polar(x[:, 0], 0.0)), angles=(0, 1)),
    "ISOTROPIC_TL_TV_DPHI": Parametrisation(3, lambda x: (polar(x[:, 0], 0.0), polar(x[:, 1], x[:, 2])), angles=(0, 1)),
    "ISOTROPIC_TL_TV_PROJ_DPHI": Parametrisation(
        3, lambda x: (polar(x[:, 0], 0.0), _projected(x[:, 1], x[:, 2])), angles=(0, (1, 2))
    ),
    "SCHLICK_TL_TK_PROJ_DPHI": Parametrisation(3, _back_projected, angles=(0, (1, 2))),
    "RETRO_TL_TVL_PROJ_DPHI": Parametrisation(3, _retro_projected, angles=(0, (1, 2))),
    "STARK_3D": Parametrisation(3, lambda x: _stark(x[:, 0], x[:, 1], x[:, 2])),
    "NEUMANN_3D": Parametrisation(3, lambda x: _neumann(x[:, 0], x[:, 1], x[:, 2])),
    "RUSIN_TH_PH_TD_PD": Parametrisation(
        4, lambda x: _rusinkiewicz(x[:, 0], x[:, 1], x[:, 2], x[:, 3]), isotropic=False, angles=(0, 2)
    ),
    "SPHERICAL_TL_PL_TV_PV": Parametrisation(
        4, lambda x: (polar(x[:, 0], x[:, 1]), polar(x[:, 2], x[:, 3])), isotropic=False, angles=(0, 2)
    ),
    "STEREOGRAPHIC": Parametrisation(
        4, lambda x: (_stereographic(x[:, 2:]), _stereographic(x[:, :2])), isotropic=False
    ),
    "RUSIN_VH_VD": Parametrisation(6, _vector_half_and_difference, isotropic=False, vectors=(0, 3)),
    "CARTESIAN": Parametrisation(6, lambda x: (x[:, 3:], x[:, :3]), isotropic=False, vectors=(0, 3)),
}
"""By name; SCHLICK_VH, ALTA's own spelling of SCHLICK_VK in files, is added below."""
PARAMETRISATIONS["SCHLICK_VH"] = PARAMETRISATIONS["SCHLICK_VK"]

AMBIGUOUS = {
    "ISOTROPIC_TV_TL": "two polar angles, with the azimuth between the directions left open",
    "ISOTROPIC_TL_TV": "two polar angles, with the azimuth between the directions left open",
    "ISOTROPIC_TD_PD": "an angle between two directions that it does not name",
    "SCHLICK_TK_PK": "the back vector alone, without a conversion in ALTA",
    "UNKNOWN_INPUT": "nothing about directions",
}
"""Names that ALTA knows but does not define as directions: a reader would have to guess."""
