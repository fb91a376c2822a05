"""Projections of many samples in bounded memory."""

import json
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import LinearBRDF
from hshjax.fitting import NORMS
from hshjax.fitting._misfit import misfit
from hshjax.fitting._project import _inner_products, factorize
from hshjax.samples import Samples

ROOT = Path(__file__).parents[2]
BASIS = IsotropicBasis(HSH(8))
DESIGN = 200_000 * 165 * 4
"""Bytes of the design matrix, if there were one."""


def shapes(n):
    def array(*shape):
        return jax.ShapeDtypeStruct(shape, jnp.float32)

    concrete = Samples.scattered(*(jnp.zeros((1, 3), jnp.float32),) * 3)
    return eqx.tree_at(
        lambda s: (s.wi, s.wo, s.value, s.weight), concrete, (array(n, 3), array(n, 3), array(n, 3), array(n))
    )


def temporaries(n):
    """Bytes that the three passes over n samples need beside them."""
    samples, model = shapes(n), LinearBRDF(BASIS, jnp.zeros((165, 3), jnp.float32))
    programs = {
        "QR": factorize.lower(BASIS, NORMS["A"], samples),
        "inner products": _inner_products.lower(BASIS, NORMS["D"], None, samples),
        "residual": jax.jit(lambda model, samples: misfit(model, samples, "A")).lower(model, samples),
    }
    return {name: program.compile().memory_analysis().temp_size_in_bytes for name, program in programs.items()}


def test_temporaries_are_a_few_blocks_whatever_the_number_of_samples():
    many, more = temporaries(200_000), temporaries(400_000)
    for name, size in many.items():
        assert 0 < size < DESIGN / 4, name
        # XLA may copy one of the inputs, 16 bytes a sample at most; a row of the design takes 660.
        assert more[name] - size <= 200_000 * 16, name


@pytest.mark.slow
def test_ten_million_samples_in_less_than_3_gigabytes():
    command = [sys.executable, "-m", "benchmarks.project_scale", "--samples", "10000000"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    figures = json.loads(done.stdout)
    assert (figures["samples"], figures["unknowns"], figures["channels"]) == (10_000_000, 165, 3)
    assert figures["peak_gigabytes"] < 3


@pytest.mark.slow
def test_the_benchmark_of_scaling_runs(tmp_path):
    command = [sys.executable, "-m", "benchmarks.scaling", "--smoke", "--out", tmp_path]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    report = json.loads(done.stdout.splitlines()[-1])
    assert report == json.loads((tmp_path / "scaling.json").read_text())
    assert set(report["exponents"]) == {"samples", "unknowns", "materials", "pixels", "devices"}
    assert (tmp_path / "scaling.png").stat().st_size > 1000
