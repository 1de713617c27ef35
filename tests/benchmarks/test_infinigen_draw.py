"""Laws of the Infinigen export: a door and its joint follow from the open and closed meshes."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.geometry.transforms import rotation_about
from momapos.model.urdf.reader import read_urdf

REPOSITORY = Path(__file__).parents[2]
PIVOT, AXIS = np.array([0.9, 0.0, 0.1]), np.array([0.0, 1.0, 0.0])


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the script, which needs Infinigen only to generate assets."""
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    return importlib.import_module("infinigen_draw")


def test_a_rotation_is_recovered_from_points_before_and_after(script: Any) -> None:
    closed = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    after = (closed - PIVOT) @ rotation_about(AXIS, script.OPEN).T + PIVOT
    pivot, axis = script._turn(closed, after)
    np.testing.assert_allclose(axis, AXIS, atol=1e-9)
    np.testing.assert_allclose(np.delete(pivot, 1), np.delete(PIVOT, 1), atol=1e-9)
    with pytest.raises(ValueError, match="do not turn as one"):
        script._turn(closed, np.concatenate([closed[:25], after[25:]]))


def test_the_urdf_has_a_revolute_door_with_its_mesh_in_place(script: Any, tmp_path: Path) -> None:
    (tmp_path / "assets").mkdir()
    for name in ("body_0", "door_0"):
        (tmp_path / "assets" / f"{name}.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    script._urdf("oven", PIVOT, AXIS).write(tmp_path / "oven.urdf", encoding="utf-8")
    urdf = read_urdf(tmp_path / "oven.urdf")
    (door,) = (joint for joint in urdf.joints if joint.kind == "revolute")
    np.testing.assert_allclose(door.T_parent_joint[:3, 3], PIVOT)
    np.testing.assert_allclose(door.axis, AXIS)
    (mesh,) = urdf.links[door.child].visuals
    np.testing.assert_allclose((door.T_parent_joint @ mesh.T_link_geometry)[:3, 3], 0.0, atol=1e-9)
