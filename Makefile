# make demo | test | test-slow | bench | fuzz | format | clean. Needs Python >= 3.11, make and a C++17 compiler; the rest goes into .venv.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
SOURCES := $(shell find cpp python -type f -not -name '*.pyc') CMakeLists.txt pyproject.toml
CTEST_DIR := build/tests
BENCH_DIR := build/bench
export MPLBACKEND := Agg

.PHONY: demo test test-slow bench fuzz figures format clean machine

machine:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "burrlab needs Python 3.11 or newer: set PYTHON=python3.x"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "burrlab needs Python's venv: apt-get install python3-venv"; exit 1; }
	@$(PYTHON) -c 'import os, sys, sysconfig; sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' || { echo "burrlab needs Python's headers: apt-get install python3-dev"; exit 1; }
	@command -v $${CXX:-c++} >/dev/null || { echo "burrlab needs a C++17 compiler: apt-get install g++"; exit 1; }

$(VENV)/tools: pyproject.toml | machine
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check --upgrade pip
	$(BIN)/python -m pip install -q --disable-pip-version-check "scikit-build-core>=0.10" "pybind11>=3" "cmeel-eigen>=3.4" "cmake>=3.26" ninja "setuptools>=70.1"
	touch $@

$(VENV)/installed: $(VENV)/tools $(SOURCES)
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation -C build-dir=build/python ".[medical]"
	touch $@

$(VENV)/developed: $(VENV)/installed
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation -C build-dir=build/python ".[dev]"
	touch $@

$(VENV)/benched: $(VENV)/installed
	$(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation -C build-dir=build/python ".[bench]"
	touch $@

demo: $(VENV)/installed
	$(BIN)/python examples/demo.py demo

test: $(VENV)/developed
	$(BIN)/cmake -S . -B $(CTEST_DIR) -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN))/ninja -DCMAKE_BUILD_TYPE=Release -DBURRLAB_PYTHON=OFF -DBURRLAB_TESTS=ON -DPython_EXECUTABLE=$(abspath $(BIN))/python
	$(BIN)/cmake --build $(CTEST_DIR)
	$(BIN)/ctest --test-dir $(CTEST_DIR) --output-on-failure
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest burrlab._core
	$(BIN)/python -m pytest -n 2 -m "not slow" tests/python
	$(BIN)/python -m pytest -p no:cacheprovider --doctest-modules --pyargs burrlab
	$(BIN)/python -m pytest --nbmake -n 2 --nbmake-timeout=600 notebooks

test-slow: $(VENV)/developed
	$(BIN)/python -m pytest -m slow tests/python

# BENCH=--quick for a look whether it runs
bench: $(VENV)/benched
	$(BIN)/cmake -S . -B $(BENCH_DIR) -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN))/ninja -DCMAKE_BUILD_TYPE=Release -DBURRLAB_PYTHON=OFF -DBURRLAB_BENCH=ON -DPython_EXECUTABLE=$(abspath $(BIN))/python
	$(BIN)/cmake --build $(BENCH_DIR) --target burrlab_bench
	$(BIN)/python tests/bench/bench.py --library $(BENCH_DIR)/burrlab_bench.so --out bench $(BENCH)

# SECONDS=10 for a look whether it runs
fuzz: SECONDS := 600
fuzz: $(VENV)/developed
	$(BIN)/cmake -S . -B $(CTEST_DIR) -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN))/ninja -DCMAKE_BUILD_TYPE=Release -DBURRLAB_PYTHON=OFF -DBURRLAB_TESTS=ON -DPython_EXECUTABLE=$(abspath $(BIN))/python
	$(BIN)/cmake --build $(CTEST_DIR) --target fuzz_openigtlink
	$(CTEST_DIR)/tests/fuzz/fuzz_openigtlink 10000000000 $(SECONDS)
	sed -n 's/^    "\([a-z]*\)": (.*/\1/p' tests/fuzz/readers.py | xargs -P 2 -I TARGET $(BIN)/python tests/fuzz/fuzz.py TARGET --seconds $(SECONDS)

figures: $(VENV)/installed
	$(BIN)/python examples/grid_independence.py docs/grid_independence.png
	$(BIN)/python examples/hierarchy.py docs/hierarchy.png

format: $(VENV)/developed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(shell find cpp tests -name '*.cpp' -o -name '*.hpp')

clean:
	rm -rf build $(VENV) demo bench
