"""The analytic BRDFs that the laws run over. Everything is built in the default float of the leg."""

import numpy as np

from hshjax.brdfs import (
    ABC,
    GGX,
    BlinnPhong,
    ConductorFresnel,
    ConstantFresnel,
    CookTorrance,
    DielectricFresnel,
    Lambert,
    OrenNayar,
    SchlickFresnel,
    Ward,
)

RGB = np.array([0.6, 0.45, 0.2])

FRESNELS = {
    "constant": ConstantFresnel(0.9),
    "schlick": SchlickFresnel(0.04),
    "schlick_rgb": SchlickFresnel(RGB),
    "dielectric": DielectricFresnel(1.5),
    "dielectric_inside": DielectricFresnel(1 / 1.5),
    "conductor": ConductorFresnel(0.2, 3.4),
    "conductor_rgb": ConductorFresnel([0.16, 0.42, 1.45], [3.9, 2.4, 1.8]),
}

ALL_BRDFS = {
    "lambert": Lambert(0.5),
    "lambert_rgb": Lambert(RGB),
    "oren_nayar": OrenNayar(0.8, 0.3),
    "oren_nayar_rgb": OrenNayar(RGB, 0.9),
    "oren_nayar_smooth": OrenNayar(0.8, 0.0),
    "oren_nayar_full": OrenNayar(0.8, 0.3, full=True),
    "oren_nayar_full_rgb": OrenNayar(RGB, 0.9, full=True),
    "cook_torrance": CookTorrance(0.2, 0.458, 0.25),
    "cook_torrance_rgb": CookTorrance(RGB, 0.3, 0.4),
    **{f"cook_torrance_{name}": CookTorrance(0.1, 0.9, 0.3, fresnel) for name, fresnel in FRESNELS.items()},
    "ggx": GGX(0.8, 0.3),
    "ggx_rgb": GGX(RGB, 0.5),
    "ggx_height_correlated": GGX(1.0, 0.6, height_correlated=True),
    **{f"ggx_{name}": GGX(1.0, 0.4, fresnel) for name, fresnel in FRESNELS.items()},
    "abc": ABC(0.2, 1.2, 40.0, 1.3),
    "abc_rgb": ABC(RGB, 0.5 * RGB, 40.0, 2.5, SchlickFresnel(0.04)),
    "blinn_phong": BlinnPhong(1.0, 20.0),
    "blinn_phong_rgb": BlinnPhong(RGB, 7.5),
    "blinn_phong_flat": BlinnPhong(0.7, 0.0),
    "ward": Ward(1.0, 0.3, 0.3),
    "ward_rgb": Ward(RGB, 0.25, 0.6),
    "ward_original": Ward(0.5, 0.3, 0.3, original=True),
    "ward_original_rgb": Ward(RGB, 0.25, 0.6, original=True),
    "sum": Lambert(RGB) + 0.4 * GGX(1.0, 0.4),
}

ALBEDO_EXCEPTIONS = {
    "ward_original": "grows without bound towards grazing, as its docstring says",
    "ward_original_rgb": "grows without bound towards grazing, as its docstring says",
}
