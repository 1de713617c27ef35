"""Library robots open a drawer in physics, and rotating fingertips face each other."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.model.robots.test_fingers import STRONG, derived, sliding, with_fingers
from tests.urdf_parts import box, joint, link

from momapos.core.geometry.transforms import apply, invert, rotation_of
from momapos.model.robots.hand_openings import pivots
from momapos.model.robots.robot import load_robot
from momapos.model.robots.robot_names import library_file
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import by_arm_length
from momapos.simulation.config import ExecutionConfig
from momapos.simulation.robot_dynamics import find_hand, read_dynamics
from momapos.simulation.simulated_robot import body_of
from momapos.simulation.simulated_room import PartResistance
from momapos.simulation.simulation import build_simulation
from momapos.workflows.run import run_plan

LENGTH, TIP = 0.12, 0.03
"""Length of rotating fingers, and distance from their ends to the centers of their tips [m]."""


def leaning(lean: float) -> str:
    """Return the URDF of rotating fingers with tips that lean against them."""
    parts = []
    for side, sign in (("left", 1), ("right", -1)):
        name = f"{side}_finger"
        parts += [
            link(name, box(LENGTH, 0.01, 0.02), f"{LENGTH / 2} 0 0"),
            joint(
                f"{name}_joint", "revolute", "palm", name, f"0.06 {0.02 * sign} 0",
                f"0 0 {sign}", STRONG.format(-0.1, 0.4, 10),
            ),
            link(f"{side}_tip", box(0.06, 0.012, 0.02), rpy=f"0 0 {lean * sign}"),
            joint(f"{side}_tip_joint", "fixed", name, f"{side}_tip", f"{LENGTH + TIP} 0 0"),
        ]  # fmt: skip
    return with_fingers(*parts)


@pytest.mark.parametrize(
    ("name", "arm", "to"),
    [
        pytest.param("hsr", None, 0.3, marks=pytest.mark.slow),  # its arm cannot pull 40 cm
        pytest.param("mobile_panda", None, None, marks=pytest.mark.slow),
        ("stretch", None, None),
        pytest.param("tiago", None, None, marks=pytest.mark.slow),
        pytest.param("tiago_dual", "left", None, marks=pytest.mark.slow),
        pytest.param("tiago_dual", "right", None, marks=pytest.mark.slow),
    ],
)
def test_a_library_robot_opens_a_drawer_in_physics(
    name: str, arm: str | None, to: float | None, kitchen: Scene
) -> None:
    robot = load_robot(name, arm=arm)
    task = make_task(kitchen, "open", "cabinet_left", "drawer_slide", to)
    reach = by_arm_length(robot, "none is needed for one drawer")
    plan = plan_base_placement(kitchen, robot, task, reach).plan
    assert plan.status == "solved"
    record = run_plan(plan, kitchen, robot, reach, tries=1)
    assert record.success, record.execution and record.execution.reason


def test_a_robot_with_one_moving_jaw_opens_a_drawer_in_physics(
    tmp_path: Path, kitchen: Scene
) -> None:
    folder = tmp_path / "one_jaw"
    shutil.copytree(library_file("fetch").parent, folder, ignore=shutil.ignore_patterns("*.reach"))
    urdf, file = folder / "fetch.urdf", folder / "fetch.toml"
    text = urdf.read_text()
    stays = text.index('name="r_gripper_finger_joint"')
    text = text[:stays] + text[stays:].replace("prismatic", "fixed", 1)
    moves = text.index('name="l_gripper_finger_joint"')
    urdf.write_text(text[:moves] + text[moves:].replace('upper="0.05"', 'upper="0.1"', 1))
    file.write_text(file.read_text().replace('name = "fetch"', 'name = "one_jaw"'))
    robot = load_robot(file)
    hand = find_hand(robot, {})
    assert [finger.joint for finger in hand.fingers] == ["l_gripper_finger_joint"]
    assert hand.pads == {"l_gripper_finger_link": -1.0, "r_gripper_finger_link": 1.0}
    task = make_task(kitchen, "open", "cabinet_left", "drawer_slide")
    reach = by_arm_length(robot, "none is needed for one drawer")
    plan = plan_base_placement(kitchen, robot, task, reach).plan
    assert plan.status == "solved"
    record = run_plan(plan, kitchen, robot, reach, tries=1)
    assert record.success, record.execution and record.execution.reason


@pytest.mark.parametrize("text", [leaning(0.35), leaning(-0.25), sliding("0.3")])
def test_leaning_tips_face_each_other_at_every_finger_position(tmp_path: Path, text: str) -> None:
    robot = derived(tmp_path, text)
    found = pivots(robot)
    assert {pivot.link for pivot in found} == {"left_tip", "right_tip"}
    for share in (0.0, 0.4, 1.0):
        for pivot in found:
            record = robot.model.joint(pivot.joint)
            value = record.lower + share * (record.upper - record.lower)
            poses = robot.model.link_poses({pivot.joint: value})
            R = (invert(poses[robot.tool_link]) @ poses[pivot.link])[:3, :3]
            R = R @ rotation_of(pivot.axis * (pivot.ratio * value + pivot.offset))
            R = R @ robot.model.boxes[pivot.link][0].rotation[0]
            assert_allclose(np.abs(R.T @ robot.closing_axis).max(), 1.0, atol=1e-6)


def test_fingers_with_parallel_tips_have_no_pivot(tmp_path: Path) -> None:
    assert pivots(derived(tmp_path, sliding("0"))) == ()


def test_the_grip_force_of_a_finger_acts_at_its_tip(tmp_path: Path) -> None:
    """The center of the finger would be closer to its hinge."""
    robot = derived(tmp_path, leaning(0.3))
    for finger in find_hand(robot, {}).fingers:
        assert finger.lever == pytest.approx(LENGTH + TIP, rel=0.06)


def test_tips_stay_parallel_while_fingers_close_on_an_object(
    tmp_path: Path, kitchen: Scene
) -> None:
    """Without pivots they lean by 0.35 rad and push the object out of the hand."""
    robot = derived(tmp_path, leaning(0.35))
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    dynamics = read_dynamics(robot.model.urdf.path)  # type: ignore[arg-type]
    hand = find_hand(robot, dynamics.mimics)
    world = build_simulation(
        kitchen, robot, (1.9, -1.6, 1.5), robot.home[None], task, hand, dynamics,
        PartResistance(mass=5.0, friction=0.1, damping=0.1, pull=0.0), None, ExecutionConfig(),
    )  # fmt: skip
    for finger, motor in world.fingers:
        world.data.ctrl[motor] = finger.closed
    mujoco.mj_step(world.model, world.data, nstep=500)
    tips = [world.model.body(body_of(f"{side}_tip")).id for side in ("left", "right")]
    T = invert(world.T_world_tool)
    for tip, pivot in zip(tips, hand.pivots, strict=True):
        R = T[:3, :3] @ world.data.xmat[tip].reshape(3, 3)
        faces = (R @ robot.model.boxes[pivot.link][0].rotation[0]).T @ robot.closing_axis
        assert np.abs(faces).max() > np.cos(np.radians(3.0))
    gap = [float(apply(T, world.data.xpos[tip][None])[0] @ robot.closing_axis) for tip in tips]
    assert gap[0] - gap[1] < 0.02, "the tips, each 12 mm thick, touch"
