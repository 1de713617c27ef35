"""The flood fill never excludes a place that the robot can drive to, and finds narrow passages."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.core.geometry.polygons import inscribed_radius
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.navigation.footprint_map import build_navigation_map
from momapos.planning.navigation.global_path import plan_path
from momapos.planning.navigation.outline_gaps import gaps
from momapos.planning.navigation.reachable_floor import ReachableFloor

FLOOR = np.array([[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]])
START = (-1.5, 0.0)
BEYOND = np.array([[1.5, 0.0]])


def doorway(width: float, *, y: float = 0.0, yaw: float = 0.0) -> Scene:
    """Return a room with a wall across it, which a doorway leaves open."""
    walls = []
    for name, side in (("wall_a", -1), ("wall_b", 1)):
        length = 3.0
        at = y + side * (width / 2 + length / 2)
        c, s = np.cos(yaw), np.sin(yaw)
        xyz = (-s * at, c * at, 1.0)
        walls.append(SceneObject.box(name, (0.1, length, 2.0), xyz, yaw=yaw))
    return Scene("room", tuple(walls), floor_polygon=FLOOR)


@pytest.mark.parametrize("robot", ["husky_ur5e", "fetch", "ranger_rm63"])
@pytest.mark.parametrize("yaw", [0.0, 0.3])
def test_a_passage_two_centimeters_too_narrow_is_found_and_a_fitting_one_is_not(
    robot: str, yaw: float
) -> None:
    arm = load_robot(robot)
    needed = 2 * inscribed_radius(build_navigation_map(doorway(1.0), arm).prisms.outlines[0])
    for width, fits in ((needed - 0.04, False), (needed + 0.001, True), (needed + 0.2, True)):
        floor = ReachableFloor(build_navigation_map(doorway(width, yaw=yaw), arm), START)
        assert floor.contains(BEYOND)[0] == fits
        assert floor.contains(np.array([START]))[0]


def test_the_passage_is_named_with_its_width(husky: Robot) -> None:
    floor = ReachableFloor(build_navigation_map(doorway(0.65, y=0.13), husky), START)
    passage = floor.passage(BEYOND)
    assert passage.width == pytest.approx(0.65, abs=0.005)
    assert set(passage.between) == {"wall_a", "wall_b"}
    assert str(passage).startswith("65 cm between wall_")
    assert str(passage).endswith("and the robot needs 69 cm")


def test_a_closed_room_has_no_passage(fetch: Robot) -> None:
    wall = SceneObject.box("wall", (0.1, 4.0, 2.0), (0, 0, 1))
    scene = Scene("room", (wall,), floor_polygon=FLOOR)
    floor = ReachableFloor(build_navigation_map(scene, fetch), START)
    assert not floor.contains(BEYOND)[0]
    assert floor.passage(BEYOND) is None


def test_without_a_floor_the_robot_may_drive_around(husky: Robot) -> None:
    scene = Scene("room", doorway(0.3).objects)
    floor = ReachableFloor(build_navigation_map(scene, husky), START)
    assert floor.contains(np.vstack([BEYOND, [[90.0, 90.0]]])).all()


def test_wherever_a_path_leads_the_fill_leads_too(husky: Robot) -> None:
    """In random rooms, for random goals where the robot fits."""
    rng = np.random.default_rng(5)
    compared, cut = 0, 0
    for _ in range(8):
        boxes = [
            SceneObject.box(
                f"box_{k}", (*rng.uniform(0.1, 0.9, 2), 1.0),
                (*rng.uniform([-1.0, -1.4], [2.4, 1.4]), 0.5), yaw=float(rng.uniform(0, 3)),
            )
            for k in range(6)
        ]  # fmt: skip
        nav_map = build_navigation_map(Scene("room", tuple(boxes), floor_polygon=FLOOR), husky)
        poses = rng.uniform([-2.2, -1.2, -np.pi], [2.2, 1.2, np.pi], (300, 3))
        start = np.array([-1.9, 0.0, 0.0])
        if gaps(start[None], nav_map.prisms, nav_map.planning_obstacles)[0] <= 0:
            continue
        fits = poses[gaps(poses, nav_map.prisms, nav_map.planning_obstacles) > 0][:8]
        reached = ReachableFloor(nav_map, (-1.9, 0.0)).contains(fits[:, :2])
        for pose, may in zip(fits, reached, strict=True):
            leads = plan_path(nav_map, start, pose) is not None
            assert may or not leads
            compared, cut = compared + leads, cut + (not may)
    assert compared >= 10
    assert cut >= 1
