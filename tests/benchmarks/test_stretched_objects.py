"""Laws of stretched and rolled objects: they still open at their hinges."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.geometry.transforms import apply
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import read_urdf

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def benchmark_module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import the benchmark, which imports its neighbors as a script does."""
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    return importlib.import_module("stretched_objects")


def fridge() -> SceneObject:
    """Return a fridge at the origin, with its front toward -x."""
    return replace(load_scene("kitchen_small").object("fridge"), T_world_object=np.eye(4))


def corners(model: Articulated) -> np.ndarray:
    poses = model.link_poses({})
    points = [apply(poses[n], h.vertices) for n, hulls in model.hulls.items() for h in hulls]
    return np.concatenate(points)


def test_a_stretched_object_has_the_scaled_size_and_hinges(
    benchmark_module: Any, tmp_path: Path
) -> None:
    item, stretch = fridge(), np.diag([1.0, 1.5, 0.75])
    other = Articulated(
        read_urdf(benchmark_module.write(item, stretch, np.eye(3), tmp_path / "wide"))
    )
    low, high = item.bounds
    points = corners(other)
    np.testing.assert_allclose(points.min(axis=0), stretch @ low, atol=1e-3)
    np.testing.assert_allclose(points.max(axis=0), stretch @ high, atol=1e-3)
    assert set(other.joints) == set(item.model.joints)
    for name, joint in other.joints.items():
        true = item.model.joint(name)
        poses, back = other.link_poses({}), item.link_poses()
        at = (poses[joint.parent] @ joint.T_parent_joint)[:3, 3]
        before = (back[true.parent] @ true.T_parent_joint)[:3, 3]
        np.testing.assert_allclose(at, stretch @ before, atol=1e-3)


@pytest.mark.parametrize("side", [1, -1])
def test_a_rolled_door_is_a_flap(side: int, benchmark_module: Any, tmp_path: Path) -> None:
    item = fridge()
    assert benchmark_module.rolls(item) in (1, -1)
    roll = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -side], [0.0, side, 0.0]])
    other = Articulated(
        read_urdf(benchmark_module.write(item, np.eye(3), roll, tmp_path / "rolled"))
    )
    for joint in other.joints.values():
        axis = (other.link_poses({})[joint.parent] @ joint.T_parent_joint)[:3, :3] @ joint.axis
        assert abs(axis[2]) < 1e-6
    low, high = item.bounds
    np.testing.assert_allclose(
        np.ptp(corners(other), axis=0)[[1, 2]], (high - low)[[2, 1]], atol=1e-3
    )
