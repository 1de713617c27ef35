"""A plan's own states in physics: they are followed as they are, and judged by what happens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import latched_room
from tests.simulation.toy import Toy, gripping
from tests.verification.door_case import BASE, Case, make_case
from tests.verification.moving_case import chain, moving_case, stops_case

from momapos.core.errors import InputError, RobotError, SceneError
from momapos.core.geometry.transforms import pose_planar
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.config import Stage
from momapos.simulation.exact_run import run_exactly
from momapos.simulation.run_record import Execution
from momapos.simulation.run_trace import RunTrace

START = (-1.3, 0.15, 0.3)


def with_drive(case: Case) -> Case:
    """Add a straight drive to the base pose of a case, sideways as an omnidirectional base can."""
    way = np.linspace(START, BASE, 21)
    case.plan["robot"]["drive"] = "omni"
    case.plan["start"] = dict(zip(("x", "y", "yaw"), START, strict=True))
    case.plan["base_path"] = way.tolist()
    return case


def ready(folder: Path, case: Case) -> tuple[PlacementPlan, Toy]:
    made = gripping(folder, case)
    drive = case.plan["robot"].get("drive", "omni")
    made = replace(made, robot=replace(made.robot, drive=drive))
    return read_plan(folder / "plan.json"), made


def followed(folder: Path, case: Case, trace: RunTrace | None = None) -> Execution:
    plan, made = ready(folder, case)
    record = run_exactly(plan, made.scene, made.robot, watch=trace)
    assert record.exact
    return record.execution


CASES: dict[str, Callable[[], Case]] = {
    "one base pose": make_case, "a drive": lambda: with_drive(make_case()),
    "a moving base": moving_case, "stops": stops_case,
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_states_of_a_valid_plan_open_the_door(name: str, tmp_path: Path) -> None:
    trace = RunTrace()
    case = CASES[name]()
    done = followed(tmp_path, case, trace)
    assert done.success, done.reason
    assert not done.collisions
    motion = trace.motion()
    bases = np.array(motion.bases)
    first = START if name == "a drive" else BASE
    last = case.plan["manipulation"].get("base", [BASE])[-1]
    np.testing.assert_allclose(bases[0], first, atol=1e-3)
    np.testing.assert_allclose(bases[-1], last, atol=5e-3)
    assert ("drive" in motion.stages) == (name == "a drive")
    assert max(done.base_shift[:2]) < 5e-3
    assert done.tracking.worst < 0.02


def test_the_plans_own_times_are_kept(tmp_path: Path) -> None:
    seconds = []
    for length in (4.0, 8.0):
        case = make_case()
        case.plan["approach_times"] = np.linspace(0.0, length, 11).tolist()
        case.plan["manipulation"]["times"] = np.linspace(0.0, 2 * length, 41).tolist()
        done = followed(tmp_path, case)
        assert done.success, done.reason
        assert not [note for note in done.notes if "times" in note]
        seconds.append((done.time[Stage.APPROACH], done.time[Stage.MANIPULATE]))
    np.testing.assert_allclose(np.diff(seconds, axis=0), [[4.0, 8.0]], atol=0.02)


def beside(case: Case, offset: float) -> Case:
    """Move the base sideways, and with it the hand from the handle; the plan's poses agree."""
    shift = np.array([-np.sin(BASE[2]), np.cos(BASE[2])]) * offset
    case.plan["base_pose"]["x"] += shift[0]
    case.plan["base_pose"]["y"] += shift[1]
    T = np.array(case.plan["manipulation"]["T_world_tool"])
    T[:, :2, 3] += shift
    case.plan["manipulation"]["T_world_tool"] = T.tolist()
    return case


@pytest.mark.parametrize("offset", [-0.1, 0.08, 0.15])
def test_a_hand_next_to_the_handle_opens_nothing(offset: float, tmp_path: Path) -> None:
    done = followed(tmp_path, beside(make_case(), offset))
    assert not done.success
    assert done.reached < 0.1


def post_on_the_drive(case: Case) -> None:
    case.obstacle([0.1, 0.1, 0.5], [-1.0, 0.15, 0.25])


def post_next_to_the_start(case: Case) -> None:
    case.obstacle([0.1, 0.1, 0.5], [START[0] + 0.2, START[1], 0.25])


def post_in_the_doors_path(case: Case) -> None:
    case.obstacle([0.1, 0.1, 0.5], [-0.1, -0.1, 0.85])


def door_said_to_lag(case: Case) -> None:
    values = np.array(case.plan["manipulation"]["object_q"])
    case.set_door_values(values[-1] * (values / values[-1]) ** 2)


def door_said_to_open_farther(case: Case) -> None:
    case.plan["task"]["to"] = 1.15
    case.set_door_values(np.linspace(0.0, 1.15, 41))


def home_through_the_door(case: Case) -> None:
    state = np.array(case.plan["manipulation"]["q"][-1])
    way = np.linspace(state, state + np.eye(6)[0] * 1.5, 21)
    case.plan["home"] = way.tolist()
    hand = pose_planar(np.array(BASE)) @ chain().tool_poses(way[10:11])[0]
    case.obstacle([0.04, 0.04, 0.04], hand[:3, 3].tolist())


WRONG: dict[str, tuple[Callable[[Case], None], str]] = {
    "a post on the drive": (post_on_the_drive, "post"),
    "a post in the path of the door": (post_in_the_doors_path, "post"),
    "a door said to lag behind": (door_said_to_lag, "from the plan's values"),
    "a door said to open farther": (door_said_to_open_farther, "hinge moved 8"),
    "a path home through a post": (home_through_the_door, "post"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_happen_as_planned_is_a_failure(name: str, tmp_path: Path) -> None:
    change, words = WRONG[name]
    case = with_drive(make_case())
    change(case)
    done = followed(tmp_path, case)
    assert not done.success
    assert words in done.reason, done.reason


def test_a_start_in_collision_and_a_hand_beyond_its_limits_are_refused(tmp_path: Path) -> None:
    case = with_drive(make_case())
    post_next_to_the_start(case)
    plan, made = ready(tmp_path / "collision", case)
    with pytest.raises(SceneError, match="start in collision"):
        run_exactly(plan, made.scene, made.robot)
    plan, made = ready(tmp_path / "valid", with_drive(make_case()))
    with pytest.raises(RobotError, match=r"left_joint rests at 0\.5"):
        run_exactly(replace(plan, robot_rest={"left_joint": 0.5}), made.scene, made.robot)
    with pytest.raises(InputError, match="nothing to execute"):
        run_exactly(replace(plan, motion=None), made.scene, made.robot)


def test_a_latch_is_turned_by_the_states_of_the_plan(tmp_path: Path, fetch: Robot) -> None:
    scene = latched_room(tmp_path, "a lever")
    task = make_task(scene, "open", "cupboard")
    plan = plan_base_placement(scene, fetch, task).plan
    assert plan.motion is not None
    done = run_exactly(plan, scene, fetch).execution
    assert done.success, done.reason
    plain = replace(scene.object("cupboard"), latch=None)
    plan = plan_base_placement(replace(scene, objects=(plain,)), fetch, task).plan
    locked = run_exactly(plan, scene, fetch).execution
    assert not locked.success
    assert "its latch turn is not turned" in locked.reason
