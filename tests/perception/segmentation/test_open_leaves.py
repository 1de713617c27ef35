"""Open doors and flaps in a cloud."""

from __future__ import annotations

import numpy as np
import pytest
from tests.perception.segmentation.cupboards import Room, cupboard, leaf_of

from momapos.model.records.scans import Cloud
from momapos.perception.segmentation.closed_leaves import close_in_cloud
from momapos.perception.segmentation.leaf_evidence import TURN_RANGE
from momapos.perception.segmentation.open_leaves import find_open_leaves


@pytest.mark.parametrize(
    ("kind", "degrees"),
    [
        ("door_left", 40.0),
        ("door_left", 90.0),
        ("door_right", 65.0),
        ("door_right", 100.0),
        ("door_down", 50.0),
        ("door_down", 90.0),
        ("door_up", 60.0),
    ],
)
def test_an_open_leaf_is_found_with_its_hinge_and_angle(kind: str, degrees: float) -> None:
    true = leaf_of(kind, np.radians(degrees))
    room = cupboard(true)
    (leaf,) = find_open_leaves(room.cloud(), room.free)
    assert leaf.kind == kind
    assert np.degrees(leaf.value) == pytest.approx(degrees, abs=3.0)
    np.testing.assert_allclose(leaf.axis, true.axis, atol=1e-9)
    off = (leaf.pivot - true.pivot) * (1.0 - np.abs(true.axis))
    assert np.linalg.norm(off) < 0.02
    np.testing.assert_allclose(leaf.size, true.size, atol=0.04)
    np.testing.assert_allclose(leaf.middle, true.middle, atol=0.03)


def test_a_denser_cloud_has_the_same_leaf() -> None:
    room = cupboard(leaf_of("door_right", np.radians(65.0)))
    cloud, rng = room.cloud(), np.random.default_rng(0)
    along = rng.normal(0.0, 0.004, (8, *cloud.points.shape))
    along -= (along * cloud.normals).sum(-1, keepdims=True) * cloud.normals
    dense = Cloud(
        (cloud.points + along).reshape(-1, 3),
        np.tile(cloud.normals, (8, 1)),
        np.tile(cloud.colors, (8, 1)),
    )
    (leaf,), (same,) = (find_open_leaves(one, room.free) for one in (cloud, dense))
    assert same.kind == leaf.kind
    assert np.degrees(same.value) == pytest.approx(np.degrees(leaf.value), abs=1.0)
    np.testing.assert_allclose(same.pivot, leaf.pivot, atol=0.01)
    np.testing.assert_allclose(same.size, leaf.size, atol=0.02)


def test_no_leaf_is_found_if_all_are_closed() -> None:
    room = cupboard(leaf_of("door_left", 0.0))
    assert find_open_leaves(room.cloud(), room.free) == []


def test_a_board_that_protrudes_from_a_closed_front_is_not_a_leaf() -> None:
    room = cupboard(leaf_of("door_left", np.radians(80.0)), hollow=False)
    assert find_open_leaves(room.cloud(), room.free) == []


def test_an_object_that_protrudes_from_a_wall_is_not_a_leaf() -> None:
    room = cupboard(leaf_of("door_left", np.radians(80.0)))
    assert find_open_leaves(room.cloud(), room.free, [(1, 0.0)])
    assert find_open_leaves(room.cloud(), room.free, [(1, -0.5), (1, -0.48)]) == []


def test_no_leaf_is_found_without_known_free_space() -> None:
    room = cupboard(leaf_of("door_left", np.radians(80.0)))
    assert find_open_leaves(room.cloud(), lambda p: np.zeros(len(p), bool)) == []


def test_a_barely_open_leaf_is_not_found() -> None:
    slightly = TURN_RANGE[0] - np.radians(8.0)
    room = cupboard(leaf_of("door_left", slightly))
    assert find_open_leaves(room.cloud(), room.free) == []


def test_closing_the_leaf_gives_the_cloud_of_the_closed_door() -> None:
    true = leaf_of("door_right", np.radians(75.0))
    room = cupboard(true)
    shut = close_in_cloud(room.cloud(), [true], 0.015)
    expected = cupboard(leaf_of("door_right", 0.0)).cloud()

    def cells(points: np.ndarray) -> set[tuple[int, ...]]:
        # The inside of the closed cupboard is invisible.
        inside = (points > [0.02, -0.47, 0.42]).all(1) & (points < [0.58, -0.02, 1.18]).all(1)
        return set(map(tuple, np.round(points[~inside] / 0.05).astype(int)))

    ours, theirs = cells(shut.points), cells(expected.points)
    near = {tuple(np.add(cell, step)) for cell in theirs for step in np.ndindex(3, 3, 3)}
    near = {tuple(np.subtract(cell, 1)) for cell in near}
    assert ours <= near
    assert len(ours & theirs) > 0.9 * len(theirs)
    before = Room(room.solids).free(np.array([[0.3, -0.3, 0.8]]))
    assert before.all()
    behind = (shut.points > [0.03, -0.45, 0.43]).all(1) & (shut.points < [0.57, -0.03, 1.17]).all(1)
    assert not behind.any()
