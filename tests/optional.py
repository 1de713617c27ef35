"""What a fresh machine may lack, and the command that gets it.

Every skip of the tests goes through this module, so that none is without a way out. What
`make test` installs is not optional: tests import it, and fail where it is missing.
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
    "eaik": ".venv/bin/pip install eaik",
    "pxr": "make test-usd",
    "xacrodoc": ".venv/bin/pip install xacrodoc",
    "EGL": "apt-get install libegl1 libgl1-mesa-dri",
    "Chromium": "make test-page, after apt-get install chromium",
    "minutes": "make test-slow",
    "a wheel": "make test-wheel",
    "rclpy": "make test-ros, with Python 3.11",
    "real data": f"{SHARED}, where FOLDER holds bestman/",
    "robot descriptions": ".venv/bin/pip install --no-deps example-robot-data "
    "hello-robot-stretch-urdf",
    "independent checker": f"{SHARED}, where FOLDER holds data/ and tools/",
}
"""What may be missing, and the command that gets it or runs with it."""


def reason(what: str) -> str:
    """The reason for a skip; the list that ends the tests is grouped by it."""
    return f"needs {what}: {GET[what]}"


def skipped(reports: Iterable[pytest.TestReport | pytest.CollectReport]) -> list[str]:
    """One line for each reason why tests were skipped, with their number."""
    reasons = Counter(
        report.longrepr[2].removeprefix("Skipped: ")
        for report in reports
        if isinstance(report.longrepr, tuple)
    )
    return [f"{count:4d} {why}" for why, count in reasons.most_common()]


def skip(what: str) -> NoReturn:
    """Skip the test that runs."""
    pytest.skip(reason(what))


def needs(what: str, there: bool) -> pytest.MarkDecorator:
    """Mark tests that are skipped where something is missing."""
    return pytest.mark.skipif(not there, reason=reason(what))


def has(package: str) -> bool:
    """Whether a package is installed; it is not imported."""
    return find_spec(package) is not None


def module(name: str, package: str = "") -> ModuleType:
    """A module that needs a package (its own, if none is named); without it, skip the test."""
    package = package or name.partition(".")[0]
    return importlib.import_module(name) if has(package) else skip(package)


def there(path: Path, what: str = "real data") -> Path:
    """A file or folder that is not part of the repository."""
    return path if path.exists() else skip(what)


@cache
def chromium() -> str | None:
    """The Chromium of this machine, which Playwright drives; None where there is none."""
    names = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


@cache
def draws_off_screen() -> bool:
    """Whether this machine has what MuJoCo draws with; asked of MuJoCo, not of our film."""
    try:
        if sys.platform == "linux" and "DISPLAY" not in os.environ:
            from mujoco.egl import GLContext
        else:
            from mujoco import GLContext
        GLContext(8, 8).free()
    except (ImportError, AttributeError, OSError, RuntimeError):  # each backend has its own
        return False
    return True
