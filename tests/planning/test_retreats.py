"""How rigid objects leave where they stand: lifted, or drawn out until they can be lifted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.retreats import (
    LIFT_HEIGHT,
    LIFT_ROOM,
    MAX_RISE,
    SLIDE_STEP,
    Retreat,
)
from momapos.planning.grasps.task_motions import rigid_retreats, task_motion
from momapos.planning.keyword_forms import plan_base_placement, plan_tour
from momapos.planning.tour import Request
from momapos.verification.part_sweep import free_length

DEPTH = 0.19
"""Depth of the carton, whose front is flush with that of the shelf [m]."""


def shelf(height: float, *, x: float = 0.0, name: str = "shelf") -> tuple[SceneObject, ...]:
    """Return a compartment of some height that opens toward -y, on a board at 0.7 m."""
    parts = {
        "board": ((0.8, 0.35, 0.02), (x, 1.1, 0.69)),
        "roof": ((0.8, 0.35, 0.02), (x, 1.1, 0.71 + height)),
        "left": ((0.02, 0.35, 0.4), (x - 0.41, 1.1, 0.85)),
        "right": ((0.02, 0.35, 0.4), (x + 0.41, 1.1, 0.85)),
        "back": ((0.84, 0.02, 0.4), (x, 1.285, 0.85)),
    }
    return tuple(SceneObject.box(f"{name}_{key}", *part) for key, part in parts.items())


def room(height: float, *others: SceneObject) -> Scene:
    """Return a carton of 25 cm in a compartment."""
    carton = SceneObject.box("carton", (0.06, DEPTH, 0.25), (0.0, 0.925 + DEPTH / 2, 0.825))
    start = np.array([0.0, -1.0, np.pi / 2])
    return Scene("room", (carton, *shelf(height), *others), start=start)


def first(scene: Scene, robot: Robot, config: MotionConfig | None = None) -> Retreat:
    return next(rigid_retreats(scene, robot, Task("pick", "carton"), config or MotionConfig()))


@pytest.mark.parametrize(("height", "lift"), [(0.4, LIFT_HEIGHT), (0.3, 0.03)])
def test_what_can_be_lifted_is_lifted_as_far_as_it_can(
    fetch: Robot, height: float, lift: float
) -> None:
    assert first(room(height), fetch) == Retreat(lift)


def test_what_cannot_be_lifted_is_drawn_out_by_the_shortest_free_path(fetch: Robot) -> None:
    scene = room(0.258)
    found = first(scene, fetch)
    x, y, z = found.slide
    assert x == pytest.approx(0.0, abs=1e-6)
    assert -DEPTH - SLIDE_STEP - LIFT_ROOM <= y < -DEPTH
    assert 0.0 < z <= MAX_RISE
    assert found.lift == LIFT_HEIGHT
    whole = found.length + found.lift
    assert free_length(scene, "carton", found.lift, found.slide) == pytest.approx(whole)
    shorter = (0.0, -DEPTH / 2, z)
    assert free_length(scene, "carton", found.lift, shorter) < DEPTH / 2 + found.lift
    wall = SceneObject.box("wall", (0.2, 0.1, 0.4), (0.0, 0.8, 0.9))
    assert first(room(0.258, wall), fetch).slide == (0.0, 0.0, 0.0)  # not out of there


def test_a_hand_draws_an_object_back_along_its_approach(fetch: Robot) -> None:
    scene, config = room(0.258), MotionConfig(retreat="back")
    motion = task_motion(scene, fetch, Task("pick", "carton"), config)
    assert motion.retreat is not None
    back = np.array(motion.retreat.slide) / motion.retreat.length
    approach = motion.Ts_world_tool[:, motion.grasp_step, :3, :3] @ fetch.approach_axis
    assert len(approach)
    assert (approach @ back < -0.99).all()
    placing = task_motion(scene, fetch, Task("place", "carton"), config)
    held = motion.Ts_world_tool[:, motion.grasp_step :]
    lowered = placing.Ts_world_tool[:, : placing.grasp_step + 1]
    np.testing.assert_allclose(lowered[0], held[0, ::-1], atol=1e-9)


def test_a_carton_goes_from_one_compartment_without_a_lift_into_another(segway: Robot) -> None:
    scene = room(0.258, *shelf(0.258, x=2.0, name="other"))
    up = PipelineConfig(motion=MotionConfig(retreat="up"))
    answer = plan_base_placement(scene, segway, Task("pick", "carton"), config=up)
    (reason,) = answer.plan.candidates.rejections
    assert "shelf_roof/box" in reason
    assert "when lifted by" in reason
    tour = plan_tour(scene, segway, [Request("bring", "carton", None, "other_board")])
    assert tour.status == "solved"
    for step in tour.steps:
        retreat = step.prepared.motion.retreat
        assert retreat is not None
        assert retreat.length > DEPTH
    goal = tour.scenes[1].object("carton").bounds
    assert goal[0, 2] == pytest.approx(0.7)


def test_a_given_lift_and_slide_are_followed(fetch: Robot) -> None:
    config = MotionConfig(lift=0.1, slide=(0.0, -0.3, 0.0))
    motion = task_motion(room(0.4), fetch, Task("pick", "carton"), config)
    moved = motion.Ts_world_tool[0, -1, :3, 3] - motion.Ts_world_tool[0, motion.grasp_step, :3, 3]
    np.testing.assert_allclose(moved, [0.0, -0.3, 0.1], atol=1e-9)
    assert replace(config, slide=None).retreat is None
