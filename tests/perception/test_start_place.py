"""A robot starts on free floor that the cameras were carried over, open to most of the room."""

from __future__ import annotations

import numpy as np
import pytest
from tests.furnished import Corners, look_at

from momapos.core.geometry.polygons import UprightBox, from_corners, to_local
from momapos.model.records.scans import Frame
from momapos.perception.pipeline import start_place

FLOOR = [(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)]
POCKET: list[Corners] = [
    ((0.9, -3.0, 0.0), (1.0, 3.0, 2.4)),  # a wall without a door, 2 m from the right end
    ((-3.0, 2.4, 0.0), (0.9, 3.0, 0.9)),
    ((-1.6, -1.0, 0.0), (-0.4, 0.0, 0.75)),
]


def boxes(corners: list[Corners]) -> list[UprightBox]:
    return [from_corners(np.array(low), np.array(high)) for low, high in corners]


def cameras(path: list[tuple[float, float]]) -> list[Frame]:
    gray = np.zeros((2, 2, 3), np.uint8)
    target = (-1.0, 2.5, 0.8)
    return [
        Frame(str(k), gray, None, np.eye(3), look_at((x, y, 1.5), target))
        for k, (x, y) in enumerate(path)
    ]


def distance(x: float, y: float, items: list[UprightBox]) -> float:
    """Return the distance to the nearest box or end of the floor."""
    at = np.array([[x, y, 0.0]])
    away = [
        np.linalg.norm(np.maximum(np.abs(to_local(at, b)[0, :2]) - b.size[:2] / 2, 0))
        for b in items
    ]  # fmt: skip
    return float(min(*away, *(3.0 - abs(v) for v in (x, y))))


def test_the_start_is_free_walked_over_and_not_in_a_pocket() -> None:
    path = [(2.2, -2.0), (2.2, 0.0), (-2.4, -2.4), (-2.4, -1.4), (-2.3, 0.4), (-1.2, 1.0)]
    start = start_place(boxes(POCKET), FLOOR, cameras(path))
    x, y, yaw = start
    assert x < 0.9, "not behind the wall, where the camera was, too"
    assert distance(x, y, boxes(POCKET)) > 0.45
    assert min(np.hypot(x - a, y - b) for a, b in path[2:]) < 1.0
    ahead = np.array([-1.0, 2.5]) - (x, y)
    assert np.cos(yaw) * ahead[0] + np.sin(yaw) * ahead[1] > 0


@pytest.mark.parametrize("seed", range(6))
def test_a_start_is_never_in_a_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-3, 2, (12, 2))
    items = [
        UprightBox(np.append(at, 0.4), np.append(rng.uniform(0.2, 1.2, 2), 0.8), rng.uniform(-1, 1))
        for at in low
    ]  # fmt: skip
    path = [tuple(place) for place in rng.uniform(-2.5, 2.5, (10, 2)).tolist()]
    start = start_place(items, FLOOR, cameras(path))
    if start is not None:
        assert distance(start[0], start[1], items) > 0.2


def test_hanging_cabinets_and_rugs_are_not_in_the_way() -> None:
    above: list[Corners] = [((-3, -3, 1.6), (3, 3, 2.2)), ((-3, -3, 0), (3, 3, 0.02))]
    start = start_place(boxes(above), FLOOR, cameras([(0.5, 0.5)]))
    assert np.hypot(start[0] - 0.5, start[1] - 0.5) < 0.35


def test_cameras_over_furniture_or_outside_leave_any_free_place() -> None:
    for path in ([(9.0, 9.0)], [(-1.0, 2.7), (-1.5, 2.7)]):
        start = start_place(boxes(POCKET), FLOOR, cameras(path))
        assert distance(start[0], start[1], boxes(POCKET)) > 0.45


def test_a_cloud_without_cameras_has_a_roomy_start() -> None:
    start = start_place(boxes(POCKET), FLOOR, [])
    assert start[0] < 0.9
    assert distance(start[0], start[1], boxes(POCKET)) > 0.6


def test_a_floor_without_room_has_no_start() -> None:
    full: list[Corners] = [((-3, -3, 0), (3, 3, 1))]
    assert start_place(boxes(full), FLOOR, cameras([(0, 0)])) is None
    assert start_place([], [(0, 0), (1e6, 0), (1e6, 1), (0, 1)], []) is None
