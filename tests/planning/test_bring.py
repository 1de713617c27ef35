"""Laws of bringing: one grasp from where an object stands to where it is put, at a free spot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of, json_of

from momapos.core.errors import OutOfTimeError, TaskError, UnknownNameError
from momapos.core.geometry import invert
from momapos.model.plan_files.plan_format import read_plan
from momapos.model.plan_files.tour_format import read_tour
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_tour
from momapos.planning.spots import EDGE, ROOM, spots_for
from momapos.planning.tour import Request
from momapos.verification.plan_check import verify_files, verify_tour


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small")


@pytest.fixture(scope="module")
def table() -> Scene:
    """Return a room with a table that is turned, a post on it, and a box on the floor."""
    top = SceneObject.box("table", (1.0, 0.6, 0.7), (2.0, 0.0, 0.35), yaw=0.6)
    post = SceneObject.box("post", (0.1, 0.1, 0.4), (2.0, 0.0, 0.9))
    carton = SceneObject.box("carton", (0.12, 0.08, 0.2), (-2.0, 0.0, 0.1))
    area = ((-1.0, -1.0), (0.0, -1.0), (0.0, 0.0))
    return Scene("room", (top, post, carton), areas={"corner": area})


def base_of(item: SceneObject, T: np.ndarray) -> np.ndarray:
    """Return the corners of an object's bounding box at a pose [m]."""
    local = (item.vertices - item.T_world_object[:3, 3]) @ item.T_world_object[:3, :3]
    return local @ T[:3, :3].T + T[:3, 3]


def test_spots_lie_on_the_face_away_from_its_edges_and_from_other_objects(table: Scene) -> None:
    carton, top, post = (table.object(name) for name in ("carton", "table", "post"))
    spots = spots_for(table, carton, "table")
    assert len(spots) > 2
    for T in spots:
        corners = base_of(carton, T)
        assert corners[:, 2].min() == pytest.approx(0.7)
        on_table = (corners - top.T_world_object[:3, 3]) @ top.T_world_object[:3, :3]
        assert (np.abs(on_table[:, :2]) < [0.5 - EDGE / 2, 0.3 - EDGE / 2]).all()
        gap = np.abs(corners[:, :2].mean(0) - post.T_world_object[:2, 3]).max()
        assert gap > 0.05 + ROOM


def test_a_spot_may_be_a_point_with_a_yaw_or_in_an_area(table: Scene) -> None:
    carton = table.object("carton")
    (T,) = spots_for(table, carton, "1.7,0.1,0.7,90deg")
    np.testing.assert_allclose(T[:3, 3], [1.7, 0.1, 0.8], atol=1e-12)
    np.testing.assert_allclose(T[:3, 0], [0.0, 1.0, 0.0], atol=1e-12)
    for T in spots_for(table, carton, "corner"):
        x, y, z = base_of(carton, T).T
        assert z.min() == pytest.approx(0.0)
        assert (x.min() > -1.0) & (x.max() < 0.0) & (y.min() > -1.0) & ((y - x).max() < 0.0)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("carton", "carton cannot be put on itself"),
        ("post", "post has no room for carton, which needs a flat face of 12 x 8 cm"),
        ("1,2", "is not X,Y,Z or X,Y,Z,YAW"),
        ("tabel", "no place 'tabel' in scene room; did you mean table"),
        ("table/leg", "no part 'leg' in table"),
    ],
)
def test_a_place_without_room_or_of_no_name_is_refused(
    table: Scene, place: str, words: str
) -> None:
    with pytest.raises((TaskError, UnknownNameError), match=words):
        spots_for(table, table.object("carton"), place)


def test_one_grasp_serves_both_tasks_and_both_plans_are_valid(
    tmp_path: Path, kitchen: Scene
) -> None:
    out = tmp_path / "bring.json"
    found = json_of(
        "place", "bring", "kitchen_small", "bottle", "--to", "table", "--robot", "fetch",
        "--out", str(out), "--json",
    )  # fmt: skip
    assert found["status"] == "solved"
    grasps, places = [], []
    for step in read_tour(out).steps:
        assert verify_files(tmp_path / step.plan).valid
        plan = read_plan(tmp_path / step.plan)
        scene = load_scene(plan.scene if Path(plan.scene).is_absolute() else tmp_path / plan.scene)
        places.append(scene.object("bottle").T_world_object)
        assert plan.motion is not None
        grasps.append(invert(places[-1]) @ plan.motion.Ts_world_tool[0])
    np.testing.assert_allclose(grasps[1], grasps[0], atol=1e-6)
    np.testing.assert_array_equal(places[0], kitchen.object("bottle").T_world_object)
    assert all(report.valid for report in verify_tour(out).values())
    top = kitchen.object("table").bounds
    assert ((places[1][:2, 3] > top[0, :2]) & (places[1][:2, 3] < top[1, :2])).all()


def test_a_tour_whose_objects_are_elsewhere_than_it_leaves_them_is_invalid(tmp_path: Path) -> None:
    out = tmp_path / "bring.json"
    json_of(
        "place", "bring", "kitchen_small", "bottle", "--to", "table", "--robot", "fetch",
        "--out", str(out), "--json",
    )  # fmt: skip
    room = tmp_path / "bring_room_2.json"
    content = json.loads(room.read_text())
    (cup,) = (one for one in content["objects"] if one["name"] == "cup")
    cup["pose"]["xyz"][0] += 0.05
    room.write_text(json.dumps(content))
    failed = [one for one in verify_tour(out)["bring.json"].checks if not one.ok]
    assert [one.detail for one in failed] == ["cup is not where or as it was"]


def test_an_object_is_brought_within_a_longer_tour(kitchen: Scene, fetch: Robot) -> None:
    requests = [
        Request("open", "cabinet_right", "drawer_top_slide"),
        Request("bring", "apple", None, "counter"),
        Request("close", "cabinet_right", "drawer_top_slide"),
    ]
    tour = plan_tour(kitchen, fetch, requests)
    assert tour.status == "solved"
    assert [step.plan.task.verb for step in tour.steps] == ["open", "pick", "place", "close"]
    assert not tour.assumed


def test_an_object_that_no_hand_holds_has_its_own_reason(table: Scene, fetch: Robot) -> None:
    wide = SceneObject.box("crate", (0.3, 0.3, 0.3), (-2.0, 2.0, 0.15))
    scene = replace(table, objects=(*table.objects, wide))
    tour = plan_tour(scene, fetch, [Request("bring", "crate", None, "table")])
    assert tour.status == "infeasible"
    assert "it is 30.0 cm wide" in str(tour.steps[-1].plan.candidates.rejections)


@pytest.mark.parametrize(
    ("point", "known"),
    [("2.85,-2.75,0.9", "a face of table is at 0.740 m"), ("1,-1.5,0.5", "the floor is at 0 m")],
)
def test_nothing_is_put_down_in_the_air(
    kitchen: Scene, fetch: Robot, point: str, known: str
) -> None:
    with pytest.raises(TaskError, match=f"nothing carries bottle at {point}; {known}"):
        plan_tour(kitchen, fetch, [Request("bring", "bottle", None, point)])


def test_bring_needs_a_place() -> None:
    words = error_of("place", "pick", "kitchen_small", "cup", "then", "bring", "cup")
    assert "bring cup needs a place: an object or a part of it" in words


@pytest.mark.parametrize("timeout", [0.05, 0.4, 60.0])
def test_an_answer_about_a_closed_container_is_no_or_late(
    kitchen: Scene, fetch: Robot, timeout: float
) -> None:
    request, config = (
        [Request("bring", "bottle", None, "dishwasher")],
        PipelineConfig(timeout=timeout),
    )
    try:
        status = plan_tour(kitchen, fetch, request, config=config).status
    except OutOfTimeError:
        status = "timeout"
    assert status == "infeasible" if timeout > 1.0 else status in ("infeasible", "timeout")


def test_one_grasp_of_a_rigid_object_runs_stored_machine_code(kitchen: Scene, fetch: Robot) -> None:
    """A read-only array has another type: its kernels would be compiled for it, in 30 s."""
    task = make_task(kitchen, "pick", "bottle")
    motion = task_motion(kitchen, fetch, task, PipelineConfig().motion)
    one = motion.only(np.arange(len(motion.Ts_world_tool)) == 0)
    for array in one.hand_loads:
        assert array.flags.c_contiguous
        assert array.flags.writeable


def test_an_object_is_let_down_less_far_under_a_shelf_than_it_was_lifted(fetch: Robot) -> None:
    carton = SceneObject.box("carton", (0.06, 0.1, 0.25), (0.0, 1.0, 0.825))
    table = SceneObject.box("table", (0.6, 0.5, 0.7), (0.0, 1.2, 0.35))
    board = SceneObject.box("board", (0.8, 0.35, 0.02), (2.0, 1.2, 0.69))
    roof = SceneObject.box("roof", (0.8, 0.35, 0.02), (2.0, 1.2, 1.01))
    scene = Scene("room", (carton, table, board, roof), start=np.array([1.0, -1.0, 1.57]))
    tour = plan_tour(scene, fetch, [Request("bring", "carton", None, "2.0,1.1,0.7")])
    assert tour.status == "solved"
    lifts = [step.prepared.motion.lift for step in tour.steps]
    assert lifts == pytest.approx([0.05, 0.03])
