"""Projections of samples that come block by block: against all of them at once, and blocks that are not in order."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HelmholtzBasis, IsotropicBasis
from hshjax.brdfs import GGX, Lambert
from hshjax.fitting import BlockError, SampleBlocks, project, project_blocks
from hshjax.fitting._sample_blocks import regrouped
from hshjax.samples import Samples
from tests.helpers import DTYPE, X64, assert_close, directions, slow_unless

BASIS = IsotropicBasis(HSH(2))
N = 3000


def arrays(seed=0):
    wi, wo = directions(seed, N, min_z=0.05), directions(seed + 1, N, min_z=0.05)
    rng = np.random.default_rng(seed)
    value = np.array(
        (Lambert(jnp.asarray([0.2, 0.6], DTYPE)) + GGX(jnp.ones(2, DTYPE), jnp.asarray(0.5, DTYPE)))(wi, wo)
    )
    weight = rng.uniform(0.5, 2, N).astype(value.dtype)
    masked = rng.random(N) < 0.1
    value[masked], weight[masked] = np.nan, 0
    return np.asarray(wi), np.asarray(wo), value, weight


def whole(isotropic=True):
    wi, wo, value, weight = map(jnp.asarray, arrays())
    return Samples.scattered(wi, wo, value, weight, isotropic=isotropic)


def cut(samples, *ends):
    """At these places."""
    parts = [samples.wi, samples.wo, samples.value, samples.weight]
    ends = (0, *ends, samples.size)
    return [Samples(*(p[a:b] for p in parts), None, samples.isotropic) for a, b in itertools.pairwise(ends)]


@pytest.mark.parametrize(
    ("norm", "ridge"),
    [slow_unless((norm, ridge) in {("D", 0.0), ("C", 1e-2)}, norm, ridge) for norm in "ABCDE" for ridge in (0.0, 1e-2)],
)
def test_the_same_as_all_at_once(norm, ridge, monkeypatch):
    monkeypatch.setattr("hshjax.fitting._project_blocks.STEP", 512)
    settings = {"norm": norm, "ridge": ridge, "prior": "spectral" if ridge else None, "covariance": True}
    expected = project(BASIS, whole(), reciprocity=False, **settings)
    for blocks in (cut(whole()), cut(whole(), 1, 2, 700, 700, 2990), iter(cut(whole(), 512, 1024))):
        got = project_blocks(BASIS, blocks, **settings)
        assert (got.samples, got.unknowns, got.method, got.norm) == (expected.samples, expected.unknowns, "QR", norm)
        assert got.model.target == expected.model.target
        # float32: unknowns of a condition number of some ten.
        tolerance = None if X64 else 1e-3
        assert_close(got.model.coefficients, expected.model.coefficients, tolerance=tolerance)
        for name in ("residual", "relative", "condition", "covariance", "noise"):
            scale = np.abs(getattr(expected, name)).max()
            assert_close(getattr(got, name) / scale, getattr(expected, name) / scale, tolerance=tolerance)


def test_blocks_of_mapped_files(tmp_path):
    names = ("wi", "wo", "value", "weight")
    for name, array in zip(names, arrays(), strict=True):
        np.save(tmp_path / f"{name}.npy", array)
    mapped = {name: np.load(tmp_path / f"{name}.npy", mmap_mode="r") for name in names}
    blocks = SampleBlocks(**mapped, rows=1000, isotropic=True)
    assert [block.size for block in blocks] == [1000, 1000, 1000]
    assert blocks[-1].size == 1000
    assert [block.size for block in blocks[1:]] == [1000, 1000]
    assert len(SampleBlocks(**mapped, rows=999)) == 4
    got = project_blocks(BASIS, blocks)
    assert_close(got.model.coefficients, project(BASIS, whole()).model.coefficients, tolerance=None if X64 else 1e-3)


@pytest.mark.parametrize("sizes", [(), (0,), (5,), (7, 0, 1), (3, 30, 4), (10,), (10, 10)])
def test_regrouped_blocks_hold_every_sample_once_in_order(sizes):
    def block(start, n):
        w = jnp.tile(jnp.asarray([0, 0, 1], DTYPE), (n, 1))
        return Samples.scattered(w, w, jnp.arange(start, start + n, dtype=DTYPE)[:, None])

    starts = np.cumsum([0, *sizes])
    blocks = list(regrouped((block(int(s), n) for s, n in zip(starts, sizes, strict=False)), 10))
    total = int(starts[-1])
    assert [one.size for one in blocks] == [10] * -(-total // 10)
    value = np.concatenate([np.zeros((0, 1)), *(one.value for one in blocks)])[:, 0]
    weight = np.concatenate([np.zeros(0), *(one.weight for one in blocks)])
    np.testing.assert_array_equal(value[:total], np.arange(total))
    np.testing.assert_array_equal(weight, np.arange(weight.size) < total)


def broken(kind):
    first, second = cut(whole(), 2000)
    if kind == "no samples":
        return iter([first, "second"])
    if kind == "channels":
        return [first, dataclasses.replace(second, value=second.value[:, :1])]
    if kind == "dtype":
        other = jnp.float16
        return [first, jax.tree.map(lambda a: a.astype(other), second)]
    if kind == "isotropic":
        return [first, dataclasses.replace(second, isotropic=False)]
    if kind == "nan":
        return [
            first,
            dataclasses.replace(second, value=second.value.at[3].set(jnp.nan), weight=second.weight.at[3].set(1)),
        ]
    if kind == "weight":
        return [first, second.reweighted(second.weight.at[3].set(-1))]
    raise ValueError(kind)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("no samples", "block 1: expected Samples, got str"),
        ("channels", "block 1: expected channels 2 as of block 0, got 1"),
        ("dtype", "block 1: expected dtype .* as of block 0, got float16"),
        ("isotropic", "block 1: expected isotropic True as of block 0, got False"),
        ("nan", "block 1: 1 of .* hold NaN or infinite values"),
        ("weight", "block 1: 1 of 1000 weights are negative"),
    ],
)
def test_the_error_names_the_block(kind, message):
    with pytest.raises(BlockError, match=message) as caught:
        project_blocks(BASIS, broken(kind))
    assert caught.value.block == 1


def test_a_source_that_ends_early_or_breaks():
    class Short(list):
        def __iter__(self):
            return iter(list.__iter__(self).__next__() for _ in range(1))

    with pytest.raises(BlockError, match="block 1: expected 2 blocks, as many as their length says, got 1"):
        project_blocks(BASIS, Short(cut(whole(), 2000)))

    def breaking():
        yield cut(whole(), 2000)[0]
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone") as caught:
        project_blocks(BASIS, breaking())
    assert "block 1" in caught.value.__notes__[0]


def test_what_all_blocks_together_lack():
    with pytest.raises(ValueError, match="no sample to fit"):
        project_blocks(BASIS, [])
    few = Samples.scattered(*(jnp.asarray(w[:3]) for w in arrays()[:2]), jnp.ones((3, 1), DTYPE))
    with pytest.raises(ValueError, match="3 samples count in norm D, but there are 10 unknowns"):
        project_blocks(BASIS, cut(few, 1))
    with pytest.raises(BlockError, match="block 0: isotropic samples say nothing"):
        project_blocks(HelmholtzBasis(HSH(1)), cut(whole(), 5))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"rows": 0}, "at least 1, got 0"),
        ({"value": np.ones(N)}, "value of shape"),
        ({"wo": np.ones((4, 3))}, "wo of shape"),
    ],
)
def test_arrays_that_do_not_fit_together(changed, message):
    parts = dict(zip(("wi", "wo", "value", "weight"), arrays(), strict=True)) | changed
    with pytest.raises(ValueError, match=message):
        SampleBlocks(**parts)
