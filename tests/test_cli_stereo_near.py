"""`hshjax stereo` with lights and a camera nearby: what it leaves, and what it wants to be told."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import hshjax
from hshjax.cli import app
from hshjax.cli._stereo_camera import with_camera
from hshjax.io import read_exr, read_light_positions
from hshjax.stereo._places import on_plane, spacing
from tests.stereo.near import EYE, ball, places

HEIGHT, FIELD = 2.05, 2 * np.degrees(np.arctan(1.025 / EYE))


def run(*arguments):
    return CliRunner().invoke(app, ["stereo", *(str(argument) for argument in arguments)])


@pytest.fixture
def archive(tmp_path):
    """Photographs whose origin is the middle of the image at the mean depth of the ball, and how tall the image is."""

    def write(eye=None, **changed):
        photographs = ball(4.0, eye, brdf=hshjax.Lambert(0.5))
        camera = photographs.camera
        origin = np.asarray(camera.centre if eye is None else camera.target)
        parts = {
            "images": np.moveaxis(photographs.image(photographs.values), 2, 0), "mask": photographs.mask,
            "positions": np.asarray(photographs.lights.position) - origin,
            "irradiance": np.asarray(photographs.lights.intensity), "normals": photographs.image(photographs.truth),
        }  # fmt: skip
        np.savez(tmp_path / "ball.npz", **{key: value for key, value in (parts | changed).items() if value is not None})
        return tmp_path / "ball.npz", photographs, origin, spacing(camera) * 20

    return write


@pytest.mark.slow
def test_a_ball_seen_and_lit_from_nearby(archive, tmp_path):
    path, photographs, origin, height = archive(EYE)
    out = tmp_path / "out"
    options = ("--image-height", height, "--field-of-view", FIELD, "--rounds", 2, "--sweeps", 1, "--seed", 1)
    done = run(path, "--out", out, *options)
    assert done.exit_code == 0, done.output + done.stderr
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["mean_angular_error_degrees"] < 0.5
    assert metrics["prediction_error"] < 0.02
    heights = read_exr(out / "heights.exr")[..., 0]
    assert np.all(np.isnan(heights[~photographs.mask]))
    wrong = heights[photographs.mask] - (places(photographs, EYE) - origin)[:, 2]
    assert np.sqrt(np.mean(wrong**2)) < 0.01
    np.testing.assert_allclose(np.load(out / "weights.npz")["positions"][:, 2], heights[photographs.mask], atol=1e-6)
    there = np.asarray(photographs.lights.position) - origin
    np.testing.assert_allclose(read_light_positions(out / "lights.lp")[1], there, atol=1e-5)
    np.testing.assert_allclose(
        np.loadtxt(out / "light_intensities.txt"), np.asarray(photographs.lights.intensity), rtol=1e-5
    )


def test_cameras_are_those_of_the_options():
    photographs = ball(4.0)
    far, near = with_camera(photographs, HEIGHT, None).camera, with_camera(photographs, HEIGHT, FIELD).camera
    np.testing.assert_allclose(np.asarray(near.eye), [0, 0, EYE], atol=1e-5)
    for camera in (far, near):
        np.testing.assert_allclose(spacing(camera), HEIGHT / 20, rtol=1e-5)
        corner = on_plane(camera, np.ones((20, 20), bool))[0]
        np.testing.assert_allclose(corner, [-0.95 * HEIGHT / 2, 0.95 * HEIGHT / 2, 0], atol=1e-5)
    alone = with_camera(ball(None), None, FIELD).camera
    np.testing.assert_allclose(spacing(alone), 1, rtol=1e-5)  # pixels


@pytest.mark.parametrize(
    ("changed", "options", "message"),
    [
        ({}, (), "lights nearby want --image-height"),
        ({}, ("--image-height", 0), "--image-height must be a finite number above 0"),
        ({}, ("--image-height", 2, "--field-of-view", 180), "below 180 degrees"),
        (
            {"positions": None, "irradiance": None, "lights": np.eye(12, 3) + np.array([0, 0, 1])},
            ("--image-height", 2),
            "nothing",
        ),
    ],
)
def test_what_is_not_said_of_the_camera(archive, tmp_path, changed, options, message):
    done = run(archive(**changed)[0], "--out", tmp_path / "out", *options)
    assert done.exit_code == 2
    assert message in " ".join(done.stderr.split())
    assert not (tmp_path / "out").exists()
