"""Paths of the real data, which is not part of the package; see its README."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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


def check_independently(plan: Path, *, but_for: str = "") -> None:
    """Check a plan file with the independent program, where it is present.

    One of its checks may fail, if it cannot know better.
    """
    if not TOOLS.is_dir():
        return
    check = [sys.executable, str(TOOLS / "verify_plan.py"), str(plan)]
    done = subprocess.run(check, capture_output=True, text=True, check=False)
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAIL")]
    assert done.stdout.strip(), done.stderr
    assert all(but_for and but_for in line for line in failed), done.stdout
    assert done.returncode == int(bool(failed)), done.stdout


def furniture(name: str) -> Path:
    """Return a URDF of a built-in kitchen or of the real data; skip the test if it is missing."""
    kitchen, piece = name.split("/")
    built_in = LIBRARY / f"{kitchen}_urdf" / f"{piece}.urdf"
    if built_in.is_file():
        return built_in
    models = DATA / "bestman/Asset/Scene/Kitchen_models/models"
    return optional.there(models / name / "mobility.urdf")
