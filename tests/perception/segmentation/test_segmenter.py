"""Each object of a synthetic kitchen is one instance, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.furnished import BACK, KITCHEN, LEFT, ROOM, TABLE, Corners, cloud_of, kitchen

from momapos.core.errors import InputError
from momapos.model.records.scans import Cloud, Detection, Instance
from momapos.perception.segmentation.front_planes import find_front_planes
from momapos.perception.segmentation.instance_boxes import boxes
from momapos.perception.segmentation.room_shell import (
    RoomShell,
    RoomWall,
    at_wall,
    find_room,
    in_room,
)
from momapos.perception.segmentation.segmenter import ClassicalSegmenter


def best_overlap(corners: Corners, found: list[Detection]) -> float:
    """Return the largest intersection over union of a box with detections."""
    low, high = np.array(corners)
    best = 0.0
    for detection in found:
        start = detection.box.center - detection.box.size / 2
        stop = detection.box.center + detection.box.size / 2
        both = np.prod(np.maximum(np.minimum(high, stop) - np.maximum(low, start), 0.0))
        best = max(best, both / (np.prod(high - low) + np.prod(stop - start) - both))
    return float(best)


def kept(cloud: Cloud, seen: np.ndarray) -> Cloud:
    """Return the seen part of a cloud."""
    return Cloud(cloud.points[seen], cloud.normals[seen], cloud.colors[seen])


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    return cloud_of(kitchen(), np.random.default_rng(1))


@pytest.fixture(scope="module")
def instances(cloud: Cloud) -> list[Instance]:
    return ClassicalSegmenter()(cloud)


@pytest.fixture(scope="module")
def found(cloud: Cloud, instances: list[Instance]) -> list[Detection]:
    return boxes(cloud, instances, find_room(cloud))


def test_walls_are_found_where_they_are(cloud: Cloud) -> None:
    walls = {(wall.axis, wall.sign): wall.offset for wall in find_room(cloud).walls}
    assert set(walls) == {(1, -1.0), (0, 1.0)}
    assert walls[1, -1.0] == pytest.approx(BACK[0][1], abs=0.005)
    assert walls[0, 1.0] == pytest.approx(LEFT[1][0], abs=0.005)


def test_fronts_of_furniture_are_not_walls(cloud: Cloud) -> None:
    room = in_room(find_room(cloud), cloud)
    front = np.abs(cloud.points[:, 1] - KITCHEN["fridge"][0][1]) < 0.01
    front &= (cloud.normals[:, 1] < -0.9) & (cloud.points[:, 2] > 0.1)
    front &= cloud.points[:, 0] > LEFT[1][0] + 0.1
    assert front.sum() > 1000
    assert not room[front].any()


@pytest.mark.parametrize("name", [*KITCHEN, "table"])
def test_every_object_is_one_instance(name: str, found: list[Detection]) -> None:
    corners = TABLE if name == "table" else KITCHEN[name]
    assert best_overlap(corners, found) > (0.75 if name != "slab" else 0.5)


def test_no_other_object_is_found(found: list[Detection]) -> None:
    assert len(found) == len(KITCHEN) + 1


def test_no_point_belongs_to_two_instances(instances: list[Instance]) -> None:
    members = np.concatenate([instance.members for instance in instances])
    assert len(np.unique(members)) == len(members)


def test_objects_are_labeled_by_size(found: list[Detection]) -> None:
    labels = sorted(detection.label for detection in found)
    assert labels == sorted(
        [
            "fridge",
            "cabinet",
            "counter",
            "oven",
            "wall cabinet",
            "microwave",
            "bottle",
            "cup",
            "table",
        ]
    )


def test_a_chair_below_a_table_is_not_part_of_it() -> None:
    seat: Corners = ((1.1, -2.0, 0.42), (1.5, -1.55, 0.46))
    legs: list[Corners] = [
        ((x, y, 0.0), (x + 0.04, y + 0.04, 0.42)) for x in (1.1, 1.46) for y in (-2.0, -1.6)
    ]
    back: Corners = ((1.1, -2.03, 0.42), (1.5, -2.0, 0.95))
    cloud = cloud_of([*kitchen(), seat, back, *legs], np.random.default_rng(2))
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert best_overlap(TABLE, found) > 0.75
    assert best_overlap(((1.1, -2.03, 0.0), (1.5, -1.55, 0.95)), found) > 0.75


def test_deep_furniture_with_a_kick_space_and_a_handle_is_one_object() -> None:
    body: Corners = ((1.0, -0.1, 0.12), (1.9, 1.0, 1.7))
    foot: Corners = ((1.0, 0.1, 0.0), (1.9, 1.0, 0.12))
    handle: Corners = ((1.8, -0.23, 0.7), (1.83, -0.2, 1.3))
    cloud = cloud_of([*ROOM, body, foot, handle], np.random.default_rng(4))
    instances = ClassicalSegmenter()(cloud)
    found = boxes(cloud, instances, find_room(cloud))
    assert len(found) == 1
    (low, high) = (
        found[0].box.center - found[0].box.size / 2,
        found[0].box.center + found[0].box.size / 2,
    )
    np.testing.assert_allclose(low, (1.0, -0.1, 0.0), atol=0.02)
    np.testing.assert_allclose(high, (1.9, 1.0, 1.7), atol=0.02)
    assert (cloud.points[instances[0].members, 1] < -0.15).any()


def test_furniture_far_from_a_wall_ends_where_the_floor_is_seen() -> None:
    body: Corners = ((1.0, -0.1, 0.0), (1.9, 0.3, 1.5))
    cloud = cloud_of([*ROOM, body], np.random.default_rng(5))
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert best_overlap(body, found) > 0.9


def test_a_fridge_flush_with_its_row_is_separated_despite_a_ragged_top() -> None:
    fridge, row = ((-2.99, 0.4, 0.0), (-2.3, 1.0, 1.75)), ((-2.3, 0.4, 0.0), (-0.3, 1.0, 0.9))
    cloud = cloud_of([*ROOM, fridge, row], np.random.default_rng(2))
    strip = np.floor(cloud.points[:, 0] / 0.03).astype(int)
    missed = (cloud.points[:, 2] > 1.75 - 0.02 * (strip % 3)) & (cloud.points[:, 1] < 0.95)
    kept = np.flatnonzero(~missed)
    cloud = Cloud(cloud.points[kept], cloud.normals[kept], cloud.colors[kept])
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert best_overlap(fridge, found) > 0.9
    assert best_overlap(row, found) > 0.85


def test_a_wall_cabinet_with_a_partly_ragged_top_is_one_object() -> None:
    cabinet: Corners = ((-2.5, 0.65, 1.3), (-0.5, 1.0, 2.1))
    cloud = cloud_of([*ROOM, cabinet], np.random.default_rng(2))
    strip = np.floor(cloud.points[:, 0] / 0.03).astype(int)
    missed = (cloud.points[:, 2] > 1.85 - 0.015 * (strip % 4)) & (cloud.points[:, 1] < 0.95)
    kept = np.flatnonzero(~missed | (cloud.points[:, 0] < -0.9))
    cloud = Cloud(cloud.points[kept], cloud.normals[kept], cloud.colors[kept])
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert best_overlap(cabinet, found) > 0.9


@pytest.mark.parametrize(("width", "count"), [(0.15, 1), (0.6, 2)])
def test_wall_cabinets_are_divided_at_steps_of_their_edges_into_whole_fronts(
    width: float, count: int
) -> None:
    cabinet: Corners = ((-2.5, 0.65, 1.3), (-0.5, 1.0, 2.1))
    cloud = cloud_of([*ROOM, cabinet], np.random.default_rng(2))
    x, y, z = cloud.points.T
    cloud = kept(cloud, ~((x < -2.5 + width) & (y < 0.95) & (z > 2.05)))
    assert len(boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))) == count


def test_an_overhanging_top_is_a_separate_object() -> None:
    body: Corners = ((0.0, -1.6, 0.0), (1.0, -1.2, 0.86))
    top: Corners = ((-0.02, -1.84, 0.86), (1.02, -1.18, 0.9))
    cloud = cloud_of([*ROOM, body, top], np.random.default_rng(6))
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert len(found) == 2
    assert best_overlap(body, found) > 0.9
    assert best_overlap(top, found) > 0.7
    assert {item.label for item in found} == {"kitchen island", "counter"}


def test_furniture_open_at_a_side_extends_to_the_end_of_its_front() -> None:
    body: Corners = ((0.1, -1.6, 0.0), (0.9, -1.2, 0.86))
    front: Corners = ((0.0, -1.62, 0.0), (1.0, -1.6, 0.86))
    top: Corners = ((0.0, -1.62, 0.86), (1.0, -1.2, 0.9))
    cloud = cloud_of([*ROOM, body, front, top], np.random.default_rng(7))
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert len(found) == 1
    assert best_overlap(((0.0, -1.62, 0.0), (1.0, -1.2, 0.9)), found) > 0.95


def test_a_front_of_few_points_is_not_divided() -> None:
    x, z = (grid.ravel() for grid in np.meshgrid(np.arange(0.0, 1.2, 0.04), (0.5, 0.53)))
    points = np.column_stack([x, np.zeros(len(x)), z])
    normals = np.tile([0.0, -1.0, 0.0], (len(x), 1))
    cloud = Cloud(points, normals, np.full((len(x), 3), 128, np.uint8))
    assert find_front_planes(cloud, find_room(cloud), np.arange(len(x))) == []


def test_an_empty_room_has_no_instances() -> None:
    assert ClassicalSegmenter()(cloud_of(list(ROOM), np.random.default_rng(3))) == []


def test_unusable_clouds_are_refused(cloud: Cloud) -> None:
    empty = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    with pytest.raises(InputError, match="empty"):
        ClassicalSegmenter()(empty)
    with pytest.raises(InputError, match="finite"):
        ClassicalSegmenter()(
            replace(cloud, points=np.where(cloud.points > 2, np.nan, cloud.points))
        )
    far = replace(cloud, points=cloud.points * np.array([1e5, 1e5, 1.0]))
    with pytest.raises(InputError, match="too much for one room"):
        ClassicalSegmenter()(far)


def test_a_side_stands_against_a_near_wall_that_it_faces() -> None:
    room = RoomShell((RoomWall(0, -1.0, 2.0, -1.0, 1.0, 2.5),))  # the room is before x = 2
    toward = np.array([1.0, 0.0, 0.0])
    assert at_wall(room, np.array([1.95, 0.0, 0.5]), toward)
    assert not at_wall(room, np.array([1.95, 0.0, 0.5]), -toward)
    assert not at_wall(room, np.array([1.95, 0.0, 0.5]), np.array([0.0, 1.0, 0.0]))
    assert not at_wall(room, np.array([1.6, 0.0, 0.5]), toward)
    assert not at_wall(room, np.array([1.95, 1.6, 0.5]), toward)


def test_deep_furniture_with_sides_hidden_at_the_rear_is_one_object() -> None:
    chest: Corners = ((0.0, 0.1, 0.0), (0.85, 1.0, 0.8))
    cloud = cloud_of([*ROOM, chest], np.random.default_rng(10))
    x, y, z = cloud.points.T
    cloud = kept(cloud, ~((np.abs(x - 0.425) > 0.41) & (y > 0.5) & (z < 0.78)))
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert best_overlap(chest, found) > 0.95


def test_a_machine_next_to_a_taller_one_ends_before_the_gap() -> None:
    machine: Corners = ((0.0, 0.4, 0.0), (0.6, 1.0, 0.85))
    fridge: Corners = ((0.68, 0.2, 0.0), (1.6, 1.0, 1.75))
    cloud = cloud_of([*ROOM, machine, fridge], np.random.default_rng(8))
    x, y, z = cloud.points.T
    cloud = kept(cloud, ~((x > 0.59) & (x < 0.69) & (y > 0.45) & (z < 0.8)))  # the gap hides it
    assert best_overlap(machine, boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))) > 0.95


def test_tall_furniture_far_from_walls_is_one_object() -> None:
    fridge: Corners = ((-0.3, -1.3, 0.0), (0.3, -0.7, 1.45))
    cloud = cloud_of([*ROOM, fridge], np.random.default_rng(4))
    x, y, z = cloud.points.T
    cloud = kept(cloud, (z < 1.44) | (np.abs(x) > 0.32) | (np.abs(y + 1.0) > 0.32))  # a low camera
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert len(found) == 1
    assert best_overlap(fridge, found) > 0.9


def test_small_objects_are_divided_as_finely_as_the_cloud_is_dense() -> None:
    floor: Corners = ((-0.6, -0.5, -0.1), (0.6, 0.5, 0.0))
    table: Corners = ((-0.5, -0.4, 0.0), (0.5, 0.4, 0.7))
    cups: list[Corners] = [
        ((x, 0.0, 0.7), (x + 0.08, 0.08, 0.8)) for x in (-0.3, -0.19, -0.08, 0.03)
    ]
    for spacing, count in ((0.006, 4), (0.015, 1)):
        rng = np.random.default_rng(6)
        cloud = cloud_of([floor, table, *cups], rng, spacing=spacing, noise=0.001)
        small = [one for one in ClassicalSegmenter()(cloud) if one.score == 0.5]
        assert len(small) == count


def test_an_object_that_hides_the_middle_of_a_counter_does_not_divide_it() -> None:
    counter: Corners = ((-1.0, 0.4, 0.0), (1.0, 1.0, 0.9))
    microwave: Corners = ((-0.4, 0.52, 0.9), (0.2, 0.98, 1.22))
    cloud = cloud_of([*ROOM, counter, microwave], np.random.default_rng(9))
    x, _, z = cloud.points.T
    cloud = kept(cloud, ~((np.abs(z - 0.9) < 0.02) & (x > -0.7) & (x < 0.1)))
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    assert best_overlap(microwave, found) > 0.95
    assert best_overlap(((-1.0, 0.4, 0.0), (1.0, 1.0, 0.86)), found) > 0.95
    assert {item.label for item in found} == {"microwave", "cabinet", "counter"}


@pytest.mark.parametrize("degrees", [-25.0, -12.0, 6.0, 12.0, 40.0])
def test_free_furniture_that_is_turned_is_one_object_with_a_turned_box(degrees: float) -> None:
    rng, angle = np.random.default_rng(2), np.radians(degrees)
    table = cloud_of([((-0.8, -0.8, 0.0), (0.8, 0.0, 0.7))], rng)
    fridge = cloud_of([((-0.3, -0.27, 0.0), (0.3, 0.27, 1.45))], rng)
    fridge = kept(fridge, (fridge.normals[:, 2] < 0.5) & (fridge.points[:, 2] > 0.01))  # too high
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    n = 4000
    floor = np.column_stack([rng.uniform(-2.0, 2.0, (n, 2)), rng.normal(0.0, 0.002, n)])
    cloud = Cloud(
        np.concatenate([table.points, fridge.points @ R.T + [0.3, -2.0, 0.0], floor]),
        np.concatenate([table.normals, fridge.normals @ R.T, np.tile([0.0, 0.0, 1.0], (n, 1))]),
        np.zeros((len(table.points) + len(fridge.points) + n, 3), np.uint8),
    )
    found = boxes(cloud, ClassicalSegmenter()(cloud), find_room(cloud))
    (box,) = (item.box for item in found if item.box.size[2] > 1.2)
    assert np.degrees(box.yaw) == pytest.approx(degrees, abs=1.0)
    np.testing.assert_allclose(box.size, [0.6, 0.54, 1.45], atol=0.02)
