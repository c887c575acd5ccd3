# Everything a developer or a curious user runs. Needs Python 3.10 or later, a C++17 compiler and make.
#   PYTHON    the Python to use                      make setup PYTHON=python3.12
#   PIP_ARGS  more options for pip, such as an index make setup PIP_ARGS="--index-url ..."
#   PYTHONS   those of make matrix                   make matrix PYTHONS="python3.12 /opt/python3.14/bin/python3"
#   DATA, RUNS  where the report's rigs are, some of its runs   make report RUNS="presets effects"
#   FUZZ_ARGS more options for make fuzz             make fuzz FUZZ_ARGS="--seed 2 --inputs 1000000"
#   BLENDER   the Blender of make blender-test        make blender-test BLENDER=5.2.3 BLENDER_PYTHON=python3.13

PYTHON ?= python3
PIP_ARGS ?=
# Python compiles what it imports; pip would compile all, which takes longer than the download.
INSTALL = -m pip install $(PIP_ARGS) --quiet --no-compile -c constraints.txt
DATA ?= ../shared/data
RUNS ?=

# Developers and tests have .venv, users and the demo .venv-user: without torch, a third of the download.
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
USER_VENV := .venv-user
USER_BIN := $(USER_VENV)/bin
USER_READY := $(USER_VENV)/ready
INSTALLS := pyproject.toml setup.py constraints.txt
KERNEL_SOURCES := $(wildcard formats/*/kernel/* decoder/rasterise/kernel/* encoder/*/kernel/* encoder/*/*/kernel/*)

# Blender as a Python module: 4.2 to 5.0 fit Python 3.11, 5.1 and 5.2 fit 3.13.
BLENDER ?= 4.5.15
BLENDER_PYTHON ?= python3.11
BLENDER_ENV = build/blender-$(BLENDER)
BLENDER_ADDON := build/decogs-blender.zip

# The compiler of the player's kernel and of wheels for every platform, and what packs, checks and tries these.
ZIG_ENV := build/zig
WHEELS := build/wheels

# A second environment that holds only the built wheel, without torch.
DIST := build/dist
WHEEL_ENV := build/wheel-env

.NOTPARALLEL:
.DELETE_ON_ERROR:
.PHONY: help setup demo loop test lint type layers wheel wheel-check wheels release matrix shell-files unit player player-wasm player-check test-browser slow soak fuzz bench report \
	blender-addon blender-test clean

help: ## list what can be made
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-13s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: $(READY) ## create .venv with decogs (editable) and the development tools

# The kernels of the editable install serve the wheel, too: compiling them takes minutes.
export DECOGS_KERNEL_CACHE := $(CURDIR)/build/kernels

$(BIN)/python $(USER_BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit("Python 3.10 or later is needed: make PYTHON=python3.12" if sys.version_info < (3, 10) else 0)'
	$(PYTHON) -m venv $(@:/bin/python=)

# All kernels, which tests compare; for users and the demo those of this machine are enough.
$(READY): export DECOGS_KERNELS := all

# Built without isolation, so that the pinned setuptools builds the kernels here too.
$(READY): $(INSTALLS) $(KERNEL_SOURCES) | $(BIN)/python
	@echo 'Installing into $(VENV): a few minutes, torch, which the tests need, is large (CONTRIBUTING.md: which torch)'
	$(BIN)/python $(INSTALL) setuptools
	$(BIN)/python $(INSTALL) --no-build-isolation -e '.[dev,all]'
	@touch $@

$(USER_READY): $(INSTALLS) $(KERNEL_SOURCES) | $(USER_BIN)/python
	@echo 'Installing into $(USER_VENV): a minute, 158 MB to download, and the kernels to compile'
	$(USER_BIN)/python $(INSTALL) setuptools
	$(USER_BIN)/python $(INSTALL) --no-build-isolation -e '.[all]'
	@touch $@

demo: $(USER_READY) ## encode the sample rig, decode its held-out view, export USD, in .venv-user
	$(USER_BIN)/python tests/demo/demo.py

loop: ## make tests/demo/loop.webp, with which README.md opens, from the stream that `make demo` has made
	@[ -f demo/scene.dgs ] || $(MAKE) demo
	$(USER_BIN)/python tests/demo/loop.py demo/scene.dgs tests/demo/loop.webp

test: lint type layers wheel-check player-check unit ## every check; what continuous integration runs

lint: $(READY) ## ruff: rules and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

type: $(READY) ## mypy --strict over the six layers
	$(BIN)/mypy

layers: $(READY) ## import contracts: formats <- codec <- decoder <- rig <- encoder <- bench
	$(BIN)/lint-imports --no-logo

unit: $(READY) ## pytest, a process for each processor
	$(BIN)/pytest -n auto --dist worksteal

# The built page is committed, since users have no Node: whoever changes player/ builds it anew and commits both.
player: player/node_modules/ready ## build the page that plays streams, decoder/viewing/page; needs Node 20 or later
	cd player && npm run --silent check && npm run --silent build
	@ls -l decoder/viewing/page

player/node_modules/ready: player/package-lock.json
	cd player && npm ci --no-audit --no-fund
	@touch $@

# Zig brings the compiler and the C++ library: 100 MB to download once.
player-wasm: $(ZIG_ENV)/ready ## compile what is WebAssembly of that page; after changes of decoder/rasterise/kernel or player/src/**/*.c
	$(ZIG_ENV)/bin/python player/exact.py
	$(ZIG_ENV)/bin/python player/kernel.py

$(ZIG_ENV)/ready: constraints.txt
	$(PYTHON) -m venv $(ZIG_ENV)
	$(ZIG_ENV)/bin/python $(INSTALL) ziglang setuptools build lief packaging uv markdown-it-py
	@touch $@

# Its unit tests are among pytest's. Without Node, or where its packages cannot be had (no network), all of them are skipped.
player-check: ## types and rules of the player, where Node is there; gets the player's packages
	@if ! command -v npm > /dev/null; then echo 'player-check: skipped, Node is not installed'; \
	elif ! { [ -d player/node_modules ] || $(MAKE) --silent player/node_modules/ready > /dev/null 2>&1; }; then \
		rm -rf player/node_modules; echo 'player-check: skipped, the packages of player/ could not be had (make player says why)'; \
	else cd player && npm run --silent check; fi

# Skipped, saying so, where Node, the player's packages or Chromium are missing. DECOGS_CHROMIUM names one that lies elsewhere.
test-browser: $(READY) ## the player in Chromium and Firefox without a window: pictures against decogs-decode, seeking, slow networks, controls
	$(BIN)/pytest -m browser tests/player

slow: $(READY) ## longer twins of tests that are in `make test`, and those that need larger rigs (CONTRIBUTING.md)
	$(BIN)/pytest -m slow -n auto --dist worksteal

soak: $(READY) ## the tests that take minutes: a thousand frames, an encode killed again and again
	$(BIN)/pytest -m soak

wheel: $(READY) ## build the sdist, and from it the wheel, into build/dist
	rm -rf $(DIST) && mkdir -p $(DIST)
	$(BIN)/pyproject-build --no-isolation --outdir $(DIST) > build/wheel.log 2>&1 || { cat build/wheel.log; exit 1; }
	@ls -l $(DIST)

# Not part of `make test`: minutes of compiling, the first time a quarter of an hour for the C++ library of each platform.
wheels: $(ZIG_ENV)/ready ## build the sdist and a wheel for every platform into build/wheels, and check their libraries
	rm -rf $(WHEELS)
	$(ZIG_ENV)/bin/python release/wheels.py $(WHEELS)
	$(ZIG_ENV)/bin/python release/check.py $(WHEELS)/*.whl

# Twice, of what is committed: a release is one that anyone can build again (release/README.md).
release: $(ZIG_ENV)/ready player/node_modules/ready ## build all that is published into build/release, twice, and compare the bytes
	$(ZIG_ENV)/bin/python release/release.py build/release

# Not part of `make test`: 600 MB to download for each Python.
matrix: wheel $(ZIG_ENV)/ready ## run the wheel with every Python there is, beside the newest and oldest of what it needs
	$(ZIG_ENV)/bin/python release/matrix.py $(DIST)/*.whl build/matrix $(PYTHONS)

shell-files: $(READY) ## write the man pages and completions in share/ anew; after a change of any option
	$(BIN)/python share/build.py

# What users get from `pip install .`: the wheel built from the sdist, in an environment of its own without torch.
wheel-check: wheel ## install that wheel without any extra and run it
	rm -rf $(WHEEL_ENV)
	$(BIN)/python -m venv $(WHEEL_ENV)
	$(WHEEL_ENV)/bin/python $(INSTALL) $(DIST)/*.whl pytest
	$(WHEEL_ENV)/bin/pytest -p no:cacheprovider tests/test_installed.py tests/decoder/test_standalone.py

# Minutes; with `.venv/bin/pip install atheris` guided by coverage.
fuzz: $(READY) ## hostile streams and payloads, 210 000 of them
	$(BIN)/python tests/fuzz/run.py $(FUZZ_ARGS)

bench: $(READY) ## time the rasteriser, sparse training steps against dense ones, decoding, and the player
	$(BIN)/python tests/bench/rasterise.py
	$(BIN)/python tests/bench/sparse.py
	$(BIN)/python tests/bench/decode.py
	$(BIN)/python tests/bench/player.py

# A night on two cores; an interrupted one goes on. tables.py keeps in report/figures what the pages cite.
report: $(READY) ## make report/full and report/full.zip: every table, picture and run; and the tables of README.md and report/
	$(BIN)/python report/make.py $(DATA) $(RUNS)
	$(BIN)/python report/tables.py
	$(BIN)/python tests/bench/archive.py report/full

blender-addon: ## pack the Blender extension as build/decogs-blender.zip; Python's standard library is enough
	$(PYTHON) blender/build.py $(BLENDER_ADDON)

# Not part of `make test`: 380 MB to download once, and minutes of rendering.
blender-test: $(READY) blender-addon $(BLENDER_ENV)/ready ## render with that extension in a Blender of its own, against decoded pictures
	$(BIN)/python tests/blender/render.py $(BLENDER_ENV)/bin/python $(BLENDER_ADDON) build/blender-test

$(BLENDER_ENV)/ready:
	$(BLENDER_PYTHON) -m venv $(BLENDER_ENV)
	$(BLENDER_ENV)/bin/python -m pip install $(PIP_ARGS) --quiet --no-compile "bpy==$(BLENDER)" zstandard
	@touch $@

clean: ## remove what was built and every cache; environments and demo/ stay
	rm -rf build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache $(READY) $(USER_READY)
	find decogs formats codec decoder rig encoder bench share tests -name __pycache__ -prune -exec rm -rf {} +
	find formats decoder encoder -name '*.abi3.so' -delete
