"""Limits of a URDF and of a robot file are in force in planning and in trajectories."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.urdf_parts import mobile_manipulator

from momapos.core.errors import MomaposError
from momapos.model.records.plans import Motion
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.trajectory import DEFAULT, time_motion

JOINTS = 7


def robot_of(folder: Path, urdf: str, more: str = "") -> Robot:
    path = folder / "robot.urdf"
    path.write_text(urdf)
    made, _ = write_robot(path)
    made.write_text(made.read_text() + more)
    return load_robot(made)


def limited(attribute: str) -> str:
    return mobile_manipulator().replace('lower="-2.5"', f'{attribute} lower="-2.5"')


def motion_of(robot: Robot) -> Motion:
    begin = np.clip(np.zeros(JOINTS), robot.chain.lower, robot.chain.upper)
    end = np.clip(np.full(JOINTS, 0.2), robot.chain.lower, robot.chain.upper)
    q = begin + np.linspace(0.0, 1.0, 40)[:, None] * (end - begin)
    return Motion(q, q, np.linspace(0.0, 1.0, 40), robot.chain.tool_poses(q))


@pytest.mark.parametrize(
    ("attribute", "more", "limit"),
    [
        ("", "", DEFAULT.acceleration),
        ('acceleration="0.5"', "", 0.5),
        ('acceleration="9" deceleration="0.3"', "", 0.3),
        ('acceleration="9"', "", DEFAULT.acceleration),
        ("", "\n[limits]\nj3 = { acceleration = 0.4 }\n", 0.4),
        ('acceleration="0.5"', "\n[limits]\nj3 = { acceleration = 0.2 }\n", 0.2),
    ],
)
def test_trajectories_keep_the_acceleration_limits(
    tmp_path: Path, attribute: str, more: str, limit: float
) -> None:
    robot = robot_of(tmp_path, limited(attribute), more)
    for timed in time_motion(robot, motion_of(robot), DEFAULT, 0.01):
        column = list(robot.moved_joints).index("j3")
        assert np.abs(timed.a[:, column]).max() <= 1.001 * limit
    approach = time_motion(robot, motion_of(robot), DEFAULT, 0.01)[0]
    assert np.abs(approach.a).max() > 0.9 * min(limit, DEFAULT.slide_acceleration)


@pytest.mark.parametrize("jerk", [0.05, 0.5])
def test_trajectories_keep_the_jerk_limits(tmp_path: Path, jerk: float) -> None:
    robot, step = robot_of(tmp_path, limited(f'jerk="{jerk}"')), 0.002
    column = list(robot.moved_joints).index("j3")
    (tmp_path / "free").mkdir()
    free = robot_of(tmp_path / "free", mobile_manipulator())
    both = (time_motion(one, motion_of(one), DEFAULT, step) for one in (robot, free))
    for timed, sooner in zip(*both, strict=True):
        assert (np.abs(np.diff(timed.a[:, column])) / step).max() <= 1.05 * jerk
        assert len(timed) > len(sooner)


@pytest.mark.parametrize(
    ("urdf", "more", "limits"),
    [
        (mobile_manipulator(), "", (-2.5, 2.5)),
        (
            mobile_manipulator().replace(
                "</joint>", '<safety_controller k_velocity="1" soft_lower_limit="-0.6" '
                'soft_upper_limit="0.6"/></joint>'
            ), "", (-0.6, 0.6),
        ),
        (mobile_manipulator(), "\n[limits]\nj3 = { lower = -0.7, upper = 0.5 }\n", (-0.7, 0.5)),
    ],
)  # fmt: skip
def test_the_arm_moves_within_its_narrowest_limits(
    tmp_path: Path, urdf: str, more: str, limits: tuple[float, float]
) -> None:
    robot = robot_of(tmp_path, urdf, "")
    robot.path.write_text(robot.path.read_text().replace(str(robot.home[4]), "0.1") + more)
    robot = load_robot(robot.path)
    at = robot.chain.names.index("j3")
    assert (robot.chain.lower[at], robot.chain.upper[at]) == limits
    assert (robot.model.joint("j3").lower, robot.model.joint("j3").upper) == limits


def test_a_robot_file_corrects_an_effort(tmp_path: Path) -> None:
    robot = robot_of(tmp_path, mobile_manipulator(), "\n[limits]\nj3 = { effort = 40.0 }\n")
    assert [robot.model.joint(name).effort for name in ("j2", "j3")] == [1.0, 40.0]
    assert robot.model.joint("j3").upper == 2.5


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("\n[limits]\nj9 = { lower = 0.0 }\n", "j9"),
        ("\n[limits]\nj3 = { speed = 1.0 }\n", "limits.j3.speed is not known"),
        ("\n[limits]\nj3 = { velocity = -1.0 }\n", "velocity must be a number > 0"),
        ("\n[limits]\nj3 = { effort = 0.0 }\n", "effort must be a number > 0"),
        ("\n[limits]\nj3 = { lower = 3.0 }\n", "lower limit 3 above upper limit"),
    ],
)
def test_invalid_limits_are_refused_in_one_line(tmp_path: Path, more: str, words: str) -> None:
    with pytest.raises(MomaposError, match=words) as caught:
        robot_of(tmp_path, mobile_manipulator(), more)
    assert "\n" not in str(caught.value)
