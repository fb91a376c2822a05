"""Published fits of analytic models: against their formulas in angles, and against the materials that were fitted."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import gamma, gammaincc

from experiments.recipes._compact_metrics import log_error
from experiments.recipes._compact_rivals import numbers
from experiments.recipes._published import abc, read_parameters, shifted_gamma
from experiments.recipes._surrogate import read_surrogates
from hshjax import direction, half_vector_samples
from tests.helpers import X64, assert_close

pytestmark = pytest.mark.skipif(not X64, reason="studies run in float64")

ROW = {
    "rhoD": [0.3, 0.2], "rhoS": [0.02, 0.1], "alpha": [0.01, 0.2], "p": [0.4, 0.9], "F0": [0.5, 1.7], "F1": [-0.3, 0.7],
    "kap": [60.0, 5.0], "lambda": [3.0, 0.2], "c": [0.4, 1e-3], "k": [7.0, 5.0], "theta0": [0.1, -0.5],
}  # fmt: skip


def by_hand(theta_h, theta_d, theta_i, theta_o, k):
    """The formula of Bagher et al. in angles, one channel, by Python's own functions."""
    row = {key: values[k] for key, values in ROW.items()}
    x = math.tan(theta_h) ** 2
    facets = row["kap"] * row["alpha"] ** row["p"] * math.exp(-(row["alpha"] ** 2 + x) / row["alpha"])
    facets /= (row["alpha"] ** 2 + x) ** row["p"] * math.pi * math.cos(theta_h) ** 4
    fresnel = row["F0"] - row["F1"] * math.cos(theta_d) + (1 - row["F0"]) * (1 - math.cos(theta_d)) ** 5
    seen = 1.0
    for theta in (theta_i, theta_o):
        power = row["c"] * max(theta - row["theta0"], 0) ** row["k"]
        seen *= max(1 + row["lambda"] * (1 - math.exp(power)), 0)
    lobe = fresnel * facets * seen / (math.pi * math.cos(theta_i) * math.cos(theta_o))
    return row["rhoD"] / math.pi + row["rhoS"] * lobe


@pytest.mark.parametrize(("theta_i", "theta_o"), [(0.3, 0.3), (0.2, 0.9), (1.4, 0.1), (1.5, 1.45)])
def test_shifted_gamma_in_the_plane_of_incidence(theta_i, theta_o):
    """There both half angles are a sum and a difference: on opposite sides of the normal, and on the same side."""
    brdf = shifted_gamma({key: np.array(values) for key, values in ROW.items()})
    for side, theta_h, theta_d in (
        (math.pi, abs(theta_i - theta_o) / 2, (theta_i + theta_o) / 2),
        (0.0, (theta_i + theta_o) / 2, abs(theta_i - theta_o) / 2),
    ):
        wi = direction(jnp.asarray(theta_i), jnp.asarray(0.0))
        wo = direction(jnp.asarray(theta_o), jnp.asarray(side))
        expected = [by_hand(theta_h, theta_d, theta_i, theta_o, k) for k in range(2)]
        assert_close(brdf(wi, wo), expected)
        assert_close(brdf(wo, wi), expected)


def test_parameters_are_read_by_channel(tmp_path):
    path = tmp_path / "fits.csv"
    path.write_text("material,kd_r,kd_g,kd_b,A_r,A_g,A_b,B,C,ior\nsteel,0.1,0.2,0.3,4,5,6,700,1.5,1.8\n")
    model = abc(read_parameters(path)["steel"])
    assert_close(model.diffuse, [0.1, 0.2, 0.3])
    assert_close(model.amplitude, [4, 5, 6])
    assert (model.sharpness, model.exponent, model.fresnel.eta) == (700, 1.5, 1.8)
    assert numbers(model) == 9


def test_published_normalisations_are_those_of_the_formula(data):
    """kap = 1 / (α Γ(1 - p, α)) wherever the incomplete gamma function of scipy reaches, p < 1."""
    rows = read_parameters(data / "merl_fits" / "merl_sgd_bagher2012.csv")
    assert len(rows) == 80
    assert all(numbers(shifted_gamma(row)) == 33 for row in rows.values())
    alpha, p, kap = (np.stack([row[key] for row in rows.values()]) for key in ("alpha", "p", "kap"))
    proper = p < 1
    ratio = np.where(proper, kap * alpha * gamma(1 - p) * gammaincc(np.where(proper, 1 - p, 1), alpha), 1)
    # A few were set by hand to two digits in the published table (chrome).
    assert np.median(np.abs(ratio - 1)) < 1e-4
    assert np.mean(np.abs(ratio - 1) < 1e-3) > 0.9


def test_published_models_are_near_the_materials_they_were_fitted_to(data):
    """Log errors of models with the factors 1 / π and 1 / π² of their lobes; half and twice the lobe are farther."""
    networks = read_surrogates(data / "merl_surrogate" / "merl_surrogate.npz")
    names = ("neoprene-rubber", "black-oxidized-steel", "green-metallic-paint")
    samples = [half_vector_samples(networks[name], shape=(30, 10, 4), grazing=0.0) for name in names]
    wi, wo = samples[0].wi, samples[0].wo
    for file, build, lobe in (
        ("merl_abc_low2012.csv", abc, "A"),
        ("merl_sgd_bagher2012.csv", shifted_gamma, "rhoS"),
    ):
        rows = read_parameters(data / "merl_fits" / file)
        errors = []
        for name, one in zip(names, samples, strict=True):
            scaled = (rows[name] | {lobe: factor * rows[name][lobe]} for factor in (0.5, 0.8, 1.0, 1.25, 2.0))
            errors.append([log_error(one.value, build(row)(wi, wo), wi, wo) for row in scaled])
        assert np.argmin(np.mean(errors, axis=0)) == 2
        assert np.max(np.array(errors)[:, 2]) < 15
