# Python >= 3.11 and make are enough; everything else comes into .venv.
PYTHON ?= python3
BIN := .venv/bin

# Tests start hundreds of processes: they read byte code, whatever the shell says.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: venv run test linked collected suite firmware docs outside fuzz lint format clean

venv: .venv/ready
run: linked
	$(BIN)/aucamp demo --speed max

# Lint goes on beside all of it: one worker has tests/network, which mostly wait (tests/conftest.py).
test: .venv/ready-test
	$(MAKE) --no-print-directory --jobs 3 lint suite

linked: .venv/ready
	$(BIN)/python -m hw.compiled

# Byte code of all tests, which else each worker makes for itself. Once: of the few that change later they may. What cannot
# be collected is told by the suite.
collected: .venv/collected

# A worker more than cores (tests/conftest.py); above four, they would wait for the one that has tests/network.
suite: .venv/ready-test linked collected
	$(BIN)/pytest -n auto --maxprocesses 4 -rs

# The files that are copied to a board (hw/README.md, "Flash it").
firmware: .venv/ready-test
	$(BIN)/python -m hw.board_files build/firmware

# The pages as a site, build/site; a link or an anchor that leads nowhere is an error.
docs: .venv/ready-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# Hostile bytes into whatever takes bytes from outside, until Ctrl-C or for so long. A seed: make fuzz FUZZ="--seed 7".
FUZZ_SECONDS ?= 600
fuzz: .venv/ready-test
	$(BIN)/python -m tests.fuzz all --seconds $(FUZZ_SECONDS) $(FUZZ)

# Programs that nobody here wrote judge the twin (docs/outside.md). One that cannot be installed is named, the rest goes on.
outside: .venv/ready-test
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --editable '.[outside]'
	$(BIN)/python -m tests.studies.outside --write

lint: .venv/ready-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	nice -n 5 $(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -q tests/test_prose.py

format: .venv/ready-test
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

.venv/bin/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed: make PYTHON=python3.11')"
	$(PYTHON) -m venv .venv

# The page is what the README shows next: aucamp demo --page.
.venv/ready: .venv/bin/python pyproject.toml constraints.txt
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --editable '.[page]'
	touch $@

.venv/ready-test: .venv/bin/python pyproject.toml constraints.txt
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --editable '.[test,enhance]'
	touch .venv/ready $@

.venv/collected: .venv/ready-test
	$(BIN)/pytest --collect-only --quiet > /dev/null || true
	touch $@

.venv/ready-docs: .venv/bin/python pyproject.toml constraints.txt
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --editable '.[docs]'
	touch $@

clean:
	rm -rf .venv runs build
