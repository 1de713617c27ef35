"""The exact check of plans whose base moves: base, arm and part on one clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from door_case import BASE, Case, make_case
from independent_check import HAND_CHECKS, INDEPENDENT_NAMES, independent_verdicts
from moving_case import moving_case, stops_case

from momapos.core.errors import FileFormatError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.plan_files.plan_format import plan_to_dict, read_plan, write_plan
from momapos.model.robots.robot import Robot
from momapos.verification.motion_loads import robot_efforts
from momapos.verification.plan_check import verify_files
from momapos.verification.report import Report
from momapos.verification.robot_collision_model import robot_collision_model

NAMES = INDEPENDENT_NAMES | {
    "base turns tighter than its drive can": "base turns tighter than it can",
    "base_pose is the first base pose of the manipulation": (
        "base_pose is the first base of the manipulation"
    ),
    "holds are ordered state ranges with unit axes": "holds are ranges of states in order",
}
VALID: dict[str, Callable[[], Case]] = {
    "differential": moving_case,
    "hand and base come to the handle together": lambda: moving_case(lead_in=8),
    "omni, sideways": lambda: moving_case("omni", sideways=0.1),
    "wide enough for the car": lambda: car(0.6),
    "two stops": stops_case,
}
BROKEN: dict[str, tuple[Callable[[], Case], str]] = {}


def car(radius: float) -> Case:
    """Return the case of a car; the base's arc has a radius of 0.67 m."""
    case = moving_case("car")
    case.plan["robot"]["min_turning_radius"] = radius
    return case


def broken(check: str) -> Callable[[Callable[[], Case]], Callable[[], Case]]:
    """Register a case that the named check rejects."""

    def register(make: Callable[[], Case]) -> Callable[[], Case]:
        BROKEN[make.__name__] = (make, check)
        return make

    return register


def manipulation(case: Case) -> dict[str, Any]:
    found: dict[str, Any] = case.plan["manipulation"]
    return found


def failed(report: Report) -> set[str]:
    return {check.name for check in report.violations}


@broken("base moves sideways, which its drive cannot")
def a_differential_base_sideways() -> Case:
    return moving_case(sideways=0.1)


@broken("base turns tighter than its drive can")
def too_tight_for_the_car() -> Case:
    return car(5.0)


@broken("base turns tighter than its drive can")
def a_car_that_turns_on_the_spot() -> Case:
    case = stops_case()
    case.plan["robot"] |= {"drive": "car", "min_turning_radius": 1.0}
    return case


@broken("base collision with the scene")
def furniture_behind_the_last_pose() -> Case:
    case = moving_case()
    case.obstacle([0.1, 0.3, 0.5], [-1.13, 0.05, 0.3])
    return case


@broken("base collision with the scene")
def furniture_that_only_the_second_stop_touches() -> Case:
    case = stops_case()
    case.obstacle([0.1, 0.3, 0.5], [-1.13, 0.05, 0.3])
    return case


@broken("largest step of the base")
def a_base_that_jumps() -> Case:
    case = moving_case(turn=0.6)
    for key in ("q", "object_q", "T_world_tool", "base"):
        del manipulation(case)[key][5:35]
    manipulation(case)["holds"] = [[0, 10]]
    return case


@broken("object moves while nothing holds it")
def a_door_that_moves_between_two_stops() -> Case:
    case = stops_case()
    manipulation(case)["holds"][1][0] += 5
    return case


@broken("object moves while nothing holds it")
def a_door_that_moves_before_the_first_hold() -> Case:
    case = moving_case(lead_in=8)
    manipulation(case)["holds"] = [[14, 48]]
    return case


@broken("base_pose is the first base pose of the manipulation")
def a_base_that_starts_elsewhere() -> Case:
    case = moving_case()
    case.plan["base_pose"]["y"] += 1e-4
    return case


@broken("FK position against T_world_tool")
def a_base_path_of_other_states() -> Case:
    case = moving_case("omni")
    manipulation(case)["base"] = np.linspace(BASE, manipulation(case)["base"][-1], 41).tolist()
    manipulation(case)["base"][20] = manipulation(case)["base"][19]
    return case


@broken("grasp slips: translation in the moved part")
def a_hand_that_slips_between_two_states() -> Case:
    case = moving_case("omni")
    for key in ("q", "object_q", "T_world_tool", "base"):
        del manipulation(case)[key][10:28]
    manipulation(case)["holds"] = [[0, 22]]
    return case


@broken("base outside the floor polygon")
def a_floor_that_ends_behind_the_first_pose() -> Case:
    case = moving_case()
    case.scene["floor"] = [[-0.97, -3.0], [3.0, -3.0], [3.0, 3.0], [-0.97, 3.0]]
    return case


@pytest.mark.parametrize("name", VALID)
def test_a_base_that_moves_as_its_drive_can_is_accepted(name: str, tmp_path: Path) -> None:
    report = verify_files(VALID[name]().write(tmp_path))
    assert not report.violations


@pytest.mark.parametrize("name", BROKEN)
def test_every_corruption_of_a_moving_base_is_rejected(name: str, tmp_path: Path) -> None:
    make, check = BROKEN[name]
    assert check in failed(verify_files(make().write(tmp_path)))


def test_the_independent_checker_gives_the_same_verdicts_for_moving_bases(tmp_path: Path) -> None:
    cases = VALID | {name: make for name, (make, _) in BROKEN.items()}
    plans = {name: make().write(tmp_path / name) for name, make in cases.items()}
    for (name, path), theirs in zip(plans.items(), independent_verdicts(plans), strict=True):
        ours = {NAMES.get(check, check) for check in failed(verify_files(path))}
        others = {key for key, (ok, _) in theirs.items() if not ok}
        assert others <= ours <= others | HAND_CHECKS, name


def test_a_turn_a_little_too_tight_adds_up_over_the_path(tmp_path: Path) -> None:
    """The independent checker looks at one step at a time, in which this turn is small."""
    assert failed(verify_files(car(0.7).write(tmp_path))) == {
        "base turns tighter than its drive can"
    }


def test_a_door_that_follows_the_base_does_not_hit_it(tmp_path: Path) -> None:
    """The door hits a long base where it stands still; here the base drives out of its way."""
    still, moves = make_case(), moving_case()
    for case in (still, moves):
        case.robot = case.robot.replace('size="0.4 0.4 0.5"', 'size="0.9 0.4 0.65"')
    name = "base collision with the scene"
    assert name in failed(verify_files(still.write(tmp_path / "still")))
    assert name not in failed(verify_files(moves.write(tmp_path / "moves")))


def test_a_base_path_of_one_pose_is_checked_as_a_base_that_stands_still(tmp_path: Path) -> None:
    case = make_case()
    still = verify_files(case.write(tmp_path))
    case.plan["version"] = 2
    case.plan["robot"]["drive"] = "differential"
    manipulation(case)["base"] = [list(BASE)] * 41
    moves = {check.name: check for check in verify_files(case.write(tmp_path)).checks}
    for check in still.checks:
        assert moves[check.name].value == pytest.approx(check.value, abs=1e-9)
        assert moves[check.name].ok == check.ok


def test_the_arm_returns_home_at_the_last_base_pose(tmp_path: Path) -> None:
    """The path home hits the post from the last base pose, and not from the first one."""
    hits = {}
    for name, make in (("still", make_case), ("moves", moving_case)):
        case = make()
        case.obstacle([0.1, 0.1, 0.1], [-0.6, -0.47, 0.8])
        last = np.array(manipulation(case)["q"][-1])
        turns = np.linspace(0.0, -0.8, 9)[:, None] * np.eye(6)[0]
        case.plan["home"] = [*(last + turns).tolist(), *(last + turns[::-1]).tolist()]
        hits[name] = failed(verify_files(case.write(tmp_path / name)))
    ends = "path home ends where the approach starts"
    assert hits == {"still": {ends}, "moves": {"arm collision with the scene", ends}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 1}, "manipulation.base needs version 2"),
        ({"version": 3}, "versions 1 and 2"),
        ({"robot": {"drive": None}}, "robot.drive is missing"),
        ({"manipulation": {"base": [[0.0, 0.0, 0.0]]}}, "manipulation.base must have 41 poses"),
        ({"manipulation": {"base": [[0.0, 0.0]] * 41}}, "manipulation.base"),
    ],
)
def test_a_file_with_an_unusable_base_path_is_refused(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    case = moving_case()
    for key, value in change.items():
        case.plan[key] = {**case.plan[key], **value} if isinstance(value, dict) else value
    with pytest.raises(FileFormatError, match=message):
        read_plan(case.write(tmp_path))


def test_a_plan_with_a_moving_base_round_trips_and_knows_its_last_pose(tmp_path: Path) -> None:
    plan = read_plan(moving_case(lead_in=8).write(tmp_path))
    write_plan(plan, tmp_path / "again.json")
    again = read_plan(tmp_path / "again.json")
    assert again == plan
    assert plan_to_dict(again)["version"] == 2
    assert again.motion is not None
    assert again.motion.base is not None
    assert again.final_base_pose == pytest.approx(again.motion.base[-1])
    turns = replace(
        again, motion=replace(again.motion, base=again.motion.base + np.array([0.0, 0.0, 9.0]))
    )
    assert turns.final_base_pose is not None
    assert -np.pi < turns.final_base_pose[2] <= np.pi


@pytest.mark.parametrize("name", ["fetch", "segway_ur5e"])
def test_stability_does_not_depend_on_where_the_base_is(
    name: str, robots: Callable[[str], Robot]
) -> None:
    robot, rng = robots(name), np.random.default_rng(0)
    model = robot_collision_model(robot)
    judge = robot_efforts(robot.model, model.bodies, robot.base_link, model.joints)
    q = rng.uniform(-1.0, 1.0, (20, len(model.joints)))
    bases = rng.uniform(-3.0, 3.0, (20, 3))
    force = rng.uniform(-30.0, 30.0, (20, 3))
    point = rng.uniform(-1.0, 1.0, (20, 3))
    still = judge.stability((0.0, 0.0, 0.0), model.body_poses((0.0, 0.0, 0.0), q), force, point)
    T = pose_planar(bases)
    turned, there = (T[:, :3, :3] @ v[..., None] for v in (force, point))
    moves = judge.stability(
        bases, model.body_poses(bases, q), turned[..., 0], there[..., 0] + T[:, :3, 3]
    )
    assert still is not None
    np.testing.assert_allclose(moves, still, atol=1e-9)
