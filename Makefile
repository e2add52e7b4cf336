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
NAME ?= se1
SCALE ?= small
WORKERS ?= 2
DEMO := demo
WERROR ?= OFF
NATIVE := $(shell find src/native -name '*.cpp' -o -name '*.hpp')
# Temporary files of tests are in memory where 8 GB are free there, 12 GB of memory are, and programs run: what a command writes is flushed to the disk file
# by file, for which tests would wait. `make test SCRATCH=/tmp` is on the disk.
SCRATCH ?= $(shell free=$$(df --output=avail -k /dev/shm 2>/dev/null | tail -1); \
  memory=$$(awk '/MemAvailable/ {print $$2}' /proc/meminfo 2>/dev/null); \
  [ "$${free:-0}" -gt 8000000 ] && [ "$${memory:-0}" -gt 12000000 ] && [ -w /dev/shm ] && ! grep -qE '^[^ ]+ /dev/shm [^ ]+ [^ ]*noexec' /proc/mounts && echo /dev/shm || echo "$${TMPDIR:-/tmp}")
PYTEST = TMPDIR=$(SCRATCH) $(BIN)/pytest -q -n $(WORKERS)
# Where the environment forbids bytecode, every worker would compile the tests and rewrite their assertions anew: 12 CPU-s of each.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help demo test test-slow test-faults test-all test-native coverage experiment lint format bench docs wheels cibuildwheel lock clean

help:  ## what there is
	@grep -hE '^[a-z-]+: .*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 14

demo: $(VENV)/.base  ## install, generate 1000 frames and look at them; then train a small detector, and evaluate it on people it never saw
	$(BIN)/cabinpose synth --config docs/examples/demo.yaml --frames $(FRAMES) --workers $(WORKERS) --out $(DEMO)/dataset --resume
	$(BIN)/cabinpose info $(DEMO)/dataset
	$(BIN)/cabinpose view $(DEMO)/dataset --out $(DEMO)/view --overwrite
	@echo "open $(DEMO)/view/index.html; next come training and evaluation"
	$(BIN)/cabinpose synth --config docs/examples/demo-unseen.yaml --frames $(UNSEEN) --workers $(WORKERS) --seed 2 --out $(DEMO)/unseen --resume
	@$(MAKE) --no-print-directory $(VENV)/.train
	$(BIN)/cabinpose train $(DEMO)/dataset --config docs/examples/demo-train.yaml --out $(DEMO)/run --resume
	$(BIN)/cabinpose export onnx $(DEMO)/run/best.ckpt --out $(DEMO)/demo.onnx --overwrite
	$(BIN)/cabinpose evaluate $(DEMO)/unseen --model $(DEMO)/demo.onnx in_car --persons driver front_passenger \
	  --out $(DEMO)/report --overwrite
	@echo "open $(DEMO)/view/index.html and $(DEMO)/report/index.html"

experiment: $(VENV)/.dev  ## install, and make frames, models and page of an experiment: NAME=se1, SCALE=paper
	$(BIN)/cabinpose experiment run $(NAME) --scale $(SCALE)

test: $(VENV)/.dev  ## the tests but for the slow ones; CABINPOSE_REAL_DATA names the folder of real recordings
	$(PYTEST) --dist loadfile -m "not slow"

# A file's tests go to one process: those that take minutes come first. A third of the files has slow ones; all are 18 CPU-s to collect.
LONGEST = $(addprefix tests/,faults/test_outputs.py synth/test_processors.py synth/test_motion.py docs/test_site.py)
SLOW = $(LONGEST) $(filter-out $(LONGEST),$(sort $(shell grep -rl 'mark\.slow' tests --include='test_*.py')))

test-slow: $(VENV)/.dev  ## the slow tests alone
	$(PYTEST) --dist loadfile --no-loadscope-reorder -m slow $(SLOW)

test-faults: $(VENV)/.dev  ## kills, full disks and hostile files alone, which are part of the slow tests
	$(PYTEST) --dist loadfile --no-loadscope-reorder -m faults

test-all: test test-slow  ## all tests

coverage: $(VENV)/.dev  ## the lines that no quick test reaches
	$(PYTEST) --dist loadfile -m "not slow" --cov --cov-report=term

test-native: $(VENV)/.dev  ## the kernels' tests with the kernels built under the address and undefined-behaviour sanitizers
	tools/test_native.sh $(BIN)

lint: $(VENV)/.dev  ## style, types, import rules, the tree's own rules
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/clang-format --dry-run --Werror $(NATIVE)
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/codespell
	$(BIN)/vulture
	$(BIN)/python tools/check_tree.py

format: $(VENV)/.dev  ## let ruff and clang-format mend what they can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format
	$(BIN)/clang-format -i $(NATIVE)

bench: $(VENV)/.dev  ## the figures of docs/benchmarks.md, as two lines of JSON on stdout
	$(BIN)/cabinpose bench synth --json
	$(BIN)/cabinpose bench detect --json

docs: $(VENV)/.dev  ## build the site into out/site; run every command, example and notebook of the documentation, follow its links
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	CABINPOSE_SITE=out/site $(BIN)/pytest -q -n $(WORKERS) tests/docs
	@echo "python -m http.server -d out/site shows the site"

wheels: $(VENV)/.dev  ## a release in dist: the source distribution, wheels for any Linux with glibc 2.28; then they are installed and tried
	PATH="$$PATH:$(BIN)" tools/wheels.sh dist
	CABINPOSE_WHEELS=dist $(BIN)/pytest -q tests/install

cibuildwheel: $(BIN)/python  ## the same by cibuildwheel, in containers of the manylinux project: for machines that have Docker
	$(BIN)/python -m pip install -q -r requirements-release.lock
	$(BIN)/python -c "from scikit_build_core.build import build_sdist; build_sdist('dist')"
	$(BIN)/cibuildwheel --output-dir dist dist/*.tar.gz

lock: $(VENV)/.dev  ## pin the newest versions that pyproject.toml allows
	$(BIN)/uv pip compile -q --universal --upgrade $(LOCK_FLAGS) pyproject.toml -o requirements.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) --group build -o requirements-build.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) --group compiler -o requirements-compiler.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) -c requirements-build.lock -c requirements-compiler.lock --group release -o requirements-release.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) -c requirements.lock --extra train pyproject.toml -o requirements-train.lock
	grep -vE "^(nvidia|cuda|triton)" requirements-train.lock > requirements-train-cpu.lock
	$(BIN)/uv pip compile -q --universal $(LOCK_FLAGS) -c requirements-train.lock --extra dev pyproject.toml -o requirements-dev.lock

clean:  ## remove what the targets made, .venv included
	rm -rf $(VENV) $(DEMO) out build dist .coverage .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests tools benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

LOCK_FLAGS := --no-header --no-annotate --no-emit-index-url --no-emit-find-links

# One environment, filled step by step: what the package needs, what training needs, what its developers need.
$(VENV)/.base: requirements.lock $(VENV)/.native
	@tools/patiently.sh "installing what cabinpose needs into $(VENV)" tools/install.sh $(VENV) -r requirements.lock
	@$(BIN)/python -m compileall -q src
	@touch $@

# The extension is built into build/ and installed with the package, which itself is used from src/.
$(VENV)/.native: requirements-build.lock pyproject.toml CMakeLists.txt $(NATIVE) | $(BIN)/python
	@tools/patiently.sh "installing what the kernels are built with into $(VENV)" tools/install.sh $(VENV) -r requirements-build.lock
	@mkdir -p build
	@defines=$$(tools/compiler.sh $(VENV)) && LOG=build/build.log tools/patiently.sh "building the kernels of cabinpose" \
	  $(BIN)/python -m pip install -v --no-build-isolation --no-deps -C cmake.define.CABINPOSE_WERROR=$(WERROR) -C cmake.define.CABINPOSE_KERNELS=all \
	  $$(printf -- '-C cmake.define.%s ' $$defines) -e . || { grep -m5 -E "error|Error" build/build.log >&2; \
	  echo "hint: all that the build said is in build/build.log; after a build that was interrupted, try make clean" >&2; exit 2; }
	@touch $@

$(VENV)/.train: requirements-train.lock $(VENV)/.base
	@tools/patiently.sh "installing what training needs into $(VENV) (5 GB)" tools/install.sh $(VENV) -r requirements-train.lock
	@touch $@

$(VENV)/.dev: requirements-dev.lock $(VENV)/.base
	@tools/patiently.sh "installing the development tools into $(VENV)" tools/install.sh $(VENV) -r requirements-dev.lock
	@touch $@

$(BIN)/python:
	@python=$$(tools/find_python.sh "$(PYTHON)"); echo "making $(VENV) with $$python"; \
	"$$python" -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "hint: Python's venv module is incomplete; on Debian: apt-get install python3-venv" >&2; exit 2; }
	@$(BIN)/python -m pip install -q uv || echo "uv cannot be installed here; going on with pip" >&2
