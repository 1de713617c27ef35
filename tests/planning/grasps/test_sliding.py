"""Test hooks that slide along a bar while the door rests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.model.records.plans import FAMILIES, Family, JointResistance, Motion
from momapos.model.robots.robot import Grip, Robot
from momapos.model.scene.scene import Scene
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.urdf_records import Geometry
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import GraspConfig, MotionConfig
from momapos.planning.grasps.sliding_hooks import SLIDE_STATES, SlidingMotion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.sliding_grasp import SlidingHook, sliding_hooks
from momapos.planning.task_setup import PreparedTask, prepare

TURNING = PipelineConfig()
CONFIG = PipelineConfig(motion=MotionConfig(grasps=GraspConfig(turning=False)))
BASE = np.array([0.300476, -1.502722, -3.024759])
"""From here no hook opens the fridge completely without a slide."""


@pytest.fixture(scope="module")
def robot(segway: Robot) -> Robot:
    return replace(segway, grips=Grip.HOOK)


def ready(scene: Scene, robot: Robot, item: str, config: PipelineConfig = CONFIG) -> PreparedTask:
    task = make_task(scene, "open", item, "door_hinge")
    return prepare(scene, robot, task, config, clearance=0.0)


def slides_of(prepared: PreparedTask, config: PipelineConfig = CONFIG) -> list[SlidingHook]:
    return list(sliding_hooks(prepared, prepared.feasibility(config, 0), config))


@pytest.fixture(scope="module")
def fridge(kitchen: Scene, robot: Robot) -> PreparedTask:
    return ready(kitchen, robot, "fridge")


@pytest.fixture(scope="module")
def hook(fridge: PreparedTask) -> SlidingHook:
    (found,) = slides_of(fridge)
    return found


@pytest.fixture(scope="module")
def opened(hook: SlidingHook, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Motion:
    reach = load_reach_map(robot, tmp_path_factory.mktemp("maps"))
    scores = hook.mode_scorers[0](reach, BASE[None]).scores
    screened = hook.screen(BASE[None], scores, None)
    modes = np.flatnonzero(scores[0] > 0)
    return hook(BASE, screened[0], modes).motion


def members(motion: SlidingMotion, group: int) -> np.ndarray:
    row = motion.turning.groups[group]
    return np.asarray(row[row >= 0])


def test_grasps_of_one_group_differ_by_a_slide_along_the_bar(hook: SlidingHook) -> None:
    motion = hook.motion
    assert (motion.grasps.code == FAMILIES.index(Family.HOOK)).all()
    Ts = motion.Ts_world_tool[:, motion.grasp_step]
    for group in range(len(motion.turning.groups)):
        some = Ts[members(motion, group)]
        assert len(some) > 1
        np.testing.assert_allclose(some[:, :3, :3], some[:1, :3, :3].repeat(len(some), 0))
        apart = np.diff(some[:, :3, 3], axis=0)
        np.testing.assert_allclose(apart[:, :2], 0.0, atol=1e-3)  # the bar is vertical
        assert (np.abs(apart[:, 2]) > 0.05).all()


def test_the_door_rests_and_the_fingers_are_open_on_a_slide(
    hook: SlidingHook, fridge: PreparedTask
) -> None:
    motion = hook.motion
    ends = motion.waypoint_steps[motion.after]
    assert len(ends) == len(fridge.motion.waypoint_steps) - 3
    for end in ends:
        slide = np.arange(end - SLIDE_STATES, end + 1)
        assert np.ptp(motion.object_q[slide]) == 0.0
        assert motion.closed[slide].tolist() == [True, *[False] * (SLIDE_STATES - 1), True]
        assert motion.closes[slide].tolist() == motion.closed[slide].tolist()
    assert motion.closed.sum() == fridge.motion.closed.sum() + len(ends)
    moving = np.diff(motion.object_q) > 0
    assert moving.sum() == (np.diff(fridge.motion.object_q) > 0).sum()


def test_the_tool_moves_straight_between_grasps(hook: SlidingHook) -> None:
    motion = hook.motion
    one, other = members(motion, 0)[:2]
    grasps = np.full(len(motion.waypoint_steps), one)
    first = int(np.flatnonzero(motion.after)[3])
    grasps[first:] = other
    Ts = motion.tool_poses(grasps)
    end = int(motion.waypoint_steps[first])
    np.testing.assert_array_equal(
        Ts[: end - SLIDE_STATES + 1], motion.Ts_world_tool[one, : end - SLIDE_STATES + 1]
    )
    np.testing.assert_allclose(Ts[end:], motion.Ts_world_tool[other, end:], atol=1e-12)
    path = np.diff(Ts[end - SLIDE_STATES : end + 1, :3, 3], axis=0)
    np.testing.assert_allclose(path, path[:1].repeat(SLIDE_STATES, 0), atol=1e-12)


def test_a_hook_slides_and_turns(kitchen: Scene, robot: Robot) -> None:
    (hook,) = slides_of(ready(kitchen, robot, "fridge", TURNING), TURNING)
    motion = hook.motion
    lanes, row = motion.lanes
    assert row.tolist() == np.where(motion.after, 2, np.arange(len(row)) != 1).tolist()
    some = members(motion, 0)
    one = some[0]
    turned = some[(lanes[1, some] == lanes[1, one]) & (some != one)][-1]
    slid = some[(lanes[2, some] == lanes[2, turned]) & (some != turned)][0]
    first = int(np.flatnonzero(motion.after)[3])
    grasps = np.full(len(row), one)
    grasps[first - 1], grasps[first:] = turned, slid
    Ts = motion.tool_poses(grasps)
    begin, end = motion.waypoint_steps[[first - 1, first]]
    before = int(motion.waypoint_steps[first - 2])
    in_part = np.linalg.inv(Ts[:1]) @ Ts
    assert np.ptp(in_part[before : begin + 1, :3, :3], axis=0).max() > 0.1
    on_slide = Ts[begin : end + 1]
    np.testing.assert_allclose(
        on_slide[:, :3, :3], on_slide[:1, :3, :3].repeat(SLIDE_STATES + 1, 0)
    )
    assert np.linalg.norm(on_slide[-1, :3, 3] - on_slide[0, :3, 3]) > 0.05
    for step, grasp in ((before, one), (begin, turned), (end, slid)):
        np.testing.assert_allclose(Ts[step], motion.Ts_world_tool[grasp, step], atol=1e-9)


def test_a_motion_without_slides_has_one_hold(hook: SlidingHook, fridge: PreparedTask) -> None:
    motion, group = hook.motion, 0
    grasp = members(motion, group)[0]
    mode = len(motion.Ts_world_tool) + group
    steps, holds = motion.executed_steps(mode, motion.Ts_world_tool[grasp])
    np.testing.assert_array_equal(motion.object_q[steps], fridge.motion.object_q)
    last = len(steps) - 1 - motion.grasp_step
    assert [(hold.first, hold.last) for hold in holds] == [(0, last)]


def test_a_sliding_hook_opens_the_door_where_a_rigid_one_cannot(
    fridge: PreparedTask, robot: Robot, opened: Motion, tmp_path: Path
) -> None:
    reach = load_reach_map(robot, tmp_path)
    still = fridge.feasibility(CONFIG, 0).screen(
        BASE[None], fridge.mode_scorers[0](reach, BASE[None]).scores, None
    )
    assert still[0].q is None
    one, other = opened.holds
    assert one.turn_axis is None
    assert other.turn_axis is None
    assert "after a slide" in other.words
    assert np.ptp(opened.object_q[one.last : other.first + 1]) == 0.0
    held = opened.Ts_world_tool[[one.last, other.first], :3, 3]
    assert np.linalg.norm(held[1] - held[0]) > 0.05
    assert fridge.violation(BASE, opened) is None
    single = replace(one, last=other.last)
    wrong = fridge.violation(BASE, replace(opened, holds=(single,)))
    assert "grasp slips" in wrong


def test_the_check_of_one_base_pose_includes_slides(
    kitchen: Scene, robot: Robot, fridge: PreparedTask, tmp_path: Path
) -> None:
    reach = load_reach_map(robot, tmp_path)
    still = GraspConfig(turning=False, sliding=False, families=("hook",))
    for sliding in (True, False):
        config = PipelineConfig(motion=MotionConfig(grasps=replace(still, sliding=sliding)))
        attempt = check_base_pose(
            kitchen, robot, fridge.task, BASE, reach, how_far=False, config=config
        )
        assert (attempt.motion is not None) == sliding


def test_no_hook_opens_a_door_that_falls_and_one_slides_on_a_door_that_springs_bear(
    kitchen: Scene, robot: Robot, hook: SlidingHook
) -> None:
    weighed = {"oven": {"door_hinge": JointResistance(balanced=False)}}
    falling = ready(kitchen.with_resistance(weighed), robot, "oven")
    assert "no hook holds back a part that falls open" in falling.infeasible_reason
    assert not slides_of(falling)
    (oven,) = slides_of(ready(kitchen, robot, "oven"))
    assert rests(oven).max() > np.radians(60.0)
    assert rests(hook).max() > np.radians(80.0)


def rests(hook: SlidingHook) -> np.ndarray:
    """Return the joint values at which a hook can slide."""
    return hook.motion.object_q[hook.motion.waypoint_steps[hook.motion.after]]


def test_no_hook_slides_past_an_obstacle_at_the_bar(
    kitchen: Scene, robot: Robot, hook: SlidingHook
) -> None:
    free = hook.motion
    (crossed,) = slides_of(ready(with_crossbar(kitchen, free), robot, "fridge"))
    assert longest(free) == 3
    assert longest(crossed.motion) == 2


def longest(motion: SlidingMotion) -> int:
    return max(len(members(motion, g)) for g in range(len(motion.turning.groups)))


def with_crossbar(kitchen: Scene, motion: SlidingMotion) -> Scene:
    """Add a crossbar between two grasps of the bar."""
    fridge, handle = kitchen.object("fridge"), motion.handle
    door = fridge.model.urdf.links["door"]
    grip = handle.grip + 0.3 * handle.half_length * handle.long
    T = np.eye(4)
    T[:3, 3] = grip - 0.015 * handle.out
    post = Geometry("box", (0.16, 0.02, 0.02), T)
    links = dict(fridge.model.urdf.links)
    links["door"] = replace(door, collisions=(*door.collisions, post))
    changed = replace(fridge, model=Articulated(replace(fridge.model.urdf, links=links)))
    others = tuple(changed if o.name == "fridge" else o for o in kitchen.objects)
    return replace(kitchen, objects=others)


def test_hands_that_pinch_do_not_slide(kitchen: Scene, segway: Robot) -> None:
    prepared = ready(kitchen, segway, "fridge")
    assert (prepared.motion.grasps.code == FAMILIES.index(Family.PINCH)).all()
    assert not slides_of(prepared)
