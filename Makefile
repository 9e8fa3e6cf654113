# `make help` lists the targets. `make all PROFILE=smoke` runs another profile, in build/smoke.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

PYTHON ?= python3.11
PROFILE ?= default
VENV := $(CURDIR)/.venv
READY := .venv/.ready-$(shell cksum < requirements.lock | cut -d' ' -f1)
HERE := $(if $(filter default,$(PROFILE)),.,build/$(PROFILE))
STAGES := meshes episodes perception objects dynamics rollouts futures overhead baselines trials tables

export PATH := $(VENV)/bin:$(PATH)
export DVC_NO_ANALYTICS := 1
# Huge pages for torch's CPU memory (Linux): a training step of perception takes 13% to 25% less time.
export THP_MEM_ALLOC_ENABLE := 1

.PHONY: help all test check setup smoke demo view bench evaluate doctor clean profile $(STAGES)

help: ## list the targets
	@echo 'make all [PROFILE=smoke|paper]   make STAGE [PROFILE=...]   make evaluate MESHES=folder [EPISODES=n] [KEEP=1]'
	@sed -n 's/^\([a-z]*\):[^#]*## \(.*\)/  \1\t\2/p' $(MAKEFILE_LIST) | expand -t 14

# DVC takes seconds to find that nothing changed among thousands of files, so `make all` first compares
# a checksum of names, sizes and times. The code's is taken before the run: an edit during the run is seen by
# the next one.
GLANCE = find $(1) -name __pycache__ -prune -o -not -type d -printf '%p %s %T@\n' | LC_ALL=C sort | cksum
CODE = $(call GLANCE,dvc.yaml params.yaml stages oes)
DATA = $(call GLANCE,dvc.lock datasets reports)

# DVC runs one stage at a time. The instances of dynamics, baselines, rollouts, futures and trials are
# independent and gain little from a second thread, so each gets one core and they run side by side. An instance
# that finds DVC's lock taken tries again. Reverse alphabetical order starts long ones first.
LIST = dvc stage list --name-only | grep -E '^($(1))@' | sort -r
SIDE_BY_SIDE = OMP_NUM_THREADS=1 LOKY_MAX_CPU_COUNT=1 xargs -P $$(nproc) -n 1 bash -c 'set -o pipefail; log=.dvc/tmp/$$0.log; \
  until dvc repro -s $$0 2>&1 | tee $$log; do grep -q "Unable to acquire lock" $$log || exit 1; sleep $$((RANDOM % 5 + 1)); done'

all: profile ## the whole study, from meshes to reports/; runs only stages that are out of date
	@cd $(HERE) && code="$$($(CODE))" && done=.dvc/tmp/done && \
	  if [ -f $$done ] && [ "$$code $$($(DATA))" = "$$(cat $$done)" ]; then echo 'Everything is up to date.'; \
	  else dvc repro objects overhead && $(call LIST,dynamics|baselines) | $(SIDE_BY_SIDE) && \
	  $(call LIST,rollouts|futures|trials) | $(SIDE_BY_SIDE) && dvc repro && echo "$$code $$($(DATA))" > $$done; fi

test: setup check ## ruff, mypy and pytest, from a fresh clone on

check: setup ## ruff, mypy and pytest
	ruff format --check .
	ruff check .
	mypy --strict oes
	pytest -q --numprocesses auto

setup: $(READY) ## the virtual environment with all pinned dependencies

smoke: ## the whole study with tiny sizes, in minutes; its figures mean nothing
	@$(MAKE) --no-print-directory all PROFILE=smoke

meshes: ## the catalogue of objects
episodes: ## pushing and falling in the simulator, recorded by 27 RGB-D cameras
perception: ## train the network from views to a 3D feature map, boxes, masks and surfaces
objects: ## run perception over all episodes
dynamics: ## train all models of object motion
rollouts: ## errors of all models on the test episodes
futures: ## render forecasts and counterfactual scenes, and evaluate them
overhead: ## images from above the table, for the video-prediction baselines
baselines: ## train Visual Foresight and PlaNet
trials: ## model predictive control: pushing to targets and around obstacles
tables: ## reports/: tables, figures, metrics

$(STAGES): profile
	@cd $(HERE) && dvc repro $@

demo: setup ## plan and execute one push with the weights in git; writes demo.mp4
	@cd $(HERE) && python -m oes.apps.demo

EPISODE ?= .work/view/traj_000000
view: setup ## an interactive episode in the browser: make view [EPISODE=folder]
	@cd $(HERE) && python -m oes.apps.view --episode "$(EPISODE)"

bench: setup ## time of capture, perception and planning on this machine
	@python -m benchmarks

evaluate: setup ## Table 1 on your meshes, without training: make evaluate MESHES=folder
	@test -n "$(MESHES)" || { echo 'evaluate: which meshes? make evaluate MESHES=folder'; exit 1; }
	@cd $(HERE) && python -m oes.apps.evaluate --meshes "$(abspath $(MESHES))" \
	  $(if $(EPISODES),--episodes $(EPISODES)) $(if $(KEEP),--keep-episodes)

doctor: setup ## check every recorded byte of datasets/episodes
	@cd $(HERE) && python -m oes.record.doctor datasets/episodes

clean: ## delete unfinished work, other profiles' builds and compiled kernels; datasets and the cache stay
	rm -rf .work build .mypy_cache .pytest_cache .ruff_cache oes/__pycache__/numba-*

# The stamp's name has the checksum of requirements.lock, so that a checkout or a touch does not reinstall.
$(READY): requirements.lock
	@$(PYTHON) --version >/dev/null 2>&1 || { echo 'Python 3.11 is needed: make PYTHON=/path/to/python3.11 ...'; exit 1; }
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	pip install -q -r requirements.lock
	pip install -q --no-deps --no-build-isolation -e .
	rm -f .venv/.ready-* && touch $@

# A profile runs in a copy of the working tree (files that git tracks or would add) with its own params, in
# build/<profile>. It has its own datasets, reports, work and dvc.lock, and shares DVC's cache.
profile: setup
ifneq ($(HERE),.)
	@test -f params.$(PROFILE).yaml || { echo "no params.$(PROFILE).yaml; there are:" params.*.yaml; exit 1; }
	@mkdir -p $(HERE)
	@git -c core.quotepath=off ls-files -co --exclude-standard | grep -vE '^(reports/|datasets/|dvc\.lock$$|params\.yaml$$)' \
	  | while IFS= read -r f; do if [ -e "$$f" -o -L "$$f" ]; then echo "$$f"; fi; done | sort -u > build/$(PROFILE).now
	@touch build/$(PROFILE).copied
	@comm -23 <(sort build/$(PROFILE).copied) build/$(PROFILE).now | (cd $(HERE) && tr '\n' '\0' | xargs -0 rm -f)
	@tar -cf - -T build/$(PROFILE).now | tar -xf - -C $(HERE)
	@mv build/$(PROFILE).now build/$(PROFILE).copied
	@cmp -s params.$(PROFILE).yaml $(HERE)/params.yaml || cp params.$(PROFILE).yaml $(HERE)/params.yaml
	@printf '[core]\n    no_scm = true\n[cache]\n    dir = %s/.dvc/cache\n' "$(CURDIR)" > $(HERE)/.dvc/config.local
endif
