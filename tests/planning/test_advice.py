"""An infeasible answer names a small change with which a plan exists."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from tests.commands import output_of
from tests.cupboards import HINGE, carcass, furniture_room, joint, link

from momapos.core.geometry.polygons import contains, edge_distances
from momapos.core.geometry.transforms import place_points
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.plans import BaseRegion
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.advice import (
    DIRECTIONS,
    DISTANCES,
    FLUSH,
    can_be_moved,
    free_offsets,
    objects_in_the_way,
    with_advice,
)
from momapos.planning.base_pose_check import check_pose
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.verification.contact_pairs import object_contacts

DOOR = link(
    "door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=((0.02, 0.02, 0.16), (-0.05, 0.53, 0.1))
)
CHAIR = SceneObject.box("chair", (0.5, 0.5, 0.9), (0.15, 0.25, 0.45), category="chair")
BRIEF = PipelineConfig(place=PlaceConfig(grid=False, rounds=1))
Robots = Callable[[str], Robot]


def cupboard_with(folder: Path, *others: SceneObject) -> Scene:
    scene = furniture_room(folder, [carcass(), DOOR, HINGE])
    start = np.array([-2.5, 0.0, 0.0])
    return replace(scene, objects=(*scene.objects, *others), start=start)


@pytest.fixture
def room(tmp_path: Path) -> Scene:
    crate = SceneObject.box("crate", (1.4, 5.0, 0.6), (-0.35, 0.0, 0.3), category="crate")
    vase = SceneObject.box("vase", (0.1, 0.1, 0.3), (0.8, 0.1, 1.05), category="vase")
    return save_scene(cupboard_with(tmp_path, vase, crate), tmp_path / "scene.json")


def advised(
    scene: Scene, robot: Robot, *task: str, region: BaseRegion | None = None
) -> tuple[PlacementResult, str]:
    """Return the infeasible answer and its advice, without a time limit for the trials."""
    what = make_task(scene, *(task or ("open", "cupboard")))
    query = PlacementQuery.of(
        scene, robot, what, region=region or BaseRegion(), config=BRIEF, clock=lambda: 0.0
    )
    answer = plan_placement(query)
    assert answer.plan.status == "infeasible"
    return answer, with_advice(answer, clock=lambda: 0.0).plan.advice


def base_pose(advice: str) -> np.ndarray:
    found = re.search(r"from \((\S+), (\S+), (\S+) deg\)$", advice)
    x, y, yaw = map(float, found.groups())
    return np.array([[x, y, np.radians(yaw)]])


def moved(scene: Scene, name: str, offset: np.ndarray) -> Scene:
    item = scene.object(name)
    T = item.T_world_object.copy()
    T[:2, 3] += offset
    other = replace(item, T_world_object=T)
    return replace(scene, objects=tuple(other if o is item else o for o in scene.objects))


def works_as_stated(query: PlacementQuery, scene: Scene, advice: str) -> bool:
    """Ask directly in the changed room, and at the base pose that the advice states."""
    stated = re.search(r"from \((\S+), (\S+), (\S+) deg\)$", advice)
    x, y, yaw = map(float, stated.groups())
    other = replace(query, scene=scene)
    there = check_pose(other, (x, y, float(np.radians(yaw))), how_far=False)
    return there.motion is not None and plan_placement(other).plan.status == "solved"


def test_the_object_that_keeps_the_robot_away_is_named(
    room: Scene, tmp_path: Path, fetch: Robot
) -> None:
    answer, advice = advised(room, fetch)
    assert set(objects_in_the_way(answer, answer.query)) == {"vase", "crate"}
    assert advice.startswith("feasible without crate, from (")
    empty = replace(room, objects=tuple(one for one in room.objects if one.name != "crate"))
    assert works_as_stated(answer.query, empty, advice)
    write_plan(replace(answer.plan, advice=advice), tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").advice == advice


@pytest.mark.parametrize("fence", [False, True])
def test_an_object_that_can_be_moved_is_moved_as_little_as_needed(
    tmp_path: Path, fence: bool, fetch: Robot
) -> None:
    """The stated displacement has a plan; with a fence it leads to the other side."""
    others = [CHAIR]
    if fence:
        others.append(SceneObject.box("fence", (0.7, 0.1, 1.0), (0.15, 0.6, 0.5), category="wall"))
    scene = cupboard_with(tmp_path, *others)
    answer, advice = advised(scene, fetch)
    found = re.match(r"feasible with chair moved (\d+) cm, by \((\S+), (\S+)\), from", advice)
    distance, offset = int(found[1]) / 100, np.array([float(found[2]), float(found[3])])
    assert np.linalg.norm(offset) == pytest.approx(distance, abs=0.008)
    assert distance <= (1.25 if fence else 0.5)
    assert works_as_stated(answer.query, moved(scene, "chair", offset), advice)


def test_an_object_is_moved_only_where_it_is_free(tmp_path: Path, fetch: Robot) -> None:
    """Checked by the exact overlap of all shapes in each room with the object moved."""
    table = SceneObject.box("table", (0.8, 0.6, 0.7), (-0.2, 1.1, 0.35), yaw=0.4)
    lamp = SceneObject.box("lamp", (0.2, 0.2, 0.4), (-0.3, 1.1, 0.9), category="lamp")
    scene = cupboard_with(tmp_path, CHAIR, table, lamp)
    scene = replace(scene, floor_polygon=np.array([[-3.0, -2], [1.1, -2], [1.1, 2], [-3, 2]]))
    task = make_task(scene, "open", "cupboard")
    free = replace(scene, objects=tuple(o for o in scene.objects if o is not CHAIR))
    without = plan_placement(PlacementQuery.of(free, fetch, task))
    query = PlacementQuery.of(scene, fetch, task)
    counts = {}
    for item in (CHAIR, lamp):
        offsets, number = free_offsets(query, item, without)
        counts[item.name] = len(offsets)
        lengths = np.array(DISTANCES)[number - 1]
        np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), lengths, atol=0.008)
        for offset in offsets:
            other = moved(scene, item.name, offset)
            index = [o.name for o in other.objects].index(item.name)
            pairs = [p for p in object_contacts(other, FLUSH) if index in (p.first, p.second)]
            assert not any(pair.depth > 3 * FLUSH for pair in pairs)
            if item is lamp:
                stands = {pair.first + pair.second - index for pair in pairs}
                assert [other.objects[k].name for k in stands] == ["table"]
            low, high = other.objects[index].bounds[:, :2]
            assert (low > [-3.0, -2.0]).all()
            assert (high < [1.1, 2.0]).all()
    assert 10 < counts["chair"] < DIRECTIONS * len(DISTANCES) / 2
    assert 0 < counts["lamp"] < counts["chair"]


def test_what_carries_something_or_is_built_in_is_not_moved(tmp_path: Path) -> None:
    box = SceneObject.box
    bowl = box("bowl", (0.2, 0.2, 0.1), (0.15, 0.25, 0.95))
    counter = box("counter", (0.6, 0.6, 0.9), (0.0, 2.0, 0.45), category="kitchen counter")
    sign = box("sign", (0.2, 0.02, 0.2), (0.0, -2.0, 1.5))
    sofa = box("sofa", (0.8, 3.0, 0.8), (-2.0, 0.0, 0.4))
    scene = cupboard_with(tmp_path, CHAIR, bowl, counter, sign, sofa)
    free = {item.name for item in scene.objects if can_be_moved(scene, item)}
    assert free == {"bowl"}
    assert can_be_moved(cupboard_with(tmp_path, CHAIR), CHAIR)


def test_an_open_door_in_the_way_is_closed(tmp_path: Path, fetch: Robot) -> None:
    second = SceneObject.from_urdf(
        "closet", furniture_room(tmp_path, [carcass(), DOOR, HINGE], "closet").objects[0].model
        .urdf.path or "", (0.25, 0.95, 0.0), yaw=np.pi / 2, joints={"hinge": 1.4},
        category="cabinet",
    )  # fmt: skip
    _, advice = advised(cupboard_with(tmp_path, second), fetch)
    assert advice.startswith("feasible with closet/hinge at 0 deg, from (")


LOW_DOOR = link("door", ((0.02, 0.4, 0.28), (0, 0.2, 0)))
LOW_HINGE = joint("hinge", "revolute", ("body", "door"), (-0.212, -0.2, 0.15), (0, 0, 1), (0, 1.6))


@pytest.mark.parametrize(
    "parts",
    [[carcass(), DOOR, HINGE], [carcass(0.4, 0.3, 0.4), LOW_DOOR, LOW_HINGE]],
    ids=["high", "low"],
)
def test_a_closed_door_around_the_object_is_opened(
    tmp_path: Path, parts: list[str], fetch: Robot
) -> None:
    """The door is opened where it encloses the hand, and where the hand has no place at all."""
    cupboard = furniture_room(tmp_path, parts).objects[0]
    raised = cupboard.T_world_object.copy()
    raised[2, 3] = 0.5
    cupboard = replace(cupboard, T_world_object=raised)
    mug = SceneObject.box("mug", (0.06, 0.06, 0.1), (0.7, 0.0, 0.57))
    scene = Scene("room", (cupboard, mug), start=np.array([-1.5, 0.0, 0.0]))
    _, advice = advised(scene, fetch, "pick", "mug")
    assert advice.startswith("feasible with cupboard/hinge at 92 deg, from (")


def test_a_keep_in_area_is_widened_as_far_as_the_stated_pose(tmp_path: Path, segway: Robot) -> None:
    scene = cupboard_with(tmp_path)
    area = ((-3.5, -1.0), (-0.5, -1.0), (-0.5, 1.0), (-3.5, 1.0))
    scene = replace(scene, areas={"lobby": area})
    _, advice = advised(scene, segway, region=BaseRegion(keep_in=(area,)))
    found = re.match(r"feasible with the keep-in area 'lobby' widened by (\d+) cm", advice)
    points = place_points(base_pose(advice), segway.footprint)[0]
    polygon = np.array(area)
    beyond = np.where(contains(polygon, points), 0.0, edge_distances(points, polygon)).max()
    assert 0.0 < beyond <= int(found[1]) / 100 + 0.002
    assert int(found[1]) <= 50


def test_a_far_keep_in_area_is_left(tmp_path: Path, fetch: Robot) -> None:
    far = BaseRegion(keep_in=(((-9.0, -9.0), (-7.0, -9.0), (-7.0, -7.0)),))
    _, advice = advised(cupboard_with(tmp_path), fetch, region=far)
    assert advice.startswith("feasible outside the keep-in area around (-7.67, -8.33), from (")


def test_the_keep_out_area_that_matters_is_named(tmp_path: Path, fetch: Robot) -> None:
    here = ((-1.5, -2.0), (1.0, -2.0), (1.0, 2.0), (-1.5, 2.0))
    region = BaseRegion(keep_out=(((-5.0, -5.0), (-4.0, -5.0), (-4.0, -4.0)), here))
    _, advice = advised(cupboard_with(tmp_path), fetch, region=region)
    assert advice.startswith("feasible without the keep-out area around (-0.25, 0.00), from (")


def test_a_longer_drive_is_stated(tmp_path: Path, fetch: Robot) -> None:
    scene = cupboard_with(tmp_path)
    _, advice = advised(scene, fetch, region=BaseRegion(most_driving=0.8))
    found = re.match(r"feasible with a drive of up to (\S+) m, from", advice)
    straight = np.linalg.norm(base_pose(advice)[0, :2] - [-2.5, 0.0])
    assert 0.8 < straight <= float(found[1]) + 0.1


def test_solved_answers_and_late_trials_get_no_advice(room: Scene, fetch: Robot) -> None:
    query = PlacementQuery.of(room, fetch, make_task(room, "open", "cupboard"))
    answer = plan_placement(query)
    ticks = iter(np.arange(0.0, 1e9, 100.0))
    late = with_advice(answer, clock=lambda: float(next(ticks))).plan
    assert late.advice == ""
    assert late.notes == (
        "the time limit ended the trials for advice; with more time the answer may differ",
    )
    slow = (0.01 * k for k in count())
    assert with_advice(answer, clock=lambda: next(slow)).plan == with_advice(answer).plan
    free = replace(room, objects=room.objects[:1])
    solved = plan_placement(replace(query, scene=free))
    assert with_advice(solved) is solved


def test_the_command_prints_the_advice_unless_an_option_omits_it(room: Scene) -> None:
    words = ["place", "open", str(room.path), "cupboard", "--robot", "fetch"]
    assert "\n  advice      feasible without crate, from (" in output_of(*words, status=3)
    assert "advice" not in output_of(*words, "--no-advice", status=3)
