# SPDX-License-Identifier: Apache-2.0
# Everything from an empty clone with Python 3.10 to 3.13 (venv) and make; `make help` lists it.
PYTHON ?= python3
VENV ?= .venv
# Once: a recipe that asked for the time in each of its lines had two names in two seconds.
ifndef RUN
RUN := runs/demo-$(shell date +%Y%m%d-%H%M%S)
endif
PYTEST_ARGS ?=
TEST_JOBS ?= 3
QUICK_JOBS ?= 3
FUZZ_SECONDS ?= 600
FUZZ_SEED ?=
# Tests start hundreds of processes: what they import is compiled once.
export PYTHONDONTWRITEBYTECODE :=

bin := $(VENV)/bin
python_sources := dz_ros benchmarks examples launch setup.py test tools
environment = @$(PYTHON) tools/environment.py $(VENV)

.PHONY: help demo test test-quick test-thorough test-live coverage fuzz lint types docs site pictures bench bench-quick bench-all bench-faults colcon \
  wheel clean distclean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12
	@echo 'make PYTHON=python3.12 … chooses the Python, make test PYTEST_ARGS="-k dead_zone" the tests.'

demo:  ## 20 s of the paper's example in real time as four ROS 2 processes, recorded and reported
	$(environment) ros live
	$(bin)/dz run config/wang2004.yaml --duration 20 --record $(RUN)
	$(bin)/dz report $(RUN)

test:  ## all tests, by TEST_JOBS (3) workers, in an hour on two cores
	$(environment) ros test numba
	$(bin)/python -m pytest -n $(TEST_JOBS) --dist loadgroup --durations=40 --durations-min=3 $(PYTEST_ARGS)

test-quick:  ## in four minutes on two cores: what needs no ROS process, no browser and no long computing
	$(environment) ros test numba
	$(bin)/python -m pytest -n $(QUICK_JOBS) --dist loadgroup -m 'not ros and not live and not slow' \
	  --hypothesis-profile=quick $(PYTEST_ARGS)

coverage:  ## lines and branches that the tests run, by folder; PYTEST_ARGS chooses the tests
	$(environment) ros test numba
	rm -rf build/coverage && mkdir -p build/coverage
	COVERAGE_FILE=build/coverage/data $(bin)/python -m pytest -n $(TEST_JOBS) --dist loadgroup \
	  --cov --cov-branch --cov-report= $(PYTEST_ARGS)
	$(bin)/python tools/coverage_by_folder.py build/coverage/data

test-thorough:  ## tests of generated inputs with ten times as many inputs, others at each run
	$(environment) ros test numba
	$(bin)/python -m pytest -n $(QUICK_JOBS) --dist loadgroup -m 'not ros and not live' \
	  --hypothesis-profile=thorough $(PYTEST_ARGS)

test-live:  ## the page in a real browser (needs chromium; part of test)
	$(environment) ros test numba
	$(bin)/python -m pytest -m live $(PYTEST_ARGS)

fuzz:  ## altered recordings and parameter files for FUZZ_SECONDS (600), from FUZZ_SEED on if given
	$(environment) ros test
	$(bin)/python test/recording/fuzz.py --seconds $(FUZZ_SECONDS) $(if $(FUZZ_SEED),--seed $(FUZZ_SEED))

lint:  ## style, by ruff and the ament linters; form of Dockerfile, workflow, hooks, issue templates, citation
	$(environment) ros lint
	$(bin)/ruff check
	$(bin)/ament_flake8 --linelength 103 $(python_sources)
	$(bin)/ament_pep257 --convention google --add-ignore D105 D107 -- dz_ros benchmarks tools launch $(wildcard examples/*/dz_*)
	$(bin)/hadolint Dockerfile
	$(bin)/check-jsonschema -q --builtin-schema vendor.github-workflows .github/workflows/ci.yml
	$(bin)/check-jsonschema -q --builtin-schema vendor.github-issue-forms \
	  .github/ISSUE_TEMPLATE/bug.yml .github/ISSUE_TEMPLATE/feature.yml
	$(bin)/check-jsonschema -q --builtin-schema vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	$(bin)/check-jsonschema -q --builtin-schema vendor.citation-file-format CITATION.cff
	$(bin)/pre-commit validate-config .pre-commit-config.yaml

types:  ## type annotations
	$(environment) ros lint
	$(bin)/mypy

docs:  ## links, citations and the map of folders in the documents
	$(environment)
	$(bin)/python tools/check_docs.py

site:  ## the documents as a site in site/, warnings are errors
	$(environment) ros site
	$(bin)/python -m sphinx -b html -W --keep-going -q docs site
	@echo site/index.html

pictures:  ## the pictures of the live page in README.md and docs/ (needs chromium)
	$(environment) ros test numba
	$(bin)/python tools/live_pictures.py

bench:  ## every ratio of speed against its target, into docs/performance.md (half an hour, alone)
	$(environment) ros test bench numba
	$(bin)/python benchmarks/performance.py --write

bench-quick:  ## the ratios that a minute can tell
	$(environment) ros test bench numba
	$(bin)/python benchmarks/performance.py --quick

bench-all: bench  ## every other figure the documents quote as well, but those of a log that is not here
	set -e; for script in $$(grep -l __main__ benchmarks/*.py | grep -v 'performance\|real_log'); do \
	  echo "== $$script"; $(bin)/python $$script; done

bench-faults:  ## inject faults into real loops, and write what happened into docs/safety.md
	$(environment) ros test
	$(bin)/python benchmarks/faults.py --write

colcon:  ## build and test as a ROS package, and look at what was installed
	$(environment) ros test colcon
	$(bin)/python tools/check_colcon.py

wheel:  ## install with pip into an environment of its own, and try the commands there
	$(environment)
	$(bin)/python tools/check_install.py

clean:  ## remove what building and testing left; recorded runs stay
	rm -rf build install log dist jupyter_execute *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean  ## clean, and remove the environment
	rm -rf $(VENV)
