"""Models: bit by bit there and back, and no harm from files that are none."""

import json
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from hshjax.bases import HSH, SHR, HalfVectorBasis, IdentityWarp, RationalWarp, Zernike
from hshjax.brdfs import AbstractBRDF
from hshjax.io import FileFormatError, load_model, read_rgl, save_model
from tests.helpers import DTYPE, directions
from tests.io.tensor_files import material, packed


class Pair(eqx.Module):
    """Anything a model may hold."""

    basis: HSH
    coefficients: jax.Array
    extras: object
    note: str = eqx.field(static=True, default="")
    scale: object = eqx.field(static=True, default=None)


class Constant(AbstractBRDF):
    albedo: jax.Array

    def formula(self, wi, wo):
        return jnp.broadcast_to(self.albedo[None, :], (*wi.shape[:-1], self.albedo.shape[0]))


def assert_same(a, b):
    """Equal structure, types and bits."""
    leaves_a, tree_a = jax.tree.flatten(a)
    leaves_b, tree_b = jax.tree.flatten(b)
    assert tree_a == tree_b
    for x, y in zip(leaves_a, leaves_b, strict=True):
        assert type(x) is type(y)
        if isinstance(x, jax.Array | np.ndarray):
            assert x.dtype == y.dtype
            assert x.shape == y.shape
            assert np.asarray(x).tobytes() == np.asarray(y).tobytes()
        else:
            assert x == y


def again(model, tmp_path, **kwargs):
    save_model(tmp_path / "a.model", model)
    return load_model(tmp_path / "a.model", **kwargs)


@pytest.mark.parametrize("basis", [HSH(4), SHR(3), Zernike(6)], ids=str)
def test_bases(basis, tmp_path):
    assert again(basis, tmp_path) == basis


def test_half_vector_bases_of_before_they_warped_the_difference(tmp_path):
    """The field that such files lack means what functions were then; no other may be missing."""
    path, basis = tmp_path / "a.model", HalfVectorBasis(5, RationalWarp(jnp.asarray(0.02, DTYPE)))
    save_model(path, basis)
    header, _, blob = path.read_bytes().partition(b"\n")
    header = json.loads(header)
    fields = header["model"]["fields"]
    assert fields.pop("difference_warp") == {"module": "IdentityWarp", "of": "hshjax", "fields": {}}
    path.write_bytes(json.dumps(header).encode() + b"\n" + blob)
    loaded = load_model(path)
    assert_same(loaded, basis)
    assert isinstance(loaded.difference_warp, IdentityWarp)
    del fields["warp"]
    path.write_bytes(json.dumps(header).encode() + b"\n" + blob)
    with pytest.raises(FileFormatError, match=r"HalfVectorBasis: expected the fields .*, got \['functions'\]"):
        load_model(path)


def test_everything_a_model_may_hold(tmp_path):
    rng = np.random.default_rng(0)
    extras = {
        "all": [None, True, 3, -0.0, "ü\n", (1.5, [2**70])],
        "special": jnp.asarray([np.nan, np.inf, -0.0, 1e-45], jnp.float32),
        "scalar": jnp.asarray(7, jnp.int32),
        "empty": jnp.zeros((0, 5), DTYPE),
        "flags": jnp.asarray([True, False]),
        "short": jnp.asarray([1.5, 2.5], jnp.bfloat16),
        "host": rng.normal(size=(2, 3)).astype(np.float64),
        "column-major": np.asfortranarray(rng.normal(size=(4, 3))),
        "complex": jnp.asarray([1 + 2j], jnp.complex64),
    }
    model = Pair(HSH(2), jnp.asarray(rng.normal(size=(9, 3)), DTYPE), extras, "static", (float("inf"), 0.1))
    loaded = again(model, tmp_path, types=(Pair,))
    assert_same(loaded, model)
    assert (loaded.note, loaded.scale) == (model.note, model.scale)


def test_sums_and_multiples_of_brdfs(tmp_path):
    model = 2.0 * Constant(jnp.asarray([0.1, 0.2, 0.3], DTYPE)) + Constant(jnp.asarray([0.5], DTYPE))
    loaded = again(model, tmp_path, types=(Constant,))
    assert_same(loaded, model)
    wi, wo = directions(0, 5), directions(1, 5)
    assert np.array_equal(loaded(wi, wo), model(wi, wo))


def test_measured_materials(tmp_path):
    (tmp_path / "small.bsdf").write_bytes(packed(material()))
    brdf = read_rgl(tmp_path / "small.bsdf")
    loaded = again(brdf, tmp_path)
    assert_same(loaded, brdf)
    assert loaded.description == "Kupfer, gebürstet"


def test_the_first_line_is_readable(tmp_path):
    save_model(tmp_path / "a.model", HSH(4))
    header = json.loads((tmp_path / "a.model").read_text().splitlines()[0])
    assert (header["format"], header["version"], header["bytes"]) == ("hshjax-model", 1, 0)
    assert header["model"] == {"module": "HSH", "of": "hshjax", "fields": {"order": 4}}


def test_overwrites_whole_and_leaves_nothing_beside(tmp_path):
    save_model(tmp_path / "a.model", HSH(4))
    save_model(tmp_path / "a.model", HSH(5))
    assert load_model(tmp_path / "a.model") == HSH(5)
    with pytest.raises(TypeError):
        save_model(tmp_path / "a.model", Constant(lambda: 0))
    assert load_model(tmp_path / "a.model") == HSH(5)
    assert [p.name for p in tmp_path.iterdir()] == ["a.model"]


class Stubborn(eqx.Module):
    doubled: jax.Array

    def __init__(self, value):
        self.doubled = 2 * value


@pytest.mark.parametrize(
    ("model", "match"),
    [
        (Pair(HSH(1), jnp.zeros(4), [len]), r"Pair.extras\[0\] cannot be saved: .* got builtin_function"),
        (Pair(HSH(1), jnp.zeros(4), {1: 2}), r"Pair.extras cannot be saved: .* got dict"),
        (Pair(HSH(1), jnp.zeros(4), np.asarray(["a"])), r"Pair.extras cannot be saved: expected a number type"),
        (Pair(HSH(1), jnp.zeros(4), jax.random.key(0)), r"Pair.extras cannot be saved: expected a number type"),
        (Stubborn(jnp.ones(2)), r"Stubborn cannot be saved: expected Stubborn to be built from its fields \(doubled\)"),
    ],
)
def test_what_cannot_be_saved_is_said(model, match, tmp_path):
    with pytest.raises(TypeError, match=match):
        save_model(tmp_path / "a.model", model)
    assert not list(tmp_path.iterdir())


def test_unknown_classes_are_not_built(tmp_path):
    model = Constant(jnp.ones(3, DTYPE))
    with pytest.raises(FileFormatError, match=r"line 1, model: .*types=\(\.\.\.\), got 'Constant' of '.*test_model'"):
        again(model, tmp_path)
    for name in ("_Private", "jnp", "Float", "AbstractBasis", "bounded", "__builtins__"):
        write(tmp_path / "a.model", {"module": name, "of": "hshjax", "fields": {}})
        with pytest.raises(FileFormatError, match="line 1, model"):
            load_model(tmp_path / "a.model")


def test_float64_is_never_cast_in_silence(tmp_path):
    with jax.enable_x64(True):
        model = Constant(jnp.asarray([1 / 3], jnp.float64))
        save_model(tmp_path / "a.model", model)
        assert_same(load_model(tmp_path / "a.model", (Constant,)), model)
    with jax.enable_x64(False):
        with pytest.raises(ValueError, match=r"model\.albedo is float64 .* set jax_enable_x64"):
            load_model(tmp_path / "a.model", (Constant,))
        loaded = load_model(tmp_path / "a.model", (Constant,), dtype=jnp.float32)
        assert loaded.albedo.dtype == jnp.float32
        assert loaded.albedo[0] == np.float32(1 / 3)


def test_the_saved_type_does_not_depend_on_the_configuration(tmp_path):
    model = Constant(jnp.asarray([1 / 3], jnp.float32))
    save_model(tmp_path / "a.model", model)
    for x64 in (True, False):
        with jax.enable_x64(x64):
            assert_same(load_model(tmp_path / "a.model", (Constant,)), model)


def write(path, tree, blob: bytes = b"", **changes):
    import zlib

    header = {"format": "hshjax-model", "version": 1, "bytes": len(blob), "crc32": zlib.crc32(blob), "model": tree}
    path.write_bytes(json.dumps(header | changes).encode() + b"\n" + blob)


def constant(array) -> dict:
    return {"module": "Constant", "of": "there", "fields": {"albedo": array}}


F4 = {"array": "float32", "shape": [2]}
MALFORMED = {
    "another format": ({"tree": None, "format": "other"}, "line 1: expected a line of JSON"),
    "a newer version": ({"tree": None, "version": 2, "library": "9.0"}, "line 1, version: .*got 2 .*9.0: a newer one"),
    "a version that is no number": ({"tree": None, "version": "x"}, "line 1, version: expected 1, got 'x'"),
    "truncated arrays": ({"tree": constant(F4), "blob": b"1234", "bytes": 8}, r"got 4 \(truncated\)"),
    "trailing bytes": ({"tree": constant(F4), "blob": b"123456789", "bytes": 8}, r"got 9 \(trailing bytes\)"),
    "changed bytes": ({"tree": constant(F4), "blob": b"12345678", "crc32": 0}, "expected bytes of CRC-32 0"),
    "no size": ({"tree": constant(F4), "bytes": None}, "line 1, bytes: expected an integer"),
    "a shape that needs more": (
        {"tree": constant(F4 | {"shape": [3]}), "blob": b"12345678"},
        "albedo, shape: .*8 bytes",
    ),
    "a shape that needs less": ({"tree": constant(F4 | {"shape": [1]}), "blob": b"12345678"}, "expected 4 bytes"),
    "an absurd shape": ({"tree": constant(F4 | {"shape": [2**62, 4]}), "blob": b"12345678"}, "albedo, shape"),
    "an absurd empty shape": ({"tree": constant(F4 | {"shape": [0, 2**62]})}, "albedo, shape"),
    "a negative shape": (
        {"tree": constant(F4 | {"shape": [-1]}), "blob": b"12345678"},
        "albedo, shape: .*integers >= 0",
    ),
    "an object type": ({"tree": constant({"array": "object", "shape": [1]}), "blob": b"12345678"}, "got 'object'"),
    "a missing field": ({"tree": {"module": "HSH", "of": "hshjax", "fields": {}}}, r"fields \['order'\], got \[\]"),
    "a field too many": ({"tree": {"module": "HSH", "of": "hshjax", "fields": {"order": 1, "x": 2}}}, "'x'"),
    "a value that fails": ({"tree": {"module": "HSH", "of": "hshjax", "fields": {"order": -1}}}, "order must be"),
    "an order that nothing can hold": (
        {"tree": {"module": "HSH", "of": "hshjax", "fields": {"order": 10**9}}},
        "model.order: expected an order of at most 512",
    ),
    "more functions than coefficients": (
        {
            "tree": {
                "module": "LinearBRDF",
                "of": "hshjax",
                "fields": {
                    "basis": {
                        "module": "HelmholtzBasis",
                        "of": "hshjax",
                        "fields": {"basis": {"module": "HSH", "of": "hshjax", "fields": {"order": 300}}},
                    },
                    "coefficients": F4 | {"shape": [1, 1]},
                    "target": "brdf",
                },
            },
            "blob": b"1234",
        },
        r"must have shape \(4104315901, channels\)",
    ),
    "a basis that is none": (
        {"tree": {"module": "HelmholtzBasis", "of": "hshjax", "fields": {"basis": "evil"}}},
        "needs a basis of single directions, got 'evil'",
    ),
    "a sum of nothing": (
        {"tree": {"module": "SumBRDF", "of": "hshjax", "fields": {"a": None, "b": None}}},
        "a sum of BRDFs needs BRDFs",
    ),
    "no module": ({"tree": [3]}, "expected a value or a tagged object, got list"),
    "a bare number": ({"tree": 3}, "line 1, model: expected a module, got int"),
    "an unknown tag": ({"tree": {"python": "exit()"}}, r"keys \['python'\]"),
    "a float that is none": ({"tree": {"float": "1.5"}}, r"keys \['float'\]"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_malformed_files_are_refused_with_the_place(case, tmp_path, unchecked):
    content, match = MALFORMED[case]
    write(tmp_path / "bad.model", **content)
    with pytest.raises(FileFormatError, match=f"bad.model: .*{match}"):
        load_model(tmp_path / "bad.model", (Constant,))


@pytest.mark.parametrize(
    ("content", "got"),
    [
        (b"", "an empty line"),
        (b"\x80\x04\x95", "x80"),
        (b"[1, 2]\n", "1, 2"),
        (b'{"format": NaN}\n', "NaN"),
        (b"[" * 100_000 + b"\n", re.escape("[[[")),
        (b'{"format": "hshjax-model", "version": 1}', "the end of the file"),
    ],
)
def test_other_files_are_refused(content, got, tmp_path):
    (tmp_path / "bad.model").write_bytes(content)
    with pytest.raises(FileFormatError, match=f"bad.model: .*got .*{got}"):
        load_model(tmp_path / "bad.model")


def test_a_deep_tree_is_refused(tmp_path):
    tree = '{"list": [' * 3000 + "1" + "]}" * 3000
    header = '{"format": "hshjax-model", "version": 1, "bytes": 0, "crc32": 0, "model": ' + tree + "}\n"
    (tmp_path / "a.model").write_text(header)
    with pytest.raises(FileFormatError):
        load_model(tmp_path / "a.model")


def test_the_file_system_keeps_its_own_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing"):
        load_model(tmp_path / "missing")
    with pytest.raises(IsADirectoryError):
        load_model(tmp_path)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damaged_files_are_read_or_refused(tmp_path, data):
    path = tmp_path / "a.model"
    save_model(path, Pair(HSH(2), jnp.ones((9, 3), jnp.float32), [1.5, (None, "x")]))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(0, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        model = load_model(path, (Pair,))
    except FileFormatError:
        return
    assert isinstance(model, eqx.Module)
