# make run: set up, build, and show a minute of play.   make test: set up and run every test.   make dist: tarballs for a robot.

PYTHON ?= python3
VENV := .venv
export PYO3_PYTHON := $(CURDIR)/$(VENV)/bin/python

.PHONY: run test lint bench dist setup check clean

run: setup
	cargo run --release --locked -- demo

# Python's tests import the package as it lies here, its compiled half from the same build.
test: setup
	cargo build --release --locked --workspace
	cargo test --release --locked --workspace
	ln -sfn ../../target/release/lib_core.so py/mirrorball/_core.so
	$(VENV)/bin/python -m pytest

lint: setup
	cargo fmt --all --check
	cargo clippy --release --locked --workspace --all-targets -- -D warnings
	$(VENV)/bin/ruff check py tests
	$(VENV)/bin/ruff format --check py tests
	$(VENV)/bin/mypy

bench: setup
	cargo bench --workspace

# Tarballs for the robot in dist/out, tried in a bare folder.
dist: setup
	tools/make_dist

setup: check $(VENV)/.ready

# Every missing system package is named with the command that installs it.
check:
	@tools/check_system "$(PYTHON)"

$(VENV)/.ready: requirements.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --requirement requirements.txt
	touch $@

clean:
	cargo clean
	rm -rf $(VENV) out
