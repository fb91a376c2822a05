"""The frame around the recipes: configs and their errors, runs that are skipped and resumed, the report."""

import importlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from rich.console import Console
from typer.testing import CliRunner

from experiments import __main__ as command, config as configs, recipes, runner, stages
from experiments.progress import Voice
from experiments.record import Record
from experiments.report import number

DTYPE = os.environ.get("HSHJAX_TEST_DTYPE", "float64")

PROBE = '''"""A recipe for tests.

Its stages count how often they are computed.
"""

from pathlib import Path
from typing import Annotated, Literal

import jax
import matplotlib.pyplot as plt
import numpy as np
from pydantic import Field

from experiments.config import DataPath, RecipeConfig, Section


class Fit(Section):
    order: Annotated[int, Field(ge=0, description="order of the basis")] = 2
    ridge: float = 1e-6


class Small(Section):
    kind: Literal["small"]
    width: int = 1


class Large(Section):
    kind: Literal["large"]
    height: int = 2


class Config(RecipeConfig):
    recipe: Literal["probe"]
    fit: Fit = Fit()
    sizes: tuple[Annotated[Small | Large, Field(discriminator="kind")], ...] = ()
    material: DataPath | None = None


computed = []
fail_at = None


def run(config, record):
    def stage(n):
        if n == fail_at:
            raise KeyboardInterrupt
        computed.append(n)
        return {"noise": jax.random.normal(record.key(f"stage {n}"), (3,)), "host": record.rng("host").uniform()}

    record.heading("Noise")
    record.paragraph("**Claim** and `measurement`. <script>alert(1)</script> ![x](http://example.org/x.png)")
    total = 0.0
    for n in record.progress(range(config.fit.order), "stages"):
        result = record.stage(f"stage {n}", stage, n)
        total += float(result["noise"].sum()) + result["host"]
    record.table("numbers", [{"n": n, "square": n**2 / 7, "name": "<b>"} for n in range(3)], "Squares & <i>.")
    figure, axes = plt.subplots()
    axes.plot([0, 1])
    record.figure("line", figure, "A line.")
    record.image("ramp", np.linspace(0, 1, 12).reshape(3, 4), "A ramp.")
    record.metric("total", total, "sr^-1")
'''


@pytest.fixture
def probe(tmp_path, monkeypatch):
    """The recipe module above, the only recipe there is."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    folder = tmp_path / "recipes"
    folder.mkdir()
    (folder / "probe.py").write_text(PROBE)
    monkeypatch.setattr(recipes, "__path__", [str(folder)])
    monkeypatch.delitem(sys.modules, "experiments.recipes.probe", raising=False)
    importlib.invalidate_caches()
    yield recipes.load("probe")
    del sys.modules["experiments.recipes.probe"]


@pytest.fixture
def write(tmp_path):
    """Writes a config of the probe and gives its path."""

    def write(text="", name="study.toml"):
        path = tmp_path / name
        path.write_text(f'recipe = "probe"\ndtype = "{DTYPE}"\n{text}')
        return path

    return write


@pytest.fixture
def call(tmp_path, probe):
    """The command line, in this process."""

    def call(*arguments):
        return CliRunner().invoke(command.app, [*map(str, arguments), "--runs", str(tmp_path / "runs")])

    return call


def only_run(tmp_path) -> Path:
    (folder,) = (tmp_path / "runs").iterdir()
    return folder


# Configs


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sed = 1", r"study.toml: unknown key 'sed'; did you mean 'seed'\? \(valid: recipe, name, seed, "),
        ("[fit]\nordr = 1", r"unknown key 'fit.ordr'; did you mean 'fit.order'\? \(valid: fit.order, fit.ridge\)"),
        ("[fit]\norder = '8'", r'fit.order: expected a valid integer, got "8"'),
        ("[fit]\norder = true", r"fit.order: expected a valid integer, got true"),
        ("[fit]\norder = -1", r"fit.order: expected greater than or equal to 0, got -1"),
        ("fit = 3", r"fit: expected an object, got 3"),
        ("seed = 2020-01-01", r"a value is neither number, string"),
        ("[[sizes]]\nkind = 'large'\nheigth = 2", r"unknown key 'sizes.0.large.heigth'; did you mean .*height'"),
        ("[[sizes]]\nwidth = 2", r"sizes.0: .*kind"),
        ("material = '$HSHJAX_DATA/rgl/x.bsdf'", r"material: .*x.bsdf needs the environment variable HSHJAX_DATA"),
        ("material = 'missing.bsdf'", r"material: missing.bsdf: nothing lies at missing.bsdf"),
        ("name = '../up'", r"name: .*"),
        ("a = 1 2\nb = 1", r"study.toml: not TOML: .*line 3"),
    ],
)
def test_an_error_names_file_key_and_remedy(probe, write, monkeypatch, text, message):
    monkeypatch.delenv("HSHJAX_DATA", raising=False)
    with pytest.raises(configs.ConfigError, match=message):
        configs.load(write(text))


def test_all_errors_are_told_at_once(probe, write):
    with pytest.raises(configs.ConfigError) as caught:
        configs.load(write("sed = 1\n[fit]\norder = 'x'\n"))
    assert len(str(caught.value).splitlines()) == 2


def test_the_recipe_must_be_known(probe, tmp_path):
    path = tmp_path / "x.toml"
    for text, message in {"": "no recipe given", 'recipe = "prob"': "'prob'; did you mean 'probe'"}.items():
        path.write_text(text)
        with pytest.raises(configs.ConfigError, match=f"{message}.*; recipes: probe"):
            configs.load(path)
    with pytest.raises(configs.ConfigError, match=r"absent.toml: No such file"):
        configs.load(tmp_path / "absent.toml")


def test_data_paths_follow_the_variable_and_leave_the_hash_alone(probe, write, tmp_path, monkeypatch):
    digests = set()
    for folder in ("one", "two"):
        (tmp_path / folder / "rgl").mkdir(parents=True)
        (tmp_path / folder / "rgl" / "x.bsdf").write_text("")
        monkeypatch.setenv("HSHJAX_DATA", str(tmp_path / folder))
        config = configs.load(write("material = '$HSHJAX_DATA/rgl/x.bsdf'"))
        assert configs.local_path(config.material) == tmp_path / folder / "rgl" / "x.bsdf"
        digests.add(configs.digest(config))
    assert len(digests) == 1


@pytest.mark.parametrize(
    ("argument", "keys", "value"),
    [
        ("seed=3", ["seed"], 3),
        ("fit.ridge=1e-3", ["fit", "ridge"], 1e-3),
        ("a=true", ["a"], True),
        ("a=hsh", ["a"], "hsh"),
        ("a=$HSHJAX_DATA/rgl/x.bsdf", ["a"], "$HSHJAX_DATA/rgl/x.bsdf"),
        ('a="two words"', ["a"], "two words"),
        ("a=[1, 2]", ["a"], [1, 2]),
        ("a={b = 1}", ["a"], {"b": 1}),
        ("a='x=y'", ["a"], "x=y"),
    ],
)
def test_an_override_is_toml_or_a_bare_word(argument, keys, value):
    assert configs.is_override(argument)
    parsed = configs.parse_override(argument)
    assert parsed == (keys, value)
    assert type(parsed[1]) is type(value)


@pytest.mark.parametrize("argument", ["a=two words", "a=", "a=1\nb = 2", "a=[1,", "a=1x"])
def test_other_overrides_are_errors(argument):
    with pytest.raises(configs.ConfigError, match="a="):
        configs.parse_override(argument)


def test_overrides_reach_the_config(probe, write):
    path = write("[fit]\norder = 1")
    config = configs.load(path, ["fit.order=5", "seed=7", "name=other"])
    assert (config.fit.order, config.fit.ridge, config.seed, config.name) == (5, 1e-6, 7, "other")
    with pytest.raises(configs.ConfigError, match=r"seed.deep: seed is a value, not a table"):
        configs.load(path, ["seed=1", "seed.deep=2"])


def test_hash_depends_on_every_value_and_on_nothing_else(probe, write, tmp_path):
    def digest(text, *overrides):
        return configs.digest(configs.load(write(text), list(overrides)))

    base = digest("seed = 1\n[fit]\norder = 2")
    assert base == digest("[fit]\norder = 2", "seed=1") == digest("seed = 1")  # given or default
    assert len({base, digest("seed = 2"), digest("seed = 1", "fit.ridge=2e-6"), digest("seed = 1", "name=b")}) == 4
    assert re.fullmatch("[0-9a-f]{8}", base)
    # The value itself: a hash that changed between versions would run every finished study again.
    assert configs.digest(recipes.load("probe").Config(recipe="probe", name="fixed")) == "15c8f459"


def test_the_resolved_config_is_the_same_config(probe, write, tmp_path):
    config = configs.load(write("[[sizes]]\nkind = 'large'\n[fit]\nridge = 0.1"))
    path = tmp_path / "resolved.toml"
    path.write_text(tomli_w.dumps(configs.as_table(config)))
    assert configs.load(path) == config
    assert configs.digest(configs.load(path)) == configs.digest(config)


# Runs


def test_a_run_leaves_its_files(call, write, tmp_path):
    result = call(write())
    assert result.exit_code == 0, result.stderr
    folder = only_run(tmp_path)
    assert result.stdout.strip() == f"report: {folder / 'report.html'}"
    names = {path.name for path in folder.rglob("*")}
    assert names == {
        "config.toml", "manifest.json", "metrics.json", "report.html", "numbers.csv", "line.png", "ramp.png",
    }  # fmt: skip
    assert (folder / "numbers.csv").read_text().splitlines()[1:3] == ["0,0.0,<b>", f"1,{1 / 7!r},<b>"]
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["versions"]["jax"] == jax.__version__
    assert (manifest["dtype"], manifest["seed"]) == (DTYPE, 0)
    assert (folder / "line.png").stat().st_size < 300_000


def test_a_finished_run_is_skipped_unless_forced(call, write, tmp_path, probe):
    path = write()
    call(path)
    report = only_run(tmp_path) / "report.html"
    assert probe.computed == [0, 1]
    again = call(path)
    assert again.exit_code == 0
    assert "done before" in again.stderr
    assert str(report) in again.stdout
    assert probe.computed == [0, 1]
    call(path, "--force")
    assert probe.computed == [0, 1, 0, 1]


def test_an_interrupted_run_continues_where_it_was(call, write, tmp_path, probe):
    path = write("[fit]\norder = 4")
    probe.fail_at = 2
    interrupted = call(path)
    folder = only_run(tmp_path)
    assert interrupted.exit_code == 130
    assert "the same command continues it" in interrupted.stderr
    assert probe.computed == [0, 1]
    assert {"config.toml", "manifest.json", "stages"} == {path.name for path in folder.iterdir()}
    assert sorted(path.name for path in (folder / "stages").iterdir()) == ["stage-0.npz", "stage-1.npz"]

    probe.fail_at = None
    assert call(path).exit_code == 0
    assert probe.computed == [0, 1, 2, 3]
    resumed = (folder / "metrics.json").read_bytes()
    assert len(json.loads((folder / "manifest.json").read_text())["resumed"]) == 1
    call(path, "--force")
    assert (folder / "metrics.json").read_bytes() == resumed


def test_stages_of_other_code_are_not_used(call, write, tmp_path, probe, monkeypatch):
    path = write("[fit]\norder = 3")
    probe.fail_at = 2
    call(path)
    monkeypatch.setattr(runner, "_code", lambda: {"sources": "changed"})
    kept = call(path, "--keep-stages")
    assert kept.exit_code == 130
    assert probe.computed == [0, 1]
    monkeypatch.setattr(runner, "_code", lambda: {"sources": "changed again"})
    probe.fail_at = None
    anew = call(path)
    assert "begun anew" in anew.stderr
    assert probe.computed == [0, 1, 0, 1, 2]


def test_an_exception_keeps_finished_stages_and_no_partial_files(call, write, tmp_path, probe, monkeypatch):
    path = write("[fit]\norder = 3")
    saved = np.savez

    def full_disk(file, **content):
        if len(list((only_run(tmp_path) / "stages").glob("stage-*.npz"))) == 1:
            file.write(b"half of")
            raise OSError("no space left on device")
        saved(file, **content)

    monkeypatch.setattr(np, "savez", full_disk)
    result = call(path)
    assert isinstance(result.exception, OSError)
    folder = only_run(tmp_path)
    assert [p.name for p in (folder / "stages").iterdir()] == ["stage-0.npz"]
    assert not (folder / "metrics.json").exists()
    monkeypatch.setattr(np, "savez", saved)
    assert call(path).exit_code == 0
    assert probe.computed == [0, 1, 1, 2]


def test_same_seed_same_metrics(call, write, tmp_path):
    def metrics(*arguments):
        call(write(), *arguments)
        folders = sorted((tmp_path / "runs").iterdir(), key=lambda folder: folder.stat().st_mtime_ns)
        return json.loads((folders[-1] / "metrics.json").read_text())

    first, again, other = metrics("name=a"), metrics("name=b"), metrics("name=c", "seed=1")
    assert first == again
    assert first != other


def test_a_wrong_config_stops_before_any_run(call, write, tmp_path):
    result = call(write(), write("sed = 1", "second.toml"))
    assert result.exit_code == 2
    assert "second.toml: unknown key 'sed'; did you mean 'seed'?" in result.stderr
    assert not (tmp_path / "runs").exists()


def test_help_list_and_describe(call):
    assert call("--list").stdout == "probe: A recipe for tests.\n"
    described = call("--describe", "probe").stdout
    assert "fit.order" in described
    assert "order of the basis" in described
    assert "unknown recipe 'x'; recipes: probe" in call("--describe", "x").stderr
    assert "no config given; try: python -m experiments --help" in call().stderr
    assert "python -m experiments configs/quickstart.toml" in call("--help").stdout


def test_the_command_starts_without_jax():
    """--help, --list and errors in a config answer at once."""
    source = "import sys, experiments.__main__; assert 'jax' not in sys.modules and 'matplotlib' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stderr


# Record, stages and report


@pytest.fixture
def record(tmp_path):
    return Record(tmp_path, 0, Voice(Console(file=io.StringIO())))


def test_stages_come_back_as_they_were(tmp_path):
    value = {
        "jax": jnp.arange(3.0),
        "single": np.ones((2, 0), np.float32),
        "flags": np.array([True]),
        "nested": [1, 2.5, None, True, "µ", (np.float64(0.1), {"deep": np.int32(4)})],
    }
    stages.save(tmp_path / "x.npz", value)
    back = stages.load(tmp_path / "x.npz")
    assert back["nested"][:5] == value["nested"][:5]
    for got, put in [
        (back["jax"], value["jax"]),
        (back["single"], value["single"]),
        (back["flags"], value["flags"]),
        (back["nested"][5][0], value["nested"][5][0]),
        (back["nested"][5][1]["deep"], value["nested"][5][1]["deep"]),
    ]:
        assert got.dtype == put.dtype
        np.testing.assert_array_equal(got, np.asarray(put))


def test_what_a_stage_cannot_keep(tmp_path):
    for value, message in [
        ({"a": [object()]}, r"result\['a'\]\[0\]: a stage returns arrays"),
        (np.array([object()]), "an array of object cannot be kept"),
        ({1: 2}, "keys must be strings, got 1"),
    ]:
        with pytest.raises(TypeError, match=message):
            stages.save(tmp_path / "x.npz", value)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "x.npz").write_bytes(b"PK half a file")
    with pytest.raises(ValueError, match=r"x.npz: not the result of a stage .* delete it"):
        stages.load(tmp_path / "x.npz")


def test_record_refuses_what_would_mislead(record):
    record.metric("a", np.float32(1))
    for function, arguments, error, message in [
        (record.metric, ("a", 2), ValueError, "metric 'a' exists already"),
        (record.metric, ("b", jnp.nan), ValueError, "metric b is nan"),
        (record.metric, ("c", np.ones(2)), TypeError, "metric c: expected a number"),
        (record.table, ("t", [], ""), ValueError, "table t has no rows"),
        (record.table, ("t", [{"x": 1}, {"y": 1}], ""), ValueError, r"row 0 has columns \['x'\], row 1 has \['y'\]"),
        (record.image, ("i", np.full((2, 2), 1.5), ""), ValueError, r"display values in \[0, 1\], got \[1.5, 1.5\]"),
        (record.image, ("i", np.full((2, 2), np.nan), ""), ValueError, "display values"),
        (record.image, ("i", np.zeros((2, 2, 4)), ""), ValueError, r"got \(2, 2, 4\)"),
        (record.stage, ("?", dict), ValueError, "needs a name"),
    ]:
        with pytest.raises(error, match=message):
            function(*arguments)


def test_a_printed_table_is_on_standard_output(record, capsys):
    rows = [
        {"model": f"a model of a name as long as this, no. {k}", "n": k, "log": 1e-7 / 3, "pairs": None} for k in (8, 9)
    ]
    record.table("silent", rows, "")
    assert capsys.readouterr().out == ""
    record.table("loud", rows, "", printed=True)
    lines = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    assert [[cell.strip() for cell in line if cell.strip()] for line in lines] == [
        ["model", "n", "log", "pairs"],
        *([row["model"], str(row["n"]), "3.333e-08", "-"] for row in rows),
    ]


def test_randomness_depends_on_seed_and_purpose(record, tmp_path):
    def draw(record, purpose):
        return jax.random.key_data(record.key(purpose)).tolist(), record.rng(purpose).integers(2**40)

    other = Record(tmp_path, 1, Voice())
    draws = [draw(record, "a"), draw(record, "b"), draw(other, "a")]
    assert draw(record, "a") == draws[0]
    assert len({str(d[0]) for d in draws}) == len({d[1] for d in draws}) == 3


def test_progress_yields_the_items_and_says_so(tmp_path):
    with (tmp_path / "log").open("w") as log:
        voice = Voice(Console(file=log, soft_wrap=True))
        assert [(i, j) for i in voice.follow("ab", "outer") for j in voice.follow(iter("cd"), "[inner]")] == [
            ("a", "c"), ("a", "d"), ("b", "c"), ("b", "d"),
        ]  # fmt: skip
    text = (tmp_path / "log").read_text()
    assert "outer: 2/2 done" in text
    assert text.count("[inner]: 2 done") == 2
    with (tmp_path / "terminal").open("w") as terminal:
        voice = Voice(Console(file=terminal, force_terminal=True))
        assert [i + j for i in voice.follow("ab", "outer") for j in voice.follow("cd", "inner")] == [
            "ac",
            "ad",
            "bc",
            "bd",
        ]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"),
        (3, "3"),
        (-3, "−3"),
        (True, "yes"),
        (None, "–"),
        ("<b>", "<b>"),
        (1.23456, "1.235"),
        (-0.0123456, "−0.01235"),
        (0.99999, "1.000"),
        (123456.7, "123457"),
        (1.23456e-5, "1.235 × 10<sup>−5</sup>"),
        (-2e10, "−2.000 × 10<sup>10</sup>"),
        (float("-inf"), "−∞"),
    ],
)
def test_numbers_have_four_digits(value, shown):
    assert number(value) == shown


def test_the_report_needs_nothing_else(call, write, tmp_path):
    call(write())
    html = (only_run(tmp_path) / "report.html").read_text()
    sources = re.findall(r'src="([^"]*)"', html)
    assert len(sources) == 2  # the figure and the image; the picture that the paragraph asks for is a mere link
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert not re.search(r"url\(|@import|<script|<link|<b>", html)
    assert "&lt;script&gt;alert(1)" in html
    assert "<strong>Claim</strong>" in html
    assert "Squares &amp; &lt;i&gt;." in html
