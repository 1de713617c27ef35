"""Test pushes from behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.rooms import cabinet_room

from momapos.model.robots.robot import Robot
from momapos.planning.grasps.config import GraspConfig
from momapos.planning.grasps.fronts import PUSH_INSET
from momapos.planning.grasps.hand_boxes import Hand, hand_of
from momapos.planning.grasps.push_grasps import push_from_behind

GRID = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 41)] * 3), axis=-1).reshape(-1, 3)


def inside(hand: Hand) -> np.ndarray:
    """Return points of the fingers' boxes in the tool frame."""
    rows = np.flatnonzero(hand.side)
    boxes = hand.boxes
    return np.concatenate(
        [boxes.center[b] + GRID * boxes.half[b] @ boxes.rotation[b].T for b in rows]
    )


@pytest.mark.parametrize(
    "name",
    [
        "fetch",
        pytest.param("husky_ur5e", marks=pytest.mark.slow),
        pytest.param("ranger_rm63", marks=pytest.mark.slow),
    ],
)
def test_fingers_touch_the_back_of_a_door(
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
        over = there[there @ to_hinge > -PUSH_INSET]
        assert np.max(there @ to_hinge) == pytest.approx(0.0, abs=1e-9)
        # The grid resolves where an edge cuts a box only to one step.
        assert -0.002 < np.min(over @ back.out) < 1e-9 + 0.002
