# Two commands for a newcomer: `make demo` and `make test`. Both install what they need themselves.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
VENV := .venv
PY := $(VENV)/bin/python
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
APT := $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get -y --no-install-recommends

# What the daemon and the demo stand on, and what only the tests need.
DEMO_PACKAGES := gir1.2-aravis-0.8 python3-gi python3-venv libusb-1.0-0
TEST_PACKAGES := $(DEMO_PACKAGES) aravis-tools-cli aravis-tools tshark gcc libc6-dev python3-dev usbutils chromium systemd openssl
SHIM_PACKAGES := gcc libc6-dev python3-dev
KERNEL_PACKAGES := qemu-system-x86 kmod udev usbip
ROBOT_PACKAGES := $(DEMO_PACKAGES) $(SHIM_PACKAGES) udev

# Of the optional C libraries: built where there are a compiler and python3-dev, as after `make setup`.
NATIVE_SOURCES := setup.py $(wildcard autoexpose_daemon/control/native/* fake_camera/usb3/shim/*)

.PHONY: setup shim demo test suite test-again test-data lint bench accept soak fuzz test-kernel install uninstall deb clean
.DEFAULT_GOAL := demo

# Stamps make second runs start at once; they are remade when what is installed changes.
$(VENV)/demo.stamp: pyproject.toml $(NATIVE_SOURCES)
	@./tools/apt-missing $(DEMO_PACKAGES) | xargs -r sh -c '$(APT) update && $(APT) install "$$@"' --
	@[ -x $(PY) ] || /usr/bin/python3 -m venv --system-site-packages $(VENV)
	@echo "installing Python packages into $(VENV) ..."
	@$(PY) -m pip install --quiet --disable-pip-version-check --editable '.[sim,calibration,publish,record,page]'
	@touch $@

$(VENV)/dev.stamp: $(VENV)/demo.stamp pyproject.toml
	@./tools/apt-missing $(TEST_PACKAGES) | xargs -r sh -c '$(APT) update && $(APT) install "$$@"' --
	@echo "installing the tools of the tests ..."
	@$(PY) -m pip install --quiet --disable-pip-version-check --editable '.[sim,calibration,publish,record,page,experiments,dev]'
	@touch $@

setup: $(VENV)/dev.stamp ## make .venv with everything

shim: $(VENV)/demo.stamp ## build the shim by which libusb finds fake USB3 Vision cameras
	@./tools/apt-missing $(SHIM_PACKAGES) | xargs -r sh -c '$(APT) update && $(APT) install "$$@"' --
	$(PY) setup.py --quiet build_ext --inplace

demo: $(VENV)/demo.stamp ## watch two fake cameras being exposed well through lights going on and off
	@mkdir -p out
	@$(VENV)/bin/autoexpose demo --plot out/demo.png

lint: $(VENV)/dev.stamp
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

test: lint suite ## everything that CI runs

suite: $(VENV)/dev.stamp ## the tests of it; what needs real time has the machine to itself
	$(VENV)/bin/pytest -m "not realtime" -n 3 --dist loadfile --no-loadscope-reorder
	$(VENV)/bin/pytest -m realtime

test-again: $(VENV)/dev.stamp ## the tests N times, 20 unless given, and their sum; BUSY=1: one core kept busy meanwhile
	$(PY) -m tools.test_again --runs $(or $(N),20) $(if $(BUSY),--busy)

test-data: $(VENV)/dev.stamp ## the tests that need data from outside the repository, in AUTOEXPOSE_DATA
	$(VENV)/bin/pytest -m data

bench: $(VENV)/dev.stamp ## where the time goes, as ratios
	$(PY) benchmarks/bench_step.py
	$(PY) benchmarks/bench_render.py
	$(PY) benchmarks/bench_publish.py

accept: $(VENV)/dev.stamp ## the longer checks in real time, about 25 minutes
	$(VENV)/bin/pytest tests/accept -p no:cacheprovider --override-ini addopts=-ra --timeout 600 -s

soak: $(VENV)/dev.stamp ## endurance: a day in virtual time, ten minutes of demo, cables pulled 50 times; accounts must balance
	@mkdir -p out
	$(PY) -m tests.soak --hours $${SOAK_HOURS:-24} $${SOAK_SEED:+--seed $$SOAK_SEED}
	$(VENV)/bin/autoexpose demo --seconds 600 --policy neves2009 --summary out/soak.json
	REPLUG_CYCLES=50 $(VENV)/bin/pytest tests/accept/test_replug.py tests/accept/test_replug_usb3.py

$(VENV)/fuzz.stamp: $(VENV)/dev.stamp pyproject.toml
	@echo "installing the fuzzer ..."
	@$(PY) -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	@touch $@

fuzz: $(VENV)/fuzz.stamp ## a million damaged messages and files to our parsers, about 12 minutes on two cores
	nice -n 5 $(PY) -m tests.fuzz $(TARGETS)

# Fetched anew when the scripts that unpack or start it change, or after `make clean`.
build/kernel/initramfs.gz: tests/kernel/build tests/kernel/init
	@$(APT) update
	@./tools/apt-missing $(KERNEL_PACKAGES) | xargs -r $(APT) install
	@./tests/kernel/build

test-kernel: $(VENV)/dev.stamp build/kernel/initramfs.gz ## a stock kernel in QEMU attaches the USB3 Vision fake
	@./tests/kernel/run $(PY)

install: ## to /opt/autoexpose, with its unit; a configuration that is there stays. DESTDIR: only the files, below it
ifeq ($(DESTDIR),)
	@[ "$$(id -u)" = 0 ] || { echo "this changes the system: sudo make install"; exit 1; }
	@./tools/apt-missing $(ROBOT_PACKAGES) | xargs -r sh -c '$(APT) update && $(APT) install "$$@"' --
endif
	@./tools/install-tree "$(DESTDIR)"
ifeq ($(DESTDIR),)
	@./tools/deb/postinst configure
	@echo "installed; next: autoexpose list, /etc/autoexpose/config.yaml, systemctl enable --now autoexpose"
endif

uninstall: ## all that `make install` brought, but configuration, state and user
ifeq ($(DESTDIR),)
	@[ "$$(id -u)" = 0 ] || { echo "this changes the system: sudo make uninstall"; exit 1; }
	@./tools/deb/prerm remove
endif
	@./tools/install-tree --remove "$(DESTDIR)"
ifeq ($(DESTDIR),)
	@./tools/deb/postrm remove
endif

deb: ## a Debian package with all its Python packages, in build/deb
	@./tools/apt-missing python3-venv $(SHIM_PACKAGES) | xargs -r sh -c '$(APT) update && $(APT) install "$$@"' --
	@rm -rf build/deb
	@./tools/install-tree "$$PWD/build/deb/tree"
	@./tools/make-deb build/deb/tree build/deb

clean:
	rm -rf $(VENV) out build *.egg-info autoexpose_daemon/control/_native.*.so fake_camera/usb3/_shim.*.so .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
