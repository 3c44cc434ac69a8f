# Everything runs in $(VENV), which is made when it is missing. `make help` says what there is.

PYTHON ?= python3
VENV ?= .venv
# The version that bigtri is built and tested with; any from 2.10 on runs the result. E.g. TORCH="torch==2.13.0 --index-url URL" takes it from elsewhere.
TORCH ?= torch==2.13.0
DEMO ?= build/demo
PYTEST_ARGS ?=

BIN := $(VENV)/bin
LIBRARY := bigtri/_C.abi3.so
PY := $(BIN)/python
CSRC := $(shell find bigtri/csrc -type f)
PYTHON_CODE := bigtri bench tests setup.py
CPP_CODE := $(shell find bigtri bench tests -name '*.cpp' -o -name '*.h' -o -name '*.inl' -o -name '*.cu' -o -name '*.cuh')
SCRIPTS := .ci/run bench/gpu.sh

.DEFAULT_GOAL := help
.PHONY: help demo test test-all build lint format wheel clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 10

demo: build  ## draw a scene of large textured triangles, explain it and time every stage
	$(BIN)/bigtri demo --out $(DEMO)

test: build  ## run the tests, each with its chosen cases; PYTEST_ARGS="-k name" runs some
	$(PY) -m pytest $(PYTEST_ARGS)

test-all: build  ## run them with all cases, also those that make test leaves out
	$(PY) -m pytest --all $(PYTEST_ARGS)

build: $(VENV)/.built  ## make .venv, install bigtri into it and build the extension

# Every check runs, also after one that fails, and any failure fails. Without files clang-format would read an empty stdin and be content.
lint: $(VENV)/.lint  ## ruff, clang-format, mypy and shellcheck
	test -n '$(CPP_CODE)'
	failed=0; \
	$(BIN)/ruff check $(PYTHON_CODE) || failed=1; \
	$(BIN)/ruff format --check $(PYTHON_CODE) || failed=1; \
	$(BIN)/clang-format --dry-run -Werror $(CPP_CODE) || failed=1; \
	$(BIN)/mypy || failed=1; \
	$(BIN)/shellcheck $(SCRIPTS) || failed=1; \
	exit $$failed

format: $(VENV)/.lint  ## rewrite the code as lint wants it
	$(BIN)/ruff check --fix $(PYTHON_CODE)
	$(BIN)/ruff format $(PYTHON_CODE)
	$(BIN)/clang-format -i $(CPP_CODE)

wheel: $(VENV)/.installed  ## dist/bigtri-*.whl, for every Python from 3.10 on
	rm -rf build/lib* build/bdist*  # a wheel takes what lies there, also what an earlier one left
	$(PY) -m pip wheel . --no-build-isolation --no-deps -w dist

clean:  ## remove what was built, .venv too
	rm -rf $(VENV) build dist bigtri.egg-info bigtri/_C*.so
	find bigtri bench tests -name __pycache__ -prune -exec rm -rf {} +

$(VENV)/.made:
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 10), "bigtri needs Python 3.10 or newer; try make PYTHON=python3.12"'
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.installed: $(VENV)/.made pyproject.toml
	$(PY) -m pip install --quiet $(TORCH)
	$(PY) -m pip install --quiet 'setuptools>=77' wheel ninja
	$(PY) -m pip install --no-build-isolation -e '.[test]'
	touch $@

# An installation builds everything. This keeps its objects, in build/, so that later only what changed is compiled.
$(VENV)/.built: $(VENV)/.installed setup.py $(CSRC)
	if [ ! -e $(LIBRARY) ] || [ -n "$$(find setup.py bigtri/csrc -newer $(LIBRARY))" ]; then $(PY) setup.py --quiet build_ext --inplace; fi
	touch $@

$(VENV)/.lint: $(VENV)/.installed
	$(PY) -m pip install --quiet 'bigtri[lint]'  # bigtri itself is there already
	touch $@
