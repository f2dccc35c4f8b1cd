# Two commands for newcomers: `make demo` and `make test`. Both install what they need.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
VENV := .venv
PY := $(VENV)/bin/python
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)

# The project's, for what is built for others; sudo passes it on only like this.
HOME_PAGE := $(if $(URL),URL='$(URL)')

# The tests start hundreds of processes; each would otherwise compile all modules again.
unexport PYTHONDONTWRITEBYTECODE

# What the daemon and the demo need, including a compiler for their C parts, and what only the tests need.
COMPILER := gcc libc6-dev python3-dev
DEMO_PACKAGES := gir1.2-aravis-0.8 python3-gi python3-venv libusb-1.0-0 $(COMPILER)
TEST_PACKAGES := $(DEMO_PACKAGES) aravis-tools-cli aravis-tools tshark usbutils chromium systemd openssl
CONTAINER := runc umoci debootstrap
ROSIDL := cmake rosidl-tools rosidl-generator-c-cpp python3-ament-index
GSTREAMER := gstreamer1.0-tools gstreamer1.0-plugins-base
ACCEPT_PACKAGES := $(GSTREAMER) g++ prometheus $(CONTAINER) socat iproute2 $(ROSIDL)
KERNEL_PACKAGES := qemu-system-x86 kmod udev usbip
ROBOT_PACKAGES := $(DEMO_PACKAGES) udev

EXTRAS := sim,calibration,publish,record,page

# A set-up that lacks one of the C parts is made again: `git clean` takes them, and the second is optional for pip.
NATIVE_SOURCES := setup.py $(wildcard autoexpose_daemon/control/native/*/* fake_camera/usb3/shim/*)
UNBUILT := $(if $(and $(wildcard autoexpose_daemon/control/_native.*.so),$(wildcard fake_camera/usb3/_shim.*.so)),,unbuilt)

.PHONY: unbuilt setup demo test suite parallel realtime test-again test-data test-platforms test-arm64 test-ros2 lint count bench accept soak fuzz mutate test-kernel install uninstall deb wheels image release docs pictures clean
.DEFAULT_GOAL := demo

# Stamps let later runs start at once; they are renewed when what is installed changes.
# An environment that was cut off while it was made has a python, but no pip.
$(VENV)/demo.stamp: pyproject.toml $(NATIVE_SOURCES) $(UNBUILT)
	@echo "setting up, once; the tools' output is in build/setup.log"
	@./tools/install-debian $(DEMO_PACKAGES)
	@$(PY) -m pip --version >/dev/null 2>&1 || ./tools/timed "making $(VENV)" /usr/bin/python3 -m venv --system-site-packages $(VENV)
	@./tools/install-python $(PY) $(EXTRAS)
	@touch $@

$(VENV)/dev.stamp: $(VENV)/demo.stamp pyproject.toml
	@echo "setting up what the tests need, once"
	@./tools/install-debian $(TEST_PACKAGES)
	@./tools/install-python $(PY) $(EXTRAS),lab,cluster,examiners,dev
	@touch $@

setup: $(VENV)/dev.stamp ## create .venv with everything

demo: $(VENV)/demo.stamp ## watch two fake cameras keep a good exposure while lights go on and off
	@mkdir -p out
	@$(VENV)/bin/autoexpose demo --plot out/demo.png

lint: $(VENV)/dev.stamp
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

count: ## files and lines of Python by room
	@python3 -m tools.count_lines

test: ## everything that CI runs
	@$(MAKE) --no-print-directory $(VENV)/dev.stamp
	@$(MAKE) --no-print-directory -j2 lint parallel
	@$(MAKE) --no-print-directory realtime

suite: parallel realtime ## only the tests

parallel: $(VENV)/dev.stamp ## those that may run at the same time
	$(VENV)/bin/pytest -m "not realtime" -n 4 --dist loadfile --no-loadscope-reorder

# Only the files with such tests: importing all of them takes 8 s longer.
realtime: $(VENV)/dev.stamp ## those in real time, which run alone
	$(VENV)/bin/pytest -m realtime $$(grep -rl --include 'test_*.py' --exclude-dir accept mark.realtime tests)

test-again: $(VENV)/dev.stamp ## the tests N times (default 20), with a summary; BUSY=1 keeps one core busy
	$(PY) -m tools.test_again --runs $(or $(N),20) $(if $(BUSY),--busy)

test-data: $(VENV)/dev.stamp ## the tests that need external data, in AUTOEXPOSE_DATA
	$(VENV)/bin/pytest -m data

test-platforms: ## the quick tests and a demo on Debian 12 and 13 and Ubuntu 22.04 and 24.04, or SUITES="..."; needs root
	@./tools/install-debian debootstrap
	@$(SUDO) $(HOME_PAGE) ./tests/platforms/run $(or $(SUITES),bookworm trixie jammy noble)

test-arm64: ## wheels, quick tests and demos on Debian 12 for arm64, emulated; about an hour; needs root
	@./tools/install-debian debootstrap qemu-user-static
	@$(SUDO) $(HOME_PAGE) ./tests/platforms/arm64

bench: $(VENV)/dev.stamp ## where the time goes, as ratios
	$(PY) benchmarks/bench_step.py
	$(PY) benchmarks/bench_render.py
	$(PY) benchmarks/bench_publish.py

build/ros2/stamp: tests/accept/ros2/install tests/accept/ros2/packages.txt
	@./tools/timed "installing ROS 2 Jazzy in build/ros2" ./tests/accept/ros2/install build/ros2
	@touch $@

build/ros2-kilted/stamp: tests/accept/ros2/install tests/accept/ros2/packages-kilted.txt
	@./tools/timed "installing ROS 2 Kilted in $(@D)" ./tests/accept/ros2/install $(@D) tests/accept/ros2/packages-kilted.txt
	@touch $@

test-ros2: $(VENV)/dev.stamp build/ros2$(if $(filter kilted,$(ROS2)),-kilted)/stamp ## the ROS 2 node beside a demo, visited by a program of ROS 2 for a minute; ROS2=kilted
	@./tools/install-debian cmake g++
	ROS2=$(or $(ROS2),jazzy) $(PY) -m tests.accept.ros2_node --seconds 60

accept: $(VENV)/dev.stamp build/ros2/stamp ## the longer checks in real time, about 40 minutes
	@./tools/install-debian $(ACCEPT_PACKAGES)
	$(VENV)/bin/pytest tests/accept -p no:cacheprovider --override-ini addopts=-ra --timeout 600 -s
	$(VENV)/bin/pytest -m long
	$(MAKE) --no-print-directory docs

soak: $(VENV)/dev.stamp ## endurance: a day in virtual time, ten minutes of demo, cables pulled 50 times; accounts must balance
	@mkdir -p out
	$(PY) -m tests.soak --hours $${SOAK_HOURS:-24} $${SOAK_SEED:+--seed $$SOAK_SEED}
	$(VENV)/bin/autoexpose demo --seconds 600 --policy neves2009 --summary out/soak.json
	REPLUG_CYCLES=50 $(VENV)/bin/pytest tests/accept/test_replug.py tests/accept/test_on_usb3.py -k replug

$(VENV)/fuzz.stamp: $(VENV)/dev.stamp pyproject.toml
	@./tools/install-python $(PY) fuzz
	@touch $@

fuzz: $(VENV)/fuzz.stamp ## feed a million damaged inputs to our parsers, about 12 minutes on two cores
	nice -n 5 $(PY) -m tests.fuzz $(TARGETS)

MUTATE ?= drivers.triggers.rate.* imaging.exposure.*

mutate: $(VENV)/mutate.stamp ## change the code of the modules in MUTATE="imaging.exposure.* ...", one place at a time: a test should notice
	@rm -rf mutants
	@echo "prepares all changes in mutants/, runs all tests concerned once (minutes), then tries the changes to $(MUTATE)"
	@set -f; nice -n 5 $(VENV)/bin/mutmut run $(MUTATE)
	@set -f; $(VENV)/bin/mutmut results --all true | $(PY) -m tools.judge_mutants $(MUTATE)

# Fetched again when the scripts that unpack or start it change, or after `make clean`.
build/kernel/initramfs.gz: tests/kernel/build tests/kernel/init
	@$(SUDO) apt-get -qq update
	@./tools/install-debian $(KERNEL_PACKAGES)
	@./tests/kernel/build

test-kernel: $(VENV)/dev.stamp build/kernel/initramfs.gz ## a stock kernel in QEMU attaches the USB3 Vision fake
	@./tests/kernel/run $(PY)

install: ## into /opt/autoexpose, with its units; keeps an existing configuration. DESTDIR: only the files, below it
ifeq ($(DESTDIR),)
	@[ "$$(id -u)" = 0 ] || { echo "this changes the system: sudo make install"; exit 1; }
	@./tools/install-debian $(ROBOT_PACKAGES)
endif
	@./tools/install-tree "$(DESTDIR)" usr/local
ifeq ($(DESTDIR),)
	@./tools/deb/postinst configure
	@echo "installed; next: autoexpose list, /etc/autoexpose/config.yaml, systemctl enable --now autoexpose"
endif

uninstall: ## remove what `make install` installed, except configuration, state and user
ifeq ($(DESTDIR),)
	@[ "$$(id -u)" = 0 ] || { echo "this changes the system: sudo make uninstall"; exit 1; }
	@./tools/deb/prerm remove
endif
	@./tools/install-tree --remove "$(DESTDIR)" usr/local
ifeq ($(DESTDIR),)
	@./tools/deb/postrm remove
endif

deb: ## a Debian package with all its Python packages, in build/deb
	@./tools/install-debian python3-venv $(COMPILER)
	@rm -rf build/deb
	@./tools/install-tree "$$PWD/build/deb/tree" usr
	@./tools/make-deb build/deb/tree build/deb

$(VENV)/docs.stamp: $(VENV)/demo.stamp pyproject.toml
	@./tools/install-python $(PY) docs
	@touch $@

pictures: $(VENV)/dev.stamp ## the pictures in docs/images again, or PICTURES="demo page"; 20 minutes, on an idle machine
	@./tools/make-pictures $(PY) docs/images

docs: $(VENV)/docs.stamp ## the documentation as a site with search, in build/site
	@$(PY) -m tools.stage_docs build/docs
	@$(VENV)/bin/zensical build --strict --config-file mkdocs.yml

$(VENV)/packages.stamp: $(VENV)/dev.stamp pyproject.toml
	@./tools/install-python $(PY) packages
	@touch $@

wheels: $(VENV)/packages.stamp ## sources and wheels of autoexpose-daemon, autoexpose-lab, autoexpose-client and camera-twin, in dist
	@./tools/make-wheels $(PY) $(or $(DIST),dist)

image: ## an OCI image of Debian 12 with the daemon, in build/image; needs root
	@./tools/install-debian debootstrap
	@$(MAKE) --no-print-directory wheels DIST=build/image/dist
	@$(SUDO) ./tools/make-image build/image/dist

release: ## all files of a release, in build/release; URL=https://..., the project's home page (CONTRIBUTING.md)
	@./tools/make-release

clean:
	rm -rf $(VENV) out build dist mutants *.egg-info autoexpose_daemon/control/_native.*.so fake_camera/usb3/_shim.*.so .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
