"""momapos run: from a plan file to a record, and one line for unusable input."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from tests.commands import error_of, json_of, output_of
from tests.rooms import Everywhere
from tests.verification.door_case import make_case

from momapos.apps.cli.main import main
from momapos.apps.cli.run import summary
from momapos.core.errors import InputError
from momapos.core.geometry.transforms import invert, pose_planar, wrap_angle
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.outcomes import PoseOutcome, PoseStatus
from momapos.model.records.plans import Attempt, Motion, PlacementPlan, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose, plan_base_placement
from momapos.planning.navigation.driving import DriveRecord
from momapos.planning.navigation.footprint_map import NavigationMap
from momapos.planning.placement.config import PlaceConfig
from momapos.simulation.config import ExecutionConfig, FurnitureConfig
from momapos.simulation.run_record import RunRecord, read_run
from momapos.simulation.simulated_room import PartResistance, draw_resistance
from momapos.simulation.true_worlds import moved
from momapos.verification.exact_check import PlanVerifier
from momapos.workflows.replanning import MIN_POSE_DISTANCE, NO_POSE_LEFT, YAW_WEIGHT, Drive
from momapos.workflows.run import run_plan

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=300.0)
Pose3 = Float[np.ndarray, "3"]
START = np.array([1.9, -1.6, 1.5708])
"""Start pose in the small kitchen."""
TO = float(np.radians(45.0))
"""Angle to which the fridge is opened [rad]."""


@pytest.fixture(scope="module")
def plan(kitchen: Scene, segway: Robot) -> PlacementPlan:
    """Plan to open the fridge of the small kitchen partly with the Segway."""
    task = make_task(kitchen, "open", "fridge", "door_hinge", TO)
    plan = plan_base_placement(kitchen, segway, task, Everywhere(), config=CONFIG).plan
    assert plan.status == "solved"
    return plan


def test_a_plan_opens_the_fridge_and_the_record_reports_it(
    plan: PlacementPlan, tmp_path: Path
) -> None:
    path, out = tmp_path / "plan.json", tmp_path / "run.json"
    write_plan(plan, path)
    shown = json_of("run", str(path), "--no-noise", "--out", str(out), "--json")
    record = read_run(out)
    assert shown["success"]
    assert record.success
    assert not record.noise
    assert record.execution.reached == pytest.approx(TO, rel=0.05)
    last = record.visits[-1]
    assert last.arrived
    assert last.clearance > 0
    assert record.driven >= np.hypot(*(np.array(last.reached) - START)[:2])
    assert np.hypot(*np.subtract(last.reached, last.planned)[:2]) < 0.02
    assert "open fridge/door_hinge: done" in summary(record)


def test_zero_tries_are_refused(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    assert "--tries must be between 1" in error_of(
        "run", str(tmp_path / "plan.json"), "--tries", "0"
    )


def test_what_an_exact_run_cannot_regard_is_refused(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    for option in (["--start", "1,0,0"], ["--tries", "2"], ["--world", "kitchen_small"]):
        words = f"--exact follows the plan as it is; leave out {option[0]}"
        assert words in error_of("run", str(tmp_path / "plan.json"), "--exact", *option)


def test_an_exact_run_reports_and_writes_its_record(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    out = tmp_path / "run.json"
    assert (
        json_of("run", str(tmp_path / "plan.json"), "--exact", "--out", str(out), "--json")["exact"]
        is True
    )
    record = read_run(out)
    assert record.exact
    np.testing.assert_allclose(record.motion.bases[0], plan.start, atol=1e-3)
    assert record.visits[0].planned == plan.base_pose


def test_a_missing_world_or_a_pose_without_world_is_refused(
    plan: PlacementPlan, kitchen: Scene, tmp_path: Path, segway: Robot
) -> None:
    write_plan(plan, tmp_path / "plan.json")
    assert "--world-at" in error_of("run", str(tmp_path / "plan.json"), "--world-at", "0,0,0")
    there = tmp_path / "scene.json"
    there.write_text("{}")
    assert "exists already" in error_of(
        "run", str(tmp_path / "plan.json"), "--out-scene", str(there)
    )
    assert there.read_text() == "{}"
    assert "no_such_room" in error_of("run", str(tmp_path / "plan.json"), "--world", "no_such_room")
    far = moved(kitchen, np.array([9.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="no part that opens"):
        run_plan(plan, kitchen, segway, Everywhere(), world=far, config=CONFIG)


def test_with_noise_the_arm_motion_is_replanned_from_the_reached_pose(
    plan: PlacementPlan, kitchen: Scene, segway: Robot
) -> None:
    traces: list[np.ndarray] = []
    record = run_plan(
        plan, kitchen, segway, Everywhere(), config=CONFIG, seed=3,
        trace=lambda _, poses: traces.append(poses),
    )  # fmt: skip
    assert record.success, record.reason
    assert record.noise
    last = record.visits[-1]
    off = np.subtract(last.reached, last.planned)
    assert 0 < np.hypot(off[0], off[1]) <= 0.03
    assert abs(off[2]) <= np.radians(2.0)
    assert len(traces) == len(record.visits)
    np.testing.assert_allclose(traces[0][0], START)
    np.testing.assert_allclose(traces[-1][-1], last.reached)


@pytest.mark.slow
def test_the_drawn_furniture_does_not_depend_on_the_drive(
    plan: PlacementPlan, kitchen: Scene, segway: Robot
) -> None:
    def run(go: Drive) -> RunRecord:
        furniture = FurnitureConfig(spread=0.3)
        return run_plan(
            plan, kitchen, segway, Everywhere(), config=CONFIG, seed=5,
            driver=go, physics=ExecutionConfig(furniture=furniture),
        )  # fmt: skip

    def near(_: NavigationMap, start: Pose3, goal: Pose3, __: np.random.Generator) -> DriveRecord:
        return ended(start, goal, goal)

    def far(_: NavigationMap, start: Pose3, goal: Pose3, rng: np.random.Generator) -> DriveRecord:
        rng.normal(size=1000)
        return ended(start, goal, goal)

    one, other = run(near).execution, run(far).execution
    assert one.resistance == other.resistance


def test_a_run_draws_from_the_resistances_of_its_plan(
    plan: PlacementPlan, kitchen: Scene, monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    """They may differ from what scene and simulation assume, as after --set."""
    assert plan.resistance["fridge"]["door_hinge"].seal_force == 30.0
    changed = replace(plan.resistance["fridge"]["door_hinge"], seal_force=17.0, mass=3.0)
    drawn: list[PartResistance] = []

    class Drawn(Exception):
        pass

    def draw(*args: Any) -> PartResistance:
        drawn.append(draw_resistance(*args))
        raise Drawn

    monkeypatch.setattr("momapos.simulation.worlds.draw_resistance", draw)
    other = replace(plan, resistance={"fridge": {"door_hinge": changed}})
    for one, pull in ((other, 17.0), (replace(plan, resistance={}), 30.0)):
        with pytest.raises(Drawn):
            run_plan(
                one, kitchen, segway, Everywhere(), config=CONFIG,
                driver=lambda _, start, goal, __: ended(start, goal, goal),
            )  # fmt: skip
        assert drawn[-1].pull == pull
    assert (drawn[0].mass, drawn[0].friction) == (3.0, changed.friction)


def test_a_motion_for_one_base_pose_passes_the_exact_check(
    plan: PlacementPlan, kitchen: Scene, segway: Robot
) -> None:
    base = np.array(plan.base_pose)
    found = check_base_pose(kitchen, segway, plan.task, base, Everywhere()).motion
    x, y, yaw = base.tolist()
    assert PlanVerifier(kitchen, segway, plan.task).check((x, y, yaw), found).valid
    tools = pose_planar(base) @ segway.chain.tool_poses(found.q)
    np.testing.assert_allclose(tools, found.Ts_world_tool, atol=1e-6)


def test_without_an_arm_motion_the_base_drives_to_the_next_cheapest_pose(
    plan: PlacementPlan, kitchen: Scene, segway: Robot
) -> None:
    goals: list[np.ndarray] = []
    record = run_plan(
        plan, kitchen, segway, Everywhere(), driver=astray_at_first(goals),
        config=CONFIG,
    )  # fmt: skip
    assert record.success, record.reason
    assert len(record.visits) == len(goals) >= 2
    assert record.visits[0].reason
    assert record.visits[0].arrived
    assert record.driven == pytest.approx(sum(visit.length for visit in record.visits))
    assert apart(goals)


def test_without_another_base_pose_the_robot_docks_again(
    plan: PlacementPlan, kitchen: Scene, monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    goals: list[np.ndarray] = []
    monkeypatch.setattr("momapos.workflows.replanning.Replanner._other_pose", lambda *_: None)
    record = run_plan(
        plan, kitchen, segway, Everywhere(), driver=astray_at_first(goals),
        config=CONFIG,
    )  # fmt: skip
    assert record.success, record.reason
    assert NO_POSE_LEFT in record.visits[0].reason
    np.testing.assert_array_equal(goals, [plan.base_pose, plan.base_pose])


def test_after_three_drives_without_arrival_the_run_fails(
    plan: PlacementPlan, kitchen: Scene, segway: Robot
) -> None:
    goals: list[np.ndarray] = []

    def stuck(_: NavigationMap, start: Pose3, goal: Pose3, __: np.random.Generator) -> DriveRecord:
        goals.append(goal)
        return ended(start, goal, start, "a wheel is stuck")

    record = run_plan(plan, kitchen, segway, Everywhere(), driver=stuck, config=CONFIG)
    assert not record.success
    assert record.reason == "a wheel is stuck"
    assert record.execution is None
    assert len(goals) == len(record.visits) == 3
    assert not any(visit.arrived for visit in record.visits)
    assert apart(goals)


def test_a_base_that_hit_something_stops(
    plan: PlacementPlan, kitchen: Scene, segway: Robot
) -> None:
    def bump(_: NavigationMap, start: Pose3, goal: Pose3, __: np.random.Generator) -> DriveRecord:
        return replace(ended(start, goal, start, "it hit a chair"), hit="a chair")

    record = run_plan(plan, kitchen, segway, Everywhere(), driver=bump, config=CONFIG)
    assert not record.success
    assert record.reason == "it hit a chair"
    assert [visit.hit for visit in record.visits] == ["a chair"]


def astray_at_first(goals: list[np.ndarray]) -> Drive:
    """BasePaths of which the first ends far from its goal; tells the goals."""

    def go(_: NavigationMap, start: Pose3, goal: Pose3, __: np.random.Generator) -> DriveRecord:
        goals.append(goal)
        return ended(start, goal, goal if len(goals) > 1 else np.array([1.9, -1.6, 1.5]))

    return go


def ended(start: np.ndarray, goal: np.ndarray, pose: np.ndarray, reason: str = "") -> DriveRecord:
    """Build the record of a straight drive that ended at a pose."""
    length = float(np.hypot(*(pose - start)[:2]))
    return DriveRecord(
        arrived=not reason, reason=reason, goal=goal, pose=pose, estimated_pose=pose, hit="",
        planned=length, length=length, time=1.0, clearance=0.1, clearance_moving=np.inf, paths=1,
        times=np.array([0.0, 1.0]), poses=np.array([start, pose]), velocities=np.zeros((2, 3)),
        step_times=np.zeros(1),
    )  # fmt: skip


def apart(goals: list[np.ndarray]) -> bool:
    """Return whether all goals differ."""
    return all(
        np.hypot(*(one - other)[:2]) + YAW_WEIGHT * abs(wrap_angle(one[2] - other[2]))
        >= MIN_POSE_DISTANCE
        for i, one in enumerate(goals)
        for other in goals[:i]
    )


def test_a_start_in_collision_in_the_simulation_is_a_failure(
    plan: PlacementPlan, kitchen: Scene, monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    def go(_: NavigationMap, start: Pose3, goal: Pose3, __: np.random.Generator) -> DriveRecord:
        return ended(start, goal, np.array([1.0, 0.0, 1.57]))

    motion = plan.motion
    monkeypatch.setattr(
        "momapos.workflows.replanning.check_pose",
        lambda *_, **__: Attempt(motion, PoseOutcome(PoseStatus.FEASIBLE)),
    )
    record = run_plan(plan, kitchen, segway, Everywhere(), driver=go, config=CONFIG)
    assert not record.success
    assert record.execution is None
    assert "start in collision" in record.reason


def test_a_scene_that_changed_after_planning_is_refused(tmp_path: Path, fetch: Robot) -> None:
    made = PlacementPlan(
        scene=str(make_case().write(tmp_path).with_name("scene.json")),
        robot_name="fetch", robot_urdf=str(fetch.model.urdf.path), base_link=fetch.base_link,
        tool_link=fetch.tool_link, task=Task("open", "cupboard", "hinge", 1.0), status="solved",
        joints=fetch.arm_joints, base_pose=(-1.5, 0.0, 0.0), motion=still(fetch),
    )  # fmt: skip
    write_plan(made, tmp_path / "plan.json")
    (tmp_path / "scene.json").write_text((tmp_path / "scene.json").read_text() + " ")
    assert "scene.json) has changed since" in error_of("run", str(tmp_path / "plan.json"))


def test_a_robot_that_changed_after_planning_is_refused(tmp_path: Path) -> None:
    case = make_case()
    case.write(tmp_path)
    digests = {
        key: hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
        for key, name in (("scene", "scene.json"), ("robot", "robot.urdf"))
    }
    case.plan["hashes"] = digests
    path = case.write(tmp_path)
    (tmp_path / "robot.urdf").write_text((tmp_path / "robot.urdf").read_text() + "<!-- -->")
    assert "robot.urdf) has changed since" in error_of("run", str(path))


def still(robot: Robot) -> Motion:
    """Build a motion in which the arm stays at home."""
    return Motion(robot.home[None], robot.home[None], np.zeros(1), np.eye(4)[None])


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        ({"version": 7}, "version 7"),
        ({"status": "infeasible", "manipulation": None}, "'infeasible'"),
        ({"format": "cake"}, "not a plan"),
        ({"scene": "nowhere.json"}, "nowhere.json"),
    ],
)
def test_a_plan_that_cannot_be_executed_is_refused(
    change: dict[str, object], hint: str, tmp_path: Path
) -> None:
    case = make_case()
    case.plan |= change
    assert hint in error_of("run", str(case.write(tmp_path)))


def test_a_plan_without_a_robot_file_needs_one(tmp_path: Path) -> None:
    path = make_case().write(tmp_path)
    assert "give --robot" in error_of("run", str(path))
    assert "another robot" in error_of("run", str(path), "--robot", "fetch")


def test_a_start_in_collision_is_refused(plan: PlacementPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    assert "would hit" in error_of("run", str(tmp_path / "plan.json"), "--start", "1,0,0")


def at_base(plan: PlacementPlan, base: tuple[float, float, float]) -> PlacementPlan:
    """Return a plan with the same motion of the arm at another base pose, without a base path."""
    T = pose_planar(np.array(base)) @ invert(pose_planar(np.array(plan.base_pose)))
    motion = replace(plan.motion, Ts_world_tool=T @ plan.motion.Ts_world_tool)
    return replace(plan, base_pose=base, base_path=None, motion=motion)


def test_from_an_unreachable_base_pose_the_run_goes_on_to_the_next_one(
    plan: PlacementPlan, tmp_path: Path
) -> None:
    write_plan(at_base(plan, (1.0, 0.0, 1.57)), tmp_path / "plan.json")
    assert "the goal is in collision with" in output_of(
        "run", str(tmp_path / "plan.json"), "--no-noise"
    )


def test_a_blocked_in_base_fails_with_that_reason(
    plan: PlacementPlan, kitchen: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = json.loads(kitchen.path.read_text())
    models = "kitchen_small_urdf"
    shutil.copytree(kitchen.path.parent / models, tmp_path / models)
    for k, (dx, dy) in enumerate([(0.45, 0.0), (-0.45, 0.0), (0.0, 0.6), (0.0, -0.6)]):
        room["objects"].append({
            "name": f"fence_{k}", "category": "fence",
            "box": [0.04 if dx else 0.94, 0.04 if dy else 1.24, 0.5],
            "pose": {
                "xyz": [START[0] + dx, START[1] + dy, 0.25], "wxyz": [1.0, 0.0, 0.0, 0.0],
            },
        })  # fmt: skip
    (tmp_path / "room.json").write_text(json.dumps(room))
    there = replace(at_base(plan, (0.3, -1.5, -3.02)), scene=str(tmp_path / "room.json"))
    write_plan(there, tmp_path / "plan.json")
    out = tmp_path / "run.json"
    assert main(["run", str(tmp_path / "plan.json"), "--out", str(out), "--json"]) == 1
    record = read_run(out)
    assert record.execution is None
    assert record.reason == f"there is no path for the footprint; {NO_POSE_LEFT}"
    assert json.loads(capsys.readouterr().out)["reason"] == record.reason


def test_a_film_is_a_png_a_gif_or_an_mp4(tmp_path: Path) -> None:
    path = make_case().write(tmp_path)
    assert ".png" in error_of("run", str(path), "--record", "film.mov")
