"""Laws of what is spread over devices: `test_mesh` runs this file in a process that has eight."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh

from hshjax.bases import HSH, IsotropicBasis
from hshjax.brdfs import GGX, Lambert
from hshjax.fitting import (
    SampleBlocks,
    SampleMisfit,
    device_mesh,
    fit,
    map_over_mesh,
    project,
    project_all,
    project_blocks,
    project_pixels,
)
from hshjax.quadrature import isotropic_pair_rule
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, directions, slow_unless

BASIS = IsotropicBasis(HSH(2))
TOLERANCE = None if X64 else 1e-3
"""Of unknowns with a condition number of some ten, in float32."""


def brdf(wi, wo):
    return (Lambert(jnp.asarray([0.2, 0.6], DTYPE)) + GGX(jnp.ones(2, DTYPE), jnp.asarray(0.5, DTYPE)))(wi, wo)


def samples(n=1003, seed=0):
    """Some masked, and not a multiple of any number of devices."""
    wi, wo = directions(seed, n, min_z=0.05), directions(seed + 1, n, min_z=0.05)
    rng = np.random.default_rng(seed)
    value, weight = np.array(brdf(wi, wo)), rng.uniform(0.5, 2, n).astype(DTYPE)
    masked = rng.random(n) < 0.1
    value[masked], weight[masked] = np.nan, 0
    return Samples.scattered(wi, wo, jnp.asarray(value), jnp.asarray(weight), isotropic=True)


def assert_same(got, expected):
    for name in ("samples", "unknowns", "method", "norm"):
        assert getattr(got, name) == getattr(expected, name)
    assert_close(got.model.coefficients, expected.model.coefficients, tolerance=TOLERANCE)
    for name in ("residual", "relative", "condition", "covariance", "noise"):
        if getattr(expected, name) is not None:
            scale = np.abs(getattr(expected, name)).max()
            assert_close(getattr(got, name) / scale, getattr(expected, name) / scale, tolerance=TOLERANCE)


@pytest.mark.parametrize(("devices", "norm"), [(2, "D"), (4, "C"), (8, "A")])
def test_project_is_that_of_one_device(devices, norm):
    data, settings = samples(), {"norm": norm, "ridge": 1e-2, "prior": "spectral", "covariance": True}
    got = project(BASIS, data, mesh=device_mesh(devices), **settings)
    assert_same(got, project(BASIS, data, **settings))
    assert_close(got.reciprocity_after.maximum, project(BASIS, data, **settings).reciprocity_after.maximum)
    elsewhere = jax.device_put(got.model.coefficients, jax.devices()[5])
    assert_close(got.model.coefficients + elsewhere, 2 * elsewhere)  # the result meets arrays of any device


@pytest.mark.parametrize("devices", [slow_unless(devices == 4, devices) for devices in (2, 4, 8)])
def test_inner_products_are_those_of_one_device(devices):
    rule = Samples.from_function(brdf, isotropic_pair_rule(4, dtype=DTYPE))
    assert rule.size % devices != 0 or devices == 2
    got = project(BASIS, rule, mesh=device_mesh(devices))
    assert got.method == "inner products"
    assert_same(got, project(BASIS, rule))


def test_axes_of_the_mesh_do_not_matter():
    data = samples()
    expected = project(BASIS, data, norm="A")
    for mesh in (
        jax.make_mesh((4, 2), ("a", "b")),  # whose axes are Explicit
        Mesh(np.asarray(jax.devices()[3:6]), ("samples",)),
        device_mesh(1),
    ):
        assert_same(project(BASIS, data, norm="A", mesh=mesh), expected)


def test_fewer_samples_than_devices():
    few = samples(5)
    settings = {"ridge": 1e-2, "reciprocity": False}
    assert_same(project(BASIS, few, mesh=device_mesh(8), **settings), project(BASIS, few, **settings))


@pytest.mark.slow
def test_samples_that_are_on_the_mesh_already():
    data = samples(1000)
    spread = jax.device_put(data, jax.NamedSharding(device_mesh(4), jax.P("devices")))
    assert_same(project(BASIS, spread, mesh=device_mesh(4)), project(BASIS, data))


def test_derivatives_are_those_of_one_device():
    data = samples(203)

    def loss(value, mesh):
        fit = project(BASIS, eqx.tree_at(lambda s: s.value, data, value), mesh=mesh, norm="A", reciprocity=False)
        return jnp.sum(fit.model.coefficients**2) + jnp.sum(fit.residual)

    value = jnp.where(data.weight[:, None] > 0, data.value, 0)
    mesh = device_mesh(4)
    got = jax.jit(jax.grad(lambda value: loss(value, mesh)))(value)
    assert_close(got, jax.jit(jax.grad(lambda value: loss(value, None)))(value), tolerance=TOLERANCE)


@pytest.mark.slow
def test_second_derivatives_are_those_of_one_device():
    data = samples(203)
    tangent = jax.random.normal(jax.random.key(0), data.value.shape, DTYPE)
    value = jnp.where(data.weight[:, None] > 0, data.value, 0)

    def slope(mesh):
        def loss(value):
            fit = project(BASIS, eqx.tree_at(lambda s: s.value, data, value), mesh=mesh, norm="A", reciprocity=False)
            return jnp.sum(fit.model.coefficients**4) + jnp.sum(fit.residual)

        return jax.jvp(jax.grad(loss), (value,), (tangent,))[1]

    assert_close(slope(device_mesh(4)), slope(None), tolerance=TOLERANCE)


@pytest.mark.slow
def test_under_vmap():
    data = samples(101)
    values = jnp.stack([data.value, 2 * data.value])

    def coefficients(value, mesh=None):
        one = eqx.tree_at(lambda s: s.value, data, value)
        return project(BASIS, one, mesh=mesh, ridge=1e-2).model.coefficients

    got = jax.vmap(lambda value: coefficients(value, device_mesh(4)))(values)
    assert_close(got, jax.vmap(coefficients)(values), tolerance=TOLERANCE)


@pytest.mark.slow
def test_constraints():
    data = samples()
    got, expected = (
        project(BASIS, data, constraints=("non_negative",), mesh=mesh, ridge=1e-3) for mesh in (device_mesh(2), None)
    )
    assert got.certificate.holds
    assert_close(got.model.coefficients, expected.model.coefficients, tolerance=1e-6 if X64 else 1e-3)


def test_many_materials():
    one, other = samples(), eqx.tree_at(lambda s: s.value, samples(), 3 * samples().value)
    for got, expected in zip(
        project_all(BASIS, [one, other], mesh=device_mesh(8)), project_all(BASIS, [one, other]), strict=True
    ):
        assert_same(got, expected)


def test_a_mesh_of_more_devices_than_there_are():
    assert device_mesh().size == 8
    with pytest.raises(ValueError, match=r"a mesh of 9 devices was asked for, and jax has 8; .*jax_num_cpu_devices"):
        device_mesh(9)
    with pytest.raises(ValueError, match="a mesh of 0 devices"):
        device_mesh(0)


@pytest.mark.parametrize("devices", [slow_unless(devices == 4, devices) for devices in (2, 4, 8)])
def test_blocks_are_those_of_one_device(devices, monkeypatch):
    monkeypatch.setattr("hshjax.fitting._block_sums.STEP", 128)
    data = samples()
    parts = [data.wi, data.wo, data.value, data.weight]
    blocks = SampleBlocks(*map(np.asarray, parts), rows=301, isotropic=True)
    got = project_blocks(BASIS, blocks, mesh=device_mesh(devices), norm="C", covariance=True)
    assert_same(got, project_blocks(BASIS, blocks, norm="C", covariance=True))


@pytest.mark.parametrize("devices", [slow_unless(devices == 4, devices) for devices in (2, 4, 8)])
def test_pixels_are_those_of_one_device(devices, tmp_path):
    lights = np.asarray(directions(0, 20, min_z=0.2))
    rng = np.random.default_rng(0)
    values = rng.uniform(0, 1, (103, 20, 3)).astype(DTYPE)
    values[rng.random((103, 20)) < 0.03] = np.nan
    values[50, 5:] = np.nan
    got = project_pixels(HSH(2), lights, values, rows=30, mesh=device_mesh(devices), out=tmp_path / "out.npy")
    expected = project_pixels(HSH(2), lights, values)
    assert_close(got.coefficients, expected.coefficients, tolerance=TOLERANCE)
    assert_close(got.residual, expected.residual)
    assert (got.partial, got.undetermined) == (expected.partial, 1)


def test_materials_are_fitted_as_on_one_device():
    """Three materials on two devices."""
    wi, wo = directions(0, 50, min_z=0.1), directions(1, 50, min_z=0.1)
    albedo = jnp.asarray([0.2, 0.5, 0.8], DTYPE)
    batch = jax.vmap(lambda a: Samples.scattered(wi, wo, Lambert(a[None])(wi, wo)))(albedo)

    def one(data):
        return fit(Lambert(jnp.asarray([0.4], DTYPE)), {"data": SampleMisfit(data)}, throw=False)

    got, expected = map_over_mesh(one, batch, device_mesh(2)), jax.vmap(one)(batch)
    assert_close(got.model.albedo[:, 0], albedo, tolerance=1e-5)
    assert jax.tree.structure(got) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
        assert_close(a, b)
    for bad in (jnp.zeros(()), (jnp.zeros(2), jnp.zeros(3)), jnp.zeros(0)):
        with pytest.raises(ValueError, match="a leading axis of equal length, at least 1"):
            map_over_mesh(lambda x: x, bad, device_mesh(2))


def test_keys_are_shared_out_too():
    keys = jax.random.split(jax.random.key(0), 3)

    def one(start):
        return jax.random.normal(start[0], (2,), DTYPE) * start[1]

    scales = jnp.arange(3, dtype=DTYPE)
    assert_close(map_over_mesh(one, (keys, scales), device_mesh(2)), jax.vmap(one)((keys, scales)))


@pytest.mark.parametrize("kind", ["threefry2x32", "rbg"])
def test_keys_come_back(kind):
    """Alone, and among other results; three on two devices, and no more than devices."""
    keys = jax.random.split(jax.random.key(0, impl=kind), 3)

    def one(key):
        return {"next": key, "two": (jax.random.split(key), jnp.zeros(2, DTYPE)), "word": "a"}

    for devices in (2, 8):
        got, expected = map_over_mesh(one, keys, device_mesh(devices)), jax.vmap(lambda key: one(key)["two"])(keys)
        assert got["word"] == "a"
        for key, whole in ((got["next"], keys), (got["two"][0], expected[0])):
            assert key.dtype == whole.dtype
            np.testing.assert_array_equal(jax.random.key_data(key), jax.random.key_data(whole))
    again = map_over_mesh(lambda key: key, map_over_mesh(lambda key: key, keys, device_mesh(2)), device_mesh(4))
    np.testing.assert_array_equal(jax.random.key_data(again), jax.random.key_data(keys))


def test_a_batch_is_not_shared_out_inside_a_transformation():
    with pytest.raises(ValueError, match="inside a transformation of jax map_over_mesh cannot share out a batch"):
        jax.jit(lambda x: map_over_mesh(lambda y: y, x, device_mesh(2)))(jnp.zeros(4, DTYPE))
