"""Two scans of one room are registered."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from momapos.core.errors import InputError
from momapos.core.geometry.transforms import apply, invert, pose, rotation_about
from momapos.model.records.scans import Cloud
from momapos.perception.fusion.registration import register

UP = np.array([0.0, 0.0, 1.0])


def box(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return points every 3 cm on the upright sides of a box, and their normals."""
    points, normals = [], []
    for axis in (0, 1):
        across = np.arange(low[1 - axis], high[1 - axis], 0.03)
        a, z = (v.ravel() for v in np.meshgrid(across, np.arange(low[2], high[2], 0.03)))
        for end, sign in ((low, -1.0), (high, 1.0)):
            side = np.empty((len(a), 3))
            side[:, axis], side[:, 1 - axis], side[:, 2] = end[axis], a, z
            points.append(side)
            normals.append(np.tile(sign * np.eye(3)[axis], (len(a), 1)))
    return np.concatenate(points), np.concatenate(normals)


def top(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return points every 3 cm on the top of a box, which fix the height of a scan; normals."""
    x, y = np.meshgrid(np.arange(low[0], high[0], 0.03), np.arange(low[1], high[1], 0.03))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high[2])])
    return points, np.tile(UP, (len(points), 1))


def room(seed: int, size: tuple[float, float] = (4.0, 3.0)) -> Cloud:
    """Return walls around a floor with five pieces of furniture."""
    rng = np.random.default_rng(seed)
    walls, normals = box((0.0, 0.0, 0.0), (*size, 2.4))
    sheets = [(walls, -normals)]
    for _ in range(5):
        low = rng.uniform(0.2, np.array(size) - 0.9)
        high = low + rng.uniform(0.3, 0.8, 2)
        corners = (*low, 0.0), (*high, rng.uniform(0.5, 1.8))
        sheets += [box(*corners), top(*corners)]
    points, normals = (np.concatenate(both) for both in zip(*sheets, strict=True))
    points = points + rng.normal(0.0, 2e-3, points.shape)
    return Cloud(points, normals, np.zeros(points.shape, np.uint8))


def moved(cloud: Cloud, T: np.ndarray) -> Cloud:
    return Cloud(apply(T, cloud.points), cloud.normals @ T[:3, :3].T, cloud.colors)


@settings(max_examples=5)
@given(
    seed=st.integers(0, 100), quarter=st.integers(0, 3), yaw=st.floats(-0.03, 0.03),
    shift=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.02, 0.02)),
)  # fmt: skip
def test_a_rotated_and_translated_room_is_registered(
    seed: int, quarter: int, yaw: float, shift: tuple[float, float, float]
) -> None:
    T = pose(shift, rotation_about(UP, np.array(quarter * np.pi / 2 + yaw)))
    first = room(seed)
    part = np.flatnonzero(first.points[:, 0] < 3.2)[::2]  # the second walk sees less of it
    seen = Cloud(first.points[part], first.normals[part], first.colors[part])
    found = register(first, moved(seen, invert(T)))
    assert (
        np.linalg.norm(apply(found, moved(seen, invert(T)).points) - seen.points, axis=1).max()
        < 0.02
    )


def test_scans_of_different_rooms_are_refused() -> None:
    with pytest.raises(InputError, match="do not show the same room"):
        register(room(1), room(2, size=(5.2, 3.7)))


def test_a_scan_of_only_a_floor_is_refused() -> None:
    first = room(1)
    low = Cloud(first.points * [1.0, 1.0, 0.0], first.normals, first.colors)
    with pytest.raises(InputError, match="only the floor"):
        register(first, low)
