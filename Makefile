# Two commands do everything on a fresh machine: `make demo` runs the robot, `make test` passes the tests.
# `make test-all` adds the slow ones: campaigns, browsers, real peers, exhaustive and long tests.
PYTHON ?= python3
ROBBIE := .venv/bin/robbie
# It says what it does: an installation may take a minute.
PIP_INSTALL := .venv/bin/pip install --disable-pip-version-check

# A worker that dies ends the run; with another one in its place, the run may hang.
# Many tests wait for a robot, so three at a time fill two processors.
PARALLEL := --numprocesses 3 --dist loadfile --max-worker-restart 0

# .ci/run has another one, which repeats failed tests once.
PYTEST := .venv/bin/python -m pytest
# Each worker imports all tests; without bytecode, it compiles them all, too.
export PYTHONDONTWRITEBYTECODE :=

# What the installation compiles: a change of it, or of what is installed, installs again.
INSTALLED := pyproject.toml setup.py $(wildcard robbie_mp/bus/_hot/*.[ch] robbie_mp/bus/_hot/*.p[xy][ix])

.PHONY: demo team test test-all test-slow test-alone test-exhaustive test-pure test-arm64 wheels ros lint types docs bench clean

demo: .venv/robot
	$(ROBBIE) run demo

# Two rescue robots in one random arena, over a link; prints their figures at the end, after two minutes.
team: .venv/team
	.venv/bin/python -m tools.trials rescue_team

test: .venv/dev
	$(PYTEST) -q -m 'not slow' --durations 5 $(PARALLEL)

test-all: test test-slow test-alone

test-slow: .venv/dev
	$(PYTEST) -q -m 'slow and not alone' --durations 15 $(PARALLEL) --dist worksteal

# These require that something takes little time, so each has the machine for itself.
test-alone: .venv/dev
	$(PYTEST) -q -m alone --durations 5

# Before a release: every case of the tests of which `make test-all` tries a sample. It takes hours.
test-exhaustive: .venv/dev
	$(PYTEST) -q -m 'slow and not alone' --exhaustive $(PARALLEL) --dist worksteal

# The tests of the hot path, of which there are two forms, with the one in Python.
test-pure: .venv/dev
	ROBBIE_PURE_PYTHON=1 $(PYTEST) -q -m 'not slow' $(PARALLEL) tests/bus/core tests/messages tests/bus/transport

# The wheel, a robot and the tests of the hot path and of messages with an emulated ARM processor: see tools/arm64/run.
test-arm64: .venv/wheels
	tools/arm64/run

lint: .venv/dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/codespell
	# What the oldest Python lacks, from the standard library too.
	.venv/bin/vermin -q --no-tips --eval-annotations --violations -t=3.10- robbie_mp hw workers modules tools

types: .venv/dev
	.venv/bin/mypy

# The docs site, in site/: links and docstrings are checked, and a warning is an error.
docs: .venv/docs
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict

# The files of a release in dist/: make wheels PYTHONS='python3.10 python3.11'
PYTHONS ?= $(PYTHON)
wheels: .venv/wheels
	rm -rf dist
	.venv/bin/python setup.py -q sdist
	.venv/bin/python -m tools.wheels dist/*.tar.gz $(PYTHONS)

bench: .venv/bench
	.venv/bin/python -m tools.bench --standard --json docs/benchmarks.json --report docs

.venv/robot: $(INSTALLED)
	$(PYTHON) -m venv .venv
	$(PIP_INSTALL) -e '.[robot]'
	touch $@

.venv/team: .venv/robot
	$(PIP_INSTALL) -e '.[robot,vision,link]'
	touch $@

.venv/dev: .venv/robot
	$(PIP_INSTALL) -e '.[robot,dev]'
	# The tests need its network only; what it requires would bring in a second OpenCV.
	$(PIP_INSTALL) --no-deps 'rapidocr>=3.0,<3.8'
	touch $@

# Real nodes of ROS 2, with its default middleware, for the slow tests of its bridge: wheels of rclpy for CPython
# 3.11, each distribution in an environment of its own. The robot needs none of them.
ros: .venv/ros-jazzy/done .venv/ros-kilted/done

.venv/ros-%/done:
	$(PYTHON) -m venv .venv/ros-$*
	.venv/ros-$*/bin/pip install --disable-pip-version-check ros-$*-rclpy ros-$*-rmw-fastrtps-cpp \
	    ros-$*-rosidl-typesupport-fastrtps-c ros-$*-rosidl-typesupport-fastrtps-cpp ros-$*-common-interfaces \
	    ros-$*-test-msgs
	touch $@

.venv/docs: $(INSTALLED)
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	$(PIP_INSTALL) -e '.[docs]'
	touch $@

.venv/bench: .venv/robot
	$(PIP_INSTALL) -e '.[robot,bench]'
	touch $@

.venv/wheels: .venv/dev
	$(PIP_INSTALL) -e '.[wheels]'
	touch $@

clean:
	rm -rf dist .venv .mypy_cache .pytest_cache .ruff_cache .hypothesis output build site *.egg-info
	rm -f robbie_mp/bus/_hot/*.so
