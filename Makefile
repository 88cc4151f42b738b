# Everything from a machine that has only Python and make:
#   make train | demo | test          set up the environment, then do the job
# VENV=<folder> puts the environment elsewhere, PYTHON=<python> chooses the interpreter, and
# ARGS="..." is handed to the commands of `train`, `demo` and `test`, PIPFLAGS="-q" to pip.

SHELL := /bin/sh
VENV ?= .venv
PYTHON ?=
ARGS ?=
STAGE ?= balance
POLICY ?= anywhere
# The best policy is shown where its success is quoted; others in the task that they were trained in.
SUITE ?= $(if $(filter anywhere best,$(POLICY)),approach-unfixed)

PY := $(VENV)/bin/python
PIPFLAGS ?=
PIP := $(PY) -m pip install --disable-pip-version-check $(PIPFLAGS)
# labmaze has no wheel for Python 3.13 (see stubs/labmaze), so the others are tried first.
CANDIDATES := $(if $(PYTHON),"$(PYTHON)",python3.12 python3.11 python3.13 python3 python)
LOCK := pyproject.toml constraints.txt

.DEFAULT_GOAL := help
.PHONY: help train demo test nightly lint docs clean setup setup-test setup-dev

help:
	@echo "make train      set up, train the $(STAGE) stage on the CPU and print the evaluated success"
	@echo "make demo       set up, then evaluate and film the shipped policy $(POLICY)"
	@echo "make test       set up, then run the tests"
	@echo "make nightly    every test, the slow ones and those for a GPU too, and the short benchmarks"
	@echo "make lint       ruff and mypy"
	@echo "make docs       build the documentation into docs/_build/html"
	@echo "make clean      remove the environment and everything that tools made (not runs/)"
	@echo "make setup      only set up $(VENV); setup-test and setup-dev add the tools"
	@echo 'settings:       PYTHON=/path/to/python  VENV=folder  STAGE=mount  POLICY=balance  SUITE=far  ARGS="seed=1"'

train: setup
	$(PY) -m skatemount.train stage=$(STAGE) $(ARGS)

demo: setup
	$(PY) -m skatemount.evaluate checkpoint=pretrained:$(POLICY) $(SUITE:%=suite=%) $(ARGS)
	$(PY) -m skatemount.record checkpoint=pretrained:$(POLICY) $(SUITE:%=suite=%) $(filter-out episodes=% json=%,$(ARGS))

test: setup-test
	$(PY) -m pytest $(ARGS)

nightly: setup-test
	$(PY) -m pytest -n 2 $(ARGS)
	$(PY) -m pytest -m "slow or gpu" $(ARGS)
	$(PY) benchmarks/startup_time.py
	$(PY) benchmarks/learner_parts.py

lint: setup-dev
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

docs: setup-dev
	$(PY) -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

clean:
	rm -rf .venv build dist docs/_build docs/api .mypy_cache .pytest_cache .ruff_cache
	find conf docs skatemount tests -name __pycache__ -type d -prune -exec rm -rf {} +

setup: $(VENV)/.setup-run ; @:
setup-test: $(VENV)/.setup-test ; @:
setup-dev: $(VENV)/.setup-dev ; @:

# Each stamp is renewed only when the dependencies change. The larger set-ups contain the
# smaller ones and renew their stamps too.
$(VENV)/.setup-run: $(LOCK) | $(VENV)/.created
	$(PIP) -c constraints.txt -e .
	@touch $@

$(VENV)/.setup-test: $(LOCK) | $(VENV)/.created
	$(PIP) -c constraints.txt -e '.[test]'
	@touch $(VENV)/.setup-run $@

$(VENV)/.setup-dev: $(LOCK) | $(VENV)/.created
	$(PIP) -c constraints.txt -e '.[test,dev,docs]'
	@touch $(VENV)/.setup-run $(VENV)/.setup-test $@

# The interpreters are run, not only looked up: a version manager's shim may exist for a
# version that is not installed.
$(VENV)/.created:
	@found=; python=; \
	for candidate in $(CANDIDATES); do \
	  version=$$("$$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) \
	    || continue; \
	  found="$$found, $$candidate is $$version"; \
	  case $$version in 3.11|3.12|3.13) python=$$candidate; break;; esac; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "error: skatemount needs Python 3.11, 3.12 or 3.13; found: $${found:-, no Python that runs}." \
	    "Install one, or name it: make PYTHON=/path/to/python3.12" | sed 's/found: , /found: /' >&2; \
	  exit 1; \
	fi; \
	if ! "$$python" -c 'import ensurepip, venv' 2>/dev/null; then \
	  echo "error: $$python ($$version) lacks the venv and ensurepip modules;" \
	    "on Debian or Ubuntu: apt install python$$version-venv" >&2; \
	  exit 1; \
	fi; \
	if [ -e "$(VENV)" ] && [ ! -e "$(VENV)/pyvenv.cfg" ] && [ -n "$$(ls -A "$(VENV)")" ]; then \
	  echo "error: VENV=$(VENV) exists and is not a virtual environment; name another folder" >&2; \
	  exit 1; \
	fi; \
	echo "Setting up $(VENV) with Python $$version (the first time downloads the libraries)"; \
	"$$python" -m venv --clear "$(VENV)" || exit 1; \
	if [ "$$version" = 3.13 ]; then $(PIP) ./stubs/labmaze || exit 1; fi; \
	touch $@
