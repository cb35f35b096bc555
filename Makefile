# Every target sets itself up: a virtual environment, pinned packages, missing system libraries.
BIN := .venv/bin
# A file of tests at a time in each process: what its tests share is rendered once. One process more than the cores of
# a small machine, as tests wait for programs at times.
PYTEST := $(BIN)/pytest --numprocesses 3 --dist loadfile --no-loadscope-reorder --durations 15
DEMO ?= demo
EXTRAS ?= dev,train,cluster,video,rerun,docs
export MPLBACKEND := Agg
# The tests start hundreds of programs: each would compile all modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test check format docs site pictures golden assets bench bench-rows soak
.DEFAULT_GOAL := help

help:  ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

setup: .venv/ready  ## .venv with the pinned packages (EXTRAS=train: without Ray and the developers' tools)

# What generating needs; what everything needs.
.venv/core: pyproject.toml constraints.txt scripts/setup
	EXTRAS= scripts/setup
	touch $@

.venv/ready: pyproject.toml constraints.txt scripts/setup
	EXTRAS=$(EXTRAS) scripts/setup
	touch .venv/core $@

demo: .venv/core  ## 12 labelled 480x360 scenes, a gallery and one scene explained, in demo/
	$(BIN)/synth3dlanes generate --n 12 --seed 1 --out $(DEMO)/data --workers 2
	$(BIN)/synth3dlanes gallery $(DEMO)/data --out $(DEMO)/gallery.png --columns 4
	$(BIN)/synth3dlanes inspect $(DEMO)/data/train:00000000 --out $(DEMO)/inspect.png
	@echo "Look at $(DEMO)/gallery.png and $(DEMO)/inspect.png"

test: .venv/ready  ## the tests; how long they take is in CONTRIBUTING.md
	scripts/browser
	$(PYTEST) $(WHICH)

check: .venv/ready  ## what CI runs: format, lint, imports, types, quick and thorough tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	@echo "mypy and the tests, side by side"
	@$(BIN)/mypy & types=$$!; trap "kill $$types" INT; \
	$(MAKE) --no-print-directory test WHICH='-m "not slow"'; tests=$$?; \
	wait $$types || { echo "mypy found errors: they are above, among the results of the tests"; exit 1; }; exit $$tests

format: .venv/ready  ## let ruff repair what it can
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: .venv/ready  ## rewrite the generated pages of docs/
	$(BIN)/python -m scripts.docs

site: .venv/ready  ## the documentation as a site in site/; dead links fail
	PYTHONPATH=. NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

pictures: .venv/ready  ## draw the pictures of frames, of the network and of results anew
	$(BIN)/python -m scripts.frames_picture
	$(BIN)/python -m scripts.network_picture
	$(BIN)/python -m scripts.results_picture

golden: .venv/ready  ## rewrite tests/golden/frozen.json from the code; review the diff
	$(BIN)/python -m tests.golden.frozen > /dev/null

assets: .venv/ready  ## rebuild cars, trees, textures and skies from their scripts
	$(BIN)/python blender_assets/make.py

bench: .venv/ready  ## seconds by stage over the render floor, against docs/bench.json and a naive pipeline
	$(BIN)/synth3dlanes bench --naive --against docs/bench.json

bench-rows: .venv/ready  ## measure every row of docs/bench.json anew, on a quiet machine
	$(BIN)/python -m scripts.bench

soak: .venv/ready  ## 50 SIGKILLs here and 50 on a Ray cluster of two nodes; the same bytes in the end
	SYNTH3DLANES_TEST_KILLS=50 $(BIN)/pytest -m "" -k test_kills tests/production/test_soak.py
