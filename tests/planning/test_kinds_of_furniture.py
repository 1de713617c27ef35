"""Furniture as others write it: followers, handles on own joints, closed ends at limits."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.cupboards import (
    DOOR,
    FOLLOWERS,
    HINGE,
    SLIDE,
    Box,
    carcass,
    furniture_room,
    joint,
    link,
    pull_out,
    tray,
)
from tests.real import CASES, check_independently

from momapos.core.errors import SceneError, TaskDoneError, TaskError, UrdfError
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene
from momapos.model.urdf.articulated import opening_of
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.handles import find_handles
from momapos.planning.grasps.task_requests import make_task, openable
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.result import PlacementResult
from momapos.verification.plan_check import verify_files

CONFIG = PipelineConfig(timeout=60.0)


def sliding_door(axis: int, *bars: Box, handle: Box | None = None) -> list[str]:
    necks: tuple[Box, ...] = tuple(((0.03, 0.015, 0.015), (-0.025, 0.2, z)) for z in (0.1, -0.1))
    panel = link("panel", ((0.02, 0.5, 1.7), (0, 0, 0)), *necks, *bars, handle=handle)
    at, ends = (-0.28, -0.25 * axis, 0.95), ("body", "panel")
    slide = joint("slide", "prismatic", ends, at, (0, axis, 0), (0, 0.48))
    return [carcass(1.0, 1.9), panel, slide]


UPRIGHT: Box = ((0.02, 0.02, 0.25), (-0.05, 0.2, 0))
TEE: tuple[Box, Box] = (((0.04, 0.02, 0.02), (-0.03, 0, 0)), ((0.02, 0.02, 0.14), (-0.055, 0, 0)))
LEVER: tuple[Box, Box] = (
    ((0.05, 0.02, 0.02), (-0.035, 0, 0)), ((0.02, 0.13, 0.02), (-0.06, -0.055, 0)),
)  # fmt: skip
BAIL: tuple[Box, ...] = (
    ((0.015, 0.12, 0.015), (-0.04, 0, -0.01)),
    ((0.04, 0.01, 0.01), (-0.02, 0.06, 0)),
    ((0.04, 0.01, 0.01), (-0.02, -0.06, 0)),
)
ON_DOOR, AT = ("door", "grip"), (0.0, 0.52, 0.1)
OWN_HANDLES = {
    "a T-handle that turns": [
        carcass(), DOOR, HINGE, link("grip", *TEE),
        joint("turn", "revolute", ON_DOOR, AT, (1, 0, 0), (0, 1.57)),
    ],
    "a lever": [
        carcass(), DOOR, HINGE, link("grip", *LEVER),
        joint("turn", "revolute", ON_DOOR, AT, (1, 0, 0), (-0.7, 0)),
    ],
    "a lever named handle": [
        carcass(), DOOR, HINGE, link("grip", LEVER[0], handle=LEVER[1]),
        joint("turn", "revolute", ON_DOOR, AT, (1, 0, 0), (-0.7, 0)),
    ],
    "a knob that turns": [
        carcass(), DOOR, HINGE, link("grip", ((0.04, 0.04, 0.04), (-0.04, 0, 0))),
        joint("turn", "continuous", ON_DOOR, AT, (1, 0, 0), (0, 0)),
    ],
    "a bail": [
        carcass(), tray(None), SLIDE, link("grip", *BAIL),
        joint("swing", "revolute", ("tray", "grip"), (-0.272, 0, 0.02), (0, 1, 0), (-0.3, 1.5)),
    ],
    "an upright bar on a sliding door": sliding_door(1, UPRIGHT),
    "a bar named handle on a sliding door": sliding_door(1, handle=UPRIGHT),
    "a sliding door to the other side": sliding_door(-1, handle=UPRIGHT),
    "a bar on the rim of a lid": [
        carcass(0.8, 0.7),
        link(
            "lid", ((0.52, 0.8, 0.03), (-0.26, 0, 0.015)),
            ((0.04, 0.02, 0.02), (-0.54, 0.08, 0.015)), ((0.04, 0.02, 0.02), (-0.54, -0.08, 0.015)),
            handle=((0.02, 0.2, 0.02), (-0.57, 0, 0.015)),
        ),
        joint("lid", "revolute", ("body", "lid"), (0.25, 0, 0.7), (0, 1, 0), (0, 1.2)),
    ],
}  # fmt: skip


def plan(scene: Scene, robot: Robot, *request: str, folder: Path) -> PlacementResult:
    """Plan, and check a solution from its file with our verifier and with the independent one."""
    answer = plan_base_placement(scene, robot, make_task(scene, *request), config=CONFIG)
    assert answer.plan.status == "solved", answer.plan.candidates
    path = folder / "plan.json"
    write_plan(answer.plan, path)
    report = verify_files(path)
    assert report.valid, report.violations
    check_independently(path)
    return answer


@pytest.mark.parametrize("kind", FOLLOWERS)
def test_a_task_on_a_follower_moves_its_leader_and_everything_that_follows(
    tmp_path: Path, kind: str, fetch: Robot
) -> None:
    parts, follower, leader = FOLLOWERS[kind]
    scene = save_scene(furniture_room(tmp_path, parts), tmp_path / "scene.json")
    answer = plan(scene, fetch, "open", "cupboard", follower, folder=tmp_path)
    task, motion = answer.plan.task, answer.plan.motion
    assert (task.joint, task.follower) == (leader, follower)
    # The hand keeps its pose in the link that it holds, wherever the model puts that link.
    item, ends = scene.object("cupboard"), (0, motion.holds[0].last)
    held = next(o.carrier for o in answer.prepared.motion.grasps.handles)
    in_link = [
        np.linalg.inv(item.link_poses({leader: motion.object_q[k]})[held]) @ motion.Ts_world_tool[k]
        for k in ends
    ]
    np.testing.assert_allclose(*in_link, atol=2e-3)


@pytest.mark.parametrize("kind", OWN_HANDLES)
def test_a_handle_is_found_on_a_joint_of_its_own_and_on_any_face(
    tmp_path: Path, kind: str, fetch: Robot
) -> None:
    scene = save_scene(furniture_room(tmp_path, OWN_HANDLES[kind]), tmp_path / "scene.json")
    answer = plan(scene, fetch, "open", "cupboard", folder=tmp_path)
    assert answer.plan.task.joint in ("hinge", "slide", "lid")
    (handle, *_) = answer.prepared.motion.grasps.handles
    assert not handle.edge


def tap(lever: Box, axis: tuple[float, float, float], limits: tuple[float, float]) -> list[str]:
    """Return a tap on a counter: a column with a lever on top, or at its side."""
    counter, column = ((0.6, 1.2, 0.86), (0.15, 0, 0.43)), ((0.04, 0.04, 0.16), (0, 0, 0.94))
    at = (0, 0, 1.04) if axis[2] else (-0.03, 0, 0.98)
    turn = joint("turn", "revolute", ("body", "lever"), at, axis, limits)
    return [link("body", counter, column), link("lever", lever), turn]


def test_a_drawer_without_a_handle_has_only_its_edges(tmp_path: Path) -> None:
    scene = furniture_room(tmp_path, [carcass(), tray(None), SLIDE])
    assert all(h.edge for h in find_handles(scene.object("cupboard").model, "slide", 1.0))


TAPS = {
    "on top": tap(((0.15, 0.02, 0.015), (-0.07, 0, 0)), (0, 0, 1), (-0.8, 0.8)),
    "to the side": tap(((0.02, 0.14, 0.02), (0, -0.06, 0)), (0, 0, 1), (0, 1.2)),
    "upright": tap(((0.02, 0.02, 0.12), (0, 0, 0.05)), (1, 0, 0), (0, 1.2)),
}


@pytest.mark.parametrize(
    "robot_name",
    [
        "fetch",
        pytest.param("segway_ur5e", marks=pytest.mark.slow),
        pytest.param("ranger_rm63", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("kind", TAPS)
def test_a_lever_is_its_own_handle(
    robots: Callable[[str], Robot], tmp_path: Path, kind: str, robot_name: str
) -> None:
    scene = save_scene(furniture_room(tmp_path, TAPS[kind]), tmp_path / "scene.json")
    answer = plan(scene, robots(robot_name), "open", "cupboard", "turn", folder=tmp_path)
    assert not answer.prepared.motion.grasps.handles[0].edge


def test_opening_a_door_by_its_object_means_the_leaf_not_its_lever(tmp_path: Path) -> None:
    scene = furniture_room(tmp_path, OWN_HANDLES["a lever named handle"])
    assert openable(scene) == [("cupboard", "hinge")]
    assert make_task(scene, "open", "cupboard").joint == "hinge"
    assert make_task(scene, "open", "cupboard", "turn", to=-0.5).joint == "turn"


def test_a_follower_is_not_a_part_of_its_own(tmp_path: Path) -> None:
    scene = furniture_room(tmp_path, FOLLOWERS["a chain of rails"][0])
    assert openable(scene) == [("cupboard", "tray_slide")]
    with pytest.raises(SceneError, match="follows tray_slide; set cupboard/tray_slide"):
        scene.with_joint("cupboard", "inner_slide", 0.1)


@pytest.mark.parametrize(
    ("mimic", "words"),
    [('joint="none"', "does not exist"), ('joint="tray_slide"', "follows itself")],
)
def test_followers_without_a_leader_are_refused(tmp_path: Path, mimic: str, words: str) -> None:
    parts = pull_out("outer", "tray", mimics=(mimic, 'joint="outer_slide"'))
    with pytest.raises(UrdfError, match=words):
        furniture_room(tmp_path, parts)


def open_at_zero(axis: int) -> list[str]:
    door = link("door", ((0.59, 0.02, 0.88), (-0.295, 0, 0)))
    ends, at = ("body", "door"), (-0.262, -0.295 * axis, 0.45)
    return [carcass(), door, joint("hinge", "revolute", ends, at, (0, 0, -axis), (0, 1.5708))]


@pytest.mark.parametrize(
    "parts",
    [
        open_at_zero(1), open_at_zero(-1),
        [carcass(),
         link("tray", ((0.02, 0.55, 0.2), (-0.66, 0, 0)), ((0.45, 0.5, 0.02), (-0.4, 0, 0))),
         joint("slide", "prismatic", ("body", "tray"), (0, 0, 0.6), (1, 0, 0), (0, 0.4))],
    ],
)  # fmt: skip
def test_a_part_that_sticks_out_at_zero_is_closed_at_its_limit(
    tmp_path: Path, parts: list[str]
) -> None:
    scene = furniture_room(tmp_path, parts)
    with pytest.raises(TaskDoneError, match="already open"):
        make_task(scene, "open", "cupboard")
    task = make_task(scene, "close", "cupboard")
    assert task.to == scene.object("cupboard").joint(str(task.joint)).upper


def test_what_a_scene_says_about_the_closed_end_wins(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    save_scene(furniture_room(tmp_path, [carcass(), DOOR, HINGE]), path)
    data = json.loads(path.read_text())
    data["objects"][0]["closed"] = {"hinge": 1.6}
    path.write_text(json.dumps(data))
    scene = load_scene(path)
    assert make_task(scene, "close", "cupboard").to == 1.6
    again = load_scene(save_scene(scene, tmp_path / "again.json").path or path)
    assert opening_of(again.object("cupboard").model, "hinge").closed == 1.6
    data["objects"][0]["closed"] = {"hinge": 1.7}
    path.write_text(json.dumps(data))
    with pytest.raises(SceneError, match=r"closed: 'hinge' is 1.7, its limits are 0 to 1.6"):
        load_scene(path)


@pytest.mark.parametrize("to", ["-60deg", "60deg"])
def test_a_swing_door_opens_both_ways(tmp_path: Path, to: str, fetch: Robot) -> None:
    frame = link("body", *(((0.1, 0.04, 2.05), (0, y, 1.025)) for y in (-0.51, 0.51)))
    knobs: list[Box] = [((0.08, 0.04, 0.04), (x, 0.8, 0)) for x in (-0.06, 0.06)]
    leaf = link("leaf", ((0.04, 0.88, 2.0), (0, 0.44, 0)), *knobs)
    ends, at = ("body", "leaf"), (0, -0.44, 1.02)
    hinge = joint("hinge", "revolute", ends, at, (0, 0, 1), (-1.57, 1.57))
    scene = save_scene(furniture_room(tmp_path, [frame, leaf, hinge]), tmp_path / "scene.json")
    task = make_task(scene, "open", "cupboard", to=to)
    answer = plan_base_placement(scene, fetch, task, config=CONFIG)
    assert answer.plan.status == "solved", answer.plan.candidates
    with pytest.raises(TaskError, match="means to open"):
        make_task(scene, "close", "cupboard", to=to)
    ajar = scene.with_joint("cupboard", "hinge", math.radians(-70))
    assert make_task(ajar, "close", "cupboard", to="-10deg").to == pytest.approx(-0.1745, abs=1e-3)


@pytest.mark.parametrize(("axis", "side"), [(1, 1.0), (-1, -1.0)])
def test_a_joint_without_limits_opens_to_the_free_side(
    tmp_path: Path, axis: int, side: float
) -> None:
    ends, at = ("body", "door"), (-0.262, -0.295, 0.45)
    hinge = joint("hinge", "continuous", ends, at, (0, 0, axis), (0, 0))
    scene = furniture_room(tmp_path, [carcass(), DOOR, hinge])
    task = make_task(scene, "open", "cupboard")
    assert task.to == pytest.approx(side * math.pi / 2)


SOLVED = {
    "telescope2.json": "chest/tray_slide", "telescope.json": "chest/tray_slide",
    "bifold.json": "lift/fold", "bifold_door.json": "closet/hinge_a", "lever.json": "door",
    "thandle.json": "locker/hinge",
    "bail.json": "chest/slide", "cont_neg.json": "cupboard/hinge",
}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        name
        if name in ("telescope2.json", "bail.json")
        else pytest.param(name, marks=pytest.mark.slow)
        for name in SOLVED
    ],
)
def test_a_public_case_is_solved(tmp_path: Path, name: str, fetch: Robot) -> None:
    scene = load_scene(optional.there(CASES / "furniture" / name))
    plan(scene, fetch, "open", SOLVED[name], folder=tmp_path)
