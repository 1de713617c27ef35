"""Pushing from behind: fingers touch the back where they are over it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import cabinet_room

from momapos.model.robots.robot import Robot
from momapos.planning.grasps.config import GraspConfig
from momapos.planning.grasps.hand_boxes import Hand, hand_of
from momapos.planning.grasps.handles import FACE_INSIDE
from momapos.planning.grasps.push_grasps import push_from_behind

GRID = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 41)] * 3), axis=-1).reshape(-1, 3)


def inside(hand: Hand) -> np.ndarray:
    """Points of the fingers' boxes, in the frame of the tool."""
    rows = np.flatnonzero(hand.side)
    boxes = hand.boxes
    return np.concatenate(
        [boxes.center[b] + GRID * boxes.half[b] @ boxes.rotation[b].T for b in rows]
    )


@pytest.mark.parametrize("name", ["fetch", "husky_ur5e", "ranger_rm63"])
def test_fingers_touch_the_back_of_a_door_by_what_is_over_it(
    name: str, robots: Callable[[str], Robot], tmp_path: Path
) -> None:
    robot, door = robots(name), cabinet_room(tmp_path).object("cabinet").model
    found = push_from_behind(robot, door, "hinge", 1.0, GraspConfig())
    assert found is not None
    back, Ts, _ = found
    hand = hand_of(robot)
    to_hinge = np.cross(back.long, back.out)
    axis = door.joint("hinge").axis
    to_hinge *= np.sign(to_hinge @ (axis * (back.center @ axis) - back.center))
    points = inside(hand)
    for T in Ts:
        there = points @ T[:3, :3].T + T[:3, 3] - back.center
        over = there[there @ to_hinge > -FACE_INSIDE]
        assert np.max(there @ to_hinge) == pytest.approx(0.0, abs=1e-9)
        # Grid points of a box come to its faces, and to within a step of where an edge cuts it.
        assert -0.002 < np.min(over @ back.out) < 1e-9 + 0.002
