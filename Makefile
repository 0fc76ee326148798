# What a person types. `make` lists it.

VENV := .venv
PYTHON ?= python3
FAB := $(VENV)/bin/fab
PIS := pi1,pi2,pi3
# How often `make test-faults` injects each fault.
FAULTS := 20
# Tests side by side: they mostly wait. Those on virtual Pis need a lab of three for each worker.
JOBS := 3
PURE_JOBS := 4
PIP := $(VENV)/bin/pip --disable-pip-version-check install
PIP_LOG := $(VENV)/pip.log
PYTEST = $(VENV)/bin/pytest --numprocesses $(JOBS)
SCRIPTS := $(wildcard fleet/onboard/*.sh docker/*.sh fleet/lab/recipe/*.sh) fleet/lab/recipe/first-process .ci/run
STEP = @printf '\n== %s\n'

# Tests start `fab` some thousand times; each would compile it anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo undemo check test test-pure test-desktop test-unit test-lab test-faults lint format reference
.PHONY: bench bench-local bench-transfer bench-change bench-build bench-dev picture lock clean desktop testbed env

help: ## list what there is
	@echo 'make WHAT, where WHAT is one of:'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: desktop env ## three virtual Pis, from blank to talking; they are left running
	$(STEP) 'Three virtual Pis (fab lab.up)'
	@$(FAB) lab.up --count 3
	$(STEP) 'Their host keys (fab trust)'
	@$(FAB) trust --hosts $(PIS) --yes
	$(STEP) 'Docker on each of them (fab provision)'
	@$(FAB) provision --hosts $(PIS)
	$(STEP) 'An image for their platform (fab build)'
	@$(FAB) build --hosts $(PIS)
	$(STEP) 'The image on each of them, started (fab ship)'
	@$(FAB) ship --hosts $(PIS)
	$(STEP) 'How they are (fab status)'
	@$(FAB) status --hosts $(PIS)
	$(STEP) 'What their programs print (fab logs)'
	@$(FAB) logs --hosts $(PIS) --tail 3
	$(STEP) 'What they publish on /time (fab listen)'
	@$(FAB) listen --hosts $(PIS) --count 3
	$(STEP) 'The fleet is running. What to try next:'
	@echo '  source $(VENV)/bin/activate     so that `fab` is found'
	@echo '  fab status --watch              a live table; Ctrl-C leaves it'
	@echo '  fab logs --follow               all robots, as they speak'
	@echo '  fab ship --dry                  what a ship would do, command by command'
	@echo '  fab shell --hosts pi1           look around on one'
	@echo '  fab --list                      all verbs'
	@echo 'To remove the virtual Pis and all they hold: make undemo'

undemo: env ## remove the virtual Pis of the demo, and nothing else
	@$(FAB) lab.down

check: lint test-pure ## lint, types and the tests that need only Python: no Docker, no sshd, no root

test: check test-desktop test-lab ## everything: check, then the tests with Docker and sshd, then those on virtual Pis

test-pure: env
	$(STEP) 'Tests that need only Python'
	@$(VENV)/bin/pytest --numprocesses $(PURE_JOBS) tests/unit -m 'not desktop' --dist worksteal

test-desktop: testbed env
	$(STEP) 'Tests that need this computer: Docker, sshd, root'
	@$(PYTEST) tests/unit -m desktop --dist worksteal

test-unit: testbed env ## all tests that need no virtual Pi
	$(STEP) 'Unit tests'
	@$(PYTEST) tests/unit --dist worksteal

test-lab: testbed env ## the tests on virtual Pis, in labs of their own
	$(STEP) 'Tests on virtual Pis'
	@$(PYTEST) tests/lab --dist loadfile --no-loadscope-reorder --durations 12

test-faults: testbed env ## power cuts, cut links, people at once, full disks, liars on virtual Pis; writes docs/reliability.md (half an hour)
	$(STEP) 'Faults'
	@FLEET_FAULTS=$(FAULTS) FLEET_FAULTS_PAGE=docs/reliability.md $(PYTEST) --dist loadfile \
		tests/lab/test_power.py tests/lab/test_faults.py tests/lab/test_hostile.py

lint: env ## style, spelling, types, layers, shell scripts, Dockerfile, the workflow
	$(STEP) 'Style and types'
	@$(VENV)/bin/ruff check .
	@$(VENV)/bin/ruff format --check .
	@$(VENV)/bin/lint-imports --no-cache --no-logo
	@$(VENV)/bin/shellcheck $(SCRIPTS)
	@$(VENV)/bin/shfmt --diff $(SCRIPTS)
	@$(VENV)/bin/hadolint docker/Dockerfile docker/packages.Dockerfile
	@$(VENV)/bin/codespell
	@$(VENV)/bin/zizmor --offline --quiet .github
	@$(VENV)/bin/mypy

format: env ## put the code into the project's format
	@$(VENV)/bin/ruff check --fix .
	@$(VENV)/bin/ruff format .
	@$(VENV)/bin/shfmt --write $(SCRIPTS)

reference: env ## write the pages of docs/reference/ that say what the code says
	@$(VENV)/bin/python -m docs.generate

bench: bench-local bench-transfer bench-change ## all of the following, and docs/benchmarks*.md

bench-local: testbed env ## measure what must be fast on this computer (under 10 minutes)
	@$(VENV)/bin/python -m bench

bench-transfer: testbed env ## measure ships over an emulated Wi-Fi beside the usual ways, as root (under 40 minutes)
	@$(VENV)/bin/python -m bench transfer $(BENCH)

bench-change: testbed env ## measure one changed line until 1 and 20 robots run it, beside the usual ways (under 40 minutes)
	@$(VENV)/bin/python -m bench change $(BENCH)

bench-build: desktop env ## measure cross-compiling beside emulation, docs/benchmarks-build.md (under 25 minutes)
	@$(VENV)/bin/python -m bench build

bench-dev: testbed env ## save a file 20 times, and measure when three virtual Pis publish the new text (3 minutes)
	@FLEET_DEV_TIMES=20 $(VENV)/bin/pytest tests/lab/test_dev.py --quiet -k saved_edit

picture: env ## draw the README's picture of what a fleet that runs prints
	@PATH="$(CURDIR)/$(VENV)/bin:$$PATH" $(VENV)/bin/python -m bench.picture

lock: ## add what pyproject.toml asks for to the lock; make lock UPGRADE=--upgrade: new versions of all (needs uv)
	@printf 'hatchling\neditables\n' | uv pip compile --quiet --universal --python-version 3.11 $(UPGRADE) \
		--generate-hashes --no-emit-index-url --no-emit-find-links --no-annotate --custom-compile-command 'make lock' \
		--group dev pyproject.toml - --output-file requirements.lock

clean: ## remove the demo, the Python environment and all caches
	@if [ -x $(FAB) ]; then $(FAB) lab.down; fi
	@rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

desktop: # Docker, emulation, tools: says what it installs, and nothing when all is there
	@docker/desktop.sh

testbed: # that, and an SSH server's program for the tests
	@docker/desktop.sh test

env: $(VENV)/ready # the Python environment, as locked

$(VENV)/ready: requirements.lock pyproject.toml
	$(STEP) 'Python environment in $(VENV) (about a minute, once)'
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo 'This needs Python 3.11 or newer. Cure: make PYTHON=python3.12 ...'; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2> /dev/null \
		|| { echo 'Python cannot make environments. Cure: docker/desktop.sh, or sudo apt-get install python3-venv'; exit 1; }
	@$(PYTHON) -m venv --clear $(VENV)
	@{ $(PIP) --require-hashes -r requirements.lock \
		&& $(PIP) --no-deps --no-build-isolation --editable .; } > $(PIP_LOG) 2>&1 \
		|| { grep '^ERROR' $(PIP_LOG); echo 'pip failed. Its whole output: $(PIP_LOG)'; exit 1; }
	@touch $@
