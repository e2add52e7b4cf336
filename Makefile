# Every target makes .venv by itself; a second call only runs what it names.
#   PYTHON=python3.12 make test     another interpreter
#   make demo FRAMES=200            a shorter demo

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
FRAMES ?= 1000
UNSEEN ?= 100
WORKERS ?= 2
DEMO := demo

.PHONY: help demo test lint format bench docs lock clean

help:  ## what there is
	@grep -hE '^[a-z]+: .*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(VENV)/.train  ## install, generate 1000 frames, train a small detector, evaluate it on people it never saw
	$(BIN)/cabinpose synth --config docs/examples/demo.yaml --frames $(FRAMES) --workers $(WORKERS) --out $(DEMO)/dataset --resume
	$(BIN)/cabinpose info $(DEMO)/dataset
	$(BIN)/cabinpose view $(DEMO)/dataset --out $(DEMO)/view --overwrite
	$(BIN)/cabinpose synth --config docs/examples/demo-unseen.yaml --frames $(UNSEEN) --workers $(WORKERS) --seed 2 --out $(DEMO)/unseen --resume
	$(BIN)/cabinpose train --data $(DEMO)/dataset --config docs/examples/demo-train.yaml --out $(DEMO)/run --resume
	$(BIN)/cabinpose export --onnx $(DEMO)/run/best.ckpt --out $(DEMO)/demo.onnx --overwrite
	$(BIN)/cabinpose evaluate --data $(DEMO)/unseen --model $(DEMO)/demo.onnx in_car --persons driver front_passenger \
	  --out $(DEMO)/report --overwrite
	@echo "open $(DEMO)/view/index.html and $(DEMO)/report/index.html"

test: $(VENV)/.dev  ## all tests; CABINPOSE_REAL_DATA names the folder of real recordings
	$(BIN)/pytest -q -n $(WORKERS) --dist loadfile

lint: $(VENV)/.dev  ## style, types, import rules, the tree's own rules
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/python tools/check_tree.py

format: $(VENV)/.dev  ## let ruff mend what it can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: $(VENV)/.dev  ## the figures of docs/benchmarks.md, as two lines of JSON on stdout
	$(BIN)/cabinpose bench synth --json
	$(BIN)/cabinpose bench detect --json

docs: $(VENV)/.dev  ## run every command and example of the documentation, follow its links
	$(BIN)/pytest -q tests/docs

lock: $(VENV)/.dev  ## pin the newest versions that pyproject.toml allows
	$(BIN)/uv pip compile -q --universal --upgrade $(LOCK_FLAGS) pyproject.toml -o requirements.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) -c requirements.lock --extra train pyproject.toml -o requirements-train.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) -c requirements-train.lock --extra dev pyproject.toml -o requirements-dev.lock

clean:  ## remove what the targets made, .venv included
	rm -rf $(VENV) $(DEMO) out build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests tools -name __pycache__ -type d -prune -exec rm -rf {} +

LOCK_FLAGS := --no-header --no-annotate --no-emit-index-url --no-emit-find-links

# One environment, filled step by step: what the package needs, what training needs, what its developers need. `uv` is only faster:
# where it cannot be had, pip installs the same pins.
INSTALL = if [ -x $(BIN)/uv ]; then $(BIN)/uv pip install -q --python $(BIN)/python $(1); else $(BIN)/python -m pip install -q $(1); fi

$(VENV)/.base: requirements.lock pyproject.toml | $(BIN)/python
	@echo "installing cabinpose into $(VENV)"
	@$(call INSTALL,-r requirements.lock)
	@$(call INSTALL,--no-deps -e .)
	@touch $@

$(VENV)/.train: requirements-train.lock $(VENV)/.base
	@echo "installing what training needs into $(VENV)"
	@$(call INSTALL,-r requirements-train.lock)
	@touch $@

$(VENV)/.dev: requirements-dev.lock $(VENV)/.base
	@echo "installing the development tools into $(VENV)"
	@$(call INSTALL,-r requirements-dev.lock)
	@touch $@

$(BIN)/python:
	@python=$$(tools/find_python.sh "$(PYTHON)"); echo "making $(VENV) with $$python"; \
	"$$python" -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "hint: Python's venv module is incomplete; on Debian: apt-get install python3-venv" >&2; exit 2; }
	@$(BIN)/python -m pip install -q uv || echo "uv cannot be installed here; going on with pip" >&2
