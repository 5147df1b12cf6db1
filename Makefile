# make run    solve the 1995 microsatellite's orbit: environment, installation, statistics, report
# make test   the tests, in the same environment
# make test-system    those of C compilers, a browser, servers, notebooks, a cluster and whole studies
# make test-slow SLICE=2/5    one of five slices, even in duration, of the slow tests; CI runs them in rotation
# make test-all    all tests, with oracles rebuilt; first names the slow ones that have not passed since their code changed
# make test-lowest    smoke tests with the lowest versions of the dependencies that pyproject.toml allows
# make bench    how fast everything is, galsim, photutils and tetra3rs beside it; writes benchmarks/RESULTS.md
# make bench-identification, make bench-frames    how often the tracker answers, and is right; tetra3rs beside it
# make readme-results    the runs of README's table of results, and the table
# make bench-mutation    the share of planted faults that the tests notice, area by area; writes benchmarks/RESULTS-mutation.md (hours)
# make notebooks    executes the notebooks and stores their outputs
# make dist   wheel and source archive in dist/, checked, installed in an environment of its own and tried outside of this folder
# make docs    the documentation site, docs/_build/html/index.html
# make docs-outputs    run the code blocks of the tutorials and guides and write what they print into the pages
# make cluster-demo    a scheduler and two workers of dask.distributed on this machine, and 40 trials on them
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: run test test-system test-slow test-all test-lowest lint docs docs-outputs dist notebooks clean cluster-demo bench \
        bench-identification bench-frames readme-results bench-mutation
run: $(VENV)/.installed
	$(BIN)/boresight run scenarios/sunsat.yaml --out out/sunsat

# worksteal: each worker begins with half of the tests in a row, which share kernels and rendered frames
test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n 2 --dist worksteal

test-system: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n 2 --dist worksteal -m 'system and not slow'

# Python's compiled modules are kept even where the environment says otherwise: each process of a test loads them.
test test-system test-slow test-all: export PYTHONDONTWRITEBYTECODE :=

# The slice follows from the number of commits, so that five commits in a row run all slow tests.
# Durations and the commit go to tests/slow_tests.json, to be committed; CI does not write it.
RECORD ?= --record-slow
MINUTES ?= 60
SLICE ?= $(shell echo $$(($$(git rev-list --count HEAD) % 5 + 1))/5)
test-slow: $(VENV)/.installed-oracles
	$(BIN)/python -m pytest -n 2 --dist worksteal -m slow --slow-slice $(SLICE) --slow-minutes $(MINUTES) $(RECORD)

test-all: $(VENV)/.installed-oracles
	$(BIN)/python tests/helpers/slow_tests.py
	$(BIN)/python -m pytest -n 2 --dist worksteal -m '' --hypothesis-profile=explore --record-slow

# An environment of its own, and kernels compiled by its own numba; old libraries may warn of newer ones.
LOWEST := .venv-lowest
SMOKE  := tests/end_to_end/test_command_line.py tests/end_to_end/test_bad_images.py tests/property/test_fits_fuzz.py \
          tests/unit/test_study_parts.py tests/unit/test_orbit.py tests/unit/test_sky_photometry.py
test-lowest: $(LOWEST)/.installed
	NUMBA_CACHE_DIR=$(CURDIR)/$(LOWEST)/numba $(LOWEST)/bin/python -m pytest -o filterwarnings=default $(SMOKE)

$(LOWEST)/.installed: pyproject.toml tests/lowest_versions.py
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python tests/lowest_versions.py >$(LOWEST)/constraints.txt
	$(LOWEST)/bin/python -m pip install --quiet --constraint $(LOWEST)/constraints.txt --editable . pytest hypothesis
	@touch $@

lint: $(VENV)/.installed-test
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy && $(BIN)/lint-imports

notebooks: $(VENV)/.installed-test
	$(BIN)/python tests/helpers/run_notebooks.py

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "boresight needs Python 3.11 or newer; name one with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

$(VENV)/.installed-test: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-oracles: $(VENV)/.installed-test
	$(BIN)/python -m pip install --quiet --editable '.[test,oracles,docs]'
	@touch $@

$(VENV)/.installed-peers: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[peers]'
	@touch $@

$(VENV)/.installed-bench: $(VENV)/.installed-peers
	$(BIN)/python -m pip install --quiet --editable '.[peers,bench]'
	@touch $@

bench: $(VENV)/.installed-bench
	$(BIN)/python -m benchmarks.speed --out benchmarks/RESULTS.md

bench-identification: $(VENV)/.installed-peers
	$(BIN)/python -m benchmarks.identification --peers --failures --out benchmarks/RESULTS-identification.md

readme-results: $(VENV)/.installed
	$(BIN)/python -m benchmarks.readme_results

bench-frames: $(VENV)/.installed
	$(BIN)/python -m benchmarks.frames --failures --out benchmarks/RESULTS-frames.md

bench-mutation: $(VENV)/.installed-test
	$(BIN)/python -m benchmarks.mutation --out benchmarks/RESULTS-mutation.md

$(VENV)/.installed-docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -b html -W --keep-going --quiet docs docs/_build/html
	@echo docs/_build/html/index.html

docs-outputs: $(VENV)/.installed
	$(BIN)/python tests/helpers/document_blocks.py docs/index.md docs/tutorials/*.md docs/how-to/*.md

$(VENV)/.installed-dask: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --editable '.[dask]'
	@touch $@

$(VENV)/.installed-dist: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet 'build>=1.2' 'twine>=6.1'
	@touch $@

# What ships works without this folder: its scenarios, catalogues, C sources and sample photograph are in the wheel.
dist: $(VENV)/.installed-dist
	rm -rf dist
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m twine check --strict dist/*
	@set -e; away=$$(mktemp -d); trap 'rm -rf $$away' EXIT; \
	$(PYTHON) -m venv $$away/venv; $$away/venv/bin/python -m pip install --quiet dist/*.whl; \
	cd $$away; export PATH=$$away/venv/bin:$$PATH PYTHONPATH= PYTHONSAFEPATH=1; \
	python -c 'import simulator, startracker; assert "site-packages" in simulator.__file__, simulator.__file__'; \
	boresight validate cubesat moon; boresight run cubesat --trials 8 --workers 1 --out out; test -s out/report.html; \
	boresight solve sample --annotate solved.jpg; boresight export-c tracker >export.txt; test -s tracker/tracker.h; \
	echo "dist: $$(cd $(CURDIR)/dist && echo *) work outside of the clone"

DASK_PORT ?= 8786
cluster-demo: $(VENV)/.installed-dask
	@address=tcp://127.0.0.1:$(DASK_PORT); log=$$(mktemp -d); \
	$(BIN)/dask scheduler --host 127.0.0.1 --port $(DASK_PORT) --no-dashboard >$$log/scheduler 2>&1 & scheduler=$$!; \
	$(BIN)/dask worker $$address --nthreads 1 --no-dashboard >$$log/worker1 2>&1 & one=$$!; \
	$(BIN)/dask worker $$address --nthreads 1 --no-dashboard >$$log/worker2 2>&1 & two=$$!; \
	trap 'kill $$one $$two 2>/dev/null; wait $$one $$two; kill $$scheduler 2>/dev/null; wait $$scheduler; rm -r $$log' EXIT; \
	$(BIN)/boresight run scenarios/cubesat.yaml --trials 40 --dask $$address --out out/cluster-demo || \
	  { tail -n 5 $$log/*; exit 1; }

clean:
	rm -rf $(VENV) $(LOWEST) out docs/_build docs/reference/generated docs/notebooks
