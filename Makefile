# make demo     bake, render and compare a scene (docs: README.md)
# make test     lint, types and every test
# make large    the test of 100,000 faces in 2048 x 2048 texels: minutes
# make venv     .venv/bin/prt-bake and all that it needs, nothing more
# make package  the extension's zips, one a platform, in dist/
# make bench    run time against error beside the peers, into docs/benchmarks.md: half an hour;
#               make bench-full measures everything, in hours
# make viewer   a page that shows a baked .glb; GLB=FILE opens one at once
# make real-blender   the zip in a real Blender under Xvfb (root, Debian)
#
# PYTHON=... chooses the interpreter (3.13 or 3.11), VENV=... the folder of the environment

VENV ?= .venv
PYTHON ?=
VALIDATOR := tests/gltf/node_modules
VIEWER := viewer/node_modules

# EEVEE compiles its shaders for half a minute when this is empty; one BLAS thread a process
export MESA_SHADER_CACHE_DIR ?= $(CURDIR)/.cache/mesa
export OPENBLAS_NUM_THREADS ?= 1
export PATH := $(abspath $(VENV))/bin:$(PATH)

.PHONY: demo test large bench bench-full bench-packages venv lint format package wheels browser viewer real-blender clean

demo: venv
	python tools/demo.py

test: lint wheels $(VALIDATOR) $(VIEWER) browser
	pytest

large: venv
	PRT_LARGE=1 pytest -rP tests/blender/test_large_textures.py

bench: bench-packages
	python benchmarks/page.py

bench-full: bench-packages
	python benchmarks/page.py --full

bench-packages: venv
	@benchmarks/install.sh $(VENV)

venv:
	@mkdir -p $(MESA_SHADER_CACHE_DIR)
	@tools/make_venv.sh $(VENV) $(PYTHON)

lint: venv
	ruff check .
	ruff format --check .
	@if python -c 'import sys; sys.exit(sys.version_info < (3, 13))'; then mypy; \
	else echo "mypy: only on 3.13, the numpy of 3.11 lacks types of its own"; fi

format: venv
	ruff check --fix .
	ruff format .

package: wheels
	python tools/package.py

wheels: venv
	python tools/fetch_wheels.py

$(VALIDATOR): tests/gltf/package-lock.json | venv
	npm ci --prefix tests/gltf --no-audit --no-fund
	@touch $@

$(VIEWER): viewer/package-lock.json | venv
	npm ci --prefix viewer --no-audit --no-fund
	@touch $@

# Chromium, in which the viewer is tested
browser: venv
	@tools/system_packages.sh python browser

viewer:
	npm start --prefix viewer -- $(GLB)

real-blender: wheels
	pytest -s tools/real_blender

clean:
	rm -rf build dist demo .cache .mypy_cache .pytest_cache .ruff_cache
