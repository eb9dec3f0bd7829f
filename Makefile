# make run: set up, build, run the demo.  make test: set up, run every test.  make check: formatting, lints, fast tests.
# make dist: tarballs for a robot.

PYTHON ?= python3
VENV := .venv
export PYO3_PYTHON := $(CURDIR)/$(VENV)/bin/python

.PHONY: announce run test check fmt lint types genicam ros2 rerun doc deny bench figures site wheel dist setup system clean

run: announce setup
	cargo run --release --locked -- demo

announce:
	@test -x target/release/mirrorball || echo "First run: sets up a Python environment (1 minute), compiles about 460 crates (7 minutes \
	on two cores), then runs a one-minute demo. Later runs start in seconds."

# Python tests import the package from this tree, with the compiled module of the same build.
test: setup
	cargo build --release --locked --workspace
	cargo test --release --locked --workspace
	ln -sfn ../../target/release/lib_core.so py/mirrorball/_core.so
	$(VENV)/bin/python -m pytest

# For each edit: what fails most often, in less than two minutes after the first build.
check: lint
	cargo test --release --locked --workspace --lib

lint: setup
	cargo fmt --all --check
	cargo clippy --release --locked --workspace --all-targets --features app/ros2 -- -D warnings
	cargo clippy --release --locked -p app --no-default-features -- -D warnings
	$(VENV)/bin/ruff check py tests
	$(VENV)/bin/ruff format --check py tests
	$(VENV)/bin/mypy
	$(VENV)/bin/python tools/file_cycles crates/localize crates/vision crates/hw crates/sim crates/pipeline crates/app py

# A user's script under pyright's strict check. basedpyright is pyright with node as a wheel, so that a machine needs no node.
types: setup
	$(VENV)/bin/python -m pip install --quiet basedpyright==1.40.2
	$(VENV)/bin/basedpyright --project tests/typing

# GenICam cameras with Aravis' fake camera; needs libaravis-dev and aravis-tools.
genicam: setup
	cargo clippy --release --locked -p hw --features aravis --all-targets -- -D warnings
	MIRRORBALL_REQUIRE_TOOLS=1 cargo test --release --locked -p hw --features aravis --test genicam

# The node of ROS 2 with Cyclone DDS, in network namespaces of the tests (root). `make test` expects the executable without it.
ros2: setup
	cargo test --release --locked -p app --features ros2 --lib ros2
	cargo build --release --locked -p app --features ros2
	MIRRORBALL_REQUIRE_TOOLS=1 $(VENV)/bin/python -m pytest tests/test_ros.py tests/test_bags.py

# Logs in Rerun: conversion and layout.
rerun: setup
	$(VENV)/bin/python -m pip install --quiet rerun-sdk==0.41.0
	MIRRORBALL_REQUIRE_TOOLS=1 $(VENV)/bin/python -m pytest -q tests/test_log.py -k rerun

# API documentation of our own crates; a broken link is an error.
doc: setup
	RUSTDOCFLAGS="-D warnings" cargo doc --release --locked --workspace --no-deps

# Licences, duplicate versions and sources of all dependencies; needs cargo-deny and no network after `cargo fetch`.
deny:
	cargo fetch --locked
	cargo deny --offline check licenses bans sources

bench: setup
	cargo bench --workspace

# Every measurement of docs/figures.md, and the page: an hour and more.
figures: setup
	cargo build --release --locked -p app
	tools/figures

# The documentation site in out/site: guides, command line, Python API, notebooks with their pictures. A broken link is an error.
site: setup
	cargo build --release --locked -p app -p mirrorball-py
	ln -sfn ../../target/release/lib_core.so py/mirrorball/_core.so
	$(VENV)/bin/python -m pip install --quiet --requirement docs/requirements.txt
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=py $(VENV)/bin/python -m mkdocs build --quiet

# The package's wheel in out/wheel, tried in a fresh environment. It compiles its dependencies once more, in target-wheel.
wheel: setup
	$(VENV)/bin/python tools/check_wheel

# Tarballs for the robot in dist/out, each started once in an empty folder.
dist: setup
	tools/make_dist

setup: system $(VENV)/.ready

# Names each missing system package with the command that installs it.
system:
	@tools/check_system "$(PYTHON)"

$(VENV)/.ready: requirements.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --requirement requirements.txt
	touch $@

clean:
	cargo clean
	rm -rf $(VENV) out
