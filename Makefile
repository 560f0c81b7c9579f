# `make demo` and `make test` work on a fresh machine with only Python >= 3.11 and make.
# Variables: PYTHON (which interpreter makes the environment), VENV (where the environment is).
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check

.DELETE_ON_ERROR:
.PHONY: demo test check docs samples clean

demo: $(VENV)/.installed
	$(BIN)/clt demo --force clt-demo

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses=auto --dist=loadfile

check: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site, from nothing but this folder; warnings are errors.
docs: $(VENV)/.installed-docs
	$(BIN)/python docs/reference/generate.py
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs docs/_build

# Every `clt simulate` line of sample_logs/README.md.
samples: $(VENV)/.installed
	cd sample_logs && sed -n 's/^clt simulate .*/& --force/p' README.md | \
	  PATH="$(abspath $(BIN)):$$PATH" sh -e

# Set-up runs again only when pyproject.toml changed.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "clt needs Python >= 3.11; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
	       "Name another one: make PYTHON=python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(PIP) install --editable .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml | $(BIN)/python
	$(PIP) install --editable '.[dev]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml | $(BIN)/python
	$(PIP) install --editable '.[docs]'
	@touch $@ $(VENV)/.installed

clean:
	rm -rf .venv clt-demo build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis docs/_build
