# One environment, made on first use; every other target needs it.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Without byte code on disk, each Python program would compile every module again; the tests start many.
unexport PYTHONDONTWRITEBYTECODE
KERNEL := CMakeLists.txt $(wildcard talc/kernel/*)

# Speed and errors beside others, in the same run on one thread; renews the tables in docs/figures.md.
# SUBJECTS=recordings RECORDINGS=folder METHODS=my_module:MyMethod: your own (docs/recordings.md).
RECORDINGS ?=
METHODS ?=
bench: $(VENV)/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/bench.lock
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 RECORDINGS="$(RECORDINGS)" METHODS="$(METHODS)" \
		$(BIN)/python -m benchmarks $(SUBJECTS)

# One of the papers' studies in full (docs/plant.md); continues where it was stopped, and renews its table in
# docs/figures.md and the figures of its page in docs/studies.
study: $(VENV)/.ready
	$(BIN)/python -m studies $(NAME) --results docs/figures.md --pages docs/studies

# Draws the pictures of the documentation again; takes as long as the demo. PICTURES=folder: there, not in docs.
# DEMO="--hours 2": a shorter demo; OUT=folder: its files, instead of out; SHOTS="tests/...": the tests that take pictures of the page for operators.
PICTURES ?= docs
DEMO ?=
OUT ?= out
SHOTS ?= tests/system/test_page_in_browser.py
pictures: $(VENV)/.ready
	$(BIN)/python -m benchmarks.method_figures $(PICTURES)
	$(BIN)/python -m benchmarks.error_figures $(PICTURES)
	$(BIN)/talc-gateway demo --folder $(OUT)/demo $(DEMO)
	cp $(OUT)/demo/report.png $(PICTURES)/demo.png
	$(BIN)/python -m tests.benches.demo_picture $(OUT)/demo $(PICTURES)/page-demo.webp
	PAGE_PICTURES=$(PICTURES) $(PYTEST) $(SHOTS)  # needs Debian's chromium, and npm

# The documentation as a site, out/site, with the studies' pages; links and references that lead nowhere are errors.
site: $(VENV)/.ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

.PHONY: bench study pictures site demo deb wheels release audit mutation test checks beside alone lint format types imports clean

# --no-compile: most modules of the libraries are never imported, the others are compiled when they are.
$(VENV)/.ready: pyproject.toml requirements/dev.lock $(KERNEL)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements/dev.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

# NC=linuxcnc: the NC side against the real LinuxCNC (Debian's linuxcnc-uspace), in three minutes of real time.
demo: $(VENV)/.ready
	$(BIN)/talc-gateway demo $(if $(NC),--nc $(NC))

# dist/talc-gateway_VERSION_ARCH.deb for this computer's Debian release (docs/install-pi.md); ARCH=arm64: for a Pi.
ARCH ?=
deb: $(VENV)/.ready
	PYTHON=$(BIN)/python ARCH=$(ARCH) deploy/debian/build.sh dist

# dist/talc_gateway-*-cp312-abi3-*.whl for x86-64 and aarch64 (docs/install-pi.md). PYTHON: 3.12 or later.
wheels:
	PYTHON=$(PYTHON) deploy/wheels.sh dist

# Everything of a release, each part installed into an empty environment; dist/VERSION, and a table (deploy/release.sh).
release:
	deploy/release.sh

# Known vulnerabilities of what an installation brings and of what builds it (asks pypi.org; needs only the standard
# library).
audit:
	$(PYTHON) deploy/advisories.py requirements/run.lock requirements/build.lock requirements/wheels.lock

# Which mutants of a module its tests do not notice, by cosmic-ray, which changes the module in this tree meanwhile:
# make mutation MODULE=gateway/nc/slew.py BY=tests/gateway/nc. Continues where it was stopped; cosmic-ray has its own
# environment.
MODULE ?= gateway/nc/slew.py
BY ?= tests/gateway/nc
MUTATION := out/mutation/$(subst /,.,$(MODULE))
mutation: $(VENV)/.ready
	test -x out/mutation/tool/bin/cosmic-ray || ($(PYTHON) -m venv out/mutation/tool && out/mutation/tool/bin/pip install --quiet cosmic-ray==8.7.0)
	sed 's|MODULE|$(MODULE)|; s|TESTS|$(BY)|' tests/cosmic-ray.toml > $(MUTATION).toml
	test -f $(MUTATION).sqlite || out/mutation/tool/bin/cosmic-ray init $(MUTATION).toml $(MUTATION).sqlite
	out/mutation/tool/bin/cosmic-ray exec $(MUTATION).toml $(MUTATION).sqlite
	out/mutation/tool/bin/cr-report --surviving-only --show-diff $(MUTATION).sqlite

lint: $(VENV)/.ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(VENV)/.ready
	nice $(BIN)/mypy  # beside tests that a computer's own time is for

imports: $(VENV)/.ready
	PYTHONPATH=. $(BIN)/lint-imports --no-cache  # a cache from before a rename reports imports that no longer exist

# Tests against third-party programs (libmodbus; node-opcua, modbus-serial, canopen) need Debian and npm packages;
# .ci/run installs them, and runs the slow ones too. Tests about the computer's own time (realtime) run alone, after the
# others. One more worker than cores, because many tests wait; each takes five seconds of a core to import and collect
# all tests.
TESTS ?= not peer and not slow
WORKERS ?= $(shell expr $$(nproc) + 1)
PYTEST := $(BIN)/python -m pytest --durations=15

# The checks run beside the tests; if one of them fails, the tests still run to their end, and make fails.
test: $(VENV)/.ready
	$(MAKE) --no-print-directory --jobs=4 checks beside
	$(MAKE) --no-print-directory alone

checks: lint types imports

alone: $(VENV)/.ready
	$(PYTEST) -m "realtime and ($(TESTS))" $$(grep -rl --include='test_*.py' 'mark\.realtime' tests)

# Otherwise each worker would compile all tests, and the libraries that they import.
$(VENV)/.compiled: $(VENV)/.ready
	-$(PYTEST) --collect-only -qq >/dev/null
	touch $@

beside: $(VENV)/.compiled
	$(PYTEST) -n $(WORKERS) --dist worksteal -m "not realtime and ($(TESTS))"

format: $(VENV)/.ready
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) build out .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
