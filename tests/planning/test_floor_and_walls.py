"""A part opens until it meets the floor, and neither arm nor part passes a wall."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.cupboards import Box, carcass, furniture_room, joint, link
from tests.real import CASES, independent_checks

from momapos.apps.cli.console import summary
from momapos.core.errors import InputError, TaskError
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.importance.ranking import rank
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.partial_opening import with_max_opening
from momapos.planning.result import PlacementResult
from momapos.verification.exact_check import PlanVerifier
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(timeout=60.0)
THICK: Box = ((0.05, 0.58, 0.56), (-0.025, 0.0, 0.27))
BAR: Box = ((0.02, 0.3, 0.02), (-0.1, 0.0, 0.5))
POSTS: tuple[Box, ...] = (
    ((0.06, 0.02, 0.02), (-0.07, 0.14, 0.5)), ((0.06, 0.02, 0.02), (-0.07, -0.14, 0.5)),
)  # fmt: skip
BELOW = "moved part below the floor"


def drop_down_door(folder: Path, height: float = 0.03) -> Scene:
    """Return a cupboard with a thick door that turns down about its lower edge."""
    door = link("door", THICK, *POSTS, handle=BAR)
    at, ends = (-0.262, 0, height), ("body", "door")
    hinge = joint("hinge", "revolute", ends, at, (0, -1, 0), (0, 1.5708))
    scene = furniture_room(folder, [carcass(), door, hinge])
    return save_scene(scene, folder / "scene.json")


def plan(scene: Scene, robot: Robot, *request: str | None) -> PlacementResult:
    return plan_base_placement(scene, robot, make_task(scene, *request), config=CONFIG)  # type: ignore[arg-type]


@pytest.mark.parametrize(("height", "contact", "end"), [(0.03, 25, 24), (0.04, 40, 40)])
def test_a_drop_down_door_ends_where_it_meets_the_floor(
    fetch: Robot, tmp_path: Path, height: float, contact: int, end: int
) -> None:
    scene = drop_down_door(tmp_path, height)
    for to in (None, "max"):
        answer = plan(scene, fetch, "open", "cupboard", None, to)
        assert answer.plan.status == "solved", answer.plan.candidates
        assert answer.plan.task.to == pytest.approx(math.radians(end))
        note = f"cupboard/door meets the floor at {contact} deg, so it opens no farther"
        assert answer.notes == (note,)
        assert note in summary(answer, None)
        write_plan(answer.with_notes().plan, tmp_path / "plan.json")
        assert read_plan(tmp_path / "plan.json").notes == (note,)
        assert verify_files(tmp_path / "plan.json").valid


def test_a_goal_below_the_floor_is_refused_with_the_value_of_contact(
    fetch: Robot, tmp_path: Path
) -> None:
    scene = drop_down_door(tmp_path)
    refused = plan(scene, fetch, "open", "cupboard", "hinge", "40deg")
    assert refused.plan.status == "infeasible"
    reason = "cupboard/door meets the floor at 25 deg, moving from 0 to 40 deg"
    assert list(refused.plan.candidates.rejections) == [reason]
    stated = with_max_opening(refused)
    assert stated.plan.feasible_to == pytest.approx(math.radians(24))


def test_a_public_drop_down_door_meets_the_floor_at_25_degrees(fetch: Robot) -> None:
    scene = load_scene(optional.there(CASES / "furniture" / "dropdoor.json"))
    refused = plan(scene, fetch, "open", "chest", "hinge", "40deg").plan
    assert list(refused.candidates.rejections) == [
        "chest/door meets the floor at 25 deg, moving from 0 to 40 deg"
    ]
    task = make_task(scene, "open", "chest")
    assert task.to == pytest.approx(math.radians(24))


def test_both_verifiers_measure_the_same_depth_below_the_floor(
    tmp_path: Path, fetch: Robot
) -> None:
    scene = drop_down_door(tmp_path)
    write_plan(plan(scene, fetch, "open", "cupboard").plan, tmp_path / "plan.json")
    text = (tmp_path / "scene.json").read_text()
    for sunk in (0.0, 0.006, 0.03, 0.05):
        data = json.loads(text)
        data["objects"][0]["pose"]["xyz"][2] -= sunk
        (tmp_path / "scene.json").write_text(json.dumps(data))
        ours = next(c for c in verify_files(tmp_path / "plan.json").checks if c.name == BELOW)
        checks = independent_checks(tmp_path / "plan.json")
        theirs = next(check for check in checks if check["check"] == BELOW)
        assert ours.ok == theirs["ok"] == (sunk == 0.0)
        assert ours.value == pytest.approx(theirs["value"], abs=0.2)


def test_a_carried_object_stays_above_the_floor(fetch: Robot, tmp_path: Path) -> None:
    stick = SceneObject.box("stick", (0.03, 0.03, 0.3), (0.8, 0.0, 0.65))
    table = SceneObject.box("table", (0.4, 0.4, 0.5), (0.8, 0.0, 0.25))
    room = Scene("room", (table, stick), start=np.array([-1.0, 0.0, 0.0]))
    scene = save_scene(room, tmp_path / "scene.json")
    answer = plan(scene, fetch, "pick", "stick")
    base, up = answer.plan.base_pose, answer.plan.motion
    down = replace(up, q=up.q[::-1], Ts_world_tool=up.Ts_world_tool[::-1])
    dips = []
    for bottom, motion in ((0.02, up), (0.02, down), (-0.04, up), (-0.04, down)):
        T = stick.T_world_object.copy()
        T[2, 3] = bottom + 0.15
        low = replace(scene, objects=(replace(stick, T_world_object=T),))
        report = PlanVerifier(low, fetch, answer.plan.task).check(base, motion)
        dips.append(next(one for one in report.checks if one.name == BELOW))
    # The lift is 5 cm; what the object is below the floor in the scene does not count.
    assert [dip.ok for dip in dips] == [True, False, True, False]
    assert [dip.value for dip in dips] == pytest.approx([0, 30, 0, 50], abs=0.5)


# ------------------------------------------------------------------------------------------- walls


def corner_room(folder: Path, **more: object) -> Path:
    """Write a room with a cupboard in a corner, its hinge next to the wall."""
    door = link("door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=(
        (0.02, 0.02, 0.2), (-0.04, 0.52, 0.1),
    ))  # fmt: skip
    at, ends = (-0.262, -0.295, 0.45), ("body", "door")
    hinge = joint("hinge", "revolute", ends, at, (0, 0, 1), (0, 1.6))
    room = furniture_room(folder, [carcass(), door, hinge])
    floor = np.array([[-2.5, -0.35], [1.1, -0.35], [1.1, 2.5], [-2.5, 2.5]])
    save_scene(replace(room, floor_polygon=floor, start=np.array([-1.5, 1.5, 0.0])), folder / "r")
    data = json.loads((folder / "r").read_text()) | more
    (folder / "room.json").write_text(json.dumps(data))
    return folder / "room.json"


def lowest_y(answer: PlacementResult) -> float:
    """Return the smallest y that a corner of the arm or the hand reaches [m]."""
    verifier = answer.prepared.verifier
    placed = verifier._placed(answer.plan.base_pose, answer.plan.motion)
    arm = verifier.robot_model.arm
    return min(
        float((arm.outline(k) @ T[1, :3] + T[1, 3]).min() - arm.ball[k])
        for row in placed.Ts_arm
        for k, T in enumerate(row)
    )


def test_without_walls_the_answer_states_how_far_the_arm_leaves_the_floor(
    tmp_path: Path, fetch: Robot
) -> None:
    scene = load_scene(corner_room(tmp_path))
    answer = plan(scene, fetch, "open", "cupboard", "hinge", "85deg")
    assert answer.plan.status == "solved", answer.plan.candidates
    outside = -0.35 - lowest_y(answer)
    assert outside > 0.05
    (note,) = answer.notes
    assert f"is up to {100 * outside:.0f} cm outside the floor's outline at (" in note
    assert 'set walls = "floor"' in note
    write_plan(answer.plan, tmp_path / "plan.json")
    assert note in verify_files(tmp_path / "plan.json").notes


def test_with_walls_along_the_floor_arm_and_part_stay_inside(tmp_path: Path, fetch: Robot) -> None:
    scene = load_scene(corner_room(tmp_path, walls="floor"))
    answer = plan(scene, fetch, "open", "cupboard", "hinge", "85deg")
    assert answer.plan.status == "solved", answer.plan.candidates
    assert lowest_y(answer) > -0.353
    assert answer.notes == ()


@pytest.mark.parametrize("file", ["room.json", "walls.json"])
def test_in_a_public_kitchen_walls_keep_the_arm_inside(file: str, fetch: Robot) -> None:
    folder = optional.there(CASES / "rooms" / "kitchen_floor_no_walls")
    scene = load_scene(folder / file)
    open_room = plan(scene, fetch, "open", "fridge", "fridge_door", "80deg")
    assert open_room.plan.status == "solved"
    closed = plan(scene.with_walls(), fetch, "open", "fridge", "fridge_door", "80deg")
    assert closed.plan.status == "solved"
    assert closed.notes == ()


def test_walls_are_no_objects_of_tasks(tmp_path: Path) -> None:
    scene = load_scene(corner_room(tmp_path, walls="floor"))
    ranked = rank(scene, "cupboard")
    assert ranked.names == ("cupboard",)
    with pytest.raises(TaskError, match="'wall_1' is a wall of the room"):
        make_task(scene, "pick", "wall_1")
    with pytest.raises(InputError, match="'wall_1' is a wall of the room"):
        rank(scene, "wall_1")
