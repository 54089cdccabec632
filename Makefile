PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: demo test lint docs gallery clean

# Plans a real problem and says where to look.
demo: $(VENV)/.installed
	$(BIN)/hitchopt solve problems/triangle.yaml -o demo
	@echo "Look at demo/summary.png; fly demo/setpoints.csv; read demo/certificate.json."

test: $(VENV)/.tested
	$(BIN)/python -m pytest

lint: $(VENV)/.tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Builds the documentation, its tutorials executed; open docs/_build/html/index.html.
docs: $(VENV)/.documented
	$(BIN)/python -m sphinx -n -W --keep-going -q -b html docs docs/_build/html
	@echo "Open docs/_build/html/index.html."

# Draws the gallery's pictures that are missing; planning all problems takes minutes.
gallery: $(VENV)/.documented
	cd docs && ../$(BIN)/python -m generators.gallery_pictures

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	touch $@

$(VENV)/.tested: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[test,lint]"
	touch $(VENV)/.installed $@

$(VENV)/.documented: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[docs]"
	touch $(VENV)/.installed $@

clean:
	rm -rf $(VENV) demo docs/_build build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
