# make demo   creates .venv, installs, runs the built-in subject through the whole chain, says where the report is
# make test   the same installation, then lint, types, import contract and tests
# make bench  the shell beside other programs, in under ten minutes: JSON, plot and the README's section

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= hilbrace-demo

.PHONY: demo test bench install lint types contract unit clean

demo: $(VENV)/.installed
	$(BIN)/hilbrace demo --out $(OUT)

test: $(VENV)/.installed-dev lint types contract unit

bench: $(VENV)/.installed-bench
	$(BIN)/python -m tests.bench.bench_shell
	$(BIN)/python -m tests.bench.show_shell

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

$(VENV)/.installed-bench: $(VENV)/.installed
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[bench]'
	touch $@

lint:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types:
	$(BIN)/basedpyright

contract:
	$(BIN)/lint-imports

# Two files at a time, one thread each: a file's tests stay together and share what they made.
unit:
	OMP_NUM_THREADS=1 $(BIN)/pytest -q -m "not soak" -n 2 --dist loadfile --no-loadscope-reorder

clean:
	rm -rf $(VENV) $(OUT)
