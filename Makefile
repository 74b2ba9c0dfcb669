# rodnet: `make demo` and `make test` set up .venv by themselves; `make help` lists the rest.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
export PIP_DISABLE_PIP_VERSION_CHECK := 1

VENV := .venv
PY := $(VENV)/bin/python
JOBS ?= 2
PLUGINS := $(patsubst %/pyproject.toml,./%,$(wildcard plugins/*/pyproject.toml))
INPUTS := pyproject.toml $(wildcard plugins/*/pyproject.toml)

# A .venv from elsewhere (another checkout, no rodnet in it) does not count as installed.
CHECK := import importlib.metadata as m, json, pathlib, urllib.parse as u; \
  d = m.distribution("rodnet").read_text("direct_url.json"); \
  p = u.unquote(u.urlparse(json.loads(d)["url"]).path); \
  raise SystemExit(pathlib.Path(p).resolve() != pathlib.Path.cwd().resolve())
ifneq ($(wildcard $(VENV)/.rodnet-*),)
ifneq ($(shell $(PY) -c '$(CHECK)' >/dev/null 2>&1 && echo yes),yes)
$(shell rm -f $(VENV)/.rodnet-*)
endif
endif

.PHONY: help demo test test-slow docs lint format bench blind clean distclean
help:  ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-10s %s\n", $$1, $$2}' Makefile

demo: $(VENV)/.rodnet-run  ## simulate the two- and three-tailed robots; results in demo/
	$(VENV)/bin/rodnet demo --out demo

test: $(VENV)/.rodnet-test  ## run the tests, but for some whole diagnoses of minutes each
	OPENBLAS_NUM_THREADS=1 $(PY) -m pytest -q -n $(JOBS) -m "not slow" $(ARGS)

test-slow: $(VENV)/.rodnet-test  ## run those
	OPENBLAS_NUM_THREADS=1 $(PY) -m pytest -q -n $(JOBS) -m slow $(ARGS)

docs: $(VENV)/.rodnet-docs  ## build the documentation into docs/_build/html, warnings are errors
	$(PY) -m sphinx -W --keep-going -j $(JOBS) -b html docs docs/_build/html $(ARGS)

lint: $(VENV)/.rodnet-dev  ## ruff (rules and format) and mypy
	$(PY) -m ruff check .
	$(PY) -m ruff format --check --quiet . || { $(PY) -m ruff format --check .; echo "run 'make format'"; exit 1; }
	$(PY) -m mypy

format: $(VENV)/.rodnet-dev  ## let ruff format and fix what it can
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .

bench: $(VENV)/.rodnet-bench  ## measure the speed, beside other codes; results in benchmarks/results
	$(PY) -m benchmarks $(ARGS)

blind: $(VENV)/.rodnet-bench  ## draw, diagnose and score a sealed set; the score goes to benchmarks/blind/ledger.jsonl
	$(PY) -m benchmarks.blind --set full --workers $(JOBS) --ledger benchmarks/blind/ledger.jsonl $(ARGS)

clean:  ## remove what was computed or cached (not .venv)
	rm -rf demo docs/_build docs/api/generated .cache .pytest_cache .mypy_cache .ruff_cache .hypothesis dist
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf

distclean: clean  ## clean, and remove .venv
	rm -rf $(VENV)

# -- the environment -----------------------------------------------------------------------
# $(call install,groups): the package in place, its plugins, and dependency groups
define install
	@$(PY) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$(VENV) is older than Python 3.11 or broken; run: make distclean" >&2; exit 1; }
	$(PY) -m pip --version >/dev/null 2>&1 || $(PY) -m ensurepip --upgrade >/dev/null
	$(PY) -m pip install --quiet --upgrade 'pip>=25.1'
	$(PY) -m pip install --quiet $(addprefix --group ,$(1)) --editable .
	$(if $(2),$(PY) -m pip install --quiet --no-deps $(addprefix --editable ,$(2)))
	@touch $@
endef

$(VENV)/.rodnet-run: $(INPUTS) | $(PY)
	@echo "installing rodnet and what it needs into $(VENV) (once; a few minutes)"
	$(call install,,)
$(VENV)/.rodnet-test: $(INPUTS) | $(VENV)/.rodnet-run
	$(call install,test,$(PLUGINS))
$(VENV)/.rodnet-docs: $(INPUTS) | $(VENV)/.rodnet-run
	$(call install,docs,$(PLUGINS))
# other codes are measured where they can be installed; the tables say which are missing
$(VENV)/.rodnet-bench: $(INPUTS) | $(VENV)/.rodnet-run
	$(call install,,$(PLUGINS))
	$(PY) -m pip install --quiet --group bench || echo "not all other codes can be installed here"
$(VENV)/.rodnet-dev: $(INPUTS) | $(VENV)/.rodnet-run
	$(call install,dev,$(PLUGINS))

# the first Python >= 3.11 with venv and pip; name another by `make ... PYTHON=/path/to/python`
$(PY):
	@found=; for p in $(PYTHON) python3.12 python3.13 python3.11 python3.14 python3 python; do \
	  if "$$p" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; then found="$$p"; break; fi; \
	done; \
	if [ -z "$$found" ]; then \
	  echo "rodnet needs Python 3.11 or newer (with its venv module); python3 here is: $$(python3 --version 2>&1 || echo missing)." >&2; \
	  echo "Install one (https://www.python.org/downloads; on Debian or Ubuntu also the package python3-venv)," >&2; \
	  echo "or name it: make $(or $(MAKECMDGOALS),demo) PYTHON=/path/to/python3.12" >&2; exit 1; \
	fi; \
	echo "creating $(VENV) with $$("$$found" --version) ($$found)"; \
	"$$found" -m venv --clear $(VENV)
