"""The `hshjax` command: what it prints, what it keeps, what it refuses."""

import pytest
from typer.testing import CliRunner

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import CookTorrance, ExpBRDF, OrenNayar
from hshjax.cli import app
from hshjax.fitting import project
from hshjax.io import load_model, save_model
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import X64, slow_unless


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def model(tmp_path):
    """A small fitted model, in a folder with brackets in its name."""
    folder = tmp_path / "runs[old]"
    folder.mkdir()
    samples = Samples.from_function(OrenNayar(0.5, 0.3), isotropic_pair_rule(8))
    save_model(folder / "small.hshjax", project(IsotropicBasis(HSH(1)), samples, reciprocity=False).model)
    return folder / "small.hshjax"


def test_help_teaches():
    assert "hshjax fit leather.bsdf" in run("--help").output
    assert "norms.md" in run("fit", "--help").output


def test_a_model_is_described_and_fitted_again(model, tmp_path):
    described = run("info", model)
    assert described.exit_code == 0, described.output
    for what in ("LinearBRDF", "4 x 1", "foreshortened", "hemispherical albedo"):
        assert what in described.output
    before = model.read_bytes()
    refused = run("fit", model, "--order", 1, "--degree", 8)
    assert refused.exit_code == 2
    assert "--out" in refused.stderr
    assert model.read_bytes() == before
    out = tmp_path / "out.hshjax"
    fitted = run("fit", model, "--order", 1, "--degree", 8, "--out", out, "--picture", tmp_path / "out.png")
    assert fitted.exit_code == 0, fitted.output + fitted.stderr
    assert "relative error, norm E" in fitted.output
    assert load_model(out).basis == IsotropicBasis(HSH(1))
    assert (tmp_path / "out.png").stat().st_size > 0


@pytest.mark.parametrize(("kind", "what"), [("exp", ExpBRDF), slow_unless(False, "cook-torrance", CookTorrance)])
def test_other_models_are_fitted_step_by_step(model, tmp_path, kind, what):
    out = tmp_path / "out.hshjax"
    fitted = run("fit", model, "--model", kind, "--order", 1, "--degree", 8, "--out", out)
    assert fitted.exit_code == 0, fitted.output + fitted.stderr
    assert "converged" in fitted.output
    assert isinstance(load_model(out), what)


@pytest.mark.skipif(not X64, reason="the command computes in float64")
def test_a_compact_model_is_fitted_and_described(model, tmp_path):
    out = tmp_path / "compact.hshjax"
    fitted = run("fit", model, "--model", "compact", "--coefficients", 12, "--degree", 8, "--out", out)
    assert fitted.exit_code == 0, fitted.output + fitted.stderr
    assert load_model(out).count == 12
    described = run("info", out)
    for shown in (fitted.output, described.output):
        assert "12: 12, of 34 functions each" in shown
        assert "(LogWarp)" in shown
    assert "log error" in fitted.output


@pytest.mark.slow
def test_a_valid_fit_shows_its_certificate(model, tmp_path):
    out = tmp_path / "valid.hshjax"
    fitted = run("fit", model, "--valid", "--norm", "A", "--order", 1, "--degree", 8, "--out", out)
    assert fitted.exit_code == 0, fitted.output + fitted.stderr
    assert "holds: smallest value" in fitted.output
    refused = run("fit", model, "--valid", "--model", "ggx", "--out", out)
    assert refused.exit_code == 2
    assert "--valid is for the linear model" in refused.stderr


def test_errors_are_sentences(model, tmp_path):
    (tmp_path / "text.bsdf").write_text("no material")
    for arguments, message in (
        (("info", tmp_path / "absent.bsdf"), "No such file"),
        (("info", tmp_path / "text.bsdf"), "text.bsdf: "),
        (("fit", model, "--out", tmp_path / "no" / "where.hshjax"), "there is no folder"),
        (("fit", model, "--out", tmp_path / "a", "--order", 8, "--degree", 2, "--ridge", 0), "unknowns"),
    ):
        result = run(*arguments)
        assert result.exit_code == 2, result.output
        assert result.stderr.startswith("error:")
        assert message in result.stderr.replace("\n", " ")
        assert isinstance(result.exception, SystemExit)
    assert not (tmp_path / "a").exists()
