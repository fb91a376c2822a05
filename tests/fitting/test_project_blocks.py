"""Projections of samples that come block by block: against all of them at once, and blocks that are not in order."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hshjax.bases import HSH, HelmholtzBasis, IsotropicBasis
from hshjax.brdfs import GGX, Lambert
from hshjax.fitting import BlockError, SampleBlocks, project, project_all, project_blocks
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
    monkeypatch.setattr("hshjax.fitting._block_sums.STEP", 512)
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
    with pytest.raises(ValueError, match="no sample to fit: no block came"):
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


@pytest.mark.parametrize("dtype", [">f4", ">f8", np.longdouble, np.float16])
def test_numbers_that_jax_has_not(dtype):
    """And values of fewer digits than directions."""
    parts = dict(zip(("wi", "wo", "value", "weight"), arrays(), strict=True))
    got = project_blocks(BASIS, SampleBlocks(**parts | {"value": parts["value"].astype(dtype)}, rows=700))
    native = parts["value"].astype(np.float16 if dtype == np.float16 else DTYPE)
    expected = project_blocks(BASIS, SampleBlocks(**parts | {"value": native}, rows=700))
    assert_close(got.model.coefficients, expected.model.coefficients, tolerance=1e-5)


def test_memory_in_any_order(unchecked):
    turned = [np.asfortranarray(np.repeat(part, 2, axis=0))[::2] for part in arrays()]
    got = project_blocks(BASIS, SampleBlocks(*turned, rows=np.int64(700), isotropic=True))
    expected = project_blocks(BASIS, SampleBlocks(*arrays(), rows=700, isotropic=True))
    np.testing.assert_array_equal(got.model.coefficients, expected.model.coefficients)


def test_values_that_nothing_can_be_made_of(unchecked):
    value = arrays()[2]
    for wrong, message in (
        (value.astype(complex), "expected real numbers for value, got complex128"),
        (value.astype(str), "expected real numbers for value, got <U"),
        (np.ma.masked_array(value, value > 1), "value is a masked array: mask samples by the weight 0"),
        (value[:, :0], "no sample to fit: values have no channel"),
    ):
        wi, wo, _, weight = arrays()
        with pytest.raises(BlockError, match=f"block 0: {message}"):
            project_blocks(BASIS, SampleBlocks(wi, wo, wrong, weight))


def test_half_floats_throughout(unchecked):
    halves = jax.tree.map(lambda a: a.astype(jnp.float16), cut(whole(), 5)[0])
    message = "samples must be float32 or float64, got float16: convert them before the fit"
    with pytest.raises(BlockError, match=f"block 0: {message}"):
        project_blocks(BASIS, [halves], ridge=1.0)
    with pytest.raises(ValueError, match=message):
        project(BASIS, halves, ridge=1.0)


def test_arguments_of_another_kind(unchecked):
    with pytest.raises(TypeError, match=r"wi must be an array, got str 'wi.npy'"):
        SampleBlocks("wi.npy", "wo.npy", "value.npy")
    with pytest.raises(TypeError, match="of Samples in memory `project` makes the fit"):
        project_blocks(BASIS, whole())
    with pytest.raises(TypeError, match=r"a basis of pairs of directions, .* got HSH\("):
        project_blocks(HSH(1), cut(whole(), 5))
    for fitted, samples in ((project, whole()), (project_blocks, [whole()])):
        with pytest.raises(TypeError, match=r"must be a mesh of jax, such as device_mesh\(4\), got 4"):
            fitted(BASIS, samples, mesh=4)
    for samples, kind in ((whole(), "Samples"), (iter([whole()]), "list_iterator"), ([1], "list")):
        with pytest.raises(TypeError, match=f"a list of Samples, one for each material, got {kind}"):
            project_all(BASIS, samples)


class Counted(SampleBlocks):
    """Says which blocks were read, and breaks at one of them."""

    broken: int | None = None

    def __init__(self, *arguments, **settings):
        super().__init__(*arguments, **settings)
        self.read = []

    def __getitem__(self, number):
        if number == self.broken:
            raise OSError("the disk is gone")
        self.read.append(number)
        return super().__getitem__(number)


def blocks_of(rows=300):
    return Counted(*arrays(), rows=rows, isotropic=True)


def interrupted(folder, at=4, **settings):
    """A run with a checkpoint that breaks at a block."""
    blocks = blocks_of()
    blocks.broken = at
    with pytest.raises(OSError, match="the disk is gone") as caught:
        project_blocks(BASIS, blocks, checkpoint=folder, every=0.0, **settings)
    assert caught.value.__notes__ == [f"while block {at} of samples was read"]


@pytest.mark.parametrize("norm", ["D", "C"])  # the second carries a second factor
def test_a_run_goes_on_after_the_blocks_that_are_in(norm, tmp_path, unchecked):
    interrupted(tmp_path, norm=norm)
    blocks, said = blocks_of(), []
    settings = {"norm": norm, "ridge": 1e-3, "covariance": True}  # which may differ from those before
    got = project_blocks(
        BASIS, blocks, checkpoint=tmp_path, on_block=lambda number, of: said.append((number, of)), **settings
    )
    assert blocks.read == list(range(3, 10)), "the last that is in is looked at again"
    assert said == [(k, 10) for k in range(4, 10)]
    assert not list(tmp_path.iterdir())
    expected = project_blocks(BASIS, blocks_of(), **settings)
    assert got.samples == expected.samples
    for name in ("residual", "relative", "covariance", "noise"):
        assert_close(getattr(got, name), getattr(expected, name), tolerance=None if X64 else 1e-3)
    assert_close(got.model.coefficients, expected.model.coefficients, tolerance=None if X64 else 1e-3)


def test_a_generator_goes_on_too(tmp_path, unchecked):
    interrupted(tmp_path)
    got = project_blocks(BASIS, cut(whole(), *range(300, N, 300)).__iter__(), checkpoint=None)
    with pytest.raises(ValueError, match="whose length was 10 and is None now"):
        project_blocks(BASIS, iter(blocks_of()), checkpoint=tmp_path)
    (file,) = tmp_path.iterdir()
    file.unlink()

    def breaking():
        yield from blocks_of()[:4]
        raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        project_blocks(BASIS, breaking(), checkpoint=tmp_path, every=0.0)
    again = project_blocks(BASIS, iter(blocks_of()), checkpoint=tmp_path)
    assert_close(again.model.coefficients, got.model.coefficients, tolerance=None if X64 else 1e-3)


def test_what_is_in_is_kept_where_it_does_not_determine_the_fit(tmp_path):
    few = SampleBlocks(*(array[:8] for array in arrays()), rows=4, isotropic=True)
    with pytest.raises(ValueError, match="there are 10 unknowns"):
        project_blocks(BASIS, few, checkpoint=tmp_path)
    assert project_blocks(BASIS, few, checkpoint=tmp_path, ridge=1e-2).unknowns == 10


def test_a_checkpoint_of_another_run_is_refused(tmp_path, unchecked):
    interrupted(tmp_path)
    for changed, words in {
        "basis": (IsotropicBasis(HSH(1)), {}),
        "norm": (BASIS, {"norm": "A"}),
    }.items():
        with pytest.raises(ValueError, match=f"is of another run, whose {changed} was .* and is .* now: take another"):
            project_blocks(words[0], blocks_of(), checkpoint=tmp_path, **words[1])
    with pytest.raises(ValueError, match="whose length was 10 and is 30 now"):
        project_blocks(BASIS, blocks_of(100), checkpoint=tmp_path)
    other = SampleBlocks(*(np.asarray(array, np.float16) for array in arrays()), rows=300, isotropic=True)
    with pytest.raises(BlockError, match=r"block 3: expected dtype .* got float16"):
        project_blocks(BASIS, other, checkpoint=tmp_path)
    (file,) = tmp_path.iterdir()
    file.rename(tmp_path / "blocks-0-of-3.npz")
    with pytest.raises(ValueError, match="holds what 3 processes have done, and the run has 1 now"):
        project_blocks(BASIS, blocks_of(), checkpoint=tmp_path)


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:200] + b"?" + b[201:]])
def test_a_damaged_checkpoint_is_refused_by_name(damage, tmp_path, unchecked):
    interrupted(tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(ValueError, match=r"blocks-0-of-1.npz is damaged .*: remove it to begin anew"):
        project_blocks(BASIS, blocks_of(), checkpoint=tmp_path)


def test_nothing_half_written_is_taken_for_finished(tmp_path, monkeypatch, unchecked):
    interrupted(tmp_path)
    (file,) = tmp_path.iterdir()
    before = file.read_bytes()

    def cut_short(descriptor):
        raise OSError("no space left")

    monkeypatch.setattr("os.fsync", cut_short)
    with pytest.raises(OSError, match="no space left"):
        project_blocks(BASIS, blocks_of(), checkpoint=tmp_path, every=0.0)
    assert [one.name for one in tmp_path.iterdir()] == [file.name]
    assert file.read_bytes() == before


def test_arrays_that_become_shorter(unchecked):
    parts = [np.asarray(array) for array in arrays()]

    class Shortened:
        """As a file that was truncated behind its header."""

        shape, dtype = parts[2].shape, parts[2].dtype

        def __getitem__(self, rows):
            return parts[2][: N - 700][rows]

    blocks = SampleBlocks(parts[0], parts[1], Shortened(), parts[3], rows=1000, isotropic=True)
    with pytest.raises(BlockError, match="block 2: expected 1000 rows of value from 2000 on, got 300"):
        project_blocks(BASIS, blocks)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"every": -1.0}, "every must be >= 0"),
        ({"timeout": 0.0}, "timeout"),
        ({"verify": "some"}, "verify must be one of last, all, got 'some'"),
    ],
)
def test_settings_that_make_no_sense(changed, message, tmp_path, unchecked):
    with pytest.raises(ValueError, match=message):
        project_blocks(BASIS, blocks_of(), checkpoint=tmp_path, **changed)
