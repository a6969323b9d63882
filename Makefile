# make demo   a scripted flight with a fake vehicle and a simulated rig, over real sockets and a serial port
# make test   style, types and the quick tests
# make test-all   also the long tests: whole flights, other programs, every command of the guides
# make wheels everything for a drone without a network, in the folder wheels
# make tools  what tests need beside Python: compilers, an emulator, a browser (without them tests are skipped)

# `make test PYTHON=python3.13 VENV=.venv/newer` tests with another Python and leaves .venv as it is.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

AS_ROOT := $(shell [ "$$(id -u)" = 0 ] || echo sudo -n)
TOOLS := g++ gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-newlib clang-tidy qemu-system-arm \
  chromium mosquitto faketime systemd
# One more than there are cores: some tests wait most of the time.
WORKERS = $$(($$(nproc) + 1))

# For whom `make wheels` is: Debian 12 and 13 on a Raspberry Pi. MACHINE=x86_64 PYTHONS=3.12 is another computer.
MACHINE := aarch64
PYTHONS := 3.11 3.13
EXTRAS := analysis,missions
# pip takes only wheels for the glibc versions that it is given; Debian 12 has 2.36.
PLATFORMS = --platform manylinux2014_$(MACHINE) $(patsubst %,--platform manylinux_2_%_$(MACHINE),$(shell seq 17 36))
# pip asks its own Python, not the drone's, which packages older Pythons need in addition. pip and setuptools are for a
# drone without python3-venv, and for changed sources on it.
IN_ADDITION := typing-extensions pip setuptools

.PHONY: demo test test-all tools wheels clean

demo: $(VENV)/.demo
	$(BIN)/flying-vines demo

test: LONG = -m "not long"
# Always write bytecode. Without it each run rewrites every test, and hundreds of processes compile every module.
test test-all: export PYTHONDONTWRITEBYTECODE :=
test test-all: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -n $(WORKERS) $(LONG)

tools:
	@dpkg -s $(TOOLS) >/dev/null 2>&1 || { \
	  echo "installing $(TOOLS)"; \
	  $(AS_ROOT) apt-get update -q && $(AS_ROOT) apt-get install -qy --no-install-recommends $(TOOLS); }

wheels: $(BIN)/pip
	rm -rf $@ build
	$(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir $@ .
	for python in $(PYTHONS); do \
	  $(BIN)/pip download --quiet --disable-pip-version-check --only-binary :all: $(PLATFORMS) --python-version $$python \
	    --dest $@ "$$(echo $@/flying_vines-*.whl)$(if $(EXTRAS),[$(EXTRAS)])" $(IN_ADDITION) || exit; \
	done

$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "flying-vines needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) -V)"; exit 2; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { \
	  echo "Python's venv module is not complete here; installing Debian's python3-venv"; \
	  $(AS_ROOT) sh -c 'apt-get update -q && apt-get install -qy python3-venv' \
	  || { echo "installing needs a password: sudo apt install python3-venv, then call make again"; exit 2; }; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo: pyproject.toml $(BIN)/pip
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[analysis]'
	@touch $@

$(VENV)/.dev: pyproject.toml $(BIN)/pip
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@ $(VENV)/.demo

clean:
	rm -rf $(VENV) build dist wheels *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
