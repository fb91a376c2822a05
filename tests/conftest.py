"""The suite runs in float64 (`make test` runs a second leg with HSHJAX_TEST_DTYPE=float32), with strict promotion,
warnings as errors and shapes checked at run time."""

import os
from pathlib import Path

import jax
import jaxtyping
import pytest
from jaxtyping import install_import_hook

DTYPE = os.environ.get("HSHJAX_TEST_DTYPE", "float64")
if DTYPE not in ("float64", "float32"):
    raise ValueError(f"HSHJAX_TEST_DTYPE must be float64 or float32, got {DTYPE!r}")
jax.config.update("jax_enable_x64", DTYPE == "float64")
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Nearly all of the suite's time is compilation, much of it of equal programs: compile each once, and never again.
jax.config.update("jax_compilation_cache_dir", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

# Every annotated function of the library checks its shapes while the tests run.
_hook = install_import_hook("hshjax", "beartype.beartype")
_hook.__enter__()


@pytest.fixture
def data() -> Path:
    """The folder of real data, or a skip that says how to get it."""
    folder = os.environ.get("HSHJAX_DATA")
    if not folder:
        pytest.skip("real data: set HSHJAX_DATA to the folder that holds rgl/, diligent/, ...")
    return Path(folder)


@pytest.fixture
def unchecked():
    """Without the tests' shape checks, which refuse what the library is to refuse itself."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(autouse=True, scope="module")
def programs():
    """Drops compiled programs before the process has too many."""
    yield
    from hshjax.fitting._programs import few_programs  # after the hook

    few_programs()
