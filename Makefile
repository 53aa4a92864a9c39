# The menu: `make` prints it. Every target sets up what it needs; once that is done, it costs nothing.

.DEFAULT_GOAL := menu
.PHONY: menu setup refine check test lint coverage bench fuzz samples doctor clean named docs wheel release-check

BIN := .venv/bin
READY := .venv/ready
TOOLS := .venv/tools
PIP := $(BIN)/python -m pip install -qq --disable-pip-version-check

define MENU
make refine ASSET=strawberry    refine a bundled sample or a file; OUT=DIR, ARGS="--size-mm 80 ..."
make setup                      virtual environment in .venv, packages, tools for development, LPIPS weights, LLVM
make check                      lint, then test: what must pass before a commit
make test                       all tests; ARGS="-k NAME" for some
make lint                       ruff, import contract, types
make coverage                   tests with coverage of lines and branches
make bench                      what makes which file of benchmarks/results; ARGS="NAME" or ARGS="--all ASSETS_DIR" to run it
make fuzz                       5000 damaged inputs of every kind that is read; N=COUNT for as many, ARGS="--seed 1"
make samples                    write the bundled samples as GLB files
make docs                       the site of the documentation, in site/; every warning is an error
make wheel                      wheel and source archive, in dist/
make release-check              build, install elsewhere, refine there, all documented commands, licences, SBOM; in dist/
make doctor                     what is there, what is missing, how to fix it
make clean                      remove .venv and caches; your runs stay

PYTHON=/path/to/python3.11      the interpreter for .venv (3.11 or newer; found by itself if not given)
PIP_ARGS="--extra-index-url https://download.pytorch.org/whl/cpu"
                                PyTorch without the gigabytes of CUDA, for a Linux machine without a GPU
endef

menu:
	@: $(info $(MENU))

setup: $(TOOLS)

$(READY): setup.cfg constraints.txt
	@for python in $(or $(PYTHON),python3.11 python3.12 python3.13 python3); do \
	    $$python -c 'import sys, venv; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && break; python=; \
	done; \
	[ -n "$$python" ] || { echo "error: no Python 3.11 or newer with venv. Install one, or say PYTHON=/path/to/it" >&2; exit 2; }; \
	echo "Setting up .venv with $$($$python --version); this takes a few minutes the first time"; \
	$$python -m venv .venv
	@$(PIP) --constraint constraints.txt $(PIP_ARGS) --editable .
	@$(BIN)/python -m genmf_mi doctor --fix
	@touch $@

$(TOOLS): $(READY)
	@$(PIP) --constraint constraints.txt $(PIP_ARGS) --editable '.[dev,docs]'
	@touch $@

named:
	@[ -n "$(ASSET)" ] || { echo "error: which asset? For example: make refine ASSET=strawberry" >&2; exit 2; }

refine: named $(READY)
	@$(BIN)/genmf-mi refine "$(ASSET)" $(if $(OUT),--out "$(OUT)") $(ARGS)

check: lint test

test: $(TOOLS)
	@$(BIN)/python -m pytest $(ARGS)

lint: $(TOOLS)
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --check --quiet . || { echo "error: not formatted. Run $(BIN)/ruff format ." >&2; exit 1; }
	@report=$$($(BIN)/lint-imports --no-cache) || { echo "$$report"; exit 1; }
	@$(BIN)/pyright --pythonpath $(BIN)/python --warnings

coverage: $(TOOLS)
	@$(BIN)/python -m pytest --cov=genmf_mi --cov-branch --cov-report=term $(ARGS)

bench: $(TOOLS)
	@$(BIN)/python -m benchmarks $(ARGS)

fuzz: $(TOOLS)
	@$(BIN)/python -m benchmarks fuzz --count $(or $(N),5000) $(ARGS)

samples: $(READY)
	@$(BIN)/genmf-mi samples $(ARGS)

docs: $(TOOLS)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	@echo "open site/index.html"

wheel: $(TOOLS)
	@rm -rf dist build
	@$(BIN)/python -m build --no-isolation . > /dev/null
	@rm -rf build
	@ls dist

release-check: $(TOOLS)
	@$(BIN)/python packaging/release_check.py $(ARGS)

doctor: $(READY)
	@$(BIN)/genmf-mi doctor $(ARGS)

clean:
	rm -rf .venv build dist site *.egg-info .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
