"""Fixtures for all tests: robots of the library, and real data where this machine has them."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from tests import optional, shapes  # noqa: F401, shapes before what it checks
from tests.real import DATA

from momapos.model.robots.robot import Robot, load_robot

pytest_plugins = ["pytester"]
ROBOTS = ("segway_ur5e", "husky_ur5e", "fetch", "ranger_rm63")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of the real data, which are not part of the package; see its README."""
    optional.there(DATA / "bestman")
    return DATA


@pytest.fixture(scope="session")
def robots() -> Callable[[str], Robot]:
    """Robots of the library by name, each read once."""
    return cache(load_robot)


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, robots: Callable[[str], Robot]) -> Robot:
    """Each robot of the library in turn."""
    return robots(request.param)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave slow tests out unless they are asked for, as `make test-slow` does."""
    slow = optional.needs("minutes", "MOMAPOS_SLOW" in os.environ)
    for item in items:
        if item.get_closest_marker("slow") is not None:
            item.add_marker(slow)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """End with what did not run, and the commands that make it run."""
    lines = optional.skipped(terminalreporter.getreports("skipped"))
    if lines:
        terminalreporter.section("not run here")
        for line in lines:
            terminalreporter.line(line)
