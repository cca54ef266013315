# Two commands do everything on a fresh Debian machine with Python, make and gcc:
#   make demo    environment, install, a demo against simulated peers for half a minute
#   make test    environment, install with the test judges, the tests of every change
# (DEMO_ROBOT=gp8 shows a Motoman, DEMO_ROBOT=omni a hand that feels what the pen touches,
# DEMO_ROBOT=ros2 an arm on ROS 2's network for your web client, DEMO_ROBOT=lab a daemon with four arms,
# DEMO_ROBOT=console the page for browsers, DEMO_ROBOT=--list lists all demos)
PYTHON ?= python3
VENV ?= .venv
DEMO_SECONDS ?= 30
HOURS ?= 2
SEED ?= 1
DEMO_ROBOT ?= gofa
PYTEST ?=
TEST_WORKERS ?= auto
MATRIX ?=
FUZZ_INPUTS ?= 10000000
FUZZ ?=
FAULT_LABS ?= 2
FAULT_OPTIONS ?=
EVALUATE ?=
BIN := $(VENV)/bin
C_SOURCES := $(wildcard cardan/*/*/*.c cardan/*/*/*.h cardan/*/*/*/*.c cardan/*/*/*/*.h \
	cardan/*/*/*/*/*.c cardan/*/*/*/*/*.h plugins/*/*/*/*.c plugins/*/*/*/*.h)
NATIVE := tools/native $(wildcard plugins/*/tools/native)

# Where the environment forbids to keep compiled modules, each of the hundreds of programs that the
# tests start compiles them anew, and so does each worker with the tests: minutes.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo page lock test test-matrix test-kernel test-systemd device-table fault-table \
	fault-table-processes fault-table-network flood-table hold-table console-pictures arm-tables docs-tables \
	docs-pictures docs-evaluation demo-picture docs release lint types check bench bench-motoros bench-thesis bench-haptics bench-network \
	bench-console bench-sessions bench-kilohertz bench-remote bench-peers bench-servo fuzz soak test-pythons test-neighbors \
	test-lerobot dist clean

help:
	@echo "make demo    run a demo against simulated peers, DEMO_ROBOT=$(DEMO_ROBOT) ($(DEMO_SECONDS) s)"
	@echo "make test    the tests of every change: what computes, and one of each mechanism that is real"
	@echo "make test-matrix  all the others, and all demos, part by part: MATRIX=\"tests studies plugins browser docs demos pythons mutants neighbors kernel lerobot\""
	@echo "make page    the console's page, where the one that is there is not of these sources"
	@echo "make lock    the versions that make installs, in locks/ (NEWEST=1: the newest of everything)"
	@echo "make test-kernel  the drivers against the real Linux kernel, in a virtual machine"
	@echo "make test-systemd  the service under systemd, which is reloaded, killed and stopped, in that machine"
	@echo "make check   lint, types and make test (also make lint, make types)"
	@echo "make test-pythons  what computes under the oldest and the newest Python"
	@echo "make test-neighbors  the lowest and the newest of what pyproject.toml allows, and beside packages of other projects"
	@echo "make test-lerobot  the plug-ins and data sets against LeRobot, in an environment of its own"
	@echo "make fuzz    10^7 damaged inputs for everything that reads foreign bytes (FUZZ_INPUTS=$(FUZZ_INPUTS))"
	@echo "make device-table  the times to neutral in docs/devices.md, from the test that measures them"
	@echo "make fault-table  tables of docs/faults.md, in tests/results: what each robot does when something fails"
	@echo "make fault-table-processes  the same with whole programs, for half an hour: FAULT_LABS=$(FAULT_LABS) side by side"
	@echo "make fault-table-network  the same on a bad network, in the virtual machine of test-kernel"
	@echo "make flood-table  its table of floods: clients that send more than a server can handle"
	@echo "make hold-table  the table of docs/console.md: every end of a hold on the page, by a real browser"
	@echo "make console-pictures  docs/images/console-*.webp, which the tests compare the page with"
	@echo "make arm-tables  what Pinocchio reads of our arms, for programs that have none: cardan/robots/*.json"
	@echo "make docs-tables  the table of README.md, and the lines in place of those that the site has"
	@echo "make docs-pictures  the pictures of the console's page, by its acceptance test's browser"
	@echo "make docs-evaluation  the report of docs/evaluation.md, EVALUATE=--quick for a short one"
	@echo "make demo-picture  the moving picture of the README, from the demo"
	@echo "make docs    the documentation as a site, in build/docs/site"
	@echo "make release  what would be released, checked; nothing is uploaded and no tag is made"
	@echo "make bench   benchmarks, printed as ratios"
	@echo "make bench-motoros  the latency study of the 2021 paper, with plots for docs/"
	@echo "make bench-thesis  the measurements of the 2020 thesis, with plots for docs/"
	@echo "make bench-haptics  stability and timing of the force feedback, with tables and plots for docs/"
	@echo "make bench-network  what the network costs a session and how fast it is, with tables for docs/"
	@echo "make bench-console  from a finger on the page to the robot, and what viewers cost, for docs/"
	@echo "make bench-sessions  how many sessions this computer runs, and what each costs, for docs/"
	@echo "make bench-remote  a device at another computer, over networks of several kinds, for docs/"
	@echo "make bench-kilohertz  whether a session holds a period of 1 ms, for docs/"
	@echo "make bench-servo  what a tick of the servo costs beside what others do, for docs/"
	@echo "make bench-peers  builds what others do in C++, which some benchmarks compare with"
	@echo "make soak    $(HOURS) hours (HOURS) of random motions and random faults on a lab, with a report in soak/"
	@echo "make dist    what is released: the source archive and a manylinux wheel, in dist/"
	@echo "make clean   remove the environment and caches"

# Versions and hashes are those of locks/; NEWEST=1 installs the newest instead, in a new environment.
$(VENV)/.cardan: pyproject.toml studies/pyproject.toml $(wildcard plugins/cardan-*/pyproject.toml) \
		hatch_build.py $(wildcard plugins/*/hatch_build.py) tools/environment tools/install $(NATIVE) \
		locks/make.txt locks/uv.txt locks/arm.txt $(C_SOURCES)
	{ $(NATIVE:%=% &&) :; } & native=$$!; tools/environment "$(PYTHON)" "$(VENV)" && \
		{ ! wait $$native || export CARDAN_NATIVE=compiled; } && \
		tools/install "$(VENV)" --editable arm
	@touch $@

# Modules are compiled at once: tests that wait for real clocks would be late by it.
$(VENV)/.cardan-dev: $(VENV)/.cardan locks/dev.txt locks/descriptions.txt
	UV_COMPILE_BYTECODE=1 tools/install "$(VENV)" dev descriptions
	@touch $@

lock: $(VENV)/.cardan
	tools/lock "$(VENV)"

# By the system's npm, or by one that pip brings where there is none. Wheels have the page.
define console-page
$(BIN)/python tools/console $(1) || { [ $$? = 3 ] && \
	tools/install "$(VENV)" page && \
	$(BIN)/python tools/console $(1); }
endef

page: $(VENV)/.cardan
	$(call console-page)

# What this demo needs beside the arm's model: extras of Cardan, as its file has them. A page is
# needed with the extra that serves it.
DEMO_LOCKS := can console network
DEMO_READY := $(VENV)/.cardan-demo-$(subst /,-,$(DEMO_ROBOT))

$(DEMO_READY): $(VENV)/.cardan $(DEMO_LOCKS:%=locks/%.txt)
	extras=$$($(BIN)/cardan demo --extras $(DEMO_ROBOT)) && { [ -z "$$extras" ] || \
		tools/install "$(VENV)" $$(echo "$$extras" | tr , ' '); }
	@touch $@

demo: $(if $(filter --list,$(DEMO_ROBOT)),$(VENV)/.cardan,$(DEMO_READY))
demo: $(if $(filter console,$(DEMO_ROBOT)),page)
	$(BIN)/cardan demo $(DEMO_ROBOT) --seconds $(DEMO_SECONDS)

# Where a test runs is said by its mark: conftest.py.
test: $(VENV)/.cardan-dev page
ifeq ($(strip $(PYTEST)),)
	TEST_WORKERS=$(TEST_WORKERS) tools/test $(BIN)/python
else
	$(BIN)/python -m pytest $(PYTEST)
endif

# Hours on a small computer, demos and virtual machines included.
test-matrix:
	VENV=$(VENV) tools/test-matrix $(MATRIX)

# Minutes, in software emulation; what it needs is installed from Debian, and downloaded once.
test-kernel: $(VENV)/.cardan-dev
	tools/debian-packages kernel
	tools/kernel-vm

# The same with the service under systemd as the machine's first process, which dies in every way.
test-systemd: $(VENV)/.cardan-dev
	tools/debian-packages kernel
	KERNEL_VM_SECONDS=1500 tools/kernel-vm tests/kernel/systemd_restarts.py

device-table: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.device_table

fault-table: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.fault_table
	$(BIN)/python -m tests.remote_fault_table

# Real processes and clocks: on a computer that has nothing else to do. What is found is kept in
# build/faults.json after each case; FAULT_OPTIONS=--missing continues a run that was ended.
fault-table-processes: $(VENV)/.cardan-dev
	mkdir -p build
	$(BIN)/python -m tests.process_faults --labs $(FAULT_LABS) --json build/faults.json --write $(FAULT_OPTIONS)

fault-table-network: $(VENV)/.cardan-dev
	mkdir -p build
	tools/debian-packages kernel
	tools/kernel-vm tests/kernel/network_faults.py | tee build/network-faults.log
	$(BIN)/python -m tests.process_faults --kernel build/network-faults.log --json build/faults.json --write

flood-table: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.flood_table

# Real clocks, too: on a computer that has nothing else to do.
hold-table: $(VENV)/.cardan-dev
	tools/console
	$(BIN)/python -m tests.console.hold_table

console-pictures: $(VENV)/.cardan-dev
	tools/console
	$(BIN)/python -m tests.console.pictures

arm-tables: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.arm_tables

docs-tables: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.docs_tables
	$(BIN)/python -m tests.site_tables

docs-pictures: $(VENV)/.cardan-dev page
	$(BIN)/python -m tests.docs_pictures

# On a computer that has nothing else to do.
docs-evaluation: $(VENV)/.cardan-dev
	$(BIN)/cardan evaluate $(EVALUATE) --output build/evaluation
	$(BIN)/python -m studies.tests.docs_evaluation build/evaluation

demo-picture: $(VENV)/.cardan-dev
	$(BIN)/python -m tests.demo_picture

# A site without a warning, whose links lead somewhere; by packages that only this needs.
docs: $(VENV)/.cardan-docs
	$(BIN)/python tools/docs

$(VENV)/.cardan-docs: $(VENV)/.cardan locks/docs.txt
	tools/install "$(VENV)" docs
	@touch $@

lint: $(VENV)/.cardan-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(NATIVE:%=% -Werror &&) :

types: $(VENV)/.cardan-dev
	$(BIN)/mypy
	$(call console-page,--check)

check: lint types test

bench: $(VENV)/.cardan-dev
	$(BIN)/python -m bench

bench-motoros: $(VENV)/.cardan-dev
	$(BIN)/python -m bench yaskawa --plots docs/images/motoman

bench-thesis: $(VENV)/.cardan-dev
	$(BIN)/python -m bench thesis --plots docs/images/thesis

bench-haptics: $(VENV)/.cardan-dev
	$(BIN)/python -m bench haptics --pages --plots docs/images/haptics

bench-network: $(VENV)/.cardan-dev
	$(BIN)/python -m bench network --pages

bench-console: $(VENV)/.cardan-dev
	tools/console
	$(BIN)/python -m bench console --pages

bench-sessions: $(VENV)/.cardan-dev
	$(BIN)/python -m bench sessions --pages

# Minutes: Pinocchio's headers. What is built stays in build/peers.
bench-peers: $(VENV)/.cardan-dev
	tools/debian-packages peers
	$(BIN)/python -m bench.native

bench-servo: bench-peers
	tools/install "$(VENV)" published
	$(BIN)/python -m bench servo-tick published-tick --pages

bench-kilohertz: $(VENV)/.cardan-dev
	$(BIN)/python -m bench kilohertz --pages

bench-remote: $(VENV)/.cardan-dev
	$(BIN)/python -m bench remote --pages

# Half an hour to an hour on a quiet machine; FUZZ has further options: FUZZ="egm.robot --seed 7".
fuzz: $(VENV)/.cardan-dev
	$(BIN)/python -m fuzz --inputs $(FUZZ_INPUTS) $(FUZZ)

soak: $(VENV)/.cardan-dev
	$(BIN)/python -m bench soak --hours $(HOURS) --seed $(SEED) \
		--output soak/$$(date +%Y-%m-%dT%H%M%S)

# The oldest and the newest Python the package promises, where the machine has them.
test-pythons:
	tools/test-pythons 3.10 3.13

test-neighbors: $(VENV)/.cardan
	tools/test-neighbors "$(VENV)" 3.10 3.13

# Gigabytes where pip finds no PyTorch for processors alone; said aloud where it cannot be installed.
test-lerobot: $(VENV)/.cardan
	tools/lerobot $(BIN)/python

dist: $(VENV)/.cardan page
	tools/dist $(BIN)/python dist

release: $(VENV)/.cardan page
	$(BIN)/python tools/release

clean:
	rm -rf $(VENV) .venv-3.* .mypy_cache .ruff_cache .pytest_cache .hypothesis build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	rm -rf console/node_modules cardan/gateway/servers/console/page docs/api
	find cardan plugins -name '*.so' -delete
