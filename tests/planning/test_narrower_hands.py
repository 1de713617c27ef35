"""Hands that do not come fully open, where a fully open hand has no room."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import (
    SLIDE,
    between_posts,
    fixed_to_carcass,
    furniture_room,
    niche,
    oven_door,
    pull_out,
    tray,
)
from tests.real import check_independently
from tests.rooms import without_springs

from momapos.apps.cli.loading import open_plan
from momapos.apps.export.ros2 import messages
from momapos.apps.export.timeline import PhaseKind, phases_of
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene, SceneObject
from momapos.model.scene.scene_files import save_scene
from momapos.planning import any_grasp
from momapos.planning import plan as plans
from momapos.planning.any_grasp import narrower_hands, with_narrower_hand
from momapos.planning.base_pose_check import plan_at_pose
from momapos.planning.base_use import plan_moving
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.planning.task_setup import prepare
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files

CASES: dict[str, tuple[str, Callable[[Path], list[str]], str]] = {
    "a bar in a niche": ("fetch", lambda _: niche(0.09), "30cm"),
    "a bar between posts": ("tiago", lambda _: between_posts(0.1), "30cm"),
    "a bow near an oven's door": ("husky_ur5e", lambda folder: oven_door(folder, 0.043), "85deg"),
}


def query_of(folder: Path, case: str, robots: Callable[[str], Robot]) -> PlacementQuery:
    name, parts, to = CASES[case]
    scene = furniture_room(folder, parts(folder))
    (joint,) = scene.object("cupboard").model.joints
    scene = save_scene(without_springs(scene, "cupboard", joint), folder / "scene.json")
    return PlacementQuery.of(scene, robots(name), make_task(scene, "open", "cupboard", joint, to))


@pytest.fixture(scope="module", params=CASES)
def solved(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    robots: Callable[[str], Robot],
) -> PlacementResult:
    """Return the answer of each case."""
    folder = tmp_path_factory.mktemp("narrow")
    result = plans.plan_placement(query_of(folder, request.param, robots))
    write_plan(result.with_notes().plan, folder / "plan.json")
    return result


def file_of(result: PlacementResult) -> Path:
    return Path(result.plan.scene).with_name("plan.json")


def test_a_limited_number_of_grasps_is_not_exceeded_with_a_hand_that_is_less_open(
    tmp_path: Path, robots: Callable[[str], Robot]
) -> None:
    query = query_of(tmp_path, "a bar in a niche", robots)
    grasps = replace(query.config.motion.grasps, count=1)
    motion = replace(query.config.motion, grasps=grasps)
    limited = replace(query, config=replace(query.config, motion=motion))
    for given, some in ((query, True), (limited, False)):
        ready = prepare(query.scene, query.robot, query.task, given.config, clearance=0.01)
        assert any(narrower_hands(given, ready)) == some


def test_a_handle_without_room_is_held_by_a_hand_that_is_less_open(solved: PlacementResult) -> None:
    assert solved.plan.status == "solved"
    robot = solved.prepared.robot
    assert 0.03 < robot.opening < robot.fully_open.opening - 0.005
    assert solved.query.robot is robot
    (note,) = solved.notes
    assert f"the hand opens to {100 * robot.opening:.1f} cm before the robot drives" in note


def test_an_open_hand_cannot_do_it(
    solved: PlacementResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(any_grasp, "with_narrower_hand", lambda _, answer, __: answer)
    whole = solved.prepared.robot.fully_open
    assert plans.plan_placement(replace(solved.query, robot=whole)).plan.status == "infeasible"


@pytest.mark.parametrize("solved", ["a bar between posts"], indirect=True)
def test_a_plan_for_a_less_probable_joint_counts(
    solved: PlacementResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = solved.prepared.robot.fully_open
    query = replace(solved.query, robot=whole)
    assumed = replace(solved, plan=replace(solved.plan, status="assumed"))
    with monkeypatch.context() as patched:
        patched.setattr(any_grasp, "with_narrower_hand", lambda _, answer, __: answer)
        refused = plans.plan_placement(query)
    found = with_narrower_hand(query, refused, lambda _: assumed)
    assert refused.plan.status == "infeasible"
    assert found.plan.status == "assumed"


@pytest.mark.parametrize("case", ["a bar in a niche", "a bar between posts"])
def test_a_moving_base_holds_with_a_hand_that_is_less_open(
    tmp_path: Path, robots: Callable[[str], Robot], case: str
) -> None:
    answer = plan_moving(query_of(tmp_path, case, robots))
    assert answer.plan.status == "solved"
    robot = answer.prepared.robot
    assert robot.opening < robot.fully_open.opening - 0.005
    write_plan(answer.with_notes().plan, tmp_path / "plan.json")
    assert verify_files(tmp_path / "plan.json").valid


def test_verifiers_read_how_far_the_hand_is_open(solved: PlacementResult) -> None:
    report = verify_files(file_of(solved))
    assert report.valid, report.violations
    check_independently(file_of(solved))


@pytest.mark.parametrize("solved", ["a bar between posts"], indirect=True)
def test_the_same_motion_with_an_open_hand_is_rejected(solved: PlacementResult) -> None:
    plan, whole = solved.plan, solved.prepared.robot.fully_open
    report = PlanVerifier(solved.prepared.scene, whole, plan.task).check(
        plan.base_pose, plan.motion
    )
    assert not report.valid


def test_a_robot_is_loaded_with_the_hand_of_its_plan(solved: PlacementResult) -> None:
    _, _, robot = open_plan(file_of(solved), None, None, "to execute", allow_assumed=False)
    assert robot.opening == pytest.approx(solved.prepared.robot.opening, abs=1e-4)
    assert robot.model.rest == solved.prepared.robot.model.rest


def test_exports_open_the_hand_to_its_width_before_the_drive(solved: PlacementResult) -> None:
    whole, plan = solved.prepared.robot.fully_open, solved.plan
    phases = phases_of(plan, whole)
    kinds = [phase.kind for phase in phases]
    assert kinds[:3] == [PhaseKind.OPEN, PhaseKind.DRIVE, PhaseKind.ARM]
    np.testing.assert_allclose(phases[0].base[-1, :2], phases[1].base[0, :2])
    steps = messages(plan, phases, whole, "map")["steps"]
    assert [step["action"].split("/")[-1] for step in steps[:2]] == [
        "GripperCommand", "NavigateToPose",
    ]  # fmt: skip
    commands = [step["goal"]["command"] for step in steps if "command" in step["goal"]]
    widths = {command["position"] for command in commands} - {0.0}
    assert [*widths] == [pytest.approx(solved.prepared.robot.opening, abs=1e-4)]


def test_a_plan_at_a_pose_may_use_a_hand_that_is_less_open(solved: PlacementResult) -> None:
    whole, pose = solved.prepared.robot.fully_open, solved.plan.base_pose
    again = plan_at_pose(replace(solved.query, robot=whole), pose)
    assert again.plan.status == "solved"
    assert again.plan.robot_rest == again.prepared.robot.model.held != whole.model.held


@pytest.mark.parametrize(
    ("verb", "when"), [("pick", "before the robot drives"), ("place", "lets go")]
)
def test_an_object_among_others_is_taken_by_a_hand_that_is_less_open(
    verb: str, when: str, fetch: Robot
) -> None:
    grid = [(0.07 * i, 0.07 * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    size = (0.04, 0.04, 0.12)
    cans = [
        SceneObject.box("can" if x == y == 0.0 else f"{x},{y}", size, (0.75 + x, y, 0.762))
        for x, y in grid
    ]
    table = SceneObject.box("table", (0.6, 1.2, 0.7), (0.8, 0.0, 0.35))
    scene = Scene("shelf", (table, *cans), start=np.array([-1.5, 0.0, 0.0]))
    query = PlacementQuery.of(scene, fetch, make_task(scene, verb, "can"))
    result = plans.plan_placement(query)
    assert result.plan.status == "solved"
    assert result.prepared.robot.fully_open is fetch
    assert when in result.notes[0]


def test_the_farthest_opening_is_that_of_any_hand(tmp_path: Path, fetch: Robot) -> None:
    scene = furniture_room(tmp_path, niche(0.09))
    task = make_task(scene, "open", "cupboard", "slide", "max")
    result = plans.plan_placement(PlacementQuery.of(scene, fetch, task))
    assert result.plan.task.to == pytest.approx(0.4)
    assert result.prepared.robot.fully_open is fetch


def test_a_task_that_an_open_hand_does_asks_for_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fetch: Robot
) -> None:
    monkeypatch.setattr(any_grasp, "with_narrower_hand", None)
    parts = pull_out("tray", mimics=("",))
    scene = furniture_room(tmp_path, parts)
    task = make_task(scene, "open", "cupboard", "tray_slide")
    result = plans.plan_placement(PlacementQuery.of(scene, fetch, task))
    assert result.plan.status == "solved"
    assert result.prepared.robot is fetch
    assert not result.notes


def test_no_hand_is_tried_where_none_helps(tmp_path: Path, fetch: Robot) -> None:
    """A slot into which no finger fits, and a part that is blocked."""
    scene = furniture_room(tmp_path, niche(0.03))
    task = make_task(scene, "open", "cupboard", "slide", 0.3)
    query = PlacementQuery.of(scene, fetch, task)
    result = plans.plan_placement(query)
    assert result.plan.status == "infeasible"
    assert result.prepared.robot is query.robot
    blocked = furniture_room(
        tmp_path, [fixed_to_carcass(((0.05, 0.6, 0.4), (-0.5, 0, 0.6))), tray(), SLIDE], "blocked"
    )
    task = make_task(blocked, "open", "blocked", "slide", 0.3)
    query = replace(query, scene=blocked, task=task)
    result = plans.plan_placement(query)
    assert result.prepared.blocked
    assert not list(narrower_hands(query, result.prepared))
