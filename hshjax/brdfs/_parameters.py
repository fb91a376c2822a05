"""Shape checks of BRDFs."""

from typing import Any

import equinox as eqx


def check_parameters(brdf: eqx.Module, *, spectra: tuple[str, ...] = (), scalars: tuple[str, ...] = ()) -> None:
    """ValueError unless `spectra` are scalars or `(channels,)` (one channel meets many) and `scalars` are scalars."""
    shapes = {name: getattr(brdf, name).shape for name in (*spectra, *scalars)}
    name = type(brdf).__name__
    for field in scalars:
        if shapes[field] != ():
            raise ValueError(f"{name} needs a scalar {field}, got shape {shapes[field]}")
    for field in spectra:
        if len(shapes[field]) > 1:
            raise ValueError(f"{name} needs {field} of shape () or (channels,), got {shapes[field]}")
    channels = {shapes[field] for field in spectra} - {(), (1,)}
    if len(channels) > 1:
        raise ValueError(f"{name} needs one number of channels, got { {f: shapes[f] for f in spectra} }")


def check_coefficients(brdf: Any, *axes: str) -> None:
    """ValueError unless `coefficients` has an axis of the modes of the basis, and one for each of `axes`."""
    shape = brdf.coefficients.shape
    if len(shape) != 1 + len(axes) or shape[0] != brdf.basis.count:
        raise ValueError(
            f"coefficients of a {type(brdf).__name__} over {brdf.basis} must have shape "
            f"({', '.join((str(brdf.basis.count), *axes))}), got {shape}"
        )
