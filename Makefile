# make demo [FILE=walk.zip] [OUT=folder]   track a walk and draw it; a minute the first time, with installation
# make test                                run the quick tests: three minutes on two cores
# make test-all                            run every test
# make check                               lint, format and types
# make models [MIRROR=folder] [MODELS=dir] train the shipped models again and compare them: half an hour
# make docs                                build the documentation and run its notebooks: some minutes the first time
# make clean                               remove all files that these commands made
#
# Needs make and Python 3.11 or newer with pip. Everything is installed into .venv.

PYTHON ?= python3
VENV ?= .venv
FILE ?=
OUT ?= demo_output
MIRROR ?=
MODELS ?= build/models

BIN := $(VENV)/bin
# tests/conftest.py has the order of the files.
PYTEST := $(BIN)/python -m pytest -q -n auto --dist loadfile --no-loadscope-reorder
PIP_INSTALL := $(BIN)/python -m pip install -qq --disable-pip-version-check

# Without stored bytecode each worker rewrites the assertions of all test files, and each process that a test starts
# compiles the package again.
unexport PYTHONDONTWRITEBYTECODE
# Each worker has a core. More threads only wait for each other: tests of training took half as long again.
test test-all models: export OMP_NUM_THREADS = 1

.PHONY: demo test test-all check models docs clean

demo: $(VENV)/.installed
	@$(BIN)/pdr-filter demo $(if $(FILE),"$(FILE)") --out "$(OUT)"

test: $(VENV)/.installed-test
	@$(PYTEST) -m "not slow"

test-all: $(VENV)/.installed-test
	@$(PYTEST)

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

models: $(VENV)/.installed-datasets
	@$(BIN)/python -m models.training.make_models "$(MODELS)" "$(MIRROR)"

docs: $(VENV)/.installed-docs
	@echo "building the pages; nine notebooks run in between, each for up to a minute the first time ..."
	@$(BIN)/python -u -m sphinx -W --keep-going -b html docs docs/_build/html
	@echo "open docs/_build/html/index.html"

clean:
	rm -rf $(VENV) build dist demo_output docs/_build docs/api .pytest_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp file for each set of packages: pip runs again only when pyproject.toml changed.
$(VENV)/.installed: pyproject.toml $(VENV)/.created
	@echo "installing pdr_filter into $(VENV), once ..."
	@$(PIP_INSTALL) --editable .
	@touch $@

$(VENV)/.installed-%: pyproject.toml $(VENV)/.created
	@echo "installing pdr_filter[$*] into $(VENV), once ..."
	@$(PIP_INSTALL) --editable ".[$*]"
	@touch $@ $(VENV)/.installed

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "pdr_filter needs Python 3.11 or newer, and '$(PYTHON)' is not; try: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@touch $@
