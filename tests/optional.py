"""Optional dependencies of the tests, and the commands that install or enable them.

Every skip goes through this module, so that each one names its command. Packages that `make test`
installs are not optional: tests import them, and fail if they are missing.
"""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections import Counter
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest

SHARED = "MOMAPOS_SHARED=FOLDER make test"
GET = {
    "torch": "make test-torch",
    "distributed": ".venv/bin/pip install 'distributed>=2024.8'",
    "av": "make test-film",
    "pyarrow": ".venv/bin/pip install 'pyarrow>=15'",
    "h5py": ".venv/bin/pip install 'h5py>=3.10'",
    "lerobot": "pip install lerobot (2 GB), in an environment of its own",
    "eaik": ".venv/bin/pip install eaik",
    "pxr": "make test-usd",
    "xacrodoc": ".venv/bin/pip install xacrodoc",
    "EGL": "apt-get install libegl1 libgl1-mesa-dri",
    "Chromium": "make test-page, after apt-get install chromium",
    "minutes": "make test-slow",
    "a wheel": "make test-wheel",
    "zsh": "apt-get install zsh",
    "fish": "apt-get install fish",
    "rclpy": "make test-ros, with Python 3.11",
    "real data": f"{SHARED}, where FOLDER holds bestman/",
    "robot descriptions": ".venv/bin/pip install --no-deps example-robot-data "
    "hello-robot-stretch-urdf",
    "independent checker": f"{SHARED}, where FOLDER holds data/ and tools/",
}
"""Each optional dependency, and the command that installs it or runs with it."""


def reason(what: str) -> str:
    """Return the reason for a skip; the summary of the tests is grouped by it."""
    return f"needs {what}: {GET[what]}"


def skipped(reports: Iterable[pytest.TestReport | pytest.CollectReport]) -> list[str]:
    """Return one line per reason for skipped tests, with their number."""
    reasons = Counter(
        report.longrepr[2].removeprefix("Skipped: ")
        for report in reports
        if isinstance(report.longrepr, tuple)
    )
    return [f"{count:4d} {why}" for why, count in reasons.most_common()]


def skip(what: str) -> NoReturn:
    """Skip the current test."""
    pytest.skip(reason(what))


def needs(what: str, available: bool) -> pytest.MarkDecorator:
    """Mark tests that are skipped if a dependency is missing."""
    return pytest.mark.skipif(not available, reason=reason(what))


def has(package: str) -> bool:
    """Return whether a package is installed, without importing it."""
    return find_spec(package) is not None


def module(name: str, package: str = "") -> ModuleType:
    """Import a module of an optional package; skip the test if the package is missing."""
    package = package or name.partition(".")[0]
    return importlib.import_module(name) if has(package) else skip(package)


def there(path: Path, what: str = "real data") -> Path:
    """Return a path outside the repository; skip the test if it is missing."""
    return path if path.exists() else skip(what)


@cache
def chromium() -> str | None:
    """Return the path of the installed Chromium, which Playwright drives; None if missing."""
    names = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


@cache
def draws_off_screen() -> bool:
    """Return whether MuJoCo can render off screen on this machine."""
    try:
        if sys.platform == "linux" and "DISPLAY" not in os.environ:
            from mujoco.egl import GLContext
        else:
            from mujoco import GLContext
        GLContext(8, 8).free()
    except (ImportError, AttributeError, OSError, RuntimeError):  # each backend has its own
        return False
    return True
