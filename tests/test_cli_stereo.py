"""`hshjax stereo`: what it leaves in its folder, what it refuses, and that it leaves nothing half done."""

import json
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import hshjax.stereo
from hshjax.brdfs import Lambert
from hshjax.camera import OrthographicCamera
from hshjax.cli import app
from hshjax.io import load_model, read_exr, read_light_positions, read_normals
from hshjax.io._images import write_png
from hshjax.lighting import DirectionalLight
from hshjax.stereo import Stage, Stereo, angular_errors
from hshjax.surface import sphere

SIZE, LIGHTS = 24, 8
FILES = {
    "albedo.exr", "albedo.png", "heights.exr", "light_intensities.txt", "lights.lp", "mesh.ply", "metrics.json",
    "model.hshjax", "normals.exr", "normals.png", "report.html", "weights.npz",
}  # fmt: skip
ALBEDO = np.array([0.6, 0.3, 0.2])


def run(*arguments):
    return CliRunner().invoke(app, ["stereo", *(str(argument) for argument in arguments)])


def scene():
    """A ball of Lambert's law under lights of different intensity: what an archive holds."""
    ball = sphere(OrthographicCamera((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), height=2.2, resolution=(SIZE, SIZE)))
    normals, mask = np.asarray(ball.normal, float), np.asarray(ball.mask)
    turn = np.arange(LIGHTS) * 2 * np.pi / LIGHTS
    tilt = np.tile(np.radians([20, 55]), LIGHTS // 2)
    lights = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    irradiance = 2 + np.cos(turn)
    images = np.maximum(normals @ lights.T, 0).transpose(2, 0, 1)[..., None] * ALBEDO / np.pi
    images = images * irradiance[:, None, None, None]
    return {"images": images, "mask": mask, "lights": lights, "irradiance": irradiance, "normals": normals}


@pytest.fixture
def archive(tmp_path):
    """Writes a scene, changed by arguments (None: left out), in a folder with brackets in its name."""
    folder = tmp_path / "photographs[old]"
    folder.mkdir()

    def write(**changed):
        parts = {key: value for key, value in (scene() | changed).items() if value is not None}
        np.savez(folder / "ball.npz", **parts)
        return folder / "ball.npz"

    return write


def solver(seen=None, turned=0.0, error=None):
    """In place of one that computes: the true normals of the ball, lights turned about z [degrees]."""

    def solve(photographs, *, materials=2, seed=0, progress=None):
        if seen is not None:
            seen.append((photographs, materials, seed))
        progress("learn", 1, 2)
        if error is not None:
            raise error
        parts = scene()
        count, (s, c) = photographs.pixels, (f(np.radians(turned)) for f in (np.sin, np.cos))
        lights = parts["lights"][: photographs.count] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        irradiance = jnp.asarray(parts["irradiance"][: photographs.count])
        nothing = np.zeros((count, photographs.count), bool)
        return Stereo(
            normals=parts["normals"][parts["mask"]].astype(np.float32),
            weights=np.tile(ALBEDO.astype(np.float32), (count, 1, 1)), brdf=Lambert(jnp.ones(1)),
            lights=jax.vmap(DirectionalLight)(jnp.asarray(lights), irradiance),
            stray=0.0, deviation=np.full(count, np.inf, np.float32), outliers=nothing, shadows=nothing,
            mask=photographs.mask, history=(Stage("learn", 0.5, {"noise": 1e-4}),),
        )  # fmt: skip

    return solve


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(hshjax.stereo, "solve_calibrated", solver())


def test_help_teaches():
    output = run("--help").output
    for what in ("hshjax stereo ballPNG --out ball", "report.html", "--lights", "photometric_stereo.md"):
        assert what in output


def test_a_ball_is_solved(archive, tmp_path):
    """All the way, with the solver itself: the files say what is true, and agree with one another."""
    out = tmp_path / "ball"
    done = run(archive(), "--out", out, "--materials", 2, "--rounds", 2, "--sweeps", 1, "--convention", "directx")
    assert done.exit_code == 0, done.output + done.stderr
    assert "angular error of normals" in done.output
    assert {file.name for file in out.iterdir()} == FILES
    assert [path.name for path in tmp_path.iterdir() if "partial" in path.name] == []
    metrics, parts = json.loads((out / "metrics.json").read_text()), scene()
    assert metrics["mean_angular_error_degrees"] < 0.5
    assert metrics["prediction_error"] < 0.02
    assert metrics["mean_light_direction_error_degrees"] is None
    assert metrics["seconds"] > 0
    normals = read_normals(out / "normals.png", "directx")
    inside = parts["mask"]
    assert angular_errors(normals[inside], parts["normals"][inside]).mean() < 0.5
    np.testing.assert_allclose(read_exr(out / "normals.exr")[inside] * (1, -1, 1), normals[inside], atol=1e-4)
    towards = parts["lights"]
    np.testing.assert_allclose(read_light_positions(out / "lights.lp")[1], towards, atol=1e-6)
    np.testing.assert_allclose(np.loadtxt(out / "light_intensities.txt"), parts["irradiance"], rtol=1e-5)
    np.testing.assert_allclose(np.median(read_exr(out / "albedo.exr")[inside], axis=0), ALBEDO, rtol=0.02)
    brdf = load_model(out / "model.hshjax")
    weights = np.load(out / "weights.npz")["weights"]
    up = jnp.asarray([0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.median(weights, axis=0).T @ np.asarray(brdf(up, up)), ALBEDO / np.pi, rtol=0.05)
    heights = read_exr(out / "heights.exr")[..., 0]
    radius = SIZE / 2.2  # pixels
    assert abs(np.nanmax(heights) - np.nanmin(heights) - radius) < 0.35 * radius  # not down to the horizon


def test_the_report_needs_nothing_else(archive, tmp_path, quick):
    assert run(archive(), "--out", tmp_path / "out").exit_code == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 6
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "<script" not in page
    for what in ("ball.npz", "Under new lights", "noise 0.0001", "true normals", "376 of them in the mask"):
        assert what.lower() in page.lower()


def test_a_folder_with_what_others_leave_out(tmp_path, quick):
    """Names without a list, true normals as text, no intensities: what was decided is printed."""
    parts, folder = scene(), tmp_path / "ball"
    folder.mkdir()
    for k, image in enumerate(parts["images"]):
        write_png(folder / f"{k:03d}.PNG", np.rint(255 / image.max() * image).astype(np.uint8))
    write_png(folder / "Mask.png", (255 * parts["mask"]).astype(np.uint8))
    np.savetxt(folder / "light_directions.txt", parts["lights"])
    np.savetxt(folder / "normal.txt", parts["normals"].reshape(-1, 3))
    done = run(folder, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output + done.stderr
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["mean_angular_error_degrees"] < 0.1
    for note in ("true normals of normal.txt", "No filenames.txt", "No light_intensities.txt"):
        assert any(note in line for line in metrics["notes"])
        assert note in " ".join(re.sub(r"[│|]", " ", done.output).split())


@pytest.mark.parametrize("channels", [1, 2])
def test_other_numbers_of_channels_and_no_truth(archive, tmp_path, monkeypatch, channels):
    """Prediction and pictures know 3 channels, and any other number; unknown values are left out."""
    images = scene()["images"][..., :channels]
    images[0, 10:12, 10:14] = np.nan

    def solve(photographs, *, materials, seed, progress):
        found = solver()(photographs, materials=materials, seed=seed, progress=progress)
        return eqx.tree_at(lambda one: one.weights, found, found.weights[..., :channels])

    monkeypatch.setattr(hshjax.stereo, "solve_calibrated", solve)
    done = run(archive(images=images, normals=None), "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output + done.stderr
    metrics = json.loads(done.stdout)
    assert metrics == json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["mean_angular_error_degrees"] is None
    assert metrics["channels"] == channels
    assert metrics["prediction_error"] < 1e-5
    assert metrics["median_deviation_degrees"] is None  # infinite: JSON has no such number
    assert 8 / (metrics["pixels"] * LIGHTS) <= metrics["masked_share"] < 0.5


def test_what_is_searched_for_is_hidden_and_then_compared(archive, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(hshjax.stereo, "solve_uncalibrated", solver(seen, turned=2.0), raising=False)
    monkeypatch.setattr(hshjax.stereo, "solve_semi_calibrated", solver(seen), raising=False)
    done = run(archive(), "--out", tmp_path / "a", "--lights", "unknown", "--json", "--materials", 3, "--seed", 5)
    assert done.exit_code == 0, done.output + done.stderr
    photographs, materials, seed = seen[0]
    assert photographs.lights is None
    assert (materials, seed) == (3, 5)
    metrics = json.loads(done.stdout)
    across = np.sin(np.arccos(scene()["lights"][:, 2]))
    expected = np.mean(np.degrees(2 * np.arcsin(across * np.sin(np.radians(1.0)))))
    assert metrics["mean_light_direction_error_degrees"] == pytest.approx(expected, rel=1e-3)
    assert metrics["mean_light_intensity_error"] == pytest.approx(0, abs=1e-6)
    done = run(archive(), "--out", tmp_path / "b", "--lights", "unknown-intensities", "--json")
    assert done.exit_code == 0, done.output + done.stderr
    np.testing.assert_array_equal(np.asarray(seen[1][0].lights.irradiance), 1)
    metrics = json.loads(done.stdout)
    assert metrics["mean_light_direction_error_degrees"] is None
    assert metrics["mean_light_intensity_error"] == pytest.approx(0, abs=1e-6)


def test_a_folder_with_files_is_kept(archive, tmp_path, quick):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    (out / "metrics.json").write_text("old")
    refused = run(archive(), "--out", out)
    assert refused.exit_code == 1
    assert "--force" in refused.stderr
    assert {file.name for file in out.iterdir()} == {"mine.txt", "metrics.json"}
    forced = run(archive(), "--out", out, "--force")
    assert forced.exit_code == 0, forced.output + forced.stderr
    assert {file.name for file in out.iterdir()} == FILES | {"mine.txt"}
    assert (out / "mine.txt").read_text() == "mine"
    assert (out / "metrics.json").read_text() != "old"


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), OSError("the disk is full"), RuntimeError("it does not converge")]
)
@pytest.mark.parametrize("place", ["solver", "report"])
def test_nothing_is_left_where_it_ends_early(archive, tmp_path, monkeypatch, quick, error, place):
    def fails(*_, **__):
        raise error

    if place == "solver":
        monkeypatch.setattr(hshjax.stereo, "solve_calibrated", solver(error=error))
    else:
        monkeypatch.setattr("hshjax.cli._stereo_report.write_report", fails)
    before = sorted(tmp_path.iterdir())
    photographs = archive()
    done = run(photographs, "--out", tmp_path / "out")
    assert sorted(tmp_path.iterdir()) == before
    if isinstance(error, KeyboardInterrupt):
        assert done.exit_code == 130
    else:
        assert done.exit_code == 1
        assert str(error) in done.stderr


TWO = {key: scene()[key][:2] for key in ("images", "lights", "irradiance")}


@pytest.mark.parametrize(
    ("changed", "options", "message"),
    [
        ({"lights": None, "irradiance": None}, (), "--lights unknown"),
        ({"mask": np.zeros((SIZE, SIZE), bool)}, (), "mask"),
        (TWO, (), "fewer than three photographs"),
        ({"lights": scene()["lights"] * (1, 0, 1)}, (), "lie in a plane"),
        ({"images": np.zeros_like(scene()["images"])}, (), "light"),
        ({}, ("--near", 2.0), "near"),
        ({}, ("--materials", 9), "--materials"),
        ({}, ("--out", "gone/out"), "there is no folder"),
    ],
)
def test_input_that_is_refused(archive, tmp_path, changed, options, message):
    done = run(archive(**changed), "--out", tmp_path / "out", *options)
    assert done.exit_code == (2 if options[:1] == ("--materials",) else 1), done.output
    assert message in done.stderr
    assert "Traceback" not in done.output + done.stderr
    assert not (tmp_path / "out").exists()


def test_paths_that_are_refused(tmp_path):
    text, nothing = tmp_path / "notes.txt", tmp_path / "nothing"
    text.write_text("no photographs")
    nothing.mkdir()
    for path, out, message in (
        (tmp_path / "gone", "out", "no such file or folder"),
        (text, "out", "expected a folder of images"),
        (nothing, "out", "images"),
        (nothing, "notes.txt", "is a file"),
        (nothing, "nothing", "another folder"),
    ):
        done = run(path, "--out", tmp_path / out)
        assert done.exit_code == 1, done.output
        assert message in done.stderr


def test_what_this_version_cannot_do_is_said(archive, tmp_path, monkeypatch):
    monkeypatch.delattr(hshjax.stereo, "solve_uncalibrated", raising=False)
    done = run(archive(), "--out", tmp_path / "out", "--lights", "unknown")
    assert done.exit_code == 2
    assert "does not have" in done.stderr
    monkeypatch.setattr(hshjax.stereo, "solve_uncalibrated", solver(), raising=False)
    done = run(archive(), "--out", tmp_path / "out", "--lights", "unknown", "--sweeps", 3)
    assert done.exit_code == 2
    assert "--sweeps" in done.stderr


def test_options_are_handed_on_to_solvers_that_hand_them_on(archive, tmp_path, monkeypatch):
    seen = []

    def solve(photographs, *, progress, seed, **options):
        seen.append(options)
        return solver()(photographs, progress=progress, seed=seed)

    monkeypatch.setattr(hshjax.stereo, "solve_uncalibrated", solve, raising=False)
    done = run(archive(), "--out", tmp_path / "out", "--lights", "unknown", "--sweeps", 3)
    assert done.exit_code == 0, done.output + done.stderr
    assert seen == [{"materials": 2, "sweeps": 3}]
