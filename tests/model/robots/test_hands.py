"""Hands by forward kinematics: linkages, drivers without a shape, cups, and drawn fingers."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.urdf_parts import box, joint, link, mobile_manipulator

from momapos.apps.cli.main import main
from momapos.core.errors import RobotError
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Grip, Robot, load_robot
from momapos.planning.grasps.hand_boxes import empty_handed, hand_of

CRANK, FINGER = 0.06, 0.05
"""Lengths of a crank and of the finger on it [m]."""


def derived(folder: Path, text: str, **options: bool) -> tuple[Robot, str]:
    path = folder / "robot.urdf"
    path.write_text(text)
    from momapos.model.robots.derive import RobotSource

    made, found = write_robot(RobotSource(path, **options))
    return load_robot(made), "\n".join(found.assumptions)


def limit(lower: float, upper: float) -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="10" velocity="1"/>'


def linkage(driver: str = "", rods: bool = True) -> str:
    """Return the mobile manipulator with a parallel gripper of cranks, rods and fingers.

    The cranks stand 6 cm apart and straight ahead at zero, so the fingers are 6 cm less their
    thickness apart; they turn 0.4 rad inwards and 0.5 rad outwards. Rods in their middle end behind
    the fingers.

    Args:
        driver: Joint of the palm that all others follow, with a link without a shape; "" for none.
        rods: Whether there are rods.
    """
    parts = []
    if driver:
        parts += [
            link("driver_link"),
            joint(driver, "revolute", "palm", "driver_link", "0 0 0", "1 0 0", limit(-0.4, 0.5)),
        ]
    for side, sign in (("l", 1), ("r", -1)):
        leads = side == "l" and not driver
        leader = driver or "l_crank_joint"

        def follow(ratio: float, leader: str = leader, leads: bool = leads) -> str:
            return "" if leads else f'<mimic joint="{leader}" multiplier="{ratio}"/>'

        parts += [
            link(f"{side}_crank", box(CRANK, 0.006, 0.02), f"{CRANK / 2} 0 0"),
            joint(
                f"{side}_crank_joint", "revolute", "palm", f"{side}_crank", f"0.06 {sign * 0.03} 0",
                f"0 0 {sign}", limit(-0.4, 0.5) + follow(1.0),
            ),
            link(f"{side}_tip", box(FINGER, 0.01, 0.02), f"{FINGER / 2} 0 0"),
            joint(
                f"{side}_tip_joint", "revolute", f"{side}_crank", f"{side}_tip", f"{CRANK} 0 0",
                f"0 0 {sign}", limit(-0.6, 0.6) + f'<mimic joint="{leader}" multiplier="-1"/>',
            ),
        ]  # fmt: skip
        if rods:
            parts += [
                link(f"{side}_rod", box(CRANK, 0.006, 0.02), f"{CRANK / 2} 0 0"),
                joint(
                    f"{side}_rod_joint", "revolute", "palm", f"{side}_rod",
                    f"0.06 {sign * 0.012} 0", f"0 0 {sign}",
                    limit(-0.6, 0.6) + f'<mimic joint="{leader}"/>',
                ),
            ]  # fmt: skip
    text = mobile_manipulator(fingers=False, tool=False)
    return text.replace("</robot>", "".join(parts) + "</robot>")


@pytest.mark.parametrize("driver", ["", "finger_drive"])
@pytest.mark.parametrize("rods", [True, False])
def test_a_gripper_of_linkages_opens_as_far_as_its_fingers_part(
    tmp_path: Path, driver: str, rods: bool
) -> None:
    robot, said = derived(tmp_path, linkage(driver, rods))
    assert_allclose(robot.approach_axis, [1, 0, 0], atol=1e-6)
    assert_allclose(robot.closing_axis, [0, 1, 0], atol=1e-6)
    widest = 2 * (0.03 + CRANK * math.sin(0.5)) - 0.01
    assert robot.opening == pytest.approx(widest, abs=2e-3)
    leader = driver or "l_crank_joint"
    assert robot.model.rest[leader] == pytest.approx(0.5, abs=0.02)
    assert ("l_rod, r_rod are linkages" in said) == rods
    assert "a hand of" not in said
    assert hand_of(robot).closes


def bare(text: str) -> str:
    """Return the mobile manipulator without fingers, tool and names of a hand."""
    return text.replace('"palm"', '"plate"')


@pytest.mark.parametrize("axis", ["1 0 0", "-1 0 0", "0 1 0"])
def test_a_bare_flange_approaches_along_the_last_axis(tmp_path: Path, axis: str) -> None:
    text = bare(mobile_manipulator(fingers=False, tool=False))
    last = '<parent link="arm_4"/><child link="arm_5"/><origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>'
    assert last in text
    robot, said = derived(tmp_path, text.replace(last, last.replace('"1 0 0"', f'"{axis}"')))
    expected = np.abs(np.array(axis.split(), float))
    assert_allclose(np.abs(robot.approach_axis), expected, atol=1e-6)
    if expected[0]:
        assert robot.approach_axis[0] > 0, "the plate is ahead of the last joint"
    assert "the axis of the arm's last joint" in said
    assert robot.approach_axis @ robot.closing_axis == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("rpy", ["0 0 0", "0 1.5707963 0"])
def test_a_frame_in_the_face_of_the_flange_has_the_arm_behind_it(tmp_path: Path, rpy: str) -> None:
    """The last link's shape lies behind its joint, as a UR's wrist does."""
    text = bare(mobile_manipulator(fingers=False, tool=False))
    changes = {
        link("arm_5", box(0.1 - 0.04, 0.06, 0.06), "0.05 0 0"):
            link("arm_5", box(0.06, 0.06, 0.06), "-0.03 0 0"),
        link("plate", box(0.06, 0.12, 0.05), "0.03 0 0"): link("plate"),
        '<origin xyz="0.1 0 0"/></joint>': f'<origin xyz="0 0 0" rpy="{rpy}"/></joint>',
    }  # fmt: skip
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    robot, _ = derived(tmp_path, text)
    ahead = robot.model.rest_poses[robot.tool_link][:3, :3] @ robot.approach_axis
    assert_allclose(ahead, [1, 0, 0], atol=1e-6)


def test_a_turned_flange_frame_does_not_turn_the_approach(tmp_path: Path) -> None:
    text = bare(mobile_manipulator(fingers=False, tool=False))
    mount = '<origin xyz="0.1 0 0"/></joint>'
    assert text.count(mount) == 1
    turned = text.replace(mount, '<origin xyz="0.1 0 0" rpy="0 1.5707963 0"/></joint>')
    robot, _ = derived(tmp_path, turned)
    assert_allclose(robot.approach_axis, [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize("name", ["suction_cup", "vacuum_foot"])
def test_a_cup_holds_by_suction_at_its_rim(tmp_path: Path, name: str) -> None:
    cup = link(name, '<cylinder radius="0.02" length="0.04"/>', "0.02 0 0", "0 1.5707963 0")
    text = mobile_manipulator(fingers=False, tool=False)
    more = cup + joint("cup_mount", "fixed", "palm", name, "0.06 0 0")
    robot, _ = derived(tmp_path, text.replace("</robot>", more + "</robot>"))
    assert robot.grips is Grip.SUCTION
    assert name in robot.gripper_links
    T = robot.model.rest_poses
    rim = np.linalg.inv(T[name]) @ T[robot.tool_link]
    assert_allclose(rim[:3, 3], [0.04, 0, 0], atol=1e-3)
    assert empty_handed(robot) == ""
    assert robot.finger_depth == pytest.approx(0.0, abs=1e-3)


def drawn_fingers() -> str:
    """Return the mobile manipulator with fingers that have visual shapes only."""
    return re.sub(
        r'(<link name="\w+_finger">)<collision>(.*?)</collision>', r"\1<visual>\2</visual>",
        mobile_manipulator(),
    )  # fmt: skip


def test_drawn_fingers_are_offered_their_hulls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(drawn_fingers())
    assert main(["robot", "check", str(path)]) == 0
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("FAILED: gripper")
    assert second.startswith("IMPORTANT: grips")
    assert "(left_finger, right_finger) are only drawn: with --visual-hulls" in second
    path.with_suffix(".toml").unlink()
    assert main(["robot", "check", str(path), "--visual-hulls"]) == 0
    robot = load_robot(path.with_suffix(".toml"))
    assert robot.opening == pytest.approx(0.09)
    assert empty_handed(robot) == ""
    assert "visual_hulls = true" in path.with_suffix(".toml").read_text()


def test_hulls_of_drawings_count_only_for_bodies_without_collision_shapes(tmp_path: Path) -> None:
    big = '<visual><geometry><box size="3 3 3"/></geometry></visual>'
    text = drawn_fingers().replace('<link name="palm">', f'<link name="palm">{big}')
    text = text.replace('<link name="tcp"/>', f'<link name="tcp">{big}</link>')
    robot, _ = derived(tmp_path, text, visual_hulls=True)
    assert len(robot.model.hulls["palm"]) == 1
    assert not robot.model.hulls["tcp"], "the palm, which carries it, has a collision shape"
    assert robot.model.hulls["left_finger"]


def test_visual_hulls_is_true_or_false(tmp_path: Path) -> None:
    robot, _ = derived(tmp_path, mobile_manipulator())
    text = robot.path.read_text()
    robot.path.write_text(text.replace("version = 1", 'version = 1\nvisual_hulls = "yes"'))
    with pytest.raises(RobotError, match="visual_hulls must be true or false"):
        load_robot(robot.path)


@pytest.mark.parametrize("yaw", [0.0, 0.7, math.pi / 3, math.pi / 2])
@pytest.mark.parametrize("length", [0.05, 0.06])
def test_the_tool_frame_does_not_depend_on_how_the_arm_is_mounted(
    tmp_path: Path, yaw: float, length: float
) -> None:
    """Fingers of 6 cm at a palm of 4 cm end exactly where a tool link no longer counts."""
    text = mobile_manipulator(tool=False).replace('"0.06 0.01 0.02"', f'"{length} 0.01 0.02"')
    text = text.replace('"0.03 0.005 0"', f'"{length / 2} 0.005 0"')
    text = text.replace('"0.03 -0.005 0"', f'"{length / 2} -0.005 0"')
    text = text.replace('xyz="0.06 0 0"', 'xyz="0.04 0 0"')
    text = text.replace('xyz="0.15 0 0.5"', f'xyz="0.15 0 0.5" rpy="0 0 {yaw}"')
    robot, _ = derived(tmp_path, text)
    assert robot.tool_link == ("palm" if length < 0.06 else "grasp_frame")


@pytest.mark.parametrize("name", ["jaco_link_hand", "gripper_base"])
def test_a_wrist_that_is_named_like_a_hand_is_a_joint_of_the_arm(tmp_path: Path, name: str) -> None:
    robot, _ = derived(tmp_path, mobile_manipulator().replace('"arm_5"', f'"{name}"'))
    assert robot.arm_joints == ("lift", *(f"j{k}" for k in range(6)))
    assert {"left_finger", "right_finger"} <= set(robot.gripper_links)
    assert_allclose(robot.closing_axis, [0, 1, 0], atol=1e-6)
