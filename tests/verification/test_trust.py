"""Times within the limits of the robot's file, and what a verification trusts."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from door_case import Case, make_case

from momapos.model.records.plans import Motion
from momapos.model.robots.robot import Robot
from momapos.verification.path_checks import time_checks
from momapos.verification.plan_check import verify_files
from momapos.verification.report import DEFAULT, Report
from momapos.verification.robot_collision_model import robot_collision_model

SPEED = 1.0
"""Speed limit of every joint of the toy arm [rad/s]."""


def timed(speed: float, acceleration: float | None = None) -> Case:
    """Return a plan whose joints move at a speed at most [rad/s]."""
    case = make_case()
    for phase, q in (
        ("approach_times", case.plan["approach"]),
        ("times", case.plan["manipulation"]["q"]),
    ):
        steps = np.abs(np.diff(q, axis=0)).max(1)
        times = np.append(0.0, np.cumsum(steps / speed)).tolist()
        (case.plan if phase == "approach_times" else case.plan["manipulation"])[phase] = times
    if acceleration is not None:
        limit = f'velocity="1" acceleration="{acceleration}"'
        case.robot = case.robot.replace('velocity="1"', limit)
    return case


def verified(case: Case, folder: Path) -> Report:
    return verify_files(case.write(folder))


def failed(report: Report) -> list[str]:
    return [check.name for check in report.violations]


def test_times_within_the_speed_limits_pass(tmp_path: Path) -> None:
    assert failed(verified(timed(0.99 * SPEED), tmp_path)) == []


@pytest.mark.parametrize("factor", [1.05, 3.0, 1e3])
def test_times_faster_than_a_joint_may_move_are_a_violation(tmp_path: Path, factor: float) -> None:
    report = verified(timed(factor * SPEED), tmp_path)
    (check,) = report.violations
    assert check.name == "joint speed by the plan's times"
    assert check.value == pytest.approx(100 * factor)
    assert check.culprit in ("pan", "lift", "elbow", "roll", "pitch", "twist")


def test_a_motion_in_no_time_is_a_violation(tmp_path: Path) -> None:
    case = timed(0.5)
    times = case.plan["manipulation"]["times"]
    times[7] = times[6]
    assert failed(verified(case, tmp_path)) == ["joint speed by the plan's times"]


def test_a_rest_in_the_times_is_none(tmp_path: Path) -> None:
    case = timed(0.5)
    case.plan["manipulation"]["times"] = [0.0] * len(case.plan["manipulation"]["q"])
    case.plan["manipulation"]["times"][1:] = (np.arange(1, 41) * 10.0).tolist()
    assert failed(verified(case, tmp_path)) == []


@pytest.mark.parametrize(("limit", "fails"), [(0.5, True), (1000.0, False)])
def test_starting_faster_than_the_acceleration_limit_is_a_violation(
    tmp_path: Path, limit: float, fails: bool
) -> None:
    found = failed(verified(timed(0.9 * SPEED, limit), tmp_path))
    assert found == (["joint acceleration by the plan's times"] if fails else [])


@pytest.mark.parametrize("phase", ["approach", "manipulation"])
@pytest.mark.parametrize("seed", range(3))
def test_a_constant_acceleration_is_found_at_any_times(
    robots: Callable[[str], Robot], phase: str, seed: int
) -> None:
    """Joints speed up and slow down for 1 s each, from rest to rest; one limit is unknown."""
    rng = np.random.default_rng(seed)
    model = robot_collision_model(robots("segway_ur5e"))
    count = len(model.joints)
    acceleration = rng.uniform(0.5, 2.0, count) * rng.choice([-1.0, 1.0], count)
    limit = rng.uniform(0.5, 2.0, count)
    limit[seed] = np.inf
    share = np.abs(acceleration) / limit
    half = np.sort(rng.uniform(0.0, 1.0, 9))
    times = np.concatenate([[0.0], half, [1.0], 1.0 + half, [2.0]])
    travel = np.where(times < 1.0, times**2 / 2, 1.0 - (2.0 - times) ** 2 / 2)
    fast, slow = np.outer(travel, acceleration), np.outer(travel, acceleration / 3)
    first, second = (fast, slow) if phase == "approach" else (slow, fast)
    Ts = np.tile(np.eye(4), (len(times), 1, 1))
    motion = Motion(first, second, np.zeros(len(times)), Ts, times, times)
    robot = replace(model, acceleration=limit, speed=np.full(count, 4.0))
    speed, change = time_checks(robot, motion, DEFAULT)
    assert change.value == pytest.approx(100 * share.max())
    assert change.culprit == model.joints[share.argmax()]
    assert change.ok == (share.max() <= DEFAULT.speed)
    means = np.abs(np.diff(travel) / np.diff(times)).max() * np.abs(acceleration)
    assert speed.value == pytest.approx(100 * means.max() / 4.0)
    assert speed.culprit == model.joints[means.argmax()]
    untimed = replace(motion, approach_times=None, times=None)
    assert list(time_checks(robot, untimed, DEFAULT)) == []


def test_pairs_that_an_srdf_disables_are_named(tmp_path: Path) -> None:
    srdf = (
        '<robot name="toy"><disable_collisions link1="palm" link2="base" reason="Never"/>'
        '<disable_collisions link1="upper" link2="fore" reason="Adjacent"/></robot>'
    )
    make_case().write(tmp_path)
    (tmp_path / "robot.srdf").write_text(srdf)
    (note,) = (n for n in verify_files(tmp_path / "plan.json").notes if "trusts" in n)
    # Neighbors are never checked, so disabling them trusts nothing.
    assert re.search(r"robot\.srdf: it disables .* of 1 of \d+ pairs of links \(base-palm\)", note)


def test_an_srdf_that_the_plan_itself_names_is_named(tmp_path: Path) -> None:
    links = ("base", "shoulder", "upper", "fore", "knuckle", "palm", "left", "right")
    pairs = [f'<disable_collisions link1="{a}" link2="{b}"/>' for a in links for b in links]
    case = make_case()
    case.plan["robot"]["srdf"] = "all.srdf"
    path = case.write(tmp_path)
    (tmp_path / "all.srdf").write_text(f'<robot name="toy">{"".join(pairs)}</robot>')
    (note,) = (n for n in verify_files(path).notes if "trusts" in n)
    count = re.search(r"all\.srdf.* of (\d+) of (\d+) pairs .* and \d+ more", note)
    assert count is not None
    assert count[1] == count[2]


def test_without_an_srdf_nothing_is_trusted(tmp_path: Path) -> None:
    assert not [note for note in verified(make_case(), tmp_path).notes if "trust" in note]


def test_objects_and_robots_without_shapes_are_named(tmp_path: Path) -> None:
    case = make_case()
    (tmp_path / "ghost.urdf").write_text('<robot name="ghost"><link name="body"/></robot>')
    pose = {"xyz": [1.0, 2.0, 0.0], "wxyz": [1.0, 0.0, 0.0, 0.0]}
    case.scene["objects"].append({"name": "curtain", "urdf": "ghost.urdf", "pose": pose})
    bare = re.sub(r'(<link name="base">)<collision>.*?</collision>', r"\1", case.robot)
    case.robot = bare
    notes = verified(case, tmp_path).notes
    assert "without collision shapes, so not checked: curtain" in notes
    assert "the base of the robot has no collision shapes: nothing of it is checked" in notes
