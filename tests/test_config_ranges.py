"""Configurations refuse numbers out of range, with one line that names the field."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from tests.shapes import unchecked

from momapos.core.errors import InputError
from momapos.perception.fusion.tsdf import FusionConfig
from momapos.perception.reconstruction.model_config import ModelConfig
from momapos.perception.records import ScanConfig
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import ResistanceConfig
from momapos.planning.navigation.driving import DriveConfig, NoiseConfig
from momapos.planning.navigation.dynamic_window import WindowConfig
from momapos.planning.navigation.path_ends import PathConfig
from momapos.planning.reachability.reach_map import ReachConfig
from momapos.simulation.config import (
    ComplianceConfig,
    ExecutionConfig,
    FurnitureConfig,
    GripConfig,
    ModelErrorConfig,
)
from momapos.verification.report import Limits

WRONG = [
    (ResistanceConfig, "density", -1.0),
    (ResistanceConfig, "most_mass", 0.1),
    (ResistanceConfig, "seal_force", math.inf),
    (ResistanceConfig, "sealed", "fridge"),
    (FurnitureConfig, "spread", -0.1),
    (FurnitureConfig, "least_mass", 0.0),
    (GripConfig, "stiffness", 0.0),
    (ComplianceConfig, "damping", 0.0),
    (ModelErrorConfig, "tilt", -0.1),
    (ExecutionConfig, "timestep", 0.0),
    (ExecutionConfig, "hold", "glue"),
    (NoiseConfig, "heading", -0.1),
    (PathConfig, "preferred_clearance", -0.1),
    (WindowConfig, "margin", -0.1),
    (DriveConfig, "timeout", 0.0),
    (ReachConfig, "cell", 0.0),
    (ReachConfig, "threshold", math.inf),
    (FusionConfig, "farthest", 0.1),
    (ModelConfig, "grid", 0),
    (ScanConfig, "voxel", 0.0),
    (Limits, "states", 0),
    (Limits, "penetration", math.inf),
]


@pytest.mark.parametrize(("kind", "field", "value"), WRONG)
def test_a_value_out_of_range_is_refused_and_its_field_is_named(
    kind: type, field: str, value: object
) -> None:
    with (
        unchecked(),
        pytest.raises(InputError, match=rf"^{kind.__name__}\.{field} must be .*, not "),
    ):
        kind(**{field: value})


@pytest.mark.parametrize(
    ("kind", "field"), [(kind, field) for kind, field, value in WRONG if isinstance(value, float)]
)
def test_nan_is_refused(kind: type, field: str) -> None:
    with pytest.raises(InputError, match=rf"^{kind.__name__}\.{field} must be a .*, not nan"):
        kind(**{field: math.nan})


def test_numbers_of_numpy_are_numbers() -> None:
    assert NoiseConfig(heading=np.radians(2.0)).heading == math.radians(2.0)
    assert ModelConfig(turn=np.float64(1.0)).turn == 1.0


COUNTED = (PipelineConfig(), ReachConfig(), DriveConfig(), Limits(), ExecutionConfig())
"""Configurations whose counts have bounds."""


def _counts(config: Any) -> Iterator[tuple[type, str]]:
    """Yield all fields for whole numbers, also of nested configurations."""
    hints = get_type_hints(type(config))
    for item in fields(config):
        if is_dataclass(getattr(config, item.name)):
            yield from _counts(getattr(config, item.name))
        elif int in (hints[item.name], *get_args(hints[item.name])):
            yield type(config), item.name


@pytest.mark.parametrize("huge", [10**9, 10**20])
def test_every_count_has_an_upper_bound(huge: int) -> None:
    found = [one for config in COUNTED for one in _counts(config)]
    assert len(found) > 20
    for kind, name in found:
        words = f"{name} must be .*{huge}"
        with pytest.raises(InputError, match=words):
            print(kind, kind(**{name: huge}))
