# One command each: `make demo`, `make cem-demo`, `make test`, `make test-slow`, `make test-browser`,
# `make decisions`, `make ray`, `make mutants`, `make compat`, `make lint`, `make bench`, `make docs`, `make clean`.
# PYTHON is the interpreter (3.11 or newer) that the virtual environment is made from.
PYTHON ?= python3
TORCH  ?= torch==2.13.0
JOBS   ?= 2
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

# Networks and matrices are small here: more threads only get in each other's way.
export OMP_NUM_THREADS ?= 1
export SDL_VIDEODRIVER ?= dummy
export PYGAME_HIDE_SUPPORT_PROMPT ?= 1

.PHONY: install demo cem-demo test test-slow test-browser decisions ray mutants compat lint bench docs clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q -c constraints.txt "$(TORCH)"
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[dev]"
	touch $@

# `make demo ENV=roundabout` on another road: merge, exit, two-way, u-turn, intersection.
demo: $(STAMP)
	$(BIN)/shield demo $(if $(ENV),--env-id $(ENV)-v0)

cem-demo: $(STAMP)
	$(BIN)/shield cem-demo

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(BIN)/python tests/support/warm_kernels.py
	$(BIN)/pytest -n auto

test-slow: $(STAMP)
	HYPOTHESIS_PROFILE=explore $(BIN)/pytest -n auto -m "slow and not ray"

# The replay page in Chromium: apt-get install chromium chromium-driver
test-browser: $(STAMP)
	$(BIN)/pytest -m browser

# Decisions on every road, compared with those that were recorded; RECORD=--record writes the file anew.
decisions: $(STAMP)
	$(BIN)/python tests/support/recorded_decisions.py --jobs $(JOBS) $(RECORD)

# Episodes spread over a Ray cluster of two nodes, which the tests start, and lose one of. Ray takes 260 MB with what it
# needs, so `make test` does without.
ray: $(STAMP)
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[dev,ray]"
	$(BIN)/pytest -m "" tests/evaluation/running/test_ray.py

# Each clause of the certificate switched off: some test has to notice.
mutants: $(STAMP)
	$(BIN)/python tests/support/mutation_check.py --jobs $(JOBS)

# The wrappers and the simulated rollouts on the older versions of highway-env that are supported.
compat: $(STAMP)
	for version in 1.10.1 1.10.2 1.11; do \
		$(BIN)/python -m pip install -q --no-deps --upgrade --target $(VENV)/highway-env-$$version highway-env==$$version \
		&& PYTHONPATH=$(VENV)/highway-env-$$version $(BIN)/pytest -q -n auto tests/shield/wrappers/test_shielded_env.py \
		tests/shield/wrappers/test_shielded_policy.py tests/shield/wrappers/test_parking_lot.py \
		tests/dynamics/vehicle/test_rollouts.py tests/dynamics/roads/test_straight.py tests/dynamics/scenes/test_scene.py || exit 1; done

bench: $(STAMP)
	$(BIN)/pytest benchmarks --benchmark-only -m ""
	$(BIN)/python benchmarks/ratios.py
	$(BIN)/python benchmarks/continuous.py
	$(BIN)/python benchmarks/filter_rivals.py
	$(BIN)/python benchmarks/cem.py
	$(BIN)/python benchmarks/simulator.py
	$(BIN)/python benchmarks/networks.py

# To site/, which is read without a network: open site/index.html. (The variable silences the theme's notice about its
# successor.)
docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:
	rm -rf build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache \
		.hypothesis .benchmarks .coverage htmlcov
	find dynamics mpc shield evaluation tests benchmarks docs -name __pycache__ -type d -prune \
		-exec rm -rf {} + 2>/dev/null || true
