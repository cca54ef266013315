# Two commands do everything on a fresh Debian machine with Python, make and gcc:
#   make demo    environment, install, a demo against simulated peers for half a minute
#   make test    environment, install with the test judges, all tests
# (DEMO_ROBOT=gp8 shows a Motoman, DEMO_ROBOT=omni a hand that feels what the pen touches,
# DEMO_ROBOT=--list lists all demos)
PYTHON ?= python3
VENV ?= .venv
DEMO_SECONDS ?= 30
DEMO_ROBOT ?= gofa
PYTEST ?=
BIN := $(VENV)/bin
C_SOURCES := $(wildcard cardan/*/*/*.c cardan/*/*/*.h)

.PHONY: help demo test test-kernel device-table fault-table docs-tables lint types check bench bench-motoros bench-thesis \
	bench-haptics test-pythons dist clean

help:
	@echo "make demo    run a demo against simulated peers, DEMO_ROBOT=$(DEMO_ROBOT) ($(DEMO_SECONDS) s)"
	@echo "make test    all tests"
	@echo "make test-kernel  the drivers against the real Linux kernel, in a virtual machine"
	@echo "make check   lint, types and tests (also make lint, make types)"
	@echo "make test-pythons  most tests under the oldest and the newest Python"
	@echo "make device-table  the table of judges in docs/devices.md, from the tests' marks"
	@echo "make fault-table  the tables of docs/faults.md: what each robot does when something fails"
	@echo "make docs-tables  the tables of drivers, simulated peers and demos, from their declarations"
	@echo "make bench   benchmarks, printed as ratios"
	@echo "make bench-motoros  the latency study of the 2021 paper, with plots for docs/"
	@echo "make bench-thesis  the measurements of the 2020 thesis, with plots for docs/"
	@echo "make bench-haptics  stability and timing of the force feedback, with tables and plots for docs/"
	@echo "make dist    what is released: the source archive and a manylinux wheel, in dist/"
	@echo "make clean   remove the environment and caches"

$(VENV)/.cardan: pyproject.toml hatch_build.py tools/environment tools/native $(C_SOURCES)
	tools/environment "$(PYTHON)" "$(VENV)"
	$(BIN)/python -m pip install --quiet --editable '.[arm]'
	@touch $@

$(VENV)/.cardan-dev: $(VENV)/.cardan
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@

demo: $(VENV)/.cardan
	$(BIN)/cardan demo $(DEMO_ROBOT) --seconds $(DEMO_SECONDS)

# Tests that wait for real clocks run alone and one by one; all others keep two cores busy.
test: $(VENV)/.cardan-dev
ifeq ($(strip $(PYTEST)),)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not realtime"
	$(BIN)/python -m pytest -m realtime
else
	$(BIN)/python -m pytest $(PYTEST)
endif

# Minutes, in software emulation; what it needs is installed from Debian, and downloaded once.
test-kernel: $(VENV)/.cardan-dev
	tools/debian-packages kernel
	tools/kernel-vm

device-table: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.device_table

fault-table: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.fault_table

docs-tables: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.docs_tables

lint: $(VENV)/.cardan-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	tools/native -Werror

types: $(VENV)/.cardan-dev
	$(BIN)/mypy

check: lint types test

bench: $(VENV)/.cardan-dev
	$(BIN)/python -m bench

bench-motoros: $(VENV)/.cardan-dev
	$(BIN)/python -m bench yaskawa --plots docs/images/motoman

bench-thesis: $(VENV)/.cardan-dev
	$(BIN)/python -m bench thesis --plots docs/images/thesis

bench-haptics: $(VENV)/.cardan-dev
	$(BIN)/python -m bench haptics --pages --plots docs/images/haptics

# The oldest and the newest Python the package promises, where the machine has them.
test-pythons:
	tools/test-pythons 3.10 3.13

dist: $(VENV)/.cardan
	tools/dist $(BIN)/python dist

clean:
	rm -rf $(VENV) .venv-3.* .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	find cardan -name '*.so' -delete
