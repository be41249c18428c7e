# Needs Python 3.11 or newer and make; everything else goes into .venv.
PYTHON ?= $(shell for p in python3.12 python3.11 python3.13 python3; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
READY := .venv/ready

.PHONY: demo test lint
.DELETE_ON_ERROR:

demo: $(READY)
	@$(BIN)/python -m experiments.train --preset quick --resume --out runs/demo/train
	@$(BIN)/python -m experiments.evaluate --planner hybrid --policy runs/demo/train/policy \
		--compare default shipped --out runs/demo
	@$(BIN)/python -m experiments.view --planner hybrid --out runs/demo --format png
	@echo "learning curve  runs/demo/train/curve.png"

test: $(READY)
	@$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(READY)
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/pyright --pythonpath $(BIN)/python
	@$(BIN)/lint-imports

# Without a C compiler the drivability checker cannot be built: its tests are skipped then.
$(READY): pyproject.toml
	@test -n "$(PYTHON)" || { echo "make: no Python 3.11 or newer found; name one with PYTHON=..." >&2; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@echo "installing packages into .venv ..."
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --editable '.[all]' \
		|| $(BIN)/python -m pip install -qq --disable-pip-version-check --editable '.[commonroad,experiments,gymnasium,viz,dev,docs]'
	@touch $(READY)
