# VibraVerse: `make demo` runs the default workflow, `make test` the tests. Both install what they need.

VENV ?= .venv
LEARN ?= .venv-learn
CORES ?= all
SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help env demo test lint lock docs clean dev learn learn-demo containers test-cluster
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

# Puts the environment's commands first, so that rules and tests find `vibraverse`.
IN_VENV = PATH="$$(realpath '$(VENV)')/bin:$$PATH"

# Tests wait for a third of their time (for processes that start, jobs and time limits): one process more than there are
# processors. A file's tests share what they prepare, so they stay in one process, longest files first.
PARALLEL = -n $$(($$(nproc) + 1)) --maxprocesses 8 --dist loadfile --no-loadscope-reorder

help:  ## list these commands
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 22

env:  ## make or update .venv; install missing system libraries with apt where possible
	@envs/env.sh '$(VENV)' workstation

demo: env  ## run the default workflow, to results/report/index.html
	@$(IN_VENV) snakemake --cores $(CORES) --workflow-profile workflow/profiles/default
	@echo "The report: file://$(CURDIR)/results/report/index.html"

test: dev  ## run the tests, then those of learning in their own environment
	@envs/system.sh '$(VENV)/bin/python' test
	@$(IN_VENV) pytest $(PARALLEL) --ignore tests/learn --ignore tests/cluster
	@envs/env.sh '$(LEARN)' learn dev
	@PATH="$$(realpath '$(LEARN)')/bin:$$PATH" pytest $(PARALLEL) tests/learn

test-cluster: dev  ## run the workflow through a Slurm and images made here; as root, on Debian (SHORT=1: no accidents)
	@$(IN_VENV) pytest tests/cluster $(if $(SHORT),-m 'not long')

lint: dev  ## check formatting, style and the workflow's rules
	@$(IN_VENV) ruff format --check .
	@$(IN_VENV) ruff check .
	@$(IN_VENV) snakefmt --check Snakefile workflow/rules
	@$(IN_VENV) snakemake --lint

dev:  ## make or update .venv with the tools of development
	@envs/env.sh '$(VENV)' dev

learn-demo:  ## make a small dataset and train every model of the benchmark tasks on it for a moment
	@envs/env.sh '$(LEARN)' learn workstation
	@PATH="$$(realpath '$(LEARN)')/bin:$$PATH" snakemake learn --cores $(CORES) --configfile examples/learn.yaml \
		--workflow-profile workflow/profiles/default
	@echo "The page: file://$(CURDIR)/results-learn/learn/index.html"

learn:  ## make or update .venv-learn, the environment with torch
	@envs/env.sh '$(LEARN)' learn

containers: env  ## build the container images that are out of date (BASE=debian: from this machine's apt)
	@$(IN_VENV) python containers/build.py $(if $(BASE),--base '$(BASE)') $(FAMILIES)

lock: env  ## rewrite the lock files envs/*.txt and envs/*.yaml from pyproject.toml (UPGRADE=1: newest versions)
	@$(IN_VENV) python envs/lock.py $(if $(UPGRADE),--upgrade)

docs: dev  ## rewrite the configuration's schema and reference, after a change of its sections
	@$(IN_VENV) vibraverse config schema > workflow/schemas/config.schema.json
	@sed -i '/^## Top level/,$$d' docs/configuration.md
	@$(IN_VENV) vibraverse config reference >> docs/configuration.md

clean:  ## remove environments and caches; results stay
	@for venv in '$(VENV)' '$(LEARN)'; do if [ -e "$$venv/.vibraverse" ]; then rm -rf "$$venv"; fi; done
	rm -rf .pytest_cache .ruff_cache .hypothesis workflow/*.egg-info
