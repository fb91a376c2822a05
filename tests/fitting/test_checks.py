"""What `project` refuses: each error names a count, a place or a remedy."""

import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.fitting import project
from hshjax.samples import Samples
from tests.helpers import DTYPE, directions

BASIS = IsotropicBasis(HSH(1))
UNKNOWNS = 4
N = 40


def samples(n=N, weight=None, min_z=0.1):
    value = jnp.asarray(np.random.default_rng(2).uniform(0.1, 1, (n, 2)), DTYPE)
    return Samples.scattered(directions(0, n, min_z=min_z), directions(1, n, min_z=min_z), value, weight)


def changed(**changes):
    """The samples with rows of some fields replaced: name = (row or rows, value)."""
    s = samples()
    fields = {"wi": s.wi, "wo": s.wo, "value": s.value, "weight": s.weight}
    for name, (row, value) in changes.items():
        fields[name] = fields[name].at[row].set(jnp.asarray(value, DTYPE))
    return Samples(**fields)


SLANTED_DOWN = [0.6, 0.0, -0.8]

REFUSED = {
    "NaN value": (changed(value=(7, np.nan)), r"1 of 40 samples.*NaN or infinite values.*sample 7"),
    "one channel": (changed(value=((3, 1), np.inf)), r"1 of 40 samples.*NaN or infinite values.*sample 3"),
    "many": (changed(value=(slice(5, 17), -np.inf)), r"12 of 40 samples.*NaN or infinite values.*sample 5"),
    "NaN direction": (changed(wo=(4, np.nan)), r"1 of 40 samples.*NaN or infinite directions.*sample 4"),
    "length": (changed(wi=((slice(0, 3), 2), 3.0)), r"3 of 40 samples.*not of unit length.*sample 0"),
    "zero vector": (changed(wo=(39, 0.0)), r"1 of 40 samples.*not of unit length.*sample 39"),
    "below, in": (changed(wi=(2, SLANTED_DOWN)), r"1 of 40 samples.*below the horizon.*sample 2"),
    "below, out": (changed(wo=(slice(0, 4), SLANTED_DOWN)), r"4 of 40 samples.*below the horizon.*sample 0"),
    "negative weight": (changed(weight=(slice(0, 2), -1.0)), r"2 of 40 weights are negative or not finite"),
    "NaN weight": (changed(weight=(0, np.nan)), r"1 of 40 weights are negative or not finite"),
    "infinite weight": (changed(weight=(0, np.inf)), r"1 of 40 weights are negative or not finite"),
    "zero weights": (changed(weight=(slice(None), 0.0)), r"no sample to fit: all of the 40 samples have weight 0"),
    "too few": (samples(3), r"3 samples count in norm D, but there are 4 unknowns: .*ridge > 0"),
    "too few unmasked": (changed(weight=(slice(3, None), 0.0)), r"3 samples count in norm D, but there are 4 unknowns"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    bad, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        project(BASIS, bad)


@pytest.mark.parametrize("case", [case for case in REFUSED if not case.startswith("too few")])
def test_a_ridge_does_not_excuse_bad_samples(case):
    bad, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        project(BASIS, bad, ridge=1.0)


def test_the_count_is_that_of_the_used_samples():
    bad = changed(value=(slice(0, 4), np.nan), weight=(slice(0, 3), 0.0))
    with pytest.raises(ValueError, match=r"1 of 37 samples.*sample 3"):
        project(BASIS, bad)


def test_norm_e_counts_only_what_it_sees():
    grazing = directions(1, N).at[5:].set(jnp.asarray([np.sqrt(0.99), 0.0, 0.1], DTYPE))
    s = samples()
    with pytest.raises(ValueError, match=r"\d samples count in norm E, but there are 4 unknowns"):
        project(BASIS, Samples.scattered(s.wi, grazing.at[3:5, :].set(grazing[5]), s.value), norm="E")


def test_one_pair_over_and_over_determines_nothing():
    s = samples()
    repeated = Samples.scattered(jnp.tile(s.wi[:1], (N, 1)), jnp.tile(s.wo[:1], (N, 1)), s.value)
    with pytest.raises(ValueError, match=r"do not determine the 4 unknowns: condition number .*give a ridge > 0"):
        project(BASIS, repeated, norm="A")
    ridged = project(BASIS, repeated, norm="A", ridge=1e-2)
    assert np.all(np.isfinite(ridged.model.coefficients))


def test_a_ridge_that_is_too_small_is_named():
    s = samples()
    repeated = Samples.scattered(jnp.tile(s.wi[:1], (N, 1)), jnp.tile(s.wo[:1], (N, 1)), s.value)
    with pytest.raises(ValueError, match=r"give a larger ridge"):
        project(BASIS, repeated, ridge=1e-36)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"ridge": -1.0}, r"ridge must be finite and >= 0, got -1.0"),
        ({"ridge": float("nan")}, r"ridge must be finite and >= 0, got nan"),
        ({"prior": "spectral"}, r"give ridge > 0"),
        ({"prior": np.ones(UNKNOWNS)}, r"give ridge > 0"),
        ({"ridge": 1.0, "prior": np.ones(UNKNOWNS + 1)}, r"each of the 4 modes, got shape \(5,\)"),
        ({"ridge": 1.0, "prior": np.ones((UNKNOWNS, 1))}, r"each of the 4 modes, got shape \(4, 1\)"),
        ({"ridge": 1.0, "prior": -np.ones(UNKNOWNS)}, r"prior must be finite and >= 0, got -1.0 for mode 0"),
        ({"ridge": 1.0, "prior": np.full(UNKNOWNS, np.nan)}, r"prior must be finite and >= 0, got nan for mode 0"),
        ({"norm": "L2"}, r"norm must be one of A, B, C, D, E"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(ValueError, match=message):
        project(BASIS, samples(), **settings)


def test_an_unknown_prior_is_refused(unchecked):
    from hshjax.fitting._prior import penalty

    with pytest.raises(ValueError, match=r'must be None, "spectral" or an array \(modes,\), got \'smooth\''):
        penalty(BASIS, 1.0, "smooth")
