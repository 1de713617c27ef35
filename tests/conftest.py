"""Fixtures for all tests: robots of the library, and real data if available."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from tests import optional, shapes  # noqa: F401, shapes before what it checks
from tests.real import DATA

from momapos.core.cache import default_cache_dir
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene

pytest_plugins = ["pytester"]
# On a busy machine any example may take long.
settings.register_profile("busy", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy")
KEPT = ("kernel-", "reach-")
"""Cache entries that all runs of tests share."""
ROBOTS = ("segway_ur5e", "husky_ur5e", "fetch", "ranger_rm63")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Return the folder of the real data, which is not part of the package; see its README."""
    optional.there(DATA / "bestman")
    return DATA


@pytest.fixture(scope="session")
def robots() -> Callable[[str], Robot]:
    """Return a loader of library robots by name, which reads each robot once."""
    return cache(load_robot)


@pytest.fixture(scope="session")
def kitchen() -> Scene:
    """Return a kitchen of the package, which is read once, as what the planner derives from it."""
    return load_scene("kitchen_small")


@pytest.fixture(scope="session")
def fetch(robots: Callable[[str], Robot]) -> Robot:
    return robots("fetch")


@pytest.fixture(scope="session")
def segway(robots: Callable[[str], Robot]) -> Robot:
    return robots("segway_ur5e")


@pytest.fixture(scope="session")
def husky(robots: Callable[[str], Robot]) -> Robot:
    return robots("husky_ur5e")


@pytest.fixture(scope="session")
def ranger(robots: Callable[[str], Robot]) -> Robot:
    return robots("ranger_rm63")


@pytest.fixture(scope="session")
def stretch(robots: Callable[[str], Robot]) -> Robot:
    return robots("stretch")


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, robots: Callable[[str], Robot]) -> Robot:
    """Return each robot in turn."""
    return robots(request.param)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip slow tests unless enabled, as by `make test-slow`."""
    slow = optional.needs("minutes", "MOMAPOS_SLOW" in os.environ)
    for item in items:
        if item.get_closest_marker("slow") is not None:
            item.add_marker(slow)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile the kernels that are not cached yet, one worker from each end, before any test runs.

    Else each worker would compile all of them. What the tests cache about their own scenes and
    robots then goes to a folder of this process, in which kernels and maps are linked.
    """
    worker = getattr(session.config, "workerinput", None)
    if worker is not None:
        from momapos.core.compiled.code_store import store
        from momapos.core.compiled.entries import ENTRIES

        names = sorted(name for name in ENTRIES if name.startswith("momapos."))
        for name in names[:: -1 if worker["workerid"] == "gw1" else 1]:
            store.prepare([ENTRIES[name]], lambda *_: None)
    folder, home = Path(tempfile.mkdtemp(prefix="momapos-tests-")), default_cache_dir()
    for file in home.iterdir() if home.is_dir() else ():
        if file.name.startswith(KEPT):
            (folder / file.name).symlink_to(file)
    session.config.add_cleanup(lambda: _end_cache(folder, home))
    os.environ["MOMAPOS_CACHE"] = str(folder)
    os.environ["MOMAPOS_MAPS_BEHIND"] = "0"


def _end_cache(folder: Path, home: Path) -> None:
    """Keep what is expensive and does not depend on the tests' own files: kernels and maps."""
    os.environ["MOMAPOS_CACHE"] = str(home)
    home.mkdir(parents=True, exist_ok=True)
    for file in folder.iterdir():
        if not file.is_symlink() and file.name.startswith(KEPT):
            shutil.move(file, home / file.name)
    shutil.rmtree(folder)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List the skipped tests and the commands that run them."""
    lines = optional.skipped(terminalreporter.getreports("skipped"))
    if lines:
        terminalreporter.section("not run here")
        for line in lines:
            terminalreporter.line(line)
