"""Laws of pressing: a fingertip moves a button or a rocker straight in, and lets go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.cupboards import HINGE, carcass, furniture_room, joint, link
from tests.real import CASES, check_independently

from momapos.core.errors import InputError, TaskDoneError
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import Family, JointResistance
from momapos.model.robots.hand_openings import with_closed_hand
from momapos.model.robots.robot import Robot
from momapos.model.scene.joint_resistance import scene_after
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement, plan_tour
from momapos.planning.tour import Request
from momapos.simulation.exact_run import run_exactly
from momapos.simulation.execute import attempt
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(timeout=60.0)
SPRUNG = JointResistance(seal_force=0.0, friction=0.5, spring=3.0)
"""A button of an elevator: 3 N bring it back."""
PLATE = link("plate", ((0.02, 0.3, 0.4), (0, 0, 1.0)))
KINDS = {
    "a button": (
        link("key", ((0.01, 0.03, 0.03), (0, 0, 0))),
        joint("key", "prismatic", ("plate", "key"), (-0.013, 0, 1.0), (1, 0, 0), (0, 0.004)),
        None, 0.004,
    ),
    "a button whose axis points out": (
        link("key", ((0.01, 0.04, 0.02), (0, 0, 0))),
        joint("key", "prismatic", ("plate", "key"), (-0.014, 0.05, 0.9), (-1, 0, 0), (-0.003, 0)),
        None, -0.003,
    ),
    "a rocker": (
        link("key", ((0.012, 0.05, 0.08), (-0.006, 0, 0))),
        joint("key", "revolute", ("plate", "key"), (-0.014, 0, 1.0), (0, 1, 0), (-0.12, 0.12)),
        None, 0.12,
    ),
    "a rocker, the other way": (
        link("key", ((0.012, 0.05, 0.08), (-0.006, 0, 0))),
        joint("key", "revolute", ("plate", "key"), (-0.014, 0, 1.0), (0, 1, 0), (-0.12, 0.12)),
        "-0.12rad", -0.12,
    ),
}  # fmt: skip
"""Part, joint, the requested value, and the expected one."""


def room_with(folder: Path, kind: str) -> Scene:
    part, moves, _, _ = KINDS[kind]
    path = folder / "scene.json"
    save_scene(furniture_room(folder, [PLATE, part, moves], "panel"), path)
    return load_scene(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["fetch", "segway_ur5e"])
def test_a_press_moves_the_part_to_its_limit_with_a_closed_hand_and_backs_out(
    tmp_path: Path, robots, kind: str, name: str
) -> None:
    scene, (_, _, to, expected) = room_with(tmp_path, kind), KINDS[kind]
    robot = robots(name)
    task = make_task(scene, "press", "panel", to=to)
    assert task.to == pytest.approx(expected)
    plan = plan_base_placement(scene, robot, task, config=CONFIG).plan
    assert plan.motion is not None, plan.candidates
    (hold,) = plan.motion.grasps
    assert hold.kind is Family.PUSH
    held = plan.motion.object_q[hold.first : hold.last + 1]
    np.testing.assert_allclose(held[[0, -1]], [0.0, expected], atol=1e-9)
    # After that the hand is as far off as before it.
    tools = plan.motion.Ts_world_tool[:, :3, 3]
    assert np.linalg.norm(tools[-1] - tools[hold.last]) > 0.05
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    report = verify_files(path)
    assert report.valid, report.violations
    check_independently(path)


@pytest.mark.parametrize("kind", ["a button", pytest.param("a rocker", marks=pytest.mark.slow)])
def test_fingertips_press_until_the_part_stops_them_in_physics(
    tmp_path: Path, fetch: Robot, kind: str
) -> None:
    scene = room_with(tmp_path, kind)
    task = make_task(scene, "press", "panel")
    plan = plan_base_placement(scene, fetch, task, config=CONFIG).plan
    record = run_exactly(plan, scene, fetch)
    assert record.success, record.reason
    # A base that stands 3 mm too far away: the hand feels where the button is.
    assert plan.base_pose is not None
    x, y, yaw = plan.base_pose
    assert plan.motion is not None
    outcome = attempt(scene, with_closed_hand(fetch), (x - 0.003, y, yaw), plan.motion, task)
    assert outcome.execution.success, outcome.execution.reason


def test_what_a_spring_returns_can_be_pressed_again_and_what_stays_cannot(tmp_path: Path) -> None:
    scene = room_with(tmp_path, "a button")
    task = make_task(scene, "press", "panel")
    assert scene_after(scene, task).object("panel").values()["key"] == task.to
    sprung = scene.with_resistance({"panel": {"key": SPRUNG}})
    assert scene_after(sprung, task) is sprung
    weak = replace(SPRUNG, spring=0.4)
    held = scene.with_resistance({"panel": {"key": weak}})
    assert scene_after(held, task) is not held


def test_a_tour_presses_a_sprung_button_twice_from_one_base_pose(
    tmp_path: Path, fetch: Robot
) -> None:
    scene = room_with(tmp_path, "a button").with_resistance({"panel": {"key": SPRUNG}})
    tour = plan_tour(scene, fetch, [Request("press", "panel")] * 2, config=CONFIG)
    assert all(step.plan.feasible for step in tour.steps)
    assert len(set(tour.stops)) == 1


def test_closing_a_button_names_the_verb_that_pushes_it(tmp_path: Path) -> None:
    scene = room_with(tmp_path, "a button")
    with pytest.raises(TaskDoneError, match="press pushes a button"):
        make_task(scene, "close", "panel")


def closing_door(folder: Path, resistance: JointResistance) -> Scene:
    bar = ((0.02, 0.02, 0.2), (-0.06, 0.5, 0.0))
    door = link("door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=bar)
    scene = furniture_room(folder, [carcass(), door, HINGE])
    return scene.with_resistance({"cupboard": {"hinge": resistance}})


CLOSER = JointResistance(friction=0.5, spring=4.0, closer=True)


def test_a_door_that_closes_by_itself_is_held_open_but_never_let_go(
    tmp_path: Path, fetch: Robot
) -> None:
    scene = closing_door(tmp_path, CLOSER)
    task = make_task(scene, "open", "cupboard", to="60deg")
    alone = plan_base_placement(scene, fetch, task, config=CONFIG)
    assert alone.plan.feasible
    assert any("must keep holding the part" in note for note in alone.notes)
    requests = [Request("open", "cupboard", None, "60deg"), Request("close", "cupboard")]
    tour = plan_tour(scene, fetch, requests, config=CONFIG)
    refused = tour.steps[-1].plan
    assert not refused.feasible
    assert "spring moves it with 4 Nm, and friction holds 0.5 Nm" in str(refused.candidates)
    firm = closing_door(tmp_path, replace(CLOSER, friction=5.0))
    assert all(s.plan.feasible for s in plan_tour(firm, fetch, requests, config=CONFIG).steps)


def test_a_spring_adds_to_the_pull_of_opening(tmp_path: Path, fetch: Robot) -> None:
    scene = closing_door(tmp_path, CLOSER)
    plain = scene.with_resistance({"cupboard": {"hinge": JointResistance(friction=0.5)}})
    most = []
    for room in (scene, plain):
        task = make_task(room, "open", "cupboard", to="30deg")
        most.append(
            plan_base_placement(room, fetch, task, config=CONFIG).prepared.motion.effort.max()
        )
    assert most[0] - most[1] == pytest.approx(4.0)


def test_a_closer_without_a_spring_is_refused() -> None:
    with pytest.raises(InputError, match="closer needs a spring"):
        JointResistance(closer=True)


def test_the_buttons_and_the_switch_that_a_user_asked_about_are_pressed(
    tmp_path: Path, fetch: Robot
) -> None:
    scene = load_scene(optional.there(CASES / "users/07_buttons/lift.json"))
    for target in ("lift_panel/press_0", "lift_panel/press_3", "light_switch"):
        answer = plan_base_placement(scene, fetch, make_task(scene, "press", target), config=CONFIG)
        assert answer.plan.feasible, target
        path = tmp_path / "plan.json"
        write_plan(answer.plan, path)
        assert verify_files(path).valid
