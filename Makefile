# `make demo` and `make test` set up everything they need in .venv and target/.

PYTHON ?= python3
VENV := .venv
FUZZ_SECONDS ?= 600
BIN := $(VENV)/bin
RUST_SOURCES := $(shell find src shaders -name '*.rs' -o -name '*.wgsl') Cargo.toml Cargo.lock

.PHONY: demo test test-rust test-python check fuzz bench bench-full gpu develop format clean readme golden notebooks

demo: develop
	$(BIN)/oitlab demo --output out/demo

test: test-rust test-python

test-rust:
	cargo test --quiet

# The GPU's tests file by file: with a driver for the processor memory grows with frames and pipelines, gigabytes over all of them
# (docs/gpu.md). Status 5 is that of a file whose tests are all skipped.
GPU_TESTS := $(wildcard tests/test_gpu*.py) tests/test_promises.py

test-python: develop
	$(BIN)/python -m pytest $(GPU_TESTS:%=--ignore=%)
	for file in $(GPU_TESTS); do $(BIN)/python -m pytest $$file || [ $$? = 5 ] || exit 1; done

check: develop
	cargo fmt --check
	cargo fmt --check --manifest-path fuzz/Cargo.toml
	cargo clippy --all-targets --quiet -- -D warnings
	CARGO_TARGET_DIR=target/python cargo clippy --features python,gpu --quiet -- -D warnings
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest oitlab._oitlab --ignore-disjoint-bases
	fuzz/run.sh 20

# FUZZ_SECONDS per target; skipped with a reason where nightly Rust, cargo-fuzz or a C++ compiler are missing.
fuzz:
	fuzz/run.sh $(FUZZ_SECONDS)

# Peers are found in OITLAB_PEER_PYTHON, an interpreter with benches/requirements-peers.txt, and skipped where absent.
bench: develop
	$(BIN)/python benches/bench.py peers skips

# All of it on the GPU at hand: tests, agreement with the CPU, and times at 1280 x 720 and 3840 x 2160.
gpu: develop
	OITLAB_REQUIRE_GPU=1 $(BIN)/python -m pytest tests/test_gpu*.py
	$(BIN)/python experiments/gpu_agreement.py --output out/gpu/agreement
	$(BIN)/python benches/bench.py gpu --output out/gpu

bench-full: develop
	$(BIN)/python benches/bench.py --huge

# At full size, in place; the tests run them reduced.
notebooks: develop
	$(BIN)/python notebooks/run.py

format:
	cargo fmt
	cargo fmt --manifest-path fuzz/Cargo.toml
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

develop: $(VENV)/.built

$(VENV)/.installed: requirements.lock
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "oitlab needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'pip>=25.1'  # knows dependency groups
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	touch $@

# The extension gets a target directory of its own: `cargo test` has other features and would rebuild it.
$(VENV)/.built: $(VENV)/.installed $(RUST_SOURCES) pyproject.toml
	CARGO_TARGET_DIR=target/python $(BIN)/maturin develop --release --quiet
	touch $@

clean:
	rm -rf $(VENV) target out dist

readme: develop
	$(BIN)/python docs/generate.py

golden: develop
	$(BIN)/python tests/test_golden.py
