# make demo | test | test-slow | cpp | oldest | bench | fuzz | figures | docs | linkcheck | wheel | release-check | windows | format | clean.
# Needs Python >= 3.11, make and a C++17 compiler; the rest goes into .venv.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install -q --disable-pip-version-check --no-compile
# build/ holds all builds, each file once. The installation is editable: a change in Python compiles nothing.
SOURCES := $(shell find cpp -type f) CMakeLists.txt pyproject.toml
CONFIGURE := $(BIN)/cmake -S . -B build -DBURRLAB_PYTHON=ON
export MPLBACKEND := Agg
# Two workers on few cores: threads of BLAS that wait for more take a tenth of the CPU time.
export OPENBLAS_NUM_THREADS := 1
unexport PYTHONDONTWRITEBYTECODE # pip compiles nothing here, so that the first import keeps what it compiles

.PHONY: demo test test-slow cpp oldest golden bench fuzz figures docs linkcheck wheel release-check windows format clean machine

machine:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "burrlab needs Python 3.11 or newer: set PYTHON=python3.x"; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "burrlab needs Python's venv: apt-get install python3-venv"; exit 1; }
	@$(PYTHON) -c 'import os, sys, sysconfig; sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' || { echo "burrlab needs Python's headers: apt-get install python3-dev"; exit 1; }
	@command -v $${CXX:-c++} >/dev/null || { echo "burrlab needs a C++17 compiler: apt-get install g++"; exit 1; }

$(VENV)/tools: pyproject.toml | machine
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip
	$(PIP) "scikit-build-core>=0.10" "pybind11>=3.1" "cmeel-eigen>=3.4" "cmake>=3.26" ninja "setuptools>=70.1"
	touch $@

$(VENV)/installed: $(VENV)/tools $(SOURCES)
	@echo "Compiling burrlab, without a word for two to five minutes, and installing what it needs"
	$(PIP) --no-build-isolation -e .
	touch $@

$(VENV)/developed: $(VENV)/installed
	@echo "Installing what the tests need: some 100 packages"
	$(PIP) --no-build-isolation -e ".[cluster,haply,medical,pandas,psychometric,viz3d]" --group dev
	touch $@

$(VENV)/documented: $(VENV)/installed
	$(PIP) --no-build-isolation -e ".[docs]"
	touch $@

demo: $(VENV)/installed
	$(BIN)/python examples/demo.py demo

test: $(VENV)/developed
	$(CONFIGURE) -DBURRLAB_TESTS=ON
	$(BIN)/cmake --build build
	$(BIN)/ctest --test-dir build -j 2 --output-on-failure
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	printf '[mypy]\nfollow_imports = skip\n' > build/stubtest.ini # the stub alone, not the package beside it
	printf '%s\n' mypy "python -m mypy.stubtest burrlab._core --mypy-config-file build/stubtest.ini" \
	  "python -m pytest -p no:cacheprovider --doctest-modules --pyargs burrlab" \
	  | xargs -P 2 -I COMMAND sh -cx '$(BIN)/COMMAND'
	$(BIN)/python -m pytest -n 2 -m "not slow" tests/python
	$(BIN)/python -m pytest --nbmake -n 2 --nbmake-timeout=600 notebooks

# The examples in C++ and C, built and run with the library as it is installed
cpp: $(VENV)/developed
	$(CONFIGURE)
	$(BIN)/cmake --build build --target burrlab
	rm -rf build/prefix
	$(BIN)/cmake --install build --component cpp --prefix build/prefix
	$(BIN)/cmake -S examples/cpp -B build/examples -DCMAKE_PREFIX_PATH=$(abspath build/prefix)
	$(BIN)/cmake --build build/examples
	rm -f build/examples/device.burr
	cd build/examples && for example in tick descent device renderer host host_c; do ./$$example || exit 1; done
	$(BIN)/burrlab replay build/examples/device.burr
	$(BIN)/burrlab fit build/examples/descent.csv --radius 3

test-slow: $(VENV)/developed
	$(BIN)/python -m pytest -m slow tests/python

# The quick tests with the lowest versions that pyproject.toml allows, which may warn; for Python 3.11 (PYTHON=python3.11)
oldest: $(VENV)/installed
	$(PIP) uv
	$(BIN)/uv venv -q --clear --python $(BIN)/python build/oldest
	$(BIN)/uv pip compile -q --resolution lowest-direct -o build/oldest.txt pyproject.toml \
	  $(addprefix --extra ,cluster haply medical pandas psychometric viz3d)
	$(BIN)/uv pip install -q --python build/oldest -r build/oldest.txt --group dev
	PYTHONPATH=$(CURDIR)/python build/oldest/bin/python -m pytest -n 2 -m "not slow" -W ignore::DeprecationWarning tests/python

# Shows how one case of tests/golden differs from what was frozen, and freezes it anew: CASE=fits
golden: $(VENV)/developed
	$(BIN)/python tests/golden/cases.py $(CASE)

# BENCH=--quick only tries whether it runs; BENCH=--waits measures where a researcher waits
bench: $(VENV)/installed
	$(CONFIGURE) -DBURRLAB_BENCH=ON
	$(BIN)/cmake --build build --target burrlab_bench
	$(BIN)/python tests/bench/bench.py --library build/burrlab_bench.so --out bench $(BENCH)

# SECONDS=10 only tries whether it runs
fuzz: SECONDS := 600
fuzz: $(VENV)/developed
	$(CONFIGURE) -DBURRLAB_TESTS=ON
	$(BIN)/cmake --build build --target fuzz_openigtlink fuzz_vrpn
	build/tests/fuzz/fuzz_openigtlink 10000000000 $(SECONDS)
	build/tests/fuzz/fuzz_vrpn 10000000000 $(SECONDS)
	sed -n 's/^    "\([a-z]*\)": (.*/\1/p' tests/fuzz/readers.py | xargs -P 2 -I TARGET $(BIN)/python tests/fuzz/fuzz.py TARGET --seconds $(SECONDS)

figures: $(VENV)/developed
	$(BIN)/python examples/phantom.py build/phantom 0.25
	$(BIN)/burrlab view build/phantom/ear.h5 --png docs/mastoidectomy.png --width 50 --size 1100x760
	$(BIN)/python examples/grid_independence.py docs/grid_independence.png
	$(BIN)/python examples/hierarchy.py docs/hierarchy.png
	$(BIN)/python examples/rooms.py docs/architecture.png
	$(BIN)/python examples/offsets.py docs/offsets.png

# Every warning is an error, also a link that leads nowhere. The site is build/docs/index.html.
docs: $(VENV)/documented
	rm -rf build/docs
	$(BIN)/python -m sphinx -W --keep-going -n -q -j auto -c docs . build/docs

# Links out of the site; this needs the network
linkcheck: $(VENV)/documented
	$(BIN)/python -m sphinx -q -b linkcheck -c docs . build/linkcheck

# A wheel for each Python that is installed, for Linux with this machine's C library or a later one.
PYTHONS ?= $(or $(strip $(foreach minor,11 12 13 14,$(shell python3.$(minor) -c 'import sys; print(sys.executable)' 2>/dev/null))),$(PYTHON))
wheel: $(VENV)/tools
	$(PIP) --group wheel
	rm -rf build/wheel dist
	for python in $(PYTHONS); do $(BIN)/python -m pip --python $$python wheel -q --no-deps --wheel-dir build/wheel . || exit 1; done
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/auditwheel repair --wheel-dir dist build/wheel/*.whl
	$(BIN)/check-wheel-contents dist/*.whl
	$(BIN)/twine check --strict dist/*.whl

# All of a release but tag and upload (docs/releasing.md): the source distribution builds, tests and makes its site by itself.
release-check:
	test -z "$$(git status --porcelain)" || { echo "commit first: a release is a commit"; exit 1; }
	$(MAKE) wheel
	$(BIN)/python -m build -q --sdist --outdir dist .
	$(BIN)/twine check --strict dist/*
	rm -rf build/release && mkdir build/release && tar xzf dist/*.tar.gz -C build/release --strip-components=1
	$(MAKE) -C build/release VENV=.venv demo test docs
	ls -l dist

WINDOWS = $(BIN)/cmake -DCMAKE_SYSTEM_NAME=Windows -DCMAKE_SYSTEM_PROCESSOR=x86_64 -DCMAKE_BUILD_TYPE=Release \
  -DCMAKE_C_COMPILER=x86_64-w64-mingw32-gcc-posix -DCMAKE_CXX_COMPILER=x86_64-w64-mingw32-g++-posix \
  -DCMAKE_EXE_LINKER_FLAGS=-static -DCMAKE_PREFIX_PATH="$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/cmeel.prefix"
# The C++ tests as programs for Windows, and the examples with burrlab.dll, under Wine: apt-get install g++-mingw-w64-x86-64-posix wine
windows: $(VENV)/tools
	$(WINDOWS) -S . -B build/windows -DCMAKE_CROSSCOMPILING_EMULATOR=wine -DBURRLAB_TESTS=ON
	$(BIN)/cmake --build build/windows -j 2
	WINEPREFIX=$(abspath build)/wine $(BIN)/ctest --test-dir build/windows --output-on-failure
	$(WINDOWS) -S . -B build/dll -DBUILD_SHARED_LIBS=ON -DCMAKE_SHARED_LINKER_FLAGS=-static
	$(BIN)/cmake --build build/dll -j 2
	$(BIN)/cmake --install build/dll --prefix build/dll/prefix
	$(WINDOWS) -S examples/cpp -B build/dll/examples -Dburrlab_DIR=$(abspath build)/dll/prefix/lib/cmake/burrlab
	$(BIN)/cmake --build build/dll/examples
	cp build/dll/prefix/bin/burrlab.dll build/dll/examples
	cd build/dll/examples && for example in tick renderer host host_c; do WINEPREFIX=$(abspath build)/wine wine ./$$example.exe || exit 1; done

format: $(VENV)/developed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(shell find cpp tests -name '*.cpp' -o -name '*.hpp')

clean:
	rm -rf build dist $(VENV) demo bench
