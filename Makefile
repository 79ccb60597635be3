# The only place where commands are spelled. `make demo` and `make test` work on a fresh machine.

PYTHON ?= python3
CONSTRAINTS ?= constraints/ci-cpu.txt
WORKERS ?= auto
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.DEFAULT_GOAL := help
.PHONY: help venv demo test lint types pytest docs accuracy bench bench-gpu bench-peer bench-scale bench-lab train-weights clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "%-14s %s\n", $$1, $$2}'

venv: $(STAMP) ## install everything into .venv (PYTHON and CONSTRAINTS may be given)

$(STAMP): pyproject.toml $(CONSTRAINTS)
	@$(PYTHON) -c 'import sys; sys.exit("$(PYTHON) is Python %d.%d, 3.11 or newer is needed; make PYTHON=python3.11" % sys.version_info[:2] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	@# The pip that comes with Python 3.11 (23.2) takes twice as long; it does where no newer one can be had.
	-$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c $(CONSTRAINTS) --upgrade pip
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c $(CONSTRAINTS) -e '.[dev,docs,exr,cluster]'
	@# Modules are compiled at their first use: of the 15,000 that come along a quarter is used. Where Python is told to
	@# keep nothing of that, all are compiled now, on all cores; some are templates of other programs and do not compile.
	@if [ -n "$$PYTHONDONTWRITEBYTECODE" ]; then $(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true; fi
	@touch $@

demo: $(STAMP) ## reconstruct the example capture into demo_output/
	$(BIN)/nsfc reconstruct examples/data/capture.tif \
		--dark examples/data/dark.tif --flat examples/data/flat.tif \
		--reference examples/data/true_heights.npy \
		--config examples/demo.yaml -o demo_output --force

test: lint types pytest ## lint, types and tests

lint: $(STAMP) ## check style
	$(BIN)/ruff check
	$(BIN)/ruff format --check

types: $(STAMP) ## check types
	$(BIN)/mypy

pytest: $(STAMP) ## tests only, on all cores (WORKERS=2 on two)
	$(BIN)/python -m pytest -n $(WORKERS) --maxprocesses 8 --dist worksteal

docs: $(STAMP) ## build the documentation into build/docs, examples included; any warning fails
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet $(DOCS_OPTIONS) docs build/docs

accuracy: $(STAMP) ## how exact simulator and gradient are, and what refine recovers
	$(BIN)/python -m benchmarks.accuracy

bench: $(STAMP) ## how fast the simulator is on this CPU, with its error
	$(BIN)/python -m benchmarks.speed --json benchmarks/cpu.json

bench-gpu: $(STAMP) ## the same on a GPU
	$(BIN)/python -m benchmarks.speed --device cuda --json benchmarks/gpu.json

bench-peer: $(STAMP) ## beside a tracer in Dr.Jit, which is installed below build/ (PEER_OPTIONS='--device cuda')
	$(BIN)/python -m benchmarks.peer --json benchmarks/peer.json $(PEER_OPTIONS)

bench-scale: $(STAMP) ## time and memory against photons, pixels and height samples, on this CPU
	$(BIN)/python -m benchmarks.scale --json benchmarks/scale_cpu.json

SUITES := ideal one-thing lab prints
BENCH_METHODS ?= flat,direct,auto
BENCH_OPTIONS ?=
PEER_OPTIONS ?=

bench-lab: $(STAMP) ## methods on the test bench, tables of docs/bench.md (BENCH_METHODS, BENCH_OPTIONS='--fields 1')
	mkdir -p build/bench
	for suite in $(SUITES); do \
		$(BIN)/nsfc bench run --suite $$suite --methods $(BENCH_METHODS) -o build/bench/$$suite $(BENCH_OPTIONS) || exit 1; \
	done
	$(BIN)/python -m benchmarks.bench $(SUITES:%=build/bench/%/table.json)

train-weights: $(STAMP) ## train every network into weights_out/, two and a quarter hours on H200s
	NSFC=$(BIN)/nsfc examples/train_weights.sh weights_out

clean: ## remove the environment and everything generated
	rm -rf $(VENV) demo_output build docs/gallery dist .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
