"""Test pushes from behind."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import furniture_room, hollow_door
from tests.rooms import cabinet_room

from momapos.model.robots.robot import Robot
from momapos.planning.grasps.config import GraspConfig
from momapos.planning.grasps.grasp_families import CLEAR, push_from_behind
from momapos.planning.grasps.hand_boxes import HandBoxes, hand_of
from momapos.planning.grasps.handles import PUSH_INSET

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
FROM, TO = (np.array(ends) for ends in zip(*(
    (a, b) for a, b in combinations(CORNERS, 2) if (a != b).sum() == 1
), strict=True))  # fmt: skip
EDGES = (FROM[:, None] + np.linspace(0.0, 1.0, 101)[:, None] * (TO - FROM)[:, None]).reshape(-1, 3)
"""Points on the edges of a cube; a plane cuts the extreme points of a box from its edges."""


def inside(hand: HandBoxes) -> np.ndarray:
    """Return points on the edges of the fingers' boxes in the tool frame."""
    rows = np.flatnonzero(hand.side)
    boxes = hand.boxes
    return np.concatenate(
        [boxes.center[b] + EDGES * boxes.half[b] @ boxes.rotation[b].T for b in rows]
    )


HANDS = (
    "fetch",
    pytest.param("husky_ur5e", marks=pytest.mark.slow),
    pytest.param("ranger_rm63", marks=pytest.mark.slow),
)


@pytest.mark.parametrize("name", HANDS)
def test_fingers_touch_the_back_of_a_door(
    name: str, robots: Callable[[str], Robot], tmp_path: Path
) -> None:
    robot, door = robots(name), cabinet_room(tmp_path).object("cabinet").model
    found = push_from_behind(robot, door, "hinge", 1.0, GraspConfig())
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
        # The points resolve where the plane cuts an edge only to one step.
        off = np.min(over @ back.out)
        parallel = abs(T[:3, :3] @ robot.approach_axis @ back.out) < 1e-6
        assert -0.002 < off < 0.002 or (parallel and off == pytest.approx(CLEAR, abs=0.002))


@pytest.mark.parametrize("name", HANDS)
def test_fingers_touch_the_surface_of_a_hollow_door_not_its_hull(
    name: str, robots: Callable[[str], Robot], tmp_path: Path
) -> None:
    """Pushed at its hull, the door would stay behind the hand by the depth of the hollow."""
    boxes, parts = hollow_door(tmp_path)
    robot, door = robots(name), furniture_room(tmp_path, parts).object("cupboard").model
    found = push_from_behind(robot, door, "hinge", 1.0, GraspConfig())
    _, Ts, _ = found
    points = inside(hand_of(robot))
    for T in Ts:
        there = points @ T[:3, :3].T + T[:3, 3]
        low, high = np.array(boxes).transpose(1, 0, 2)[:, :, None]
        outside = np.linalg.norm(np.maximum(0.0, np.maximum(low - there, there - high)), axis=2)
        deep = np.minimum(there - low, high - there).min(2)
        assert outside.min() < CLEAR + 0.001
        assert deep.max() < 0.003


@pytest.mark.parametrize("name", HANDS)
def test_fingers_come_in_clear_of_the_edge_of_the_door(
    name: str, robots: Callable[[str], Robot], tmp_path: Path
) -> None:
    """A door that stands a millimeter off its planned angle must not catch them."""
    robot, door = robots(name), cabinet_room(tmp_path).object("cabinet").model
    found = push_from_behind(robot, door, "hinge", 1.0, GraspConfig())
    back, Ts, _ = found
    edge = min(hull.vertices[:, 0].min() for hull in door.hulls["door"])
    points = inside(hand_of(robot))
    for T in Ts:
        approach = T[:3, :3] @ robot.approach_axis
        there = points @ T[:3, :3].T + T[:3, 3]
        there = there - (there[:, 0].max() - edge) / approach[0] * approach  # the tips at the edge
        tips = there[there[:, 0] > edge - 0.002]
        assert np.min((tips - back.center) @ back.out) > 0.005
