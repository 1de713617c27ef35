"""Laws of bad arguments: a public name handles them, or raises a readable `MomaposError`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.shapes import unchecked

import momapos

NAN = float("nan")
HOSTILE: dict[str, Any] = {
    "None": None,
    "text": "no such name",
    "empty text": "",
    "NUL": "a\0b",
    "NaN": NAN,
    "infinity": float("inf"),
    "zero": 0,
    "minus one": -1,
    "huge": 10**30,
    "empty": (),
    "two numbers": (0.0, 0.0),
    "NaN in three": (NAN, 0.0, 0.0),
    "matrix": np.full((2, 2), NAN),
    "object": object(),
    "list": [None],
    "dict": {"a": 1},
}
OUTPUTS = {
    "Attempt", "Importance", "Motion", "MomaposError", "PlacementPlan", "PlacementResult",
    "ReachMap", "Robot", "ScanAnswer", "SceneReport", "TimedTrajectory", "Tolerance", "Tour",
}  # fmt: skip
"""Records that momapos returns; the functions that take them are tested with them."""
METHODS = {
    "with_grasps",
    "with_inverse_kinematics",
    "SceneObject.from_mesh",
    "SceneObject.from_trimesh",
}
"""Further ways to make a record."""
TRIANGLE = {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return valid arguments by parameter name."""
    folder = tmp_path_factory.mktemp("hostile")
    scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("segway_ur5e")
    task = momapos.make_task(scene, "open", "fridge", "door_hinge")
    config = momapos.PipelineConfig(place=momapos.PlaceConfig(count=64, rounds=1, grid=False))
    plan = momapos.plan_base_placement(scene, robot, task, config=config).plan
    momapos.write_plan(plan, folder / "plan.json")
    reach = momapos.load_reach_map(robot)
    (folder / "poses.csv").write_text("x,y,z\n0,0,9\n")
    return {
        "folder": folder, "scene": scene, "robot": robot, "task": task, "config": config,
        "plan": plan, "reach": reach, "base_pose": plan.base_pose,
    }  # fmt: skip


def calls(given: dict[str, Any]) -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Return a valid and quick call of each public name."""
    m, of = momapos, {key: given[key] for key in ("scene", "robot", "task")}
    folder: Path = given["folder"]
    quick = {**of, "reach": given["reach"], "config": given["config"], "start": None, "seed": 0,
             "region": m.BaseRegion(), "keep_poses": None, "keep_grasps": None}  # fmt: skip
    at_pose = {**quick, "base_pose": given["base_pose"]}
    task = {"verb": "open", "object": "fridge", "joint": "door_hinge", "to": 1.0}
    tour = {"scene": of["scene"], "robot": of["robot"], "requests": [m.Request(*task.values())]}
    return {
        "load_scene": (m.load_scene, {"source": "kitchen_small", "root": None}),
        "save_scene": (m.save_scene, {"scene": room(), "path": folder / "scene.json"}),
        "load_robot": (m.load_robot, {"source": "segway_ur5e", "arm": None}),
        "with_inverse_kinematics": (of["robot"].with_inverse_kinematics, {"solve": len}),
        "with_grasps": (of["robot"].with_grasps, {"source": len}),
        "make_task": (m.make_task, {"scene": of["scene"], "verb": "open",
                                    "object_name": "fridge", "joint": "door_hinge", "to": 1.0}),
        "openable": (m.openable, {"scene": of["scene"]}),
        "check_scene": (m.check_scene, {"scene": of["scene"], "robot": None}),
        "rank": (m.rank, {"scene": of["scene"], "target": "fridge", "config": None, "seed": 0,
                          "path": None}),
        "load_reach_map": (m.load_reach_map, {"robot": of["robot"], "config": None}),
        "plan_base_placement": (m.plan_base_placement, quick),
        "plan_by_method": (m.plan_by_method, quick),
        "iter_placements": (lambda **a: next(m.iter_placements(**a), None), quick),
        "check_base_pose": (m.check_base_pose, {**at_pose, "how_far": False}),
        "placement_tolerance": (m.placement_tolerance, {**at_pose, "samples": 1}),
        "plan_tour": (m.plan_tour, {**tour, "reach": given["reach"], "config": given["config"]}),
        "plan_reach": (m.plan_reach, {
            "scene": of["scene"], "robot": of["robot"], "poses": [m.ToolPose((0.0, 0.0, 9.0))],
            "reach": given["reach"], "config": given["config"], "in_order": False}),
        "plan_follow": (m.plan_follow, {
            "scene": of["scene"], "robot": of["robot"], "reach": given["reach"],
            "path": m.ToolPath((m.ToolPose((0.0, 0.0, 9.0)), m.ToolPose((0.1, 0.0, 9.0)))),
            "config": given["config"]}),
        "ToolPath": (m.ToolPath, {
            "poses": (m.ToolPose((0.0, 0.0, 1.0)), m.ToolPose((0.1, 0.0, 1.0))), "breaks": (),
            "speed": 0.1}),
        "load_path": (m.load_path, {"path": folder / "poses.csv", "scene": of["scene"]}),
        "ToolPose": (m.ToolPose, {"xyz": (0.0, 0.0, 1.0)}),
        "load_poses": (m.load_poses, {"path": folder / "poses.csv", "scene": of["scene"]}),
        "PlacementQuery": (m.PlacementQuery.of, quick),
        "read_plan": (m.read_plan, {"path": folder / "plan.json"}),
        "write_plan": (m.write_plan, {"plan": given["plan"], "path": folder / "again.json"}),
        "verify_files": (m.verify_files, {"plan_path": folder / "plan.json", "scene_root": None}),
        "time_plan": (m.time_plan, {"plan": given["plan"], "robot": of["robot"],
                                    "config": m.SpeedConfig(), "step": 0.1}),
        "read_scan": (m.read_scan, {"path": folder, "max_frames": 1, "depth_scale": None}),
        "scan_to_scene": (m.scan_to_scene, {"scan": None, "out": folder / "scan.json"}),
        "solve_scan": (m.solve_scan, {"scan": None, "arms": (), "task": None,
                                      "out": folder / "scan.json"}),
        "Task": (m.Task, task),
        "Request": (lambda **a: m.plan_tour(of["scene"], of["robot"], [m.Request(**a)],
                                            given["reach"], config=given["config"]), task),
        "BaseRegion": (m.BaseRegion, {"keep_in": (), "keep_out": (), "facing": 1.0,
                                      "most_driving": 1.0}),
        "JointResistance": (m.JointResistance, {"seal_force": 20.0, "friction": 2.0, "mass": 6.0,
                                                "balanced": True}),
        "Scene": (lambda **a: m.Scene(**{"name": "room", "objects": (), **a}).objects, {}),
        "SceneObject": (m.SceneObject.box, {"name": "box", "size": (1.0, 1.0, 1.0),
                                            "xyz": (0.0, 0.0, 0.0), "yaw": 0.0}),
        "SceneObject.from_mesh": (m.SceneObject.from_mesh, {
            "name": "mesh", **TRIANGLE, "xyz": (0.0, 0.0, 0.0), "yaw": 0.0, "category": ""}),
        "SceneObject.from_trimesh": (m.SceneObject.from_trimesh, {
            "name": "mesh", "mesh": SimpleNamespace(**TRIANGLE), "xyz": (0.0, 0.0, 0.0)}),
        "ScanTask": (lambda **a: m.solve_scan(None, (), m.ScanTask(**a), folder), task),
        **{name: (getattr(m, name), defaults(getattr(m, name)))
           for name in m.__all__ if name.endswith("Config")},
    }  # fmt: skip


def room() -> momapos.Scene:
    return momapos.Scene("room", (momapos.SceneObject.box("box", (1, 1, 1), (0, 0, 0.5)),))


def defaults(config: Any) -> dict[str, Any]:
    assert is_dataclass(config)
    return {
        item.name: item.default if item.default is not MISSING else item.default_factory()  # type: ignore[misc]
        for item in fields(config)
    }


def test_each_public_name_is_tested(given: dict[str, Any]) -> None:
    assert set(momapos.__all__) | METHODS == set(calls(given)) | OUTPUTS


@pytest.mark.parametrize("name", sorted({*momapos.__all__, *METHODS} - OUTPUTS))
def test_a_hostile_argument_is_accepted_or_refused_with_a_message(
    name: str, given: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, valid = calls(given)[name]
    missed = []
    for argument in valid:
        for what, value in HOSTILE.items():
            error = raised_by(call, {**valid, argument: value})
            refused = isinstance(error, momapos.MomaposError) and "--" not in str(error)
            if error is not None and not refused:
                missed.append(f"{argument}={what}: {type(error).__name__}: {error!s:.90}")
    assert missed == []


def raised_by(call: Callable[..., Any], arguments: dict[str, Any]) -> Exception | None:
    try:
        with unchecked():
            call(**arguments)
    except Exception as error:
        return error
    return None


def test_missing_and_unknown_arguments_are_named(given: dict[str, Any]) -> None:
    scene, robot, task = (given[key] for key in ("scene", "robot", "task"))
    with pytest.raises(momapos.MomaposError, match="scene, robot and task are needed"):
        momapos.plan_base_placement(scene)
    with pytest.raises(momapos.MomaposError, match="unknown argument 'sped'"):
        momapos.plan_base_placement(scene, robot, task, sped=1)
    with pytest.raises(momapos.MomaposError, match="base_pose is needed"):
        momapos.check_base_pose(scene, robot, task)


def test_a_query_answers_as_its_parts_do(given: dict[str, Any]) -> None:
    parts = {key: given[key] for key in ("scene", "robot", "task", "reach", "config")}
    query = momapos.PlacementQuery.of(**parts)
    assert momapos.plan_base_placement(query).plan == momapos.plan_base_placement(**parts).plan
    assert inspect.signature(momapos.PlacementQuery.of).parameters["seed"].default == 0


def test_plans_are_equal_and_hashed_by_content(given: dict[str, Any]) -> None:
    plan = momapos.read_plan(given["folder"] / "plan.json")
    again = momapos.read_plan(str(given["folder"] / "plan.json"))
    assert plan == again
    assert hash(plan) == hash(again)
    other = replace(plan.motion, q=plan.motion.q + 1e-9)
    assert replace(plan, motion=other) != plan


def test_a_plan_of_another_robot_is_not_timed(given: dict[str, Any]) -> None:
    with pytest.raises(momapos.MomaposError, match="not for robot fetch"):
        momapos.time_plan(given["plan"], momapos.load_robot("fetch"))


def test_an_object_and_its_joint_can_be_one_name(given: dict[str, Any]) -> None:
    one = momapos.make_task(given["scene"], "open", "fridge/door_hinge")
    assert one == momapos.make_task(given["scene"], "open", "fridge", "door_hinge")


def test_keep_poses_keeps_what_it_returns_true_for(given: dict[str, Any]) -> None:
    parts = {key: given[key] for key in ("scene", "robot", "task", "reach", "config")}
    plan = momapos.plan_base_placement(**parts, keep_poses=lambda poses: poses[:, 0] < 0.6).plan
    assert plan.base_pose is None or plan.base_pose[0] < 0.6
    with pytest.raises(momapos.MomaposError, match="keep_poses must return"):
        momapos.plan_base_placement(**parts, keep_poses=lambda poses: poses[:, 0])


def test_functions_that_change_their_arguments_do_not_change_the_answer(
    given: dict[str, Any],
) -> None:
    parts = {key: given[key] for key in ("scene", "robot", "task", "config")}

    def zeroed(poses: np.ndarray) -> np.ndarray:
        poses[:] = 0.0
        return np.zeros(len(poses))

    class Zeroed:
        def min_score(self, bases: np.ndarray, Ts_world_tool: np.ndarray) -> np.ndarray:
            bases[:], Ts_world_tool[:] = 0.0, 0.0
            return np.ones((len(bases), len(Ts_world_tool)))

    plain = momapos.plan_base_placement(**parts, reach=given["reach"]).plan
    for name, value in (
        ("pose_cost", zeroed), ("keep_poses", lambda poses: zeroed(poses) == 0.0)
    ):  # fmt: skip
        found = momapos.plan_base_placement(**parts, reach=given["reach"], **{name: value}).plan
        assert found.base_pose == plain.base_pose
    assert momapos.plan_base_placement(**parts, reach=Zeroed()).plan.feasible


@pytest.mark.parametrize(
    ("scores", "match"),
    [
        (lambda n, g: np.full((n, g), NAN), r"scores in \[0, 1\]"),
        (lambda n, g: np.full((n, g), 1.5), r"scores in \[0, 1\]"),
        (lambda n, _: np.ones(n), "an array of shape"),
        (lambda *_: None, "an array of shape"),
        (lambda n, g: [["a"] * g] * n, "an array of shape"),
    ],
)
def test_wrong_scores_of_a_reach_scorer_are_refused(
    given: dict[str, Any], scores: Callable[[int, int], Any], match: str
) -> None:
    parts = {key: given[key] for key in ("scene", "robot", "task", "config")}
    wrong = SimpleNamespace(min_score=lambda bases, Ts: scores(len(bases), len(Ts)))
    with unchecked(), pytest.raises(momapos.MomaposError, match=match):
        momapos.plan_base_placement(**parts, reach=wrong)
