# Every target installs what it needs by itself. `make help` lists them.

PYTHON  ?= $(shell command -v python3.11 || command -v python3)
WORKERS ?= 2
VENV    := .venv
BIN     := $(VENV)/bin
STAMP   := $(VENV)/.installed

# One thread per process: small networks run several times slower with more.
export OMP_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
# Notebook kernels and console scripts come from the environment made here.
export PATH := $(abspath $(BIN)):$(PATH)

.DEFAULT_GOAL := help
.PHONY: help install book pages pdf test check format figures clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-9s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

install: $(STAMP) ## create .venv and install everything (the other targets do this too)

$(STAMP): environment.txt pyproject.toml .ci/debian-packages
	@.ci/debian-packages "$(PYTHON)"
	@test -x $(BIN)/python || "$(PYTHON)" -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --quiet -r environment.txt
	$(BIN)/python -m pip install --disable-pip-version-check --quiet \
		--no-deps --no-build-isolation -e .
	@touch $@

book: $(STAMP) ## execute the notebooks and build the book: _build/html/index.html
	$(BIN)/python -m silem.report.build --workers $(WORKERS)

pdf: $(STAMP) ## the whole book as _build/silem.pdf, printed by Debian's chromium
	$(BIN)/python -m silem.report.build --workers $(WORKERS) --pdf

pages: $(STAMP) ## build the book and read every page of it in Debian's chromium
	$(BIN)/python -m pytest -m built tests/book

test: $(STAMP) ## run the tests, and every notebook with its own small parameters
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup --nbmake notebooks tests

check: $(STAMP) ## style, types, spelling, and notebooks without outputs
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell
	@if grep -lE '"(output_type|execution_count)": *["0-9]' notebooks/*.ipynb; then \
		echo "the notebooks above hold outputs: clear them before committing" >&2; exit 1; fi

format: $(STAMP) ## rewrite the code as `make check` wants it
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

figures: $(STAMP) ## redraw book/figures from the committed records
	$(BIN)/python -m silem.report.build --figures

clean: ## remove what was built; the environment, the records and the runs stay
	rm -rf _build .pytest_cache .mypy_cache .ruff_cache *.egg-info
	find silem tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +
