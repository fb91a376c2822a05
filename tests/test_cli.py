"""The `hshjax` command: what it prints, what it keeps, what it refuses."""

import json
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest
import typer.main
from typer.testing import CliRunner

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import CookTorrance, ExpBRDF, HalfVectorTable, OrenNayar
from hshjax.cli import app
from hshjax.fitting import project
from hshjax.geometry import direction, from_half_difference
from hshjax.io import exr_channels, load_model, read_exr, save_model, write_csv_samples, write_exr
from hshjax.io._images import read_image
from hshjax.io.merl import write_merl
from hshjax.metrics import albedo
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import X64, mostly_slow, slow_unless


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


def test_no_help_loses_words_to_markup():
    """What stands in brackets would be taken for markup, and vanish."""
    for command in typer.main.get_group(app).commands.values():
        for parameter in command.params:
            assert "[" not in (getattr(parameter, "help", None) or ""), (command.name, parameter.name)
    assert "(64," in run("fit", "--help").output  # the rest of the default may stand on the next line


def test_a_model_is_described_and_fitted_again(model, tmp_path):
    described = run("info", model)
    assert described.exit_code == 0, described.output
    for what in ("LinearBRDF", "4 x 1", "foreshortened", "hemispherical albedo"):
        assert what in described.output
    before = model.read_bytes()
    refused = run("fit", model, "--order", 1, "--degree", 8)
    assert refused.exit_code == 1
    assert "--out" in refused.stderr
    assert model.read_bytes() == before
    out = tmp_path / "out.hshjax"
    fitted = run("fit", model, "--order", 1, "--degree", 8, "--out", out, "--picture", tmp_path / "out.png")
    assert fitted.exit_code == 0, fitted.output + fitted.stderr
    assert "relative error, norm E" in fitted.output
    assert load_model(out).basis == IsotropicBasis(HSH(1))
    assert (tmp_path / "out.png").stat().st_size > 0


def test_a_series_that_rings_and_one_that_shines_by_itself_get_advice(tmp_path):
    polished = CookTorrance(diffuse=0.05, specular=0.6, slope=0.08)
    for name, material, advice in (
        ("rings", polished, "--model compact follows it"),
        ("shines", OrenNayar(1.0, 0.0) + OrenNayar(1.0, 0.0), "more light is reflected than received"),
        ("good", OrenNayar(0.5, 0.3), None),
    ):
        save_model(tmp_path / f"{name}.hshjax", material)
        fitted = run("fit", tmp_path / f"{name}.hshjax", "--order", 4, "--degree", 24, "--out", tmp_path / name)
        assert fitted.exit_code == 0, fitted.output + fitted.stderr
        figures = json.loads((tmp_path / name / "metrics.json").read_text())
        assert (advice in figures["advice"]) if advice else ("advice" not in figures), name


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "what"), [("exp", ExpBRDF), slow_unless(False, "cook-torrance", CookTorrance)])
def test_other_models_are_fitted_step_by_step(model, tmp_path, kind, what):
    out = tmp_path / "out.hshjax"
    fitted = run("fit", model, "--model", kind, "--order", 1, "--degree", 8, "--out", out)
    assert fitted.exit_code == 0, fitted.output + fitted.stderr
    assert "converged" in fitted.output
    assert isinstance(load_model(out), what)


@pytest.mark.slow
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


def test_errors_are_sentences(model, tmp_path):
    (tmp_path / "text.bsdf").write_text("no material")
    for arguments, message in (
        (("info", tmp_path / "absent.bsdf"), "absent.bsdf: No such file"),
        (("info", tmp_path / "text.bsdf"), "text.bsdf: "),
        (("fit", model, "--out", tmp_path / "no" / "where.hshjax"), "there is no folder"),
        (("fit", model, "--out", tmp_path / "a", "--order", 8, "--degree", 2, "--ridge", 0), "unknowns"),
        (("fit", model, "--out", tmp_path / "text.bsdf"), "takes a folder"),
        (("compare", model, tmp_path / "text.bsdf"), "text.bsdf: "),
        (("render", model, "--out", tmp_path / "no" / "x.png"), "there is no folder"),
        (("render", model, "--light", tmp_path / "absent.exr", "--out", tmp_path / "x.png"), "No such file"),
        (("render", model, "--mesh", tmp_path / "text.bsdf", "--out", tmp_path / "x.png"), "suffix"),
        (("convert", tmp_path / "text.bsdf", tmp_path / "a.hshjax"), "text.bsdf: "),
    ):
        result = run(*arguments)
        assert result.exit_code == 1, result.output
        assert result.stderr.startswith("error:")
        assert message in result.stderr.replace("\n", " ")
        assert isinstance(result.exception, SystemExit)
    assert {path.name for path in tmp_path.iterdir()} == {"runs[old]", "text.bsdf"}


def test_misuse_is_told_from_bad_input(model, tmp_path):
    for arguments, message in (
        (("fit", model, "--norm", "F"), "--norm"),
        (("fit",), "file"),
        (("fit", model, "--valid", "--model", "ggx"), "--valid is for the linear model"),
        (("render", model, "--out", tmp_path / "x.jpg"), ".exr or .png"),
        (("render", model, "--light", "1,2", "--out", tmp_path / "x.png"), "three numbers"),
        (("render", model, "--light", "0,0,0", "--out", tmp_path / "x.png"), "not all 0"),
        (("render", model, "--light", "nan,0,1", "--out", tmp_path / "x.png"), "three numbers"),
        (("render", model, "--exposure", "-1", "--out", tmp_path / "x.png"), "above 0"),
        (("convert", model, tmp_path / "x.tiff"), ".glsl"),
        (("convert", model, tmp_path / "x.glsl", "--to", "tiff"), ".glsl"),
        (("stereo", tmp_path, "--out", tmp_path / "o", "--lights", "some"), "--lights"),
    ):
        result = run(*arguments)
        assert result.exit_code == 2, (arguments, result.output)
        assert message in result.stderr.replace("\n", " "), (arguments, result.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["runs[old]"]


def results(tmp_path, model, out):
    """Commands that write `out`, small."""
    small = ("--order", 1, "--degree", 8)
    return {
        "model": ("fit", model, *small, "--out", out("a.hshjax")),
        "folder": ("fit", model, *small, "--out", out("folder")),
        "spheres": ("fit", model, *small, "--out", tmp_path / "spheres.hshjax", "--picture", out("b.png")),
        "compare": ("compare", model, model, "--degree", 8, "--picture", out("c.png")),
        "render": ("render", model, "--size", 16, "--out", out("d.png")),
        "exr": ("render", model, "--size", 16, "--out", out("e.exr")),
        "convert": ("convert", model, out("f.hshjax")),
    }


@pytest.mark.parametrize("case", ["model", "folder", "spheres", "compare", "render", "exr", "convert"])
def test_results_are_replaced_by_force_alone(model, tmp_path, case):
    """Everything that is written, wherever it is: what was there stays, byte by byte, until --force says otherwise."""
    written = []

    def out(name):
        written.append(tmp_path / name)
        return written[-1]

    command = results(tmp_path, model, out)[case]
    (target,) = [path for path in written if path in command]
    if case == "folder":
        target.mkdir()
        (target / "metrics.json").write_text("mine")
        (target / "notes.txt").write_text("mine too")
    else:
        target.write_text("mine")
    kept = sorted(path for path in tmp_path.rglob("*"))
    refused = run(*command)
    assert refused.exit_code == 1
    assert "--force" in refused.stderr
    assert sorted(path for path in tmp_path.rglob("*")) == kept
    assert (target / "metrics.json" if case == "folder" else target).read_text() == "mine"
    done = run(*command, "--force")
    assert done.exit_code == 0, done.output + done.stderr
    if case == "folder":
        assert {path.name for path in target.iterdir()} == {"metrics.json", "model.hshjax", "notes.txt", "spheres.png"}
        assert (target / "notes.txt").read_text() == "mine too"
        assert json.loads((target / "metrics.json").read_text())["coefficients"] == [4, 1]
    else:
        assert target.read_bytes() != b"mine"
    assert not list(tmp_path.rglob("*.partial"))


def test_json_is_all_there_is_on_standard_output(model, tmp_path):
    def out(name):
        return tmp_path / name

    cases = {name: command for name, command in results(tmp_path, model, out).items() if name != "exr"}
    cases["info"] = ("info", model)
    for name, command in cases.items():
        done = run(*command, "--json")
        assert done.exit_code == 0, (name, done.output + done.stderr)
        assert isinstance(json.loads(done.stdout), dict)
    metrics = json.loads((tmp_path / "folder" / "metrics.json").read_text())
    assert metrics == json.loads(run(*cases["folder"], "--force", "--json").stdout)


@pytest.mark.parametrize("case", ["model", "folder", "compare", "render", "convert"])
@pytest.mark.parametrize(
    ("raised", "status", "message"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "more memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: out of memory"), 1, "out of memory"),
        (OSError("no space left"), 1, "no space"),
    ],
    ids=["interrupt", "memory", "device", "disk"],
)
def test_an_end_in_the_middle_leaves_nothing(model, tmp_path, monkeypatch, case, raised, status, message):
    """Whatever stops a command before its result has its name: one sentence, no traceback, no half of a file."""

    def stopped(*_):
        raise raised

    before = sorted(tmp_path.rglob("*"))
    with monkeypatch.context() as patched:
        patched.setattr("hshjax.io._replace.os.replace", stopped)
        done = run(*results(tmp_path, model, lambda name: tmp_path / name)[case])
    assert done.exit_code == status, done.output
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_a_fault_of_the_program_shows_where_it_is(model, monkeypatch):
    def broken(*arguments, **options):
        raise TypeError("a fault")

    monkeypatch.setattr("hshjax.io.read_material", broken)
    assert isinstance(run("info", model).exception, TypeError)


@pytest.mark.slow
def test_pictures_hold_what_reflects(model, tmp_path):
    """Under light from everywhere, the radiance is the albedo; an EXR has it, with alpha."""
    brdf = load_model(model)
    done = run("render", model, "--light", "furnace", "--size", 32, "--out", tmp_path / "x.exr", "--json")
    assert done.exit_code == 0, done.output + done.stderr
    assert exr_channels(tmp_path / "x.exr") == ("A", "Y")
    alpha, image = np.moveaxis(read_exr(tmp_path / "x.exr"), -1, 0)
    middle = float(albedo(brdf, jnp.asarray([0.0, 0.0, 1.0]))[0])
    np.testing.assert_allclose(image[15:17, 15:17], middle, rtol=5e-3)  # pixels of 1/16 of the sphere about the pole
    assert alpha[0, 0] == 0 == image[0, 0]
    assert alpha[16, 16] == 1
    # A map of radiance 2 all over is a furnace twice as bright; it is estimated.
    write_exr(tmp_path / "sky.exr", np.full((16, 32, 3), 2.0, np.float32))
    done = run("render", model, "--light", tmp_path / "sky.exr", "--size", 32, "--out", tmp_path / "y.exr", "--json")
    assert done.exit_code == 0, done.output + done.stderr
    figures = json.loads(done.stdout)
    assert 0 < figures["noise"] < 0.1
    np.testing.assert_allclose(figures["mean_radiance"], 2 * image[alpha > 0].mean(), rtol=0.02)


def scattered(path, limit=60.0):
    """A gonioreflectometer's table: three incidences, no direction beyond `limit` degrees."""
    theta_i, theta_o, phi = (
        axis.ravel() for axis in np.meshgrid([10.0, 30.0, 50.0], np.arange(2.5, limit, 7.5), np.arange(0, 360, 30.0))
    )
    wi = direction(jnp.radians(theta_i), jnp.zeros(phi.size))
    wo = direction(jnp.radians(theta_o), jnp.radians(phi))
    value = OrenNayar([0.5, 0.3], 0.3)(wi, wo)
    write_csv_samples(path, Samples.scattered(wi, wo, value, isotropic=True), ("550 nm", "650 nm"))
    return wi, wo, value


@pytest.mark.parametrize(
    "kind", ["linear", slow_unless(False, "inferred"), slow_unless(False, "compact"), slow_unless(False, "ggx")]
)
def test_a_table_of_a_goniometer_is_fitted(tmp_path, kind):
    """Few incidences, nothing near the horizon: what was measured is met, and what was not is said."""
    wi, wo, value = scattered(tmp_path / "table.csv")
    described = json.loads(run("info", tmp_path / "table.csv", "--json").stdout)
    assert described["incidences"] == 3
    assert described["theta_o_degrees"] == pytest.approx([2.5, 55])
    assert described["channels"] == ["550 nm", "650 nm"]
    options = ("--order", 3) if kind == "linear" else ("--coefficients", 30)
    done = run("fit", tmp_path / "table.csv", "--model", kind, *options, "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output + done.stderr
    metrics = json.loads(done.stdout)
    assert "beyond θ_i 50 and θ_o 55 degrees" in metrics["extrapolated"]
    fitted = load_model(tmp_path / "out" / "model.hshjax")
    wanted = 0.02 if kind != "ggx" else 0.1  # a lobe and Lambert's law are another model
    assert max(metrics["relative_error_A"]) < wanted
    np.testing.assert_allclose(np.asarray(fitted(wi, wo)), np.asarray(value), rtol=0.1 if kind != "ggx" else 0.4)
    grazing = direction(jnp.radians(jnp.asarray([85.0, 89.0])), jnp.zeros(2))
    assert np.all(np.isfinite(np.asarray(fitted(grazing, grazing))))


@pytest.mark.parametrize(
    "suffix", mostly_slow([".csv", ".binary", ".bsdf", ".glsl", ".exr", ".hshjax"], {".glsl", ".csv"})
)
def test_a_model_is_converted(tmp_path, suffix):
    """What is written is read again, and is the same material as far as the format goes."""
    source, target = tmp_path / "paint.hshjax", tmp_path / f"out{suffix}"
    brdf = ExpBRDF(IsotropicBasis(HSH(1)), jnp.full((4, 3), -0.5))
    save_model(source, brdf)
    done = run("convert", source, target, "--degree", 8)
    assert done.exit_code == 0, done.output + done.stderr
    if suffix == ".glsl":
        assert "vec3 hshjax_brdf(vec3 wi, vec3 wo)" in target.read_text()
    elif suffix == ".exr":
        wi, wo = from_half_difference(*jnp.radians(jnp.asarray([45.25, 45.25, 90.0])))
        np.testing.assert_allclose(read_exr(target)[89, 90], np.asarray(brdf(wi, wo)), rtol=1e-5)
    else:
        compared = run("compare", source, target, "--degree", 8, "--json")
        assert compared.exit_code == 0, compared.output + compared.stderr
        exact = suffix in (".csv", ".hshjax")
        assert max(json.loads(compared.stdout)["relative_error_E"]) < (1e-6 if exact else 0.02)


def test_samples_are_no_brdf(tmp_path):
    scattered(tmp_path / "table.csv")
    for arguments in (
        ("convert", tmp_path / "table.csv", tmp_path / "x.binary"),
        ("convert", tmp_path / "table.csv", tmp_path / "x.exr"),
        ("render", tmp_path / "table.csv", "--out", tmp_path / "x.png"),
        ("compare", tmp_path / "table.csv", tmp_path / "table.csv"),
    ):
        refused = run(*arguments)
        assert refused.exit_code == 1, refused.output
        assert "scattered samples" in refused.stderr
    done = run("convert", tmp_path / "table.csv", tmp_path / "again.csv")
    assert done.exit_code == 0, done.stderr
    assert json.loads(run("info", tmp_path / "again.csv", "--json").stdout)["entries"] == 3 * 8 * 12


def test_the_real_process_ends_as_it_says(model, tmp_path):
    """Ctrl-C before a command has begun, bad usage, bad input and success, by the exit codes of processes."""
    run_main = "import sys; from hshjax.cli import main; sys.argv = ['hshjax', *sys.argv[1:]]; main()"
    interrupted = "import hshjax.cli\ndef stop(): raise KeyboardInterrupt\nhshjax.cli.keep_programs = stop\n" + run_main
    for source, arguments, status in (
        (run_main, ("info", str(model), "--json"), 0),
        (run_main, ("info", str(tmp_path / "gone"), "--json"), 1),
        (run_main, ("info",), 2),
        (interrupted, ("info", str(model)), 130),
    ):
        done = subprocess.run([sys.executable, "-c", source, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == status, done.stderr
        assert "Traceback" not in done.stderr
        if status == 0:
            assert json.loads(done.stdout)["kind"] == "LinearBRDF"
        else:
            assert done.stdout == ""


def test_what_is_read_is_never_replaced(model, tmp_path):
    """Not as a file within a folder, nor as a map, a mesh or under another name, --force or not."""
    sky, ball, link = tmp_path / "sky.exr", tmp_path / "ball.png", tmp_path / "link.exr"
    write_exr(sky, np.ones((4, 8, 3), np.float32))
    ball.write_text("read by nobody")
    link.symlink_to(sky)
    source = model.with_name("model.hshjax")
    model.rename(source)
    small = ("--order", 1, "--degree", 8)
    before = {path: path.read_bytes() for path in (sky, source, ball)}
    for command in (
        ("fit", source, *small, "--out", source.parent),
        ("fit", source, *small, "--out", tmp_path / "new.hshjax", "--picture", source),
        ("render", source, "--size", 16, "--light", sky, "--out", sky),
        ("render", source, "--size", 16, "--light", sky, "--out", link),
        ("render", source, "--size", 16, "--light", link, "--out", sky),
        ("render", source, "--size", 16, "--mesh", ball, "--out", ball),
        ("convert", source, source.parent / ".." / source.parent.name / source.name),
        ("compare", source, source, "--picture", source),
    ):
        refused = run(*command, "--force")
        assert refused.exit_code == 1, (command, refused.output)
        assert "is what is read" in refused.stderr
    assert {path: path.read_bytes() for path in before} == before


@pytest.mark.parametrize(
    ("out", "picture"), [("a.hshjax", "a.hshjax"), ("a.hshjax", "./b/../a.hshjax"), ("b", "b/spheres.png")]
)
def test_one_file_is_not_two_results(model, tmp_path, out, picture):
    (tmp_path / "b").mkdir()
    command = ("fit", model, "--order", 1, "--degree", 8, "--out", tmp_path / out, "--picture", f"{tmp_path}/{picture}")
    for force in ((), ("--force",)):
        refused = run(*command, *force)
        assert refused.exit_code == 1
        assert "written twice" in refused.stderr
    assert not (tmp_path / "a.hshjax").exists()
    assert not list((tmp_path / "b").iterdir())


@pytest.mark.parametrize("out", ["new.hshjax", "new", "old"])
def test_an_interrupt_between_two_results_leaves_neither(model, tmp_path, monkeypatch, out):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "metrics.json").write_text("mine")
    before = sorted(tmp_path.rglob("*"))

    def stopped(path, *_):
        if path.name != "spheres.png":
            raise KeyboardInterrupt

    monkeypatch.setattr("hshjax.cli._fit.save_spheres", stopped)
    picture = ("--picture", tmp_path / "new.png", "--force")
    done = run("fit", model, "--order", 1, "--degree", 8, "--out", tmp_path / out, *picture)
    assert done.exit_code == 130
    assert "every file is as it was, or whole" in done.stderr
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "old" / "metrics.json").read_text() == "mine"


def test_a_slice_says_where_nothing_was_measured_and_refuses_what_is_infinite(tmp_path):
    """Alpha 0 there; under another name too."""
    axes = np.radians([0.0, 30.0, 60.0, 80.0]), np.radians([0.0, 30.0, 60.0, 80.0]), np.asarray([np.pi / 2])
    measured = jnp.broadcast_to((jnp.arange(4) < 2)[:, None, None], (4, 4, 1))
    table = HalfVectorTable(np.full((4, 4, 1, 1), 0.5), *axes, channel_names=("Y",), measured=measured)
    save_model(tmp_path / "table.hshjax", table)
    done = run("convert", tmp_path / "table.hshjax", tmp_path / "slice.image", "--to", "exr")
    assert done.exit_code == 0, done.output + done.stderr
    assert exr_channels(tmp_path / "slice.image") == ("A", "Y")
    alpha, value = np.moveaxis(read_exr(tmp_path / "slice.image"), -1, 0)
    assert np.all(alpha[:, :120] == 1)  # pixels of half a degree, the last measured node at 30, the next at 60
    assert np.all(alpha[:, 120:] == 0)
    np.testing.assert_allclose(value, 0.5 * alpha, rtol=1e-6)
    save_model(tmp_path / "huge.hshjax", ExpBRDF(IsotropicBasis(HSH(1)), jnp.full((4, 1), 1e4)))
    refused = run("convert", tmp_path / "huge.hshjax", tmp_path / "huge.exr")
    assert refused.exit_code == 1
    assert "finite values" in refused.stderr
    assert not (tmp_path / "huge.exr").exists()


def test_a_merl_file_is_fitted(tmp_path):
    """From the file to a model on disk: of its channels, near its values, with what the reader found."""
    brdf = OrenNayar([0.5, 0.3, 0.2], 0.3)
    write_merl(tmp_path / "x.binary", brdf, steps=(12, 10, 12))
    out = tmp_path / "x"
    done = run("fit", tmp_path / "x.binary", "--order", 3, "--out", out, "--json")
    assert done.exit_code == 0, done.output + done.stderr
    metrics = json.loads(done.stdout)
    assert metrics == json.loads((out / "metrics.json").read_text())
    assert metrics["format"].startswith("MERL")
    assert metrics["channels"] == ["R", "G", "B"]
    assert metrics["entries"] == 12 * 10 * 12
    assert metrics["fit_notes"] == []
    assert max(metrics["relative_error_E"]) < 0.02
    fitted = load_model(out / "model.hshjax")
    wi, wo = direction(jnp.radians(jnp.asarray([20.0, 50.0])), jnp.asarray([0.0, 2.0]))
    # Of a table of 12 x 10 x 12 nodes and a series of order 3.
    np.testing.assert_allclose(np.asarray(fitted(wi, wo)), np.asarray(brdf(wi, wo)), rtol=0.05)
    assert read_image(out / "spheres.png").shape[1] == 2 * read_image(out / "spheres.png").shape[0]
