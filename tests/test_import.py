"""What `import hshjax` does to the process that imports it: nothing but define names, quickly."""

import json
import statistics
import subprocess
import sys

HEAVY = ["OpenEXR", "PIL", "imagecodecs", "jaxopt", "matplotlib", "pydantic", "rich", "trimesh", "typer"]
DEPENDENCIES = "import jax, equinox, lineax, optimistix"


def run_python(source: str, *options: str) -> str:
    """Standard output of a fresh interpreter; its standard error where it fails."""
    done = subprocess.run([sys.executable, *options, "-c", source], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == "", "import must be silent"
    return done.stdout


def test_import_touches_no_jax_configuration():
    changed = run_python(
        f"{DEPENDENCIES}; import json\n"
        "before = dict(jax.config.values)\n"
        "import hshjax\n"
        "after = dict(jax.config.values)\n"
        "changed = [key for key in after if key not in before or before[key] != after[key]]\n"
        "print(json.dumps([len(after), changed]))"
    )
    count, keys = json.loads(changed)
    assert count > 50, "jax.config.values no longer lists the configuration: this test has to look elsewhere"
    assert keys == []


def test_import_starts_no_backend():
    """A library that makes a device array at import fixes the platform before its user can choose one."""
    run_python(
        "import hshjax\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge.backends_are_initialized(), 'import hshjax made a device array'"
    )


def test_import_is_silent_under_every_warning():
    # The dependencies come first: what they warn about is theirs.
    run_python(f"{DEPENDENCIES}\nimport warnings\nwarnings.simplefilter('error')\nimport hshjax")


def test_import_loads_no_heavy_modules():
    loaded = run_python(
        f"{DEPENDENCIES}; import sys, json; before = set(sys.modules); import hshjax\n"
        "print(json.dumps([name.split('.')[0] for name in set(sys.modules) - before]))"
    )
    new = set(json.loads(loaded))
    assert "hshjax" in new
    assert not new & {*HEAVY, "scipy"}


def test_import_costs_little_more_than_its_dependencies():
    """One process times both, in processor time: other work on the machine shifts both alike."""
    source = (
        "from time import process_time\n"
        f"start = process_time(); {DEPENDENCIES}; middle = process_time(); import hshjax; end = process_time()\n"
        "print((end - start) / (middle - start))"
    )
    run_python(source)  # byte code is compiled now
    ratios = [float(run_python(source)) for _ in range(3)]
    assert statistics.median(ratios) < 1.5, ratios
