"""Unseen sides are recommended for another scan from where a person can stand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tests.perception.segmentation.test_coverage import surface

from momapos.core.geometry.upright_boxes import UprightBox
from momapos.model.records.scans import Cloud, Detection, Frame
from momapos.perception.next_views import scan_again
from momapos.perception.records import Decision, Modeled
from momapos.perception.segmentation.surface_coverage import with_coverage

K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
BOX = UprightBox(np.array([0.0, 0.0, 0.5]), np.array([0.6, 0.8, 1.0]))
FLOOR = np.array([[x, y, 0.0] for x in np.linspace(-3, 3, 41) for y in np.linspace(-3, 3, 41)])
WALL = UprightBox(np.array([-0.4, 0.0, 1.0]), np.array([0.2, 6.0, 2.0]))


def frame(x: float) -> Frame:
    """Return a camera that looks along -x at the front of the box, without depth."""
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, 0, -1], [1, 0, 0], [0, -1, 0]])
    T[:3, 3] = [x, 0, 0.6]
    return Frame(str(x), np.zeros((240, 320, 3), np.uint8), None, K, T)


def made(faces: tuple[int, ...], label: str = "cabinet", frames: tuple[Frame, ...] = ()) -> Modeled:
    """Return an object at a wall, of which some faces were seen."""
    item, cloud = surface(BOX, faces)
    cloud = Cloud(
        np.concatenate([cloud.points, FLOOR]),
        np.concatenate([cloud.normals, np.tile([0.0, 0, 1], (len(FLOOR), 1))]),
        np.zeros((len(cloud.points) + len(FLOOR), 3), np.uint8),
    )
    wall = Detection("wall_1", "wall", 0.8, WALL, np.zeros(0, int))
    thing = Detection("thing", label, item.score, item.box, item.members)
    (thing,) = with_coverage([thing], cloud, [wall])
    decisions = [Decision(one, None, None, (), None, "") for one in (thing, wall)]
    return Modeled(Path("s.json"), cloud, frames, np.eye(4), tuple(decisions))


def test_an_unseen_side_is_recommended_from_in_front_of_it() -> None:
    (one,) = scan_again(made((1, 3, 4)))
    assert one.object == "thing"
    assert one.look_at == (0.3, 0.0, 0.5)
    assert one.position[0] > 0.9
    assert one.position[1] == 0.0
    assert 0.9 <= one.position[2] <= 1.5
    assert one.gain > 0.7


def test_seen_and_invisible_sides_are_not_recommended() -> None:
    assert scan_again(made((0, 1, 3, 4))) == []
    assert scan_again(made((1, 3, 4), frames=(frame(1.2), frame(1.4), frame(1.6)))) == []
    assert scan_again(made((1, 3, 4), label="chair")) == []


def test_no_view_is_recommended_inside_furniture() -> None:
    room = made((1, 3, 4))
    stack = UprightBox(np.array([1.7, 0.0, 0.5]), np.array([2.2, 2.0, 1.0]))
    block = Decision(
        Detection("stack", "chair", 0.5, stack, np.zeros(0, int)), None, None, (), None, ""
    )
    blocked = Modeled(
        room.scene, room.cloud, (), room.T_scene_scan, (*room.decisions, block), {}, None
    )
    assert scan_again(blocked) == []
