# Everything from an empty clone with Python 3.10 to 3.13 (venv) and make; `make help` lists it.
PYTHON ?= python3
VENV ?= .venv
RUN ?= runs/demo-$(shell date +%Y%m%d-%H%M%S)
PYTEST_ARGS ?=

bin := $(VENV)/bin
environment = @$(PYTHON) tools/environment.py $(VENV)

.PHONY: help demo test test-live lint types docs pictures bench bench-quick bench-all bench-faults colcon \
  wheel clean distclean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12
	@echo 'make PYTHON=python3.12 … chooses the Python, make test PYTEST_ARGS="-k dead_zone" the tests.'

demo:  ## 20 s of the paper's example in real time as four ROS 2 processes, recorded and reported
	$(environment) ros
	$(bin)/dz run config/wang2004.yaml --duration 20 --record $(RUN)
	$(bin)/dz report $(RUN)

test:  ## all tests
	$(environment) ros test numba
	$(bin)/python -m pytest $(PYTEST_ARGS)

test-live:  ## the page in a real browser (needs chromium; part of test)
	$(environment) ros test numba
	$(bin)/python -m pytest -m live $(PYTEST_ARGS)

lint:  ## style
	$(environment) ros lint
	$(bin)/ruff check

types:  ## type annotations
	$(environment) ros lint
	$(bin)/mypy

docs:  ## links, citations and the map of folders in the documents
	$(environment)
	$(bin)/python tools/check_docs.py

pictures:  ## the pictures of the live page in README.md and docs/ (needs chromium)
	$(environment) ros test numba
	$(bin)/python tools/live_pictures.py

bench:  ## every ratio of speed against its target, into docs/performance.md (half an hour, alone)
	$(environment) ros test bench numba
	$(bin)/python benchmarks/performance.py --write

bench-quick:  ## the ratios that a minute can tell
	$(environment) ros test bench numba
	$(bin)/python benchmarks/performance.py --quick

bench-all: bench  ## every other figure the documents quote as well
	set -e; for script in $$(grep -l __main__ benchmarks/*.py | grep -v performance); do \
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
	rm -rf build install log dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean  ## clean, and remove the environment
	rm -rf $(VENV)
