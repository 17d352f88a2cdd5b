# moteslam: set-up, demo, tests and checks. `make help` lists the targets.
#
# Everything is installed into .venv from constraints.txt; the checks have an environment of their own, .venv-lint.

PYTHON ?= python3
WORKERS ?= 2
SHELL := /bin/sh
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup demo examples test test-fast lint docs bench clean FORCE

PACKAGES := api kernels robot sim slam eval
PYTEST := $(if $(PROCESSORS),MOTESLAM_TEST_PROCESSORS=$(PROCESSORS) PYTHONPATH='$(CURDIR)/tests/processors' )\
    .venv/bin/python -m pytest
PIP_FLAGS := --quiet --disable-pip-version-check --constraint constraints.txt
LINT := .venv-lint/bin

# what is wrong with $(PYTHON), in one line, or nothing
define CHECK_PYTHON
import sys
if not (3, 11) <= sys.version_info[:2] <= (3, 13):
    sys.exit("make: %s is Python %d.%d, expected 3.11 to 3.13: name one with PYTHON=python3.12" \
        % (sys.executable, *sys.version_info[:2]))
try:
    import ensurepip, venv
except ImportError:
    sys.exit("make: %s has no venv module, expected one (Debian, Ubuntu: apt install python3-venv)" % sys.executable)
endef
export CHECK_PYTHON

# $(call environment,FOLDER): a virtual environment of $(PYTHON) in FOLDER, made anew where there is none,
# where it is broken, or where it is of another Python
define environment
@command -v "$(PYTHON)" > /dev/null || { echo "make: no $(PYTHON), expected Python 3.11 to 3.13: name one with PYTHON=" >&2; exit 1; }
@$(PYTHON) -c "$$CHECK_PYTHON"
@echo "setting up $(1) (once; some minutes on a slow line)"
@tag='import sys; print(sys.version_info[:2])'; \
if [ "$$($(1)/bin/python -c "$$tag" 2> /dev/null)" != "$$($(PYTHON) -c "$$tag")" ]; then \
    $(PYTHON) -m venv --clear $(1); \
fi
@$(1)/bin/python -m pip install $(PIP_FLAGS) setuptools
endef

help: ## list the targets
	@echo "make TARGET [PYTHON=python3.12] [WORKERS=2] [PROCESSORS=8]"
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  \1|\2/p' Makefile | while IFS='|' read -r name what; do \
	    printf '  %-10s %s\n' $$name "$$what"; done

setup: .venv/.stamp ## install everything into .venv; nothing when it is up to date

demo: .venv/.stamp ## drive a simulated corridor, run SLAM, score it: pictures and numbers in demo/
	@.venv/bin/moteslam demo --out demo --force

examples: .venv/.stamp ## run every script of examples/: pictures in build/examples/
	@printf '%s\n' $(filter-out %/ros2_node.py %/serial_lidar.py,$(wildcard examples/*.py)) | \
	    xargs -P 2 -I{} sh -c 'echo {}; .venv/bin/python {} build/examples'

test: .venv/.stamp ## every test, then the kernels once more with bounds checks
	$(PYTEST) -n $(WORKERS) --dist worksteal
	MOTESLAM_TEST_DEBUG=1 $(PYTEST) -n $(WORKERS) --dist worksteal --ignore tests/kernels/test_runtime.py tests/kernels

test-fast: .venv/.stamp ## the tests that take no whole run, in under two minutes
	$(PYTEST) -n $(WORKERS) --dist worksteal -m "not slow"

lint: .venv-lint/.stamp .venv-lint/.links ## style, types and floors
	$(LINT)/ruff check .
	$(LINT)/ruff format --check .
	$(LINT)/mypy -p moteslam
	$(LINT)/mypy benchmarks
	$(LINT)/lint-imports --no-logo

docs: .venv-lint/.stamp .venv-lint/.links ## the pages of docs/ and the reference of the package as a site in build/docs, links checked
	NO_MKDOCS_2_WARNING=1 $(LINT)/python -m mkdocs build --quiet --strict

bench: .venv/.stamp ## the kernels beside plain C and Python, ratios measured side by side in one run
	.venv/bin/python benchmarks/speed.py

clean: ## remove what the targets made: environments, caches, builds, demo/
	rm -rf .venv .venv-lint build dist moteslam.egg-info demo
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find $(PACKAGES) tests benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.stamp: pyproject.toml constraints.txt
	$(call environment,.venv)
	@PYTHONWARNINGS=ignore .venv/bin/python -m pip install $(PIP_FLAGS) --no-build-isolation --editable '.[test]'
	@touch $@

.venv-lint/.stamp: pyproject.toml constraints.txt
	$(call environment,.venv-lint)
	@PYTHONWARNINGS=ignore $(LINT)/python -m pip install $(PIP_FLAGS) --no-build-isolation --editable '.[dev]' \
	    --config-settings editable_mode=strict
	@rm -f .venv-lint/.links .venv-lint/.files
	@touch $@

# mypy and import-linter see the modules through a tree of links to the files, which knows the files that were
# there when it was made: made anew when the list of files changes
.venv-lint/.links: .venv-lint/.files
	@PYTHONWARNINGS=ignore $(LINT)/python -m pip install $(PIP_FLAGS) --no-build-isolation --no-deps --editable . \
	    --config-settings editable_mode=strict
	@touch $@

.venv-lint/.files: .venv-lint/.stamp FORCE
	@find $(PACKAGES) -name '*.py' -o -name '*.toml' -o -name py.typed | LC_ALL=C sort > $@.new
	@if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi

FORCE:
