"""Faces of boxes lie on surfaces, despite protrusions and unseen sides."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from tests.furnished import Corners, cloud_of

from momapos.core.errors import InputError
from momapos.core.geometry.polygons import UprightBox
from momapos.model.records.scans import Cloud, Detection, Instance
from momapos.perception.segmentation.instance_boxes import MIN_YAW, boxes, named, wall_detections
from momapos.perception.segmentation.room_shell import RoomShell, RoomWall

BACK_WALL = RoomShell((RoomWall(1, -1.0, 1.0, -3.0, 3.0, 2.4),))
NO_WALLS = RoomShell()
CRATE: Corners = ((0.2, -0.4, 0.0), (0.8, 0.2, 0.9))


def whole(cloud: Cloud, label: str = "crate") -> Instance:
    """Return all points as one instance."""
    return Instance(label, 0.9, np.arange(len(cloud.points)))


def draw(cloud: Cloud, room: RoomShell = NO_WALLS) -> UprightBox:
    """Return the box around all points."""
    (detection,) = boxes(cloud, [whole(cloud)], room)
    return detection.box


def assert_close(box: UprightBox, corners: Corners, atol: float) -> None:
    low, high = np.array(corners)
    np.testing.assert_allclose(box.center - box.size / 2, low, atol=atol)
    np.testing.assert_allclose(box.center + box.size / 2, high, atol=atol)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_a_crate_gets_its_true_box(rng: np.random.Generator) -> None:
    assert_close(draw(cloud_of([CRATE], rng)), CRATE, 0.004)


def test_handles_do_not_move_the_front(rng: np.random.Generator) -> None:
    handle: Corners = ((0.25, -0.45, 0.4), (0.28, -0.42, 0.8))
    assert_close(draw(cloud_of([CRATE, handle], rng)), CRATE, 0.005)


def test_far_points_do_not_grow_a_box(rng: np.random.Generator) -> None:
    cloud = cloud_of([CRATE], rng)
    far = rng.uniform((-2, -2, 0), (2, 2, 4), (15, 3))
    stray = np.concatenate([cloud.points, far])
    more = np.tile([[1.0, 0.0, 0.0]], (15, 1))
    stray_cloud = Cloud(
        stray, np.concatenate([cloud.normals, more]), np.zeros((len(stray), 3), np.uint8)
    )
    (detection,) = boxes(stray_cloud, [whole(stray_cloud)], RoomShell())
    assert_close(detection.box, CRATE, 0.006)
    assert len(np.intersect1d(detection.members, np.arange(len(cloud.points), len(stray)))) <= 1


@pytest.mark.parametrize(("gap", "snaps"), [(0.06, True), (0.3, False)])
def test_backs_near_a_wall_snap_to_it(gap: float, snaps: bool, rng: np.random.Generator) -> None:
    crate: Corners = ((0.2, 0.3, 0.0), (0.8, 1.0 - gap, 0.9))
    box = draw(cloud_of([crate], rng), BACK_WALL)
    back = box.center[1] + box.size[1] / 2
    assert back == pytest.approx(1.0 if snaps else 1.0 - gap, abs=0.005)


@pytest.mark.parametrize(("bottom", "snaps"), [(0.08, True), (0.4, False)])
def test_bottoms_near_the_floor_snap_to_it(
    bottom: float, snaps: bool, rng: np.random.Generator
) -> None:
    box = draw(cloud_of([((0.2, -0.4, bottom), (0.8, 0.2, 0.9))], rng))
    assert box.center[2] - box.size[2] / 2 == pytest.approx(0.0 if snaps else bottom, abs=0.005)


def test_objects_snap_to_the_surface_below(rng: np.random.Generator) -> None:
    cup = cloud_of([((0.4, -0.2, 0.93), (0.48, -0.12, 1.0))], rng)
    crate = cloud_of([CRATE], rng)
    both = Cloud(*(np.concatenate(pair) for pair in zip(_arrays(crate), _arrays(cup), strict=True)))
    n = len(crate.points)
    found = boxes(
        both,
        [
            Instance("cup", 1.0, np.arange(n, len(both.points))),
            Instance("crate", 1.0, np.arange(n)),
        ],
        RoomShell(),
    )
    box = next(d.box for d in found if d.label == "cup")
    assert box.center[2] - box.size[2] / 2 == pytest.approx(0.9, abs=0.005)


def _arrays(cloud: Cloud) -> tuple[np.ndarray, ...]:
    return cloud.points, cloud.normals, cloud.colors


@pytest.mark.parametrize("degrees", [-30.0, 2.0, 5.0, 20.0])
def test_turned_objects_get_turned_boxes(degrees: float, rng: np.random.Generator) -> None:
    angle = np.radians(degrees)
    cloud = cloud_of([((-0.5, -0.3, 0.0), (0.5, 0.3, 0.9))], rng)
    box = draw(_turned(cloud, angle))
    straight = abs(degrees) < MIN_YAW
    assert box.yaw == pytest.approx(0.0 if straight else angle, abs=0.02)
    if not straight:
        np.testing.assert_allclose(box.size, [1.0, 0.6, 0.9], atol=0.02)
        np.testing.assert_allclose(box.center, [0.0, 0.0, 0.45], atol=0.01)


def _turned(cloud: Cloud, angle: float) -> Cloud:
    c, s = np.cos(angle), np.sin(angle)
    R: Float[np.ndarray, "3 3"] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Cloud(cloud.points @ R.T, cloud.normals @ R.T, cloud.colors)


def test_a_cup_seen_from_one_side_is_as_deep_as_it_is_wide(rng: np.random.Generator) -> None:
    angle = rng.uniform(np.pi, 2 * np.pi, 400)  # the half that looks to -y
    ring = 0.045 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.column_stack([ring, rng.uniform(0.9, 1.0, 400)])
    normals = np.column_stack([ring / 0.045, np.zeros(400)])
    crate = cloud_of([((-0.3, -0.3, 0.0), (0.3, 0.3, 0.9))], rng)
    cloud = Cloud(
        np.concatenate([crate.points, points]),
        np.concatenate([crate.normals, normals]),
        np.zeros((len(crate.points) + 400, 3), np.uint8),
    )
    n = len(crate.points)
    found = boxes(
        cloud,
        [Instance("c", 1.0, np.arange(n)), Instance("cup", 1.0, n + np.arange(400))],
        RoomShell(),
    )
    cup = next(d.box for d in found if d.label == "cup")
    np.testing.assert_allclose(cup.size[:2], 0.09, atol=0.012)
    np.testing.assert_allclose(cup.center[:2], 0.0, atol=0.01)


@pytest.mark.parametrize(("gap", "depth"), [(0.6, 0.5), (0.3, 0.3)])
def test_a_microwave_seen_from_the_front_extends_back_but_not_through_a_wall(
    gap: float, depth: float, rng: np.random.Generator
) -> None:
    n = 500
    front = np.column_stack([rng.uniform(-0.25, 0.25, n), np.zeros(n), rng.uniform(0.9, 1.2, n)])
    crate = cloud_of([((-0.6, -0.3, 0.0), (0.6, 0.3, 0.9))], rng)
    cloud = Cloud(
        np.concatenate([crate.points, front]),
        np.concatenate([crate.normals, np.tile([0.0, -1.0, 0.0], (n, 1))]),
        np.zeros((len(crate.points) + n, 3), np.uint8),
    )
    members = len(crate.points) + np.arange(n)
    instances = [
        Instance("crate", 1.0, np.arange(len(crate.points))),
        Instance("microwave", 1.0, members),
    ]
    room = RoomShell((RoomWall(1, -1.0, gap, -2.0, 2.0, 2.4),))
    box = next(d.box for d in boxes(cloud, instances, room) if d.label == "microwave")
    assert box.size[1] == pytest.approx(depth, abs=0.02)
    assert box.center[1] - box.size[1] / 2 == pytest.approx(0.0, abs=0.01)


def test_an_instance_that_is_only_a_box_keeps_it() -> None:
    given = UprightBox(np.array([1.0, -1.0, 1.5]), np.array([0.4, 0.3, 0.2]), 0.3)
    empty = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    (detection,) = boxes(empty, [Instance("lamp", 0.5, None, given)], RoomShell())
    np.testing.assert_allclose(detection.box.center, given.center)
    np.testing.assert_allclose(detection.box.size, given.size)
    assert (detection.name, detection.box.yaw) == ("lamp_1", 0.3)


def test_names_count_each_label_from_the_origin_outward() -> None:
    def at(x: float, label: str) -> Detection:
        box = UprightBox(np.array([x, 0.0, 0.5]), np.ones(3))
        return Detection("", label, 1.0, box, np.zeros(0, int))

    items = [at(3.0, "wall cabinet"), at(1.0, "cup"), at(2.0, "wall cabinet")]
    names = [d.name for d in named(items)]
    assert names == ["cup_1", "wall_cabinet_1", "wall_cabinet_2"]
    assert [d.name for d in named(items[::-1])] == names
    assert named(items)[1].box.center[0] == 2.0


def test_walls_become_boxes_behind_their_surface() -> None:
    (wall,) = wall_detections(BACK_WALL)
    np.testing.assert_allclose(wall.box.center - wall.box.size / 2, [-3.0, 1.0, 0.0])
    assert wall.label == "wall"


def test_members_that_are_not_indices_are_refused(rng: np.random.Generator) -> None:
    cloud = cloud_of([CRATE], rng)
    with pytest.raises(InputError, match="indices"):
        boxes(cloud, [Instance("x", 1.0, np.array([0, len(cloud.points)]))], RoomShell())
