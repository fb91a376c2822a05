"""Tables over half and difference angles: their nodes, what lies between, and where φ_d means nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from hshjax.brdfs import HalfVectorTable
from hshjax.brdfs._half_vector_table import half_difference_angles
from hshjax.geometry import from_half_difference
from hshjax.io import load_model, save_model
from hshjax.quadrature import isotropic_pair_rule
from tests.helpers import DTYPE, X64, assert_close, directions

MERL = (np.arange(90) / 90) ** 2 * np.pi / 2, np.radians(np.arange(90.0)), np.radians(np.arange(180.0))
SMALL = (np.linspace(0, 1, 7) ** 2 * np.pi / 2, np.linspace(0, np.pi / 2, 5), np.linspace(0, np.pi, 6, endpoint=False))


def table(nodes=SMALL, channels=3, seed=0):
    values = np.random.default_rng(seed).uniform(0.1, 1, (*map(len, nodes), channels))
    names = tuple("RGBXYZ"[:channels])
    return HalfVectorTable(*(jnp.asarray(part, DTYPE) for part in (values, *nodes)), channel_names=names)


def pairs(n=400):
    rng = np.random.default_rng(1)
    h, d, f = rng.uniform(0, 0.7, n), rng.uniform(0, 0.8, n), rng.uniform(-np.pi, np.pi, n)
    return h, d, f, *(jnp.asarray(w, DTYPE) for w in from_half_difference(*map(jnp.asarray, (h, d, f))))


def test_between_the_nodes():
    """scipy's multilinear interpolation in sqrt(θ_h), θ_d, φ_d; one more node of φ_d closes the period."""
    brdf, (h, d, f, wi, wo) = table(), pairs()
    values = np.concatenate([brdf.values, brdf.values[:, :, :1]], axis=2).astype(np.float64)
    axes = np.sqrt(SMALL[0]), SMALL[1], np.r_[SMALL[2], np.pi]
    expected = RegularGridInterpolator(axes, values)(np.stack([np.sqrt(h), d, f % np.pi], -1))
    assert_close(brdf(wi, wo), expected, tolerance=1e-9 if X64 else 2e-3)  # small angles are ill-conditioned


def test_reciprocal_and_isotropic():
    brdf, wi, wo = table(), directions(0, 300), directions(1, 300)
    assert_close(brdf(wo, wi), brdf(wi, wo), tolerance=1e-9 if X64 else 1e-3)
    turn = jnp.asarray([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]], DTYPE)
    assert_close(brdf(wi @ turn, wo @ turn), brdf(wi, wo), tolerance=1e-9 if X64 else 5e-3)


def test_nodes_of_a_merl_file():
    """The values are met at the nodes, where both directions are above the horizon; no matter where θ is 0."""
    values = np.arange(90 * 90 * 180, dtype=np.float64).reshape(90, 90, 180, 1) / 1e5
    brdf = HalfVectorTable(*(jnp.asarray(part, DTYPE) for part in (values, *MERL)), channel_names=("Y",))
    h, d, f = np.meshgrid([1, 5, 30, 60], [1, 10, 40], [0, 7, 90, 179], indexing="ij")
    angles = MERL[0][h], MERL[1][d], MERL[2][f]
    wi, wo = (jnp.asarray(w, DTYPE) for w in from_half_difference(*map(jnp.asarray, angles)))
    above = np.minimum(wi[..., 2], wo[..., 2]) > 0
    assert above.sum() > 30
    found = np.asarray(brdf(wi, wo))[above]
    # φ_d at θ_d of a degree and θ_h of one node is known to no more than rounding over the product of both.
    assert_close(found, values[h, d, f][above], tolerance=1e-8 if X64 else 2e-2)


def test_beyond_the_ends_the_last_node_holds():
    inner = (np.array([0.1, 0.3]), np.array([0.2, 0.5]), np.array([0.0]))
    brdf = table(inner, channels=1)
    for (h, d), (i, j) in {(0.0, 0.1): (0, 0), (0.6, 0.05): (1, 0), (0.05, 0.9): (0, 1)}.items():
        wi, wo = from_half_difference(*(jnp.asarray(x, DTYPE) for x in (h, d, 1.0)))
        assert_close(brdf(wi, wo), brdf.values[i, j, 0])


DEGENERATE = {
    "both at the pole": ([0, 0, 1], [0, 0, 1]),
    "the same": ([0.6, 0, 0.8], [0.6, 0, 0.8]),
    "mirrored": ([0.6, 0, 0.8], [-0.6, 0, 0.8]),
    "mirrored at grazing": ([1, 0, 1e-4], [-1, 0, 1e-4]),
    "the same at grazing": ([1, 0, 1e-4], [1, 0, 1e-4]),
    "one at the pole": ([0, 0, 1], [0.6, 0, 0.8]),
    "at the horizon": ([0, 1, 0], [0.6, 0, 0.8]),
    "nearly mirrored": ([0.6, 1e-9, 0.8], [-0.6, 0, 0.8]),
    "nearly the same": ([0.6, 1e-9, 0.8], [0.6, 0, 0.8]),
}


def test_finite_where_angles_break():
    brdf = table()
    wi, wo = (jnp.asarray([pair[side] for pair in DEGENERATE.values()], DTYPE) for side in (0, 1))
    value, gradients = jax.jit(jax.vmap(jax.value_and_grad(lambda *w: jnp.sum(brdf(*w)), (0, 1))))(wi, wo)
    for k, name in enumerate(DEGENERATE):
        assert np.isfinite(value[k]), name
        assert all(np.all(np.isfinite(gradient[k])) for gradient in gradients), name


def test_derivatives_against_differences():
    if not X64:
        pytest.skip("differences in float64")
    brdf, (*_, wi, wo) = table(), pairs(40)
    step = 1e-7
    along = jnp.asarray(np.random.default_rng(3).normal(size=wi.shape))
    found = jax.jvp(lambda w: brdf(w, wo), (wi,), (along,))[1]
    differences = (brdf(wi + step * along, wo) - brdf(wi - step * along, wo)) / (2 * step)
    close = np.isclose(found, differences, rtol=1e-4, atol=1e-4).all(axis=1)
    assert close.mean() > 0.95  # but where a step crosses from one cell to the next


def test_settled_does_not_depend_on_an_azimuth_that_means_nothing():
    brdf = table().settled()
    assert np.ptp(brdf.values[0], axis=1).max() == np.ptp(brdf.values[:, 0], axis=1).max() == 0
    assert_close(brdf.values[0, 2, 0], table().values[0, 2].mean(0))
    assert np.array_equal(brdf.values[1:, 1:], table().values[1:, 1:])
    # Continuous: from all sides of the mirror direction the same value, to the root of a small angle.
    wo, mirror = np.array([0.6, 0, 0.8]), np.array([-0.6, 0, 0.8])
    around = np.linspace(0, 2 * np.pi, 9)
    near = mirror + 1e-5 * np.stack([np.cos(around), np.sin(around), 0 * around], -1)
    near = jnp.asarray(near / np.linalg.norm(near, axis=1, keepdims=True), DTYPE)
    wo, mirror = jnp.asarray(wo, DTYPE), jnp.asarray(mirror, DTYPE)
    exact = np.asarray(brdf(mirror, wo))
    smooth, rough = (np.abs(np.asarray(one(near, wo)) - exact).max() for one in (brdf, table()))
    assert smooth < 0.02 < rough


def test_values_are_parameters_and_nodes_are_none():
    brdf, wi, wo = table(), directions(0, 20), directions(1, 20)
    gradient = jax.grad(lambda brdf: jnp.sum(brdf(wi, wo)))(brdf)
    for nodes in (gradient.theta_h, gradient.theta_d, gradient.phi_d):
        assert np.all(nodes == 0)
    assert_close(np.sum(gradient.values), 20 * 3)  # weights of eight corners add up to 1


def test_transforms_dtypes_and_empty_batches():
    brdf, wi, wo = table(), directions(0, 4, 5), directions(1, 4, 5)
    assert_close(jax.jit(lambda *w: brdf(*w))(wi, wo), brdf(wi, wo))
    assert_close(jax.vmap(lambda *w: brdf(*w))(wi, wo), brdf(wi, wo))
    assert brdf(wi, wo[0, 0]).shape == (4, 5, 3)
    assert brdf(wi[:0], wo[:0]).shape == (0, 5, 3)
    assert brdf(wi.astype(jnp.float32), wo.astype(jnp.float32)).dtype == jnp.float32


def test_measured_nodes_share_the_weight_of_the_others():
    """The quotient of two tables: of values where there are any, and of ones."""
    whole, (*_, wi, wo) = table(), pairs()
    there = np.random.default_rng(5).random(whole.values.shape[:3]) < 0.6
    parts = whole.theta_h, whole.theta_d, whole.phi_d
    unmeasured = jnp.where(jnp.asarray(there)[..., None], whole.values, jnp.nan)  # nothing is read there
    brdf = HalfVectorTable(unmeasured, *parts, measured=jnp.asarray(there))
    held = HalfVectorTable(jnp.where(jnp.asarray(there)[..., None], whole.values, 0), *parts)
    share = np.asarray(HalfVectorTable(jnp.asarray(there[..., None], DTYPE), *parts, channel_names=("Y",))(wi, wo))
    expected = np.where(share > 0, np.asarray(held(wi, wo)) / np.where(share > 0, share, 1), 0)
    # A share of a thousandth magnifies the rounding of angles.
    assert_close(brdf(wi, wo), expected, tolerance=1e-6 if X64 else 5e-2)
    assert np.mean(share < 0.999) > 0.5
    everywhere = HalfVectorTable(whole.values, *parts, measured=jnp.ones(there.shape, bool))
    assert_close(everywhere(wi, wo), whole(wi, wo))


def test_settled_takes_the_mean_of_what_was_measured():
    whole = table()
    there = np.ones(whole.values.shape[:3], bool)
    there[0, 1, :4] = there[0, 2] = there[3, 3, 3] = False
    parts = whole.theta_h, whole.theta_d, whole.phi_d
    settled = HalfVectorTable(whole.values, *parts, measured=jnp.asarray(there)).settled()
    assert_close(settled.values[0, 1, 2], whole.values[0, 1, 4:].mean(0))
    found = np.asarray(settled.measured)
    assert found[0, 1].all()
    assert not found[0, 2].any()
    assert not found[3, 3, 3]


@pytest.mark.parametrize("folded", [False, True])
def test_weights_of_nodes_are_solid_angles(folded):
    """Integrals over pairs, by the rule of the other kind of coordinates."""
    values = np.ones((90, 90, 180, 1))
    samples = HalfVectorTable(
        *(jnp.asarray(part, DTYPE) for part in (values, *MERL)), channel_names=("Y",)
    ).node_samples(folded=folded)
    rule = isotropic_pair_rule(8, dtype=DTYPE)
    # Cells that the horizon cuts are not cut: an error of first order in the steps, where nothing vanishes there.
    for power, tolerance in ((0, 2e-3), (1, 3e-4), (2, 3e-4)):
        found = jnp.sum(samples.weight * (samples.wi[:, 2] * samples.wo[:, 2]) ** power)
        expected = jnp.sum(rule.weight * (rule.wi[:, 2] * rule.wo[:, 2]) ** power)
        np.testing.assert_allclose(found, expected, rtol=tolerance)
    cosine = jnp.sum(samples.wi[:, :2] * samples.wo[:, :2], axis=1)
    found = jnp.sum(samples.weight * cosine**2)
    expected = jnp.sum(rule.weight * jnp.sum(rule.wi[:, :2] * rule.wo[:, :2], axis=1) ** 2)
    np.testing.assert_allclose(found, expected, rtol=3e-3)
    assert samples.isotropic
    assert float(jnp.min(samples.wi[:, 2])) > 0


def test_node_samples_are_the_values_at_the_nodes():
    brdf = table()
    samples = brdf.node_samples()
    seen = np.asarray(samples.weight) > 0
    inside = seen & (np.asarray(samples.value) != 0).all(1)
    assert inside.all()
    # Away from where φ_d means nothing.
    h, d, _ = half_difference_angles(samples.wi, samples.wo)
    tilted = (np.asarray(h) > 1e-3) & (np.asarray(d) > 1e-3)
    assert tilted.sum() > 20
    assert_close(brdf(samples.wi, samples.wo)[tilted], samples.value[tilted], tolerance=1e-7 if X64 else 5e-2)
    there = np.zeros(brdf.values.shape[:3], bool)
    there[2, 1, 3] = True
    parts = brdf.theta_h, brdf.theta_d, brdf.phi_d
    only = HalfVectorTable(brdf.values, *parts, measured=jnp.asarray(there)).node_samples()
    assert only.size == 1
    assert_close(only.value[0], brdf.values[2, 1, 3])


def test_folding_keeps_integrals_of_bilateral_functions():
    brdf = table()
    there = np.random.default_rng(7).random(brdf.values.shape[:3]) < 0.7
    masked = HalfVectorTable(brdf.values, brdf.theta_h, brdf.theta_d, brdf.phi_d, measured=jnp.asarray(there))
    whole, half = masked.node_samples(), masked.node_samples(folded=True)
    assert half.size < 0.9 * whole.size

    def integral(samples):
        even = (samples.wi[:, 2] * samples.wo[:, 2])[:, None] * samples.value
        return jnp.sum(samples.weight[:, None] * even, axis=0)

    assert_close(integral(half), integral(whole), tolerance=1e-10 if X64 else 1e-4)


def test_saved_and_loaded(tmp_path):
    brdf = table(channels=2)
    save_model(tmp_path / "table.hshjax", brdf)
    loaded = load_model(tmp_path / "table.hshjax")
    assert loaded.channel_names == ("R", "G")
    assert np.array_equal(loaded.values, brdf.values)


def test_what_is_refused():
    zeros = np.zeros((3, 2, 1, 1))
    half, difference, azimuth = [0, 0.5, 1.0], [0, 1.0], [0]
    with pytest.raises(ValueError, match=r"values of a table must have shape \(3, 2, 1, 3\)"):
        HalfVectorTable(*map(jnp.asarray, (zeros, half, difference, azimuth)))
    for nodes, message in (
        (([0, 1.0, 0.5], difference, azimuth), "theta_h of a table must rise"),
        ((half, [0, 1.6], azimuth), r"theta_d of a table must rise within \[0, 1.5708\]"),
        ((half, difference, [np.pi]), r"phi_d of a table must rise within \[0, 3.14159\)"),
        ((half, [-0.1, 1.0], azimuth), "theta_d of a table must rise"),
    ):
        with pytest.raises(ValueError, match=message):
            HalfVectorTable(*map(jnp.asarray, (zeros, *nodes)), channel_names=("Y",))
    with pytest.raises(ValueError, match="two nodes along"):
        HalfVectorTable(*map(jnp.asarray, (zeros[:1], half[:1], difference, azimuth)), channel_names=("Y",))
