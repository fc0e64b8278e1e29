# Two commands do everything on a fresh machine: `make demo` runs the robot, `make test` passes the tests.
PYTHON ?= python3
ROBBIE := .venv/bin/robbie

.PHONY: demo test lint types docs bench clean

demo: .venv/robot
	$(ROBBIE) run demo

test: .venv/dev
	.venv/bin/python -m pytest -q

lint: .venv/dev
	.venv/bin/ruff check .

types: .venv/dev
	.venv/bin/mypy

# The docs site, in site/: links and docstrings are checked, and a warning is an error.
docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict

bench: .venv/bench
	.venv/bin/python -m tools.bench --json docs/benchmarks.json --report docs

.venv/robot: pyproject.toml
	$(PYTHON) -m venv .venv
	.venv/bin/pip install --quiet --disable-pip-version-check -e '.[robot]'
	touch $@

.venv/dev: pyproject.toml .venv/robot
	.venv/bin/pip install --quiet --disable-pip-version-check -e '.[robot,dev]'
	touch $@

.venv/docs: pyproject.toml
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	.venv/bin/pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

.venv/bench: pyproject.toml .venv/robot
	.venv/bin/pip install --quiet --disable-pip-version-check -e '.[robot,bench]'
	touch $@

clean:
	rm -rf .venv .mypy_cache .pytest_cache .ruff_cache .hypothesis output build site *.egg-info
