"""Paths of the real data, which is not part of the package; see its README."""

from __future__ import annotations

import importlib
import json
import os
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from tests import optional

_GIVEN = Path(os.environ.get("MOMAPOS_SHARED", Path(__file__).parents[2] / "shared"))
DATA = _GIVEN / "data" if (_GIVEN / "data").is_dir() else _GIVEN
"""The folder that holds bestman/; it may be missing."""
LIBRARY = Path(__file__).parents[1] / "src" / "momapos" / "model" / "scene" / "library"
BUILT_IN = (
    "kitchen_small/fridge",
    "kitchen_small/cabinet_left",
    "kitchen_island/wall_cabinet_lift",
)
"""Furniture of the package: hinges on either side, drawers, a flap."""
CASES = DATA.parent / "findings" / "cases"
"""Small inputs of other people's kinds; it may be missing."""
TOOLS = DATA.parent / "tools"
"""Independent checks of our files; it may be missing."""


@cache
def _independent_program() -> ModuleType:
    """Import the independent program and the module next to it, by name as in its own process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(optional.there(TOOLS, "independent checker"))
        return importlib.import_module("verify_plan")


def independent_checks(plan: Path) -> list[dict[str, Any]]:
    """Return the checks of a plan file by the independent program; skip the test without it."""
    options = SimpleNamespace(skip_approach=False, allow_hinge_grasp=False)
    data = json.loads(plan.read_text())
    report, _ = _independent_program().verify(data, plan.parent, None, options)
    return list(report.checks)


def check_independently(plan: Path, *, but_for: str = "") -> None:
    """Check a plan file with the independent program, where it is present.

    One of its checks may fail, if it cannot know better.
    """
    if TOOLS.is_dir():
        failed = [one["check"] for one in independent_checks(plan) if not one["ok"]]
        assert all(but_for and but_for in name for name in failed), failed


def furniture(name: str) -> Path:
    """Return a URDF of a built-in kitchen or of the real data; skip the test if it is missing."""
    kitchen, piece = name.split("/")
    built_in = LIBRARY / f"{kitchen}_urdf" / f"{piece}.urdf"
    if built_in.is_file():
        return built_in
    models = DATA / "bestman/Asset/Scene/Kitchen_models/models"
    return optional.there(models / name / "mobility.urdf")
