# The verbs of this project; CI runs the same ones.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test test-all lint docs image-check notebook install browser bench table figures paper clean

# README command one: install, reconstruct the embedded clip, print its error against the truth.
demo: $(STAMP)
	$(BIN)/reconstruct --demo -o demo_run --overwrite

# README command two: install, lint, the site, and the everyday tests.
test: $(STAMP) lint docs browser
	$(BIN)/python -m pytest -m "not slow" --numprocesses 2 --dist loadfile --no-loadscope-reorder

test-all: $(STAMP) lint browser
	$(BIN)/python -m pytest

# The pages of docs/ as a site in build/site; a broken link ends it.
docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

# Wheel and sdist into an empty environment, and the image's steps as far as they go without Docker: some three minutes.
image-check:
	sh scripts/system_libraries.sh
	PYTHON="$(PYTHON)" sh scripts/check_image.sh build/image

# The notebook from its beginning, with what it showed, in build/demo.ipynb.
notebook: $(STAMP)
	$(BIN)/python scripts/run_notebook.py notebooks/demo.ipynb build/demo.ipynb

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

install: $(STAMP)

# For the tests that click through the report; where it cannot be installed they are skipped.
browser:
	sh scripts/chromium.sh

$(STAMP): pyproject.toml constraints.txt scripts/system_libraries.sh
	sh scripts/system_libraries.sh
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt $(PIP_TORCH) torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $(STAMP)

# Speed and memory of `reconstruct` beside COLMAP + interpolation + TSDF, once on the embedded clip.
bench: $(STAMP)
	$(BIN)/python -m benchmarks.speed throughput --runs 1

# Every row of the README's tables with this commit, into benchmarks/results/table.json and the README: some 15 minutes
# on two cores; goes on where it was stopped.
table: $(STAMP)
	$(BIN)/python -m benchmarks.table --seeds 3

# The same, and every record of docs/lab that benchmarks/records.yaml lists, with its pages: some hours; WORK and DATA are
# folders for films and of the data sets. Goes on where it was stopped.
figures: table
	$(BIN)/python -m benchmarks.records --work $(WORK) --data $(DATA)

# The paper's tables on rendered scenes: prints its budget, goes on where it was stopped. Figures 4 and 6 need the networks,
# which have to be trained anew with another folder of records: python -m benchmarks.paper.figures says how.
paper: $(STAMP)
	$(BIN)/python -m benchmarks.paper --work runs/paper
	$(BIN)/python -m scripts.pages.paper.page > docs/lab/paper.md

clean:
	rm -rf $(VENV) demo_run build *.egg-info
