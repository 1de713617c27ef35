"""Where real data are, which are not part of the package; see the README beside them."""

from __future__ import annotations

import os
from pathlib import Path

from tests import optional

_GIVEN = Path(os.environ.get("MOMAPOS_SHARED", Path(__file__).parents[2] / "shared"))
DATA = _GIVEN / "data" if (_GIVEN / "data").is_dir() else _GIVEN
"""The folder that holds bestman/; it need not exist."""
LIBRARY = Path(__file__).parents[1] / "src" / "momapos" / "model" / "scene" / "library"
BUILT_IN = (
    "kitchen_small/fridge",
    "kitchen_small/cabinet_left",
    "kitchen_island/wall_cabinet_lift",
)
"""Furniture of the package: a hinge each way, drawers, a flap."""
TOOLS = DATA.parent / "tools"
"""Independent checks of our files; it need not exist."""


def furniture(name: str) -> Path:
    """URDF of furniture of a built-in kitchen, or of the real data; skip the test without it."""
    kitchen, piece = name.split("/")
    built_in = LIBRARY / f"{kitchen}_urdf" / f"{piece}.urdf"
    if built_in.is_file():
        return built_in
    models = DATA / "bestman/Asset/Scene/Kitchen_models/models"
    return optional.there(models / name / "mobility.urdf")
