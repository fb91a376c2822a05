"""The bases that the laws run over. A new basis adds one line here."""

from functools import partial

from hshjax import HSH, SHR, HelmholtzBasis, IsotropicBasis, SphericalHarmonics, TensorBasis, Zernike

ALL_BASES = {"hsh": HSH, "zernike": Zernike, "shr": SHR}
"""Orthonormal on the hemisphere; each is called with the order."""

EVERY_BASIS = {**ALL_BASES, "spherical": SphericalHarmonics}
"""Also the one that is orthonormal on the sphere: for the laws that do not mention the domain."""

ALL_PAIR_BASES = {
    "tensor": TensorBasis,
    "helmholtz": HelmholtzBasis,
    "isotropic": partial(IsotropicBasis, bilateral=False),
    "isotropic_bilateral": IsotropicBasis,
}
"""Orthonormal on pairs of directions; each is called with a basis of ALL_BASES."""

ALL_PAIRS = {
    f"{pair_name}-{name}": (pairs, basis)
    for pair_name, pairs in ALL_PAIR_BASES.items()
    for name, basis in ALL_BASES.items()
}
"""Every pair basis over every basis, as two constructors."""

SOME_PAIRS = ["tensor-hsh", "helmholtz-zernike", "isotropic-hsh", "isotropic_bilateral-shr"]
"""Every pair basis, and every basis, once: for what costs a compilation and is the same code for all."""
