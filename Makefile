PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

# Threads of OpenBLAS only wait for small matrices; the command line sets the same.
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: demo film coverage test test-core slices test-slow test-all test-kernels browser lint types docs site gallery screenshots package smoke test-3.11 test-3.12 test-3.13 test-lowest clean

# Plans a real problem and says where to look.
demo: $(VENV)/.installed
	$(BIN)/hitchopt solve problems/carry_box.yaml -o demo --report
	@echo "Open demo/report.html in a browser; demo/summary.png shows the plan at a glance."

# Films a plan in real time to demo/, and four times as fast and small for the pages.
film: $(VENV)/.filmed
	$(BIN)/hitchopt solve -q problems/carry_box.yaml -o demo/carry_box
	$(BIN)/hitchopt view demo/carry_box --save demo/carry_box.mp4
	"$$($(BIN)/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')" -loglevel error -y -i demo/carry_box.mp4 \
		-vf "setpts=PTS/4, fps=12.5, scale=800:-1" -quality 75 -loop 0 problems/pictures/carry_box.webp

# What a change needs, in some ten minutes on two cores; pytest tests/ROOM runs all tests of a room.
test: $(VENV)/.tested
	$(BIN)/python -m pytest -m "not slow" --durations=20

# The tests of the core that name no slice; they run without any of them.
CORE_TESTS := tests/geometry tests/objects tests/hitch/test_hitch.py tests/hitch/test_legs.py tests/hitch/test_model.py \
	tests/checks/test_bounds.py tests/checks/test_closed_forms.py tests/checks/test_degenerate.py \
	tests/planners/test_times.py tests/planners/test_retargeting.py tests/planners/test_stages.py
test-core: $(VENV)/.tested
	$(BIN)/python -m pytest -m "not slow" $(CORE_TESTS)

# Removes one slice after the other, with what needs it, from a copy, and runs what is left.
slices: $(VENV)/.tested
	$(BIN)/python .ci/slices.py

# The tests that take seconds each, marked slow.
test-slow: $(VENV)/.tested
	$(BIN)/python -m pytest -m slow --durations=20

test-all: $(VENV)/.tested
	$(BIN)/python -m pytest --durations=20

# Tests of planning with other kernels of OpenBLAS, which round otherwise.
test-kernels: $(VENV)/.tested
	OPENBLAS_CORETYPE=Haswell $(BIN)/python -m pytest -m "not slow" tests/cli/test_solve.py \
		tests/planners/test_morph.py tests/mission/test_solving.py

# The lines of the package that neither the tests of `make test` nor any problem executes.
# Processes that tests start are not measured; circles of 64 and 200 drones are not planned.
coverage: $(VENV)/.tested
	$(BIN)/python -m pytest -m "not slow" --cov=hitchopt --cov-report=
	$(BIN)/python -m pytest -m slow tests/cli/test_solve.py --cov=hitchopt --cov-append --cov-report=term-missing:skip-covered

# Opens report and live view in a headless Chromium, which has to be there (Debian: apt-get install chromium).
browser: $(VENV)/.browsed
	$(BIN)/python -m pytest -o addopts="-q --strict-markers" tests/browser

lint: $(VENV)/.tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Checks the types of scripts as users write them with the type checker of many editors.
types: $(VENV)/.tested
	$(BIN)/pyright

# Builds the documentation, its tutorials executed; open docs/_build/html/index.html.
docs: $(VENV)/.documented
	$(BIN)/python -m sphinx -n -W --keep-going -q -b html docs docs/_build/html
	@echo "Open docs/_build/html/index.html."

# Looks for broken links and errors in the documentation's pages in a headless Chromium, and searches it.
site: docs $(VENV)/.browsed
	cd docs && ../$(BIN)/python -m generators.site_check

# Draws the gallery's pictures that are missing; planning all problems takes minutes.
gallery: $(VENV)/.documented
	cd docs && ../$(BIN)/python -m generators.gallery_pictures

# Takes the gallery's pictures of live view and report in a headless Chromium.
screenshots: $(VENV)/.browsed
	cd docs && ../$(BIN)/python -m generators.page_pictures

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/.tested: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[test,lint]"
	touch $(VENV)/.installed $@

$(VENV)/.browsed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[browser]"
	touch $(VENV)/.installed $(VENV)/.tested $@

$(VENV)/.filmed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[view]"
	touch $(VENV)/.installed $@

$(VENV)/.documented: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[docs]"
	touch $(VENV)/.installed $@

# Builds sdist and wheel, checks their metadata, and uses each in an environment of its own.
package: $(VENV)/.tested
	rm -rf dist
	$(BIN)/python -m build -o dist
	$(BIN)/twine check --strict dist/*
	set -e; for archive in dist/*.whl dist/*.tar.gz; do \
		rm -rf $(VENV)-package dist/tie_carry_untie*; \
		$(PYTHON) -m venv $(VENV)-package; \
		$(VENV)-package/bin/python -m pip install --quiet --disable-pip-version-check "$$archive"; \
		(cd dist && ../$(VENV)-package/bin/hitchopt init --example tie_carry_untie \
			&& ../$(VENV)-package/bin/hitchopt solve -q tie_carry_untie.yaml); \
	done
	rm -rf $(VENV)-package dist/tie_carry_untie*

# Installs the package on the newest Python that runs here, with the newest of all that it needs, and uses it once.
smoke:
	rm -rf $(VENV)-smoke demo/smoke && mkdir -p demo/smoke
	"$$(bash .ci/python)" -m venv $(VENV)-smoke
	$(VENV)-smoke/bin/python --version
	$(VENV)-smoke/bin/python -m pip install --quiet --disable-pip-version-check .
	cd demo/smoke && export PATH="$(abspath $(VENV)-smoke)/bin:$$PATH" && hitchopt init first.yaml && hitchopt solve -q first.yaml -o out \
		&& hitchopt check -q out && hitchopt verify -q out && hitchopt export -q out --format csv -o files \
		&& python -c 'import hitchopt as ho; print(ho.load("out"))'
	rm -rf $(VENV)-smoke demo/smoke

# The tests of `make test` on another Python, with the newest versions of all that it needs.
test-3.11 test-3.12 test-3.13: test-%:
	"$$(bash .ci/python $*)" -m venv $(VENV)-$*
	$(VENV)-$*/bin/python -m pip install --quiet --disable-pip-version-check --upgrade --upgrade-strategy eager -e ".[test]"
	$(VENV)-$*/bin/python -m pytest -m "not slow"

# All tests on Python 3.11 with the lowest versions that pyproject.toml admits. Tools that only tests
# use need newer versions of numpy and scipy: the package's own are installed over these.
test-lowest: $(VENV)/.tested
	"$$(bash .ci/python 3.11)" -m venv $(VENV)-lowest
	$(BIN)/uv pip compile --quiet --python $(VENV)-lowest --resolution lowest-direct \
		--extra test -o $(VENV)-lowest/lowest.txt pyproject.toml
	$(VENV)-lowest/bin/python -m pip install --quiet --disable-pip-version-check \
		-e ".[test]" -r $(VENV)-lowest/lowest.txt
	$(BIN)/uv pip compile --quiet --python $(VENV)-lowest --resolution lowest-direct \
		-o $(VENV)-lowest/own.txt pyproject.toml
	$(VENV)-lowest/bin/python -m pip install --quiet --disable-pip-version-check --no-deps \
		-r $(VENV)-lowest/own.txt
	$(VENV)-lowest/bin/python -m pytest

clean:
	rm -rf $(VENV) $(VENV)-* demo docs/_build build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
