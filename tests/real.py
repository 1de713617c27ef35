"""Paths of the real data, which is not part of the package; see its README."""

from __future__ import annotations

import os
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


def furniture(name: str) -> Path:
    """Return a URDF of a built-in kitchen or of the real data; skip the test if it is missing."""
    kitchen, piece = name.split("/")
    built_in = LIBRARY / f"{kitchen}_urdf" / f"{piece}.urdf"
    if built_in.is_file():
        return built_in
    models = DATA / "bestman/Asset/Scene/Kitchen_models/models"
    return optional.there(models / name / "mobility.urdf")
