"""Test hands that turn about a bar or a knob."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.core.geometry.transforms import invert, rotation_about, rotation_angle
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.motion_record import MIN_GROUP
from momapos.planning.grasps.task_motions import TaskMotion, task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.task_setup import PreparedTask, prepare

CONFIG = PipelineConfig()
BASE = np.array([0.458, -1.39, 2.532])
"""From here no rigid grasp opens the fridge completely."""


def with_round_bars(item: SceneObject) -> SceneObject:
    """Replace square bar handles along z by cylinders."""
    links = {}
    for name, link in item.model.urdf.links.items():
        shapes = tuple(
            replace(s, kind="cylinder", size=(s.size[0] / 2, s.size[2]))
            if "handle" in name and s.size[0] == s.size[1]
            else s
            for s in link.collisions
        )
        links[name] = replace(link, collisions=shapes, visuals=shapes)
    return replace(item, model=Articulated(replace(item.model.urdf, links=links)))


@pytest.fixture(scope="module")
def fridge(segway: Robot, kitchen: Scene) -> PreparedTask:
    objects = [with_round_bars(o) if o.name == "fridge" else o for o in kitchen.objects]
    scene = replace(kitchen, objects=tuple(objects))
    task = make_task(scene, "open", "fridge", "door_hinge")
    return prepare(scene, segway, task, CONFIG, clearance=0.0)


def in_part(motion: TaskMotion, Ts: np.ndarray) -> np.ndarray:
    """Return tool poses in the door frame, given by the first grasp."""
    T_part_tool = np.eye(4)
    T_part_tool[:3, :3] = motion.turning.R_part_tool[0]
    rigid = motion.Ts_world_tool[0, motion.grasp_step :]
    return np.asarray(T_part_tool @ invert(rigid) @ Ts[motion.grasp_step :])


def test_grasps_of_one_group_differ_by_a_turn_about_the_bar(fridge: PreparedTask) -> None:
    turning = fridge.motion.turning
    assert len(turning.groups)
    for group in turning.groups:
        members = group[group >= 0]
        R = turning.R_part_tool[members]
        turns = turning.angles[members] - turning.angles[members[0]]
        np.testing.assert_allclose(rotation_angle(R[:1], R), np.abs(turns), atol=1e-6)
        held = fridge.motion.Ts_world_tool[members, fridge.motion.grasp_step, :3, 3]
        assert np.ptp(held, axis=0).max() < 1e-9


def test_a_turning_hand_keeps_its_position_on_the_bar(fridge: PreparedTask) -> None:
    motion = fridge.motion
    group = motion.turning.groups[0]
    members = group[group >= 0]
    grasps = np.full(len(motion.waypoint_steps), members[0])
    grasps[-4:] = members[1]
    turned = in_part(motion, motion.tool_poses(grasps))
    np.testing.assert_allclose(
        turned[:, :3, 3], turned[:1, :3, 3].repeat(len(turned), 0), atol=1e-9
    )
    R = turned[:, :3, :3] @ turned[0, :3, :3].T
    # A rotation about the axis leaves the axis unchanged.
    np.testing.assert_allclose(
        R @ motion.turning.axis, motion.turning.axis[None].repeat(len(R), 0), atol=1e-9
    )
    change = float(rotation_angle(turned[0, :3, :3], turned[-1, :3, :3]))
    assert change == pytest.approx(abs(np.diff(motion.turning.angles[members[:2]])[0]))


def test_single_grasps_are_rigid(fridge: PreparedTask) -> None:
    motion = fridge.motion
    grasps = np.full(len(motion.waypoint_steps), 5)
    np.testing.assert_array_equal(motion.tool_poses(grasps), motion.Ts_world_tool[5])


def test_groups_lose_dropped_grasps(fridge: PreparedTask) -> None:
    motion = fridge.motion
    kept = np.ones(len(motion.Ts_world_tool), bool)
    group = motion.turning.groups[0]
    members = group[group >= 0]
    kept[members[MIN_GROUP - 1 :]] = False
    left = motion.only(kept)
    assert len(left.turning.groups) == len(motion.turning.groups) - 1
    old = np.flatnonzero(kept)
    for row in left.turning.groups:
        same = [g for g in motion.turning.groups if np.isin(old[row[row >= 0]], g).all()]
        assert len(same) == 1


def test_a_turning_hand_opens_the_door_where_a_rigid_one_cannot(
    fridge: PreparedTask, segway: Robot, tmp_path: Path
) -> None:
    reach = load_reach_map(segway, tmp_path)
    feasible = fridge.feasibility(CONFIG, seed=0)
    poses = BASE[None]
    rigid = feasible.screen(poses, fridge.mode_scorers[0](reach, poses).scores, None)
    turning = feasible.screen(poses, fridge.mode_scorers[1](reach, poses).scores, None)
    assert rigid[0].q is None
    assert turning[0].q is not None
    found = feasible(BASE, turning[0], np.array([turning[0].grasp])).motion
    assert found.holds[0].turn_axis is not None
    assert fridge.violation(BASE, found) is None
    assert "rotation" in (fridge.violation(BASE, replace(found, holds=())) or "")


def knob_drawer(folder: Path, shape: str) -> Scene:
    """Return a drawer with a knob."""
    (folder / "drawer.urdf").write_text(
        '<robot name="drawer"><link name="body"/><link name="front"><collision>'
        '<origin xyz="0 0 0.7"/><geometry><box size="0.02 0.5 0.2"/></geometry></collision></link>'
        '<link name="handle"><collision><origin xyz="0 0 0" rpy="0 1.5707963 0"/>'
        f'<geometry>{shape}</geometry></collision></link><joint name="post" type="fixed">'
        '<parent link="front"/><child link="handle"/><origin xyz="-0.045 0 0.7"/></joint>'
        '<joint name="slide" type="prismatic"><parent link="body"/><child link="front"/>'
        '<axis xyz="-1 0 0"/><limit lower="0" upper="0.3" effort="1" velocity="1"/></joint></robot>'
    )
    item = SceneObject.from_urdf("drawer", folder / "drawer.urdf", (0.0, 0.0, 0.0))
    floor = np.array([[-3.0, -2.0], [0.5, -2.0], [0.5, 2.0], [-3.0, 2.0]])
    return Scene("knob", (item,), floor_polygon=floor)


ROUND_KNOB = '<cylinder radius="0.015" length="0.02"/>'


def test_a_short_arm_turns_about_a_round_knob(tmp_path: Path, stretch: Robot) -> None:
    scene = knob_drawer(tmp_path, ROUND_KNOB)
    task = make_task(scene, "open", "drawer")
    plan = plan_base_placement(scene, stretch, task).plan
    assert plan.status == "solved"
    (hold,) = plan.motion.holds
    np.testing.assert_allclose(np.abs(hold.turn_axis), [1, 0, 0], atol=1e-9)
    assert hold.words.endswith(", the hand turning about it")


def test_only_short_arms_turn_about_knobs_and_only_about_round_ones(
    segway: Robot, tmp_path: Path, stretch: Robot
) -> None:
    for name, shape, arm, turns in (
        ("round", ROUND_KNOB, stretch, True),
        ("square", '<box size="0.03 0.03 0.02"/>', stretch, False),
        ("full", ROUND_KNOB, segway, False),
    ):
        (tmp_path / name).mkdir()
        scene = knob_drawer(tmp_path / name, shape)
        motion = task_motion(scene, arm, make_task(scene, "open", "drawer"), MotionConfig())
        assert not motion.refusal
        assert motion.handle.knob
        assert bool(len(motion.turning.groups)) is turns, name


def test_grasps_of_one_knob_group_differ_by_a_turn_about_its_axis(
    tmp_path: Path, stretch: Robot
) -> None:
    scene = knob_drawer(tmp_path, ROUND_KNOB)
    motion = task_motion(scene, stretch, make_task(scene, "open", "drawer"), MotionConfig())
    turning = motion.turning
    np.testing.assert_allclose(turning.axis, [-1, 0, 0], atol=1e-6)
    for group in turning.groups:
        members = group[group >= 0]
        R, angles = turning.R_part_tool[members], turning.angles[members]
        for k, turn in enumerate(angles - angles[0]):
            np.testing.assert_allclose(rotation_about(turning.axis, turn) @ R[0], R[k], atol=1e-6)
        held = motion.Ts_world_tool[members, motion.grasp_step, :3, 3]
        assert np.ptp(held, axis=0).max() < 1e-9
