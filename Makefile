# make case   sets up an environment, builds a sample case from a synthetic scan and pulls on it
# make test   everything that must hold before a change goes in
# make thorough  more sizes, seeds and shapes of what make test tries; the gate runs it, too
# make journey  the studio from a DICOM folder to an operated heart, in a browser; pictures of each step in out/journey
# make docs   the documentation as a site: out/site/index.html
# make bench  run time against error (minutes)
# make versions  every kernel compiles, and a sample case comes out as on the Python that ran this before
# make lowest, make newest  the same with the oldest packages that pyproject.toml allows, and with the newest there are
# make gpu    what only an NVIDIA GPU can show: tests, violent scripts and benchmarks of its engine (some twelve minutes)
# All need Python 3.11, 3.12 or 3.13, and make. Another Python: make case PYTHON=python3.12 VENV=.venv-3.12

PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
LOCK ?= requirements.lock

.PHONY: installed reference case test thorough journey check format lint types imports docs plain bench versions lowest newest gpu lock clean same-python

# An environment keeps the Python that it was made with: it is not used where another one is asked for.
# No comma may stand in the script: make would end the argument of its $(if) there.
VERSION_OF = -c 'import sys; print("%d.%d" % sys.version_info[:2])'
same-python:
	@$(if $(filter command environment,$(origin PYTHON)),asked=$$($(PYTHON) $(VERSION_OF)) || exit 1; \
	for venv in $(VENV) $(VENV)-plain $(VENV)-gpu; do \
	  if [ -x $$venv/bin/python ]; then there=$$($$venv/bin/python $(VERSION_OF)); \
	    if [ "$$there" != "$$asked" ]; then \
	      echo "$$venv was made with Python $$there but PYTHON=$(PYTHON) is $$asked: add VENV=$(VENV)-$$asked or make clean first" >&2; \
	      exit 1; fi; fi; done,true)

# Not compiled to byte code: most of what comes is never imported, and the rest is compiled as it is.
$(VENV)/installed: $(LOCK) pyproject.toml | same-python
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "heartcase needs Python 3.11 or newer: make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -r $(LOCK)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $(VENV)/prepare-installed $@

# Byte code of what a case takes: otherwise the first build and the processes that compile its kernels each make it.
BYTE_CODE = $(BIN)/python -m compileall -q -j 0 heartcase && $(BIN)/python -c \
	'import click, edt, jinja2, numba, PIL.Image, pydantic, rich.progress, safetensors, scipy.ndimage, scipy.spatial, SimpleITK'

# What building a case takes, without what only tests and benchmarks use.
$(VENV)/prepare-installed: requirements-prepare.lock pyproject.toml | same-python
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "heartcase needs Python 3.11 or newer: make PYTHON=...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -r requirements-prepare.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	$(BYTE_CODE)
	touch $@

case: $(VENV)/prepare-installed
	$(BIN)/heartcase build sample_cases/adult_phantom.toml --out out
	$(BIN)/heartcase simulate out/adult-phantom.case --script sample_cases/pull.toml --picture out/pull.png
	@echo 'Look at out/adult-phantom.report.html and out/pull.png'

test:
	$(MAKE) --jobs=2 check plain
	$(BIN)/python -m pytest -n 2 --dist loadfile

thorough: $(VENV)/installed
	$(BIN)/python -m pytest -m 'thorough and not slow'

# Alone on the machine: it waits for a build and for what is compiled.
journey: $(VENV)/installed
	rm -rf out/journey
	HEARTCASE_SHOTS=out/journey $(BIN)/python -m pytest -m slow -s tests/studio/page/test_journey.py -k childs

# All that is checked without running the package; .pre-commit-config.yaml runs the same one by one.
check: format lint types imports docs

format: $(VENV)/installed
	$(BIN)/ruff format --check .

lint: $(VENV)/installed
	$(BIN)/ruff check .

types: $(VENV)/installed
	$(BIN)/mypy

imports: $(VENV)/installed
	$(BIN)/lint-imports --no-cache

# Needs no network; warnings are errors (mkdocs.yml).
docs: $(VENV)/installed
	$(BIN)/python -m mkdocs build

# The simulator alone, in an environment without SimpleITK, VTK or scikit-image, on a case that the other one wrote.
plain: $(VENV)/installed $(VENV)-plain/installed
	$(BIN)/python -m tests.write_block_case out/block.case
	$(VENV)-plain/bin/python -c 'import importlib.util as u; found = [m for m in ("SimpleITK", "vtk", "skimage", "scipy") if u.find_spec(m)]; assert not found, found'
	$(VENV)-plain/bin/heartcase simulate out/block.case --seconds 0.05

$(VENV)-plain/installed: requirements-plain.lock pyproject.toml | same-python
	$(PYTHON) -m venv $(VENV)-plain
	$(VENV)-plain/bin/python -m pip install --quiet --disable-pip-version-check --no-compile -r requirements-plain.lock
	$(VENV)-plain/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $@

# Tests of the kernels that the adult phantom's case does not use.
BESIDE = tests/pipeline/test_stage_versions.py tests/pipeline/formats/test_stl_parts.py tests/pipeline/markers/test_markers.py \
  tests/pipeline/watershed/test_forest.py tests/pipeline/fields/test_wall_thickness.py tests/pipeline/edits/test_shapes.py \
  tests/pipeline/mesh/test_decimate.py tests/pipeline/mesh/test_normal_map.py tests/pipeline/building/test_thin_lumens.py

# With an empty cache of numba's: all is compiled here and now. Other packages round some figures otherwise, and bring
# warnings of their own: then bytes may differ, but not where the nodes are.
versions: $(VENV)/installed
	rm -rf $(VENV)/numba-cache
	NUMBA_CACHE_DIR=$(VENV)/numba-cache HEARTCASE_VERSIONS=out/versions HEARTCASE_OTHER_PACKAGES=$(OTHER_PACKAGES) \
	$(BIN)/python -m pytest -s -m 'not slow' -p no:cacheprovider $(if $(OTHER_PACKAGES),-W ignore) $(BESIDE) tests/compiling/test_every_kernel.py

# The environment alone.
installed: $(VENV)/installed

# What `make versions` of other Pythons compares with, from kernels that are there already.
reference: $(VENV)/installed
	HEARTCASE_VERSIONS=out/versions $(BIN)/python -m pytest -s -m 'not slow' -p no:cacheprovider \
	  tests/compiling/test_every_kernel.py::test_the_others_found_the_same

lowest:
	$(MAKE) versions VENV=$(VENV)-lowest LOCK=requirements-lowest.lock OTHER_PACKAGES=1

newest:
	$(PYTHON) -m venv $(VENV)-newest
	$(VENV)-newest/bin/python -m pip install --quiet --disable-pip-version-check --upgrade --editable '.[dev]'
	touch $(VENV)-newest/installed
	$(MAKE) versions VENV=$(VENV)-newest OTHER_PACKAGES=1

# An environment that has numba-cuda and pytest already: make gpu GPU_PYTHON=python3. A machine without the pipeline takes
# lattices (python -m benchmarks.lattices out/lattices) and a case that another one made. Less time: GPU_JOBS, up to the cores
# that there are, and GPU_VIOLENT_SECONDS, after which no script is begun. out/gpu/summary.md sums up.
GPU_PYTHON ?= $(VENV)-gpu/bin/python
GPU_OUT ?= out/gpu
GPU_JOBS ?= 6
GPU_VIOLENT_SECONDS ?= 200
# Not in numba's simulator: there is no answer without a GPU.
gpu: export NUMBA_ENABLE_CUDASIM = 0
gpu: export HEARTCASE_LATTICES ?= out/lattices
gpu: $(if $(filter file,$(origin GPU_PYTHON)),$(VENV)-gpu/installed)
	mkdir -p $(GPU_OUT)
	rm -f $(GPU_OUT)/tests.xml $(GPU_OUT)/violence.json $(GPU_OUT)/bench.json $(GPU_OUT)/summary.md
	$(GPU_PYTHON) -m tests.parity.gpu
	-$(GPU_PYTHON) -m pytest -n $(GPU_JOBS) -p no:cacheprovider -p no:benchmark --durations 10 --junitxml $(GPU_OUT)/tests.xml \
	  -m 'not slow and not versions' -k 'cuda or gpu' tests/parity tests/simulator/instruments/test_hands.py \
	  tests/simulator/instruments/test_probe_contact.py tests/simulator/patching/test_patches.py \
	  tests/simulator/test_simulation.py tests/simulator/lattice/test_strain_sharing.py tests/stress/test_violence_other_backends.py
	-$(GPU_PYTHON) -m tests.stress.many_violent_scripts cuda --jobs $(GPU_JOBS) --seconds $(GPU_VIOLENT_SECONDS) --json $(GPU_OUT)/violence.json
	-$(GPU_PYTHON) -m benchmarks frame-adult-gpu engine-gpu --json $(GPU_OUT)/bench.json
	$(GPU_PYTHON) -m tests.parity.gpu_summary $(GPU_OUT)
	! grep -q -e '- failed' -e 'is missing' $(GPU_OUT)/summary.md

$(VENV)-gpu/installed: $(LOCK) pyproject.toml | same-python
	$(PYTHON) -m venv $(VENV)-gpu
	$(VENV)-gpu/bin/python -m pip install --quiet --disable-pip-version-check --no-compile -r $(LOCK)
	$(VENV)-gpu/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[cuda]'
	touch $@

bench: $(VENV)/installed
	$(BIN)/python -m benchmarks --json out/bench.json

# New pins; needs uv.
lock:
	uv pip compile --upgrade pyproject.toml --extra dev --universal --python-version 3.11 --no-annotate --no-header --no-emit-index-url --generate-hashes -o requirements.lock
	uv pip compile --upgrade pyproject.toml --extra prepare --universal --python-version 3.11 --no-annotate --no-header --no-emit-index-url --generate-hashes -o requirements-prepare.lock
	uv pip compile --upgrade pyproject.toml --universal --python-version 3.11 --no-annotate --no-header --no-emit-index-url --generate-hashes -o requirements-plain.lock
	uv pip compile --upgrade pyproject.toml --extra dev --resolution lowest-direct --python-version 3.11 --no-annotate --no-header --no-emit-index-url --generate-hashes -o requirements-lowest.lock

clean:
	rm -rf $(VENV) $(VENV)-* out
