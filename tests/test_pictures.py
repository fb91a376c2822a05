"""Pictures of BRDFs as arrays and as files: slices, lobes, spheres."""

import jax.numpy as jnp
import numpy as np
import pytest

import hshjax
from hshjax import plotting
from hshjax.io import exr_channels, read_exr
from hshjax.io._images import read_image
from tests.helpers import DTYPE, X64, assert_close

GLOSSY = hshjax.GGX(jnp.asarray([0.5, 0.4, 0.3], DTYPE), 0.1) + hshjax.Lambert(0.3)


def test_a_slice_has_the_values_at_its_angles():
    size = 30
    image = plotting.slice_image(GLOSSY, size=size)
    assert image.shape == (size, size, 3)
    for row, column in ((0, 0), (29, 0), (0, 29), (7, 20)):
        theta_h, theta_d = (np.pi / 2 * (k + 0.5) / size for k in (column, size - 1 - row))
        # By hand: h in the plane y = 0, the difference along y, which is perpendicular to it.
        h = np.array([np.sin(theta_h), 0, np.cos(theta_h)])
        wi, wo = (np.cos(theta_d) * h + sign * np.sin(theta_d) * np.array([0, 1, 0]) for sign in (1, -1))
        expected = GLOSSY(jnp.asarray(wi, DTYPE), jnp.asarray(wo, DTYPE))
        assert_close(image[row, column], expected, tolerance=None if X64 else 2e-4)
    # The highlight is the left edge, what grows towards grazing its top; the rest is diffuse.
    assert image[-1, 0, 0] > 10 * image[20, 15, 0]
    assert image[0, 0, 0] > 3 * image[-1, 0, 0]
    assert_close(image[20, 15], np.full(3, 0.3 / np.pi), tolerance=2e-2)


def test_a_slice_of_another_azimuth_ends_at_the_horizon():
    image = plotting.slice_image(hshjax.Lambert(0.5), size=20, phi_d=0.0)[..., 0]
    theta = np.pi / 2 * (np.arange(20) + 0.5) / 20
    below = theta[None, :] + theta[::-1, None] >= np.pi / 2  # in one plane the angles of incidence are θ_d ± θ_h
    clear = np.abs(theta[None, :] + theta[::-1, None] - np.pi / 2) > 1e-3
    np.testing.assert_array_equal(np.isnan(image)[clear], below[clear])
    assert_close(image[~np.isnan(image)], 0.5 / np.pi)


def test_the_root_widens_the_highlight():
    even, wide = (plotting.slice_image(GLOSSY, size=40, root=root)[20, :, 0] for root in (False, True))
    assert np.sum(wide > wide[0] / 2) > 1.5 * np.sum(even > even[0] / 2)


@pytest.mark.parametrize("wi", [(0.0, 0.0, 1.0), (0.8, 0.0, 0.6), (-1.0, 1.0, 2.0)])
def test_a_lobe_sums_to_the_albedo_and_points_away_from_the_light(wi):
    size = 200
    image = plotting.lobe_image(GLOSSY, wi, size=size)
    step = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(step, -step)
    cosine = 1 - (x**2 + y**2)
    assert np.array_equal(np.isnan(image[..., 0]), cosine <= 0)
    total = np.nansum(image * cosine[..., None], axis=(0, 1)) * 8 / size**2
    light = np.asarray(wi) / np.linalg.norm(wi)
    # Sums over pixels: their error is that of the rim, a pixel in some hundred, where the cosine is 0.
    np.testing.assert_allclose(total, hshjax.albedo(GLOSSY, jnp.asarray(light, DTYPE)), rtol=5e-3)
    mirror = light * (-1, -1, 1)
    row, column = np.unravel_index(np.nanargmax(image[..., 0]), image.shape[:2])
    assert np.hypot(*(np.array([x[row, column], y[row, column]]) - mirror[:2] / np.sqrt(1 + mirror[2]))) < 0.15


@pytest.mark.parametrize("wi", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, 1.0)])
def test_a_lobe_of_no_light_is_refused(wi):
    with pytest.raises(ValueError, match="above the horizon"):
        plotting.lobe_image(GLOSSY, wi)


@pytest.mark.parametrize(("channels", "names"), [(1, ("A", "Y")), (3, ("R", "G", "B", "A")), (2, ("A", "C0", "C1"))])
def test_a_picture_in_exr_has_its_values_and_where_they_are(channels, names, tmp_path):
    brdf = hshjax.Lambert(jnp.asarray((0.5, 0.3, 0.2)[:channels], DTYPE))
    image = plotting.sphere(brdf, size=16)
    plotting.write_picture(tmp_path / "sphere.exr", image)
    assert exr_channels(tmp_path / "sphere.exr") == names
    order = [*(name for name in names if name != "A"), "A"]
    found = read_exr(tmp_path / "sphere.exr", order)
    seen = ~np.isnan(image[..., 0])
    np.testing.assert_array_equal(found[..., -1], seen)
    np.testing.assert_array_equal(found[..., :-1][seen], image[seen].astype(np.float32))
    assert np.all(found[~seen] == 0)


def test_a_picture_without_gaps_has_no_alpha_and_the_factor_counts(tmp_path):
    image = plotting.slice_image(hshjax.Lambert(0.5), size=4)
    plotting.write_picture(tmp_path / "slice.exr", image, factor=2 * np.pi)
    assert exr_channels(tmp_path / "slice.exr") == ("Y",)
    np.testing.assert_allclose(read_exr(tmp_path / "slice.exr"), 1, rtol=1e-6)


def test_a_picture_in_png_is_what_display_shows(tmp_path):
    image = plotting.lobe_image(GLOSSY, (0.6, 0, 0.8), size=24)
    plotting.write_picture(tmp_path / "lobe.png", image)
    shown = plotting.display(image, plotting.exposure(image))
    np.testing.assert_array_equal(read_image(tmp_path / "lobe.png"), np.rint(255 * shown))
    plotting.write_picture(tmp_path / "lobe.png", image, factor=0.1)
    assert read_image(tmp_path / "lobe.png").mean() < 255 * shown.mean()


def test_another_suffix_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"\.exr or \.png, got 'lobe\.jpg'"):
        plotting.write_picture(tmp_path / "lobe.jpg", np.zeros((2, 2, 3)))
