"""The sweep of recipe `paper_basis_sweep` against tests/reference/basis_sweep.csv, which other code computed.

The reference prints five decimals: half a unit of the last one is allowed on top of the tolerance.
"""

import csv
import os
from pathlib import Path

import numpy as np
import pytest

from experiments.recipes import paper_basis_sweep as recipe
from experiments.recipes._paper import PAPER_BRDFS, paper_brdf

pytestmark = pytest.mark.skipif(
    os.environ.get("HSHJAX_TEST_DTYPE") == "float32", reason="figures of the float64 study: once is enough"
)

with (Path(__file__).parents[1] / "reference" / "basis_sweep.csv").open(encoding="utf-8") as file:
    REFERENCE = list(csv.DictReader(file))
LAST_DIGIT = 0.5e-5
# The kink of Oren-Nayar at θi = θo limits the quadrature of the reference itself.
TOLERANCE = {"CT_spec_Fconst": 0.01, "OrenNayar_s0.3": 0.03}
COLUMNS = {
    "HSH": "err_HSH",
    "Zernike": "err_ZER_same_order",
    "SHR": "err_SHR_same_order_same_count_as_HSH",
}


def deviations(brdf: str, metric: str, errors: dict[str, np.ndarray]) -> dict[str, float]:
    """Largest relative deviation from the reference by column, after the allowance for its last digit."""
    rows = [row for row in REFERENCE if row["brdf"] == brdf and row["metric"] == metric]
    assert [int(row["order"]) for row in rows] == list(range(17))
    fit = rows[0]["fit"]

    def excess(column, values):
        expected = np.array([float(row[column]) for row in rows])
        return float(np.max(np.maximum(np.abs(values - expected) - LAST_DIGIT, 0) / expected))

    found = {column: excess(column, errors[basis][:17]) for basis, column in COLUMNS.items()}
    floor = [int(row["zer_order_with_n<=n_HSH"]) for row in rows]
    found["err_ZER_floor"] = excess("err_ZER_floor", errors["Zernike"][floor])
    column = "err_ZER_at_n_HSH_loglog_interp"
    found[column] = excess(column, np.array([recipe.at_equal_count(errors, fit, n) for n in range(17)]))
    for row in rows:
        assert recipe.count("HSH", int(row["order"]), fit) == int(row["n_HSH"])
        assert recipe.count("Zernike", int(row["order"]), fit) == int(row["n_ZER_same_order"])
    print(brdf, metric, {name: f"{value:.2%}" for name, value in found.items()})
    return found


def check(brdf: str, errors: dict[str, dict[str, np.ndarray]], metrics) -> None:
    for metric in metrics:
        for column, deviation in deviations(brdf, metric, errors[metric]).items():
            assert deviation <= TOLERANCE[brdf], f"{brdf}, {metric}, {column}: {deviation:.2%} off"


def test_counts_are_those_of_the_mode_tables():
    assert recipe.counts_match_the_modes(12)


# Grids just fine enough for the tolerance; those of configs/paper_basis_sweep.toml are in the slow test.
@pytest.mark.parametrize(
    ("brdf", "norms", "polar"), [("CT_spec_Fconst", ("B", "D"), 64), ("OrenNayar_s0.3", ("D",), 96)]
)
def test_norms_on_a_coarse_grid(brdf, norms, polar):
    errors = recipe.sweep_norms(paper_brdf(brdf), 16, norms, polar=polar, levels=5)
    check(brdf, errors, [recipe.METRICS[norm] for norm in norms])


@pytest.mark.parametrize("brdf", PAPER_BRDFS)
def test_slices_on_a_coarse_grid(brdf):
    errors = recipe.sweep_slices(paper_brdf(brdf), 60.0, 16, polar=100, levels=3, plane_limit=89.85)
    check(brdf, errors, recipe.SLICE_METRICS)


@pytest.mark.slow
@pytest.mark.parametrize("brdf", PAPER_BRDFS)
def test_the_whole_table(brdf):
    config = recipe.Config(recipe="paper_basis_sweep", name="test")
    surface = paper_brdf(brdf)
    errors = recipe.sweep_norms(surface, 16, config.norms, polar=config.polar, levels=config.levels)
    errors |= recipe.sweep_slices(
        surface, config.theta_i, 16, polar=config.slice_polar, levels=config.levels, plane_limit=config.plane_limit
    )
    check(brdf, errors, (*recipe.METRICS.values(), *recipe.SLICE_METRICS))
