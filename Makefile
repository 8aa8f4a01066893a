# Every target sets itself up: on a machine that has only Python 3.11 the first one takes minutes,
# after that the virtual environment is reused until pyproject.toml or constraints.txt changes.

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
AUDIT := .audit/bin/pip-audit
SEEDS ?= 20
# of make fuzz: see python -m tests.fuzz --help
FUZZ ?= --cases 10000
FAULTS ?= 10
# each worker takes a run of neighbours, which share what their module prepares
PYTEST := $(BIN)/python -m pytest -n auto --dist worksteal

# One thread a process: the test workers and the worlds fill the cores, not the BLAS inside them.
export OMP_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help install demo test test-generic test-seeds fuzz faults lint format audit clean

help: ## show this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 15

install: $(STAMP) ## create .venv and install the project with its tools

$(STAMP): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: install Python 3.11, or name it: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev]'
	@touch $@

demo: $(STAMP) ## acquire a grasp, solve for its forces and hold the object
	$(BIN)/python scripts/demo.py

test: $(STAMP) ## run all tests, the slow ones too
	$(PYTEST)

test-generic: $(STAMP) ## run the quick tests of the solvers with kernels that any x86-64 processor has
	NUMBA_CPU_NAME=generic NUMBA_CACHE_DIR=$(CURDIR)/.numba_generic \
		$(PYTEST) -m "not slow" tests/solvers

test-seeds: $(STAMP) ## run all tests on other random inputs in random order, SEEDS=20 times: a night
	@failed=; for seed in $$(seq 1 $(SEEDS)); do \
		GRASPFORCE_TEST_SEED=$$seed $(PYTEST) --hypothesis-seed=$$seed \
			--random-order --random-order-seed=$$seed || failed="$$failed $$seed"; \
	done; \
	[ -z "$$failed" ] || { echo "failed on the inputs$$failed" >&2; exit 1; }

fuzz: $(STAMP) ## try 10,000 hostile problems, arguments, meshes, files and settings: FUZZ="--seed 1"
	$(BIN)/python -m tests.fuzz $(FUZZ)

faults: $(STAMP) ## kill each command of collection and training FAULTS=10 times on its way
	GRASPFORCE_FAULTS=$(FAULTS) $(BIN)/python -m pytest tests/scripts/test_faults.py

lint: $(STAMP) ## check style, types, layers and spelling
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/codespell

format: $(STAMP) ## reformat, and repair what can be repaired
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

$(AUDIT):
	$(PYTHON) -m venv .audit
	.audit/bin/python -m pip install --quiet pip-audit

audit: $(AUDIT) ## look the pinned versions up among known vulnerabilities (asks pypi.org)
	$(AUDIT) --requirement constraints.txt --no-deps --disable-pip --strict

clean: ## delete the virtual environment and every cache
	rm -rf $(VENV) .audit build dist .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache .numba_generic
	find gfo_env scripts solvers tests training -name __pycache__ -prune -exec rm -rf {} +
