# Needs Python >= 3.11 with pip, and make. Everything else goes into .venv, from uv.lock.
#
#   make study   run the A3 study to a report          make lint    style, types, layers
#   make test    the tests                             make wheel   the wheel, into dist/
#   make slow    the long studies and tests (nightly)  make clean   what was built (distclean: .venv too)
#   make docs    the documentation site, into out/docs
#   make blind   the blind benchmark, 40 cases         make blind BLIND_CASES=1000   all of it
#
# Another interpreter: make PYTHON=python3.12 study

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STUDY := a3_ball_bar
# Two workers, a study file at one of them, files in their order: with those of few tests last, long ones would run alone
# at the end. One BLAS thread each: two threads on two busy cores slow small solves down tenfold.
PYTEST_ARGS ?= -n 2 --dist loadfile --no-loadscope-reorder
export OPENBLAS_NUM_THREADS ?= 1
# Where it is set, every process of the tests would compile every module anew.
unexport PYTHONDONTWRITEBYTECODE
# The blind benchmark: what is there already is not made again. A diagnosis that fails stops nothing: the judge counts it
# as wrong.
BLIND_CASES ?= 40
UV_WANTED := 'uv>=0.13,<1'

SYNC := UV_PROJECT_ENVIRONMENT=$(VENV) UV_PYTHON_DOWNLOADS=never $(BIN)/uv sync --frozen --quiet --compile-bytecode --python $(BIN)/python

.PHONY: study test test-lowest slow blind docs lint format wheel lock clean distclean setup setup-dev
.DEFAULT_GOAL := study

setup: $(VENV)/.stamp-run
setup-dev: $(VENV)/.stamp-dev

study: setup
	$(BIN)/oed run studies/$(STUDY).study.toml --out out/$(STUDY)

test: setup-dev
	$(BIN)/pytest $(PYTEST_ARGS)

slow: setup-dev
	$(BIN)/pytest -m slow $(PYTEST_ARGS)

# The lowest versions that pyproject.toml allows, in an environment of their own.
test-lowest: $(BIN)/uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python .venv-lowest
	VIRTUAL_ENV=.venv-lowest $(BIN)/uv pip install --quiet --resolution lowest-direct --group dev -e .
	.venv-lowest/bin/pytest $(PYTEST_ARGS)

blind: setup-dev
	PYTHONPATH=. $(BIN)/oed campaign --allow-code benchmarks/blind.campaign.toml --seeds $(BLIND_CASES)
	$(BIN)/python -m benchmarks.harness blind

# Warnings are errors; -n: every reference must resolve.
docs: $(VENV)/.stamp-docs
	$(BIN)/sphinx-build -W --keep-going -n -q -b html docs out/docs
	@echo "Site: out/docs/index.html"

lint: setup-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

format: setup-dev
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

wheel: setup-dev
	$(BIN)/uv build --wheel --out-dir dist

# After a change of dependencies in pyproject.toml.
lock: $(BIN)/uv
	UV_PYTHON_DOWNLOADS=never $(BIN)/uv lock --python $(BIN)/python

clean:
	rm -rf out dist build docs/reference/api docs/reference/generated .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV)

# Set-up: a virtual environment, uv inside it, then the locked dependencies; each step once.
# Where venv cannot install pip (Debian without python3-venv), the pip of $(PYTHON) fills the environment.
$(BIN)/uv:
	@command -v $(PYTHON) >/dev/null || { \
	  echo "$(PYTHON) was not found: install Python 3.11 or newer, or name one, as in: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$(PYTHON) is $$($(PYTHON) -V 2>&1), but 3.11 or newer is needed: name one, as in: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@echo "Setting up $(VENV) (once)"
	@if $(PYTHON) -m venv --clear $(VENV) >/dev/null 2>&1; then \
	  $(BIN)/python -m pip install --quiet --disable-pip-version-check $(UV_WANTED); \
	else \
	  $(PYTHON) -m venv --clear --without-pip $(VENV) && \
	  $(PYTHON) -m pip --python $(BIN)/python install --quiet --disable-pip-version-check $(UV_WANTED); \
	fi

$(VENV)/.stamp-run: pyproject.toml uv.lock $(BIN)/uv
	@echo "Installing the locked dependencies"
	@$(SYNC) --no-dev --inexact
	@touch $@

$(VENV)/.stamp-dev: pyproject.toml uv.lock $(BIN)/uv
	@echo "Installing the locked dependencies and the development tools"
	@$(SYNC)
	@touch $@ $(VENV)/.stamp-run

$(VENV)/.stamp-docs: $(VENV)/.stamp-dev
	@echo "Installing the documentation tools"
	@$(SYNC) --group docs
	@touch $@
