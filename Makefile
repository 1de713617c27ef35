# Two commands on a fresh machine with Python 3.11+ and make: make demo, make test.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CODE := src tests benchmarks examples training integrations docs_hooks.py
# Versions of packages: newest allowed by default; constraints/locked.txt or constraints/lowest.txt.
CONSTRAINTS ?=
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS))

.PHONY: demo test check bench docs torch test-quick test-all test-torch test-slow test-wheel test-ros test-usd test-film test-page lock clean

$(VENV)/.core: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or later is needed; set PYTHON=...") if sys.version_info < (3, 11) else None'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) --editable .
	touch $@

$(VENV)/.dev: $(VENV)/.core
	$(INSTALL) --editable '.[bench,dev,kitchens,physics,scan,view,xacro]'
	touch $@

$(VENV)/.torch: $(VENV)/.dev
	$(INSTALL) torch==2.13.0 'onnx>=1.16'
	touch $@

$(VENV)/.film: $(VENV)/.dev
	$(INSTALL) --editable '.[film]'
	touch $@

$(VENV)/.usd: $(VENV)/.dev
	$(INSTALL) --editable '.[usd]'
	touch $@

$(VENV)/.docs: $(VENV)/.core
	$(INSTALL) --editable '.[docs,view]'
	touch $@

# rclpy from wheels, which re-execute Python with libraries of their own: an environment apart, which
# sees the packages of ours. Where there are no wheels for this Python, the tests say so.
ROS := $(VENV)/ros
ROS_WHEELS := $(addprefix ros-,action-msgs geometry-msgs nav-msgs std-msgs trajectory-msgs rosidl-adapter \
	rosidl-generator-c rosidl-generator-py rosidl-typesupport-c rosidl-typesupport-fastrtps-c)
ROS_PACKAGES := integrations/ros2/momapos_interfaces tests/ros2/stand_ins/nav2_msgs tests/ros2/stand_ins/control_msgs
$(ROS)/.ready: $(VENV)/.dev tests/ros2/build_interfaces.py $(shell find $(ROS_PACKAGES) -type f)
	$(PYTHON) -m venv --clear $(ROS)
	if $(ROS)/bin/python -m pip install --quiet --disable-pip-version-check 'ros-rclpy[fastrtps]' $(ROS_WHEELS); \
	then $(ROS)/bin/python tests/ros2/build_interfaces.py $(ROS)/interfaces $(ROS_PACKAGES); \
	else echo "there are no wheels of rclpy for this Python"; fi
	touch $@

demo: $(VENV)/.core
	$(BIN)/momapos place open kitchen_small fridge/door_hinge --robot segway_ur5e --out demo_plan.json --plot demo_plan.png

check: $(VENV)/.dev
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

# Types, shapes and dtypes are checked at the first calls of each function, see tests/shapes.py.
test: check
	MOMAPOS_SHAPES=1 $(BIN)/pytest

# One folder of tests: make test-quick PATH=planning/placement. The variable replaces the search path
# of commands, which the recipe therefore sets again.
test-quick: $(VENV)/.dev
	$(if $(filter command,$(firstword $(origin PATH))),,$(error name a folder of tests, as in: make test-quick PATH=planning/placement))
	PATH="$(CURDIR)/$(BIN):$$(command -p getconf PATH)" $(BIN)/pytest tests/$(PATH)

# Before a larger change is called done.
test-all: test test-wheel test-slow test-torch test-usd test-ros test-film test-page docs

# What make test leaves out, since a fresh machine lacks it or it takes minutes.
# Torch trains the front networks.
torch: $(VENV)/.torch

test-torch: $(VENV)/.torch
	$(BIN)/pytest $(shell grep -lE '"torch"' $(shell find tests -name 'test_*.py' ! -name test_optional.py))

test-slow: $(VENV)/.dev
	MOMAPOS_SLOW=1 $(BIN)/pytest -m slow --dist worksteal

test-usd: $(VENV)/.usd
	$(BIN)/pytest $(shell grep -lE '"pxr"' $(shell find tests -name 'test_*.py' ! -name test_optional.py))

test-wheel: $(VENV)/.dev
	MOMAPOS_WHEEL=1 $(BIN)/pytest tests/packaging/test_wheel.py

test-ros: $(ROS)/.ready
	AMENT_PREFIX_PATH=$(abspath $(ROS)) PYTHONPATH=$(ROS)/interfaces:integrations/ros2/momapos_ros:src:$(shell $(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') \
		$(ROS)/bin/python -m pytest -n 0 tests/ros2

test-film: $(VENV)/.film
	MOMAPOS_SLOW=1 $(BIN)/pytest tests/simulation/test_film.py tests/simulation/test_film_files.py tests/apps/web/test_drawing.py

test-page: $(VENV)/.dev
	MOMAPOS_SLOW=1 $(BIN)/pytest tests/apps/web

docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

bench: $(VENV)/.dev
	$(BIN)/python benchmarks/run.py

# Writes both; needs uv.
lock:
	uv pip compile pyproject.toml --universal --python-version 3.11 --no-header --no-annotate --upgrade \
		$(addprefix --extra ,bench dev kitchens physics scan view xacro) --output-file constraints/locked.txt
	uv pip compile pyproject.toml --universal --python-version 3.11 --no-header --no-annotate --resolution lowest-direct \
		$(addprefix --extra ,bench kitchens physics scan view xacro) --output-file constraints/lowest.txt

clean:
	rm -rf $(VENV) build dist demo_plan.json demo_plan.png
