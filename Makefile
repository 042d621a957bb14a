# `make run` shows the main job, `make test` proves it. Everything is installed into .venv.
.DEFAULT_GOAL := help
.PHONY: help run live test quick slow check format docs reproduce reproduce-quick bench wheels clean

VENV := .venv
BIN := $(VENV)/bin
# The build tools stay in .venv. Otherwise, pip would put them into a new folder each time, and compile everything again.
INSTALL := PIP_CONSTRAINT=constraints.txt $(BIN)/pip install --quiet --no-build-isolation
KERNELS := CMakeLists.txt pyproject.toml constraints.txt $(wildcard src/kernels/*.* src/kernels/*/*)

help:
	@echo "make run    installs into .venv and renders the examples pinch and open_hand into out/"
	@echo "make live   makes the sound follow a motion, and prints the address of its web page"
	@echo "make test   runs all checks and tests (less than 6 minutes on 2 cores)"
	@echo "make slow   runs the tests that take longer"
	@echo "make check  runs only the linters, the type checks and the import contracts"
	@echo "make format formats the sources"
	@echo "make docs   builds the documentation in build/docs; warnings and broken links are errors"
	@echo "make wheels builds and tests wheels in dist/ for every installed Python from 3.11"
	@echo "make reproduce  reproduces the experiment of Inoue et al. (2014) in 20 minutes; make reproduce-quick takes 3"
	@echo "make bench  measures the table in benchmarks/MEASUREMENTS.md"

# The loops for the best instruction set of this machine are enough here; the tests compile those for the others, too.
$(VENV)/installed: $(KERNELS)
	@echo "Installing into $(VENV) takes minutes, because packages are downloaded and C++ code is compiled."
	python3 -m venv $(VENV)
	$(INSTALL) 'scikit-build-core>=1.1' 'nanobind>=2.5' cmake ninja
	AIRTACT_VARIANTS=best $(INSTALL) --editable '.[fem,live]'
	@touch $@

$(VENV)/installed-for-tests: $(VENV)/installed
	$(INSTALL) --editable '.[test]'
	@touch $@

run: $(VENV)/installed
	$(BIN)/airtact render pinch --out out/pinch
	$(BIN)/airtact render open_hand --out out/open_hand
	@echo "Open out/pinch/report.html and out/open_hand/report.html; the drives are in drive.csv and drive.h5 in the same folders."

live: $(VENV)/installed
	$(BIN)/airtact live live_pinch --out out/live

check: $(VENV)/installed-for-tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

# Workers with a thread each: threads of several on two cores would wait for each other in every loop. More workers than
# cores, as some tests wait for processes, boards and browsers; but not many more, as each imports all of airtact, with
# checks of shapes, in 7 s. The bytecode of that is kept: without it each would take 20 s, and every process that a test
# starts a second. A file's tests share what was solved for them, so they stay together, but where one takes minutes.
PYTEST := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -q

# The checks take one core for half a minute, so they run beside the tests.
test: $(VENV)/installed-for-tests
	$(MAKE) --jobs=2 check quick

quick: $(VENV)/installed-for-tests
	$(PYTEST) -n 4 --dist loadfile

slow: $(VENV)/installed-for-tests
	$(PYTEST) -n 2 --dist worksteal -m slow

format: $(VENV)/installed-for-tests
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(VENV)/installed-for-docs: $(VENV)/installed
	$(INSTALL) --editable '.[docs]'
	@touch $@

docs: $(VENV)/installed-for-docs
	$(BIN)/sphinx-build --quiet --fresh-env --fail-on-warning --keep-going docs build/docs
	@echo "Open build/docs/index.html."

reproduce: $(VENV)/installed
	$(BIN)/python examples/inoue2014/reproduce.py --out out/inoue2014

reproduce-quick: $(VENV)/installed
	$(BIN)/python examples/inoue2014/reproduce.py --quick --out out/inoue2014

# The comparison with AcousTools and bempp-cl needs interpreters of environments with them:
# make bench ACOUSTOOLS=PYTHON BEMPP=PYTHON.
bench: $(VENV)/installed-for-tests
	$(BIN)/python -m benchmarks.bench --out out/bench $(if $(ACOUSTOOLS),--acoustools $(ACOUSTOOLS)) $(if $(BEMPP),--bempp $(BEMPP))
	$(BIN)/python -m benchmarks.accuracy
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.surfaces
	$(BIN)/python -m benchmarks.finite_element
	$(BIN)/python -m benchmarks.synthesis
	$(BIN)/python -m benchmarks.frames
	$(BIN)/python -m benchmarks.emission
	$(BIN)/python -m benchmarks.fuzz
	$(BIN)/python -m benchmarks.hand_meshing
	$(BIN)/python -m benchmarks.hand_tracking

wheels:
	python3 .ci/wheels.py

clean:
	rm -rf $(VENV) build dist out docs/reference
