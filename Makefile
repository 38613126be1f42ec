# Two commands do everything on a machine with Python 3.11+, pip and make:
#   make demo    sets up .venv with an OpenCL driver for the CPU, denoises a picture, says where it is
#   make test    sets up .venv with everything the tests need, runs them
PYTHON ?= python3
VENV ?= .venv
PYTEST_ARGS ?= -n 2 --dist loadfile
BIN = $(VENV)/bin

.PHONY: demo test gpu-test lint bench docs clean

demo: $(VENV)/.demo-ready
	$(BIN)/gpureg demo

test: $(VENV)/.test-ready
	$(BIN)/python -m pytest $(PYTEST_ARGS)

# What a GPU gets, without one: pretended GPUs, compilers for other machines, a simulator that finds races. See
# kernels/README.md.
gpu-test: $(VENV)/.test-ready
	$(BIN)/python -m pytest --as-gpu double $(PYTEST_ARGS) tests/gpu
	$(BIN)/python -m pytest --as-gpu single tests/gpu/test_opencl_as_gpu.py

lint: $(VENV)/.test-ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run -Werror kernels/opencl/*.cl
	$(BIN)/mypy

bench: $(VENV)/.bench-ready
	mkdir -p bench/results
	$(BIN)/python -m bench --json bench/results/bench.json --plot bench/results/bench.png

docs: $(VENV)/.docs-ready
	$(BIN)/sphinx-build -W --keep-going -q docs build/docs
	$(BIN)/python docs/links.py build/docs
	@echo open build/docs/index.html

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.demo-ready: pyproject.toml $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e '.[pocl,plot]'
	touch $@

$(VENV)/.test-ready: pyproject.toml $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e '.[pocl,warp,plot,dev]'
	touch $@

$(VENV)/.bench-ready: pyproject.toml $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e '.[pocl,warp,plot,bench]'
	touch $@

$(VENV)/.docs-ready: pyproject.toml $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -e '.[pocl,docs]'
	touch $@

clean:
	rm -rf $(VENV) build dist docs/api docs/figures docs/figures.md docs/gallery docs/sg_execution_times.rst
