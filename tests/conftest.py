"""Fixtures for all tests: robots of the library, and real data where this machine has them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from tests.real import DATA

from momapos.robots.robot import Robot, load_robot

ROBOTS = ("segway_ur5e", "husky_ur5e", "fetch", "ranger_rm63")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of the real data, which are not part of the package; see its README."""
    if not (DATA / "bestman").is_dir():
        pytest.skip(f"no real data at {DATA}; set MOMAPOS_SHARED to the folder that holds bestman/")
    return DATA


@pytest.fixture(scope="session")
def robots() -> Callable[[str], Robot]:
    """Robots of the library by name, each read once."""
    return cache(load_robot)


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, robots: Callable[[str], Robot]) -> Robot:
    """Each robot of the library in turn."""
    return robots(request.param)
