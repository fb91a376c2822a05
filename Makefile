# Needs Python >= 3.11, make and a package index. Everything else is installed, as locked in uv.lock, into $(VENV).

PYTHON ?= python3
VENV ?= .venv
UV_VERSION := 0.13.9

PYTHON_IN_VENV := $(VENV)/bin/python
# uv installs into this environment only, and never fetches an interpreter. Compiled bytecode halves the start of every
# process, where the machine does not let Python write it.
UV := UV_COMPILE_BYTECODE=1 UV_PYTHON_DOWNLOADS=never UV_PYTHON=$(abspath $(PYTHON_IN_VENV)) UV_PROJECT_ENVIRONMENT=$(abspath $(VENV)) $(VENV)/bin/uv
PYTEST := $(PYTHON_IN_VENV) -m pytest
# Compilation fills the suite's time, and compiles on one core: a worker a core.
PARALLEL := -n auto --dist worksteal
# The float64 leg compiles without optimisation, in half the time. The float32 leg and `make test-slow` compile as users do.
QUICK := --xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true
# A flag that newer versions of jaxlib do not know, and end at.
OLDER := --xla_cpu_use_fusion_emitters=false
# Laws of what computes (the oracles look at both precisions in the first run). The rest runs there in `make test-slow`.
FLOAT32 := tests/bases/test_laws.py tests/test_quadrature.py tests/test_geometry.py tests/test_samples.py tests/test_metrics.py
# Extra arguments of every pytest run: make test PYTEST_ARGS="-x -k basis"
PYTEST_ARGS ?=
# Of all readers together, with other damages: make fuzz FUZZ_SECONDS=3600 FUZZ_SEED=0
FUZZ_SECONDS ?= 60
FUZZ_SEED ?= 1
# Interpreters of `make test-matrix`.
MATRIX := 3.11 3.12 3.13

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo fuzz peers test test-float64 test-float32 test-slow test-matrix lock bench clean setup
.PHONY: check check-lint check-format check-types check-floors

help: ## List the targets
	@sed -n 's/^\([a-z0-9-]*\):.*## \(.*\)/\1|\2/p' $(firstword $(MAKEFILE_LIST)) | while IFS='|' read -r target text; do \
		printf '  make %-14s %s\n' "$$target" "$$text"; done
	@echo "Variables: PYTHON=$(PYTHON) (interpreter for a new environment), VENV=$(VENV), PYTEST_ARGS"

demo: $(VENV)/.installed ## Run configs/quickstart.toml; prints where its report is
	$(PYTHON_IN_VENV) -m experiments configs/quickstart.toml

peers: $(VENV)/.installed ## Make the environments of other programs, in .peers (docs/run_experiments.md)
	$(PYTHON_IN_VENV) -m experiments.peers

test: test-float64 test-float32 ## Run the suite in float64, then what computes in float32 (without the slow tests)

test-float64: $(VENV)/.installed
	@flags="$$XLA_FLAGS $(QUICK)"; \
	XLA_FLAGS="$(OLDER)" $(PYTHON_IN_VENV) -c "import jax; jax.devices()" 2>/dev/null && flags="$$flags $(OLDER)"; \
	XLA_FLAGS="$$flags" HSHJAX_TEST_DTYPE=float64 $(PYTEST) $(PARALLEL) $(PYTEST_ARGS)

test-float32: $(VENV)/.installed
	HSHJAX_TEST_DTYPE=float32 $(PYTEST) $(PARALLEL) $(FLOAT32) $(PYTEST_ARGS)

test-slow: $(VENV)/.installed ## Run the tests marked slow (minutes), and the whole suite in float32
	HSHJAX_TEST_DTYPE=float64 $(PYTEST) -m slow $(PYTEST_ARGS)
	HSHJAX_TEST_DTYPE=float32 $(PYTEST) $(PARALLEL) $(PYTEST_ARGS)

# pyenv puts a shim on PATH even for a version that is not selected, so an interpreter counts only if it runs.
test-matrix: ## Run `make test` on every Python of 3.11, 3.12, 3.13 that is installed
	@found=; for version in $(MATRIX); do \
		for python in python$$version "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/$$version.*/bin/python3; do \
			"$$python" -c "" 2>/dev/null || continue; \
			found="$$found $$version"; echo "== Python $$version: $$python"; \
			$(MAKE) --no-print-directory test PYTHON="$$python" VENV=.venv-$$version || exit 1; \
			break; \
		done; \
	done; \
	if [ -z "$$found" ]; then echo "none of Python $(MATRIX) found on PATH or in pyenv" >&2; exit 1; fi; \
	echo "passed on Python$$found"

check: check-lint check-format check-types check-floors ## Lint, formatting, types, floors; `make -k check` shows all errors

check-lint: $(VENV)/.installed-check
	$(VENV)/bin/ruff check .

check-format: $(VENV)/.installed-check
	$(VENV)/bin/ruff format --check .

check-types: $(VENV)/.installed-check
	$(VENV)/bin/pyright --pythonpath $(PYTHON_IN_VENV) hshjax

check-floors: $(VENV)/.installed-check
	$(PYTEST) -q tests/test_layers.py

fuzz: $(VENV)/.installed-fuzz ## Readers under random damage for FUZZ_SECONDS [60], by atheris, or Hypothesis without it
	$(PYTHON_IN_VENV) -m tests.fuzz --seconds $(FUZZ_SECONDS) --seed $(FUZZ_SEED)

lock: $(VENV)/.installed ## Resolve pyproject.toml into uv.lock anew
	$(UV) lock --upgrade

bench: $(VENV)/.installed ## Run the benchmarks, half an hour (docs/performance.md); the tests run tiny ones
	$(PYTHON_IN_VENV) -m benchmarks

setup: $(VENV)/.installed ## Create the environment only

clean: ## Remove environments, caches and build outputs; runs/ stays
	rm -rf $(VENV) .venv-3.* .peers .fuzz .pytest_cache .ruff_cache .hypothesis build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(PYTHON_IN_VENV):
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit( \
		"hshjax needs Python >= 3.11; $(PYTHON) is " + sys.version.split()[0] + ". Choose another: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

# Order-only: the interpreter behind the link may be older or newer than the stamp, that means nothing.
$(VENV)/.installed: pyproject.toml uv.lock | $(PYTHON_IN_VENV)
	@$(PYTHON_IN_VENV) -m ensurepip >/dev/null # an environment that uv made has no pip
	$(PYTHON_IN_VENV) -m pip install --quiet --disable-pip-version-check uv==$(UV_VERSION)
	$(UV) sync --frozen --inexact --all-extras
	@touch $@

$(VENV)/.installed-check: $(VENV)/.installed
	$(UV) sync --frozen --inexact --all-extras --group check
	@touch $@

$(VENV)/.installed-fuzz: $(VENV)/.installed
	$(UV) sync --frozen --inexact --all-extras --group fuzz
	@touch $@
