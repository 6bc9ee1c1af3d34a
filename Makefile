# Builds in .venv and target; needs a Rust toolchain, Python 3.11 or newer, and make.
PYTHON ?= python3
BIN    := .venv/bin
RUST   := Cargo.toml Cargo.lock $(shell find rust clients -name '*.rs' -o -name '*.proto' -o -name Cargo.toml 2>/dev/null) \
	$(wildcard python/egp_service/_core/*.pyi)

.DEFAULT_GOAL := help
.PHONY: help demo test bench fmt lint lint-rust lint-python deny rust-test python-test timed-tests busy-tests browser site wheel wheel-test arm-test instructions soak recipe clean

# Python's bytecode is written once: without it a process that imports torch takes 6 s of processor time longer, and the tests
# start hundreds of processes.
unexport PYTHONDONTWRITEBYTECODE

help: ## List these commands
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

demo: .venv/built-viz ## Set up, then drive six laps over three surfaces and draw them
	$(BIN)/egp demo

# Compilers have the machine to themselves. Then tests that mostly wait and have deadlines to keep run beside tests that need
# the processor, which get only what the former leave: on Linux as idle tasks, which anything else displaces at once.
test: .venv/built-dev ## Set up and pass every check: format, lint, types, Rust and Python tests
	$(MAKE) --jobs=2 lint instructions
	$(CARGO_TEST) --no-run
	$(MAKE) --jobs=2 timed-tests busy-tests

bench: .venv/built-bench ## Run the benchmarks
	cargo bench -p egp-bench
	$(BIN)/python tests/bench/compare.py
	$(BIN)/python tests/bench/qp.py

fmt: .venv/built-dev ## Format Rust and Python
	cargo fmt --all
	$(BIN)/ruff format python tests
	$(BIN)/ruff check --fix python tests

lint: lint-rust lint-python ## Check format, lints, types, stubs and import rules

# With the examples the documentation needs the development's dependencies, so that it reads what clippy has checked.
lint-rust: .venv/built-dev
	cargo fmt --all --check
	cargo clippy --release --locked --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --release --locked --workspace --no-deps --lib --bin egp-server --examples

lint-python: .venv/built-dev
	$(BIN)/ruff format --check python tests
	$(BIN)/ruff check python tests
	$(BIN)/mypy
	$(BIN)/stubtest egp_service._core
	$(BIN)/lint-imports

SEEDS ?= 0..10000
SHIPPED := python/egp_service/shipped
soak: ## Simulate vehicles and replicas with faults for hours: make soak SEEDS=0..10000
	cargo run --release --locked -p egp-simulate -- $(SHIPPED)/demo-library.safetensors \
		--other $(SHIPPED)/evaluation-library.safetensors --seeds $(SEEDS)

recipe: .venv/built-dev ## Make the demo library again by its whole recipe, and compare it with the shipped one
	EGP_WHOLE_RECIPE=1 $(BIN)/pytest tests/train/test_demo_library.py

deny: ## Check licences, sources and advisories of the Rust crates, with cargo-deny and the network
	cargo deny --locked check $(CHECKS)

# The same profile as the extension, and without criterion, which changes the features of zenoh's dependencies: what the
# extension was built with is not compiled again.
CARGO_TEST := MAKEFLAGS= cargo test --release --locked --workspace --exclude egp-bench
rust-test: .venv/built-dev ## Run the Rust tests
	$(CARGO_TEST)

# The tests in these folders have deadlines to keep, and mostly wait: two files of them run at a time.
TIMED := tests/conformance tests/service tests/monitor tests/ros2
PYTEST := $(BIN)/pytest --dist loadfile --no-loadscope-reorder
python-test: .venv/built-dev ## Run the Python tests
	$(PYTEST) --numprocesses auto $(addprefix --ignore ,$(TIMED))
	$(PYTEST) --numprocesses auto --maxprocesses 2 $(TIMED)

timed-tests: rust-test
	$(PYTEST) --numprocesses auto --maxprocesses 2 $(TIMED)

IDLE := $(shell command -v chrt >/dev/null && echo chrt --idle 0 || echo nice -n 19)
busy-tests: .venv/built-dev
	$(IDLE) $(PYTEST) --numprocesses auto $(addprefix --ignore ,$(TIMED))

site: .venv/built-docs ## Build the documentation site in target/site
	$(BIN)/mkdocs build
	$(BIN)/python tests/stories/site.py target/site

TARGET := x86_64-unknown-linux-gnu
wheel: .venv/bin/python ## Build a wheel for Linux with glibc 2.17 or newer: make wheel TARGET=aarch64-unknown-linux-gnu
	$(BIN)/pip install --quiet --constraint constraints.txt ziglang
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/maturin build --profile dist --locked --zig --target $(TARGET) \
		--compatibility manylinux2014 --interpreter $(BIN)/python --out target/wheels

ARM := aarch64-unknown-linux-gnu
ARM_CRATES := core wire engine driver gate map path plant
arm-test: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER := aarch64-linux-gnu-gcc
arm-test: export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER := qemu-aarch64 -L /usr/aarch64-linux-gnu
arm-test: ## Pass the Rust tests for 64-bit Arm in an emulator; needs qemu-user and gcc-aarch64-linux-gnu
	cargo test --release --locked --target $(ARM) $(addprefix --package egp-,$(ARM_CRATES))

wheel-test: wheel ## Install the wheel from `make wheel` in a fresh environment, and pass the stories there
	$(BIN)/python tests/stories/fresh.py target/wheels/egp_service-*x86_64.whl
browser: ## Install Chromium on Debian or Ubuntu (as root), for the tests of the live page
	apt-get install --yes chromium

instructions: .venv/bin/python ## Check the instructions of a control step against their budget, with valgrind
	$(BIN)/python tests/bench/instructions.py

clean: ## Remove what these commands built
	rm -rf .venv target

COMMA := ,
EXTRAS_viz := viz
EXTRAS_dev := train,viz,paper,cluster,dev
EXTRAS_docs := viz,docs
EXTRAS_bench := train,viz,paper,cluster,dev,bench
PROFILE_bench := dist

# One marker per set of extras; a change to Rust or to the package's metadata rebuilds the extension. The crates are
# compiled while uv installs the packages; maturin then finds both done. Where uv cannot reach the index, pip tries with
# its own configuration. Markers of another profile are removed, because this extension replaces theirs.
.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed, found $$($(PYTHON) --version). Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	@command -v cargo >/dev/null || { echo "A Rust toolchain is needed: see https://rustup.rs"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt maturin uv

.venv/built-%: .venv/bin/python pyproject.toml constraints.txt $(RUST)
	export VIRTUAL_ENV=$(CURDIR)/.venv PATH="$(CURDIR)/$(BIN):$$PATH" UV_SYSTEM_CERTS=true \
		UV_CONSTRAINT=$(CURDIR)/constraints.txt PIP_CONSTRAINT=$(CURDIR)/constraints.txt PIP_NO_COMPILE=1; \
	build="maturin develop --profile $(or $(PROFILE_$*),release) --locked"; \
	$$build --quiet --skip-install & \
	uv pip install --requirement pyproject.toml $(patsubst %,--extra %,$(subst $(COMMA), ,$(EXTRAS_$*))); \
	wait; $$build --extras $(EXTRAS_$*) --uv || $$build --extras $(EXTRAS_$*)
	@rm -f $(if $(PROFILE_$*),.venv/built-*,.venv/built-bench)
	@touch $@
