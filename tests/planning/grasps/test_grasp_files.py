"""Laws of files of grasps: every format holds the same, and such grasps are used alone or first."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of, output_of

from momapos.core.errors import FileFormatError, InputError
from momapos.core.geometry.transforms import invert
from momapos.model.records.plans import Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.config import MotionConfig
from momapos.planning.grasps.grasp_files import FRANKA_DEPTH, load_grasps
from momapos.planning.grasps.hand_boxes import hand_of
from momapos.planning.grasps.own_grasps import nearest_shifted
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task


@pytest.fixture(scope="module")
def task(kitchen: Scene) -> Task:
    return make_task(kitchen, "pick", "cup")


@pytest.fixture(scope="module")
def ours(kitchen: Scene, segway: Robot, task: Task) -> np.ndarray:
    """Return the grasps of the cup in its frame."""
    motion = task_motion(kitchen, segway, task, MotionConfig())
    return invert(kitchen.object("cup").T_world_object) @ motion.Ts_world_tool[:, motion.grasp_step]


def written(path: Path, value: object) -> Path:
    path.write_text(json.dumps(value))
    return path


def quaternion(R: np.ndarray) -> list[float]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_quat().tolist()


def as_files(folder: Path, robot: Robot, T: np.ndarray) -> dict[str, Path]:
    """Return one grasp in every format, as the hand of each would hold it."""
    hand, R = hand_of(robot), T[:3, :3]
    approach, closing = R @ hand.approach, R @ hand.closing
    across = np.cross(approach, closing)
    tip = T[:3, 3] + hand.tip * approach
    panda = np.eye(4)
    panda[:3, :3] = np.column_stack([closing, across, approach])
    panda[:3, 3] = tip - FRANKA_DEPTH * approach
    x, y, z, w = quaternion(panda[:3, :3])
    net = np.column_stack([approach, closing, across])
    row = [0.7, 0.08, 0.02, 0.03, *net.ravel(), *(tip - 0.03 * approach), 0.0]
    np.save(folder / "graspnet.npy", np.array([row]))
    isaac = {
        "format": "isaac_grasp",
        "grasps": {
            "failed": {"confidence": 0.0, "position": [0, 0, 0],
                       "orientation": {"w": 1, "xyz": [0, 0, 0]}},
            "good": {"confidence": 0.7, "position": panda[:3, 3].tolist(),
                     "orientation": {"w": w, "xyz": [x, y, z]}},
        },
    }  # fmt: skip
    data = {
        "object": {"file": "cup.obj", "scale": 1.0},
        "grasps": {
            "transforms": [np.eye(4).tolist(), panda.tolist()],
            "object_in_gripper": [False, True],
        },
    }
    message = {
        name: dict(zip("xyz", vector.tolist(), strict=True))
        for name, vector in (
            ("approach", approach), ("binormal", closing), ("axis", across),
            ("position", tip - 0.06 * approach),
        )
    }  # fmt: skip
    return {
        "own": written(folder / "own.json", [{"matrix": T.tolist(), "score": 0.7}]),
        "isaac": written(folder / "isaac.yaml", isaac),
        "graspgen": written(folder / "graspgen.json", data),
        "gpd": written(folder / "gpd.yaml", {"grasps": [message | {"score": {"data": 0.7}}]}),
        "graspnet": folder / "graspnet.npy",
    }


@pytest.mark.parametrize("kind", ["own", "isaac", "graspgen", "gpd", "graspnet"])
def test_every_format_gives_the_same_grasp(
    kind: str, kitchen: Scene, segway: Robot, task: Task, ours: np.ndarray, tmp_path: Path
) -> None:
    T = ours[0]
    found = load_grasps(as_files(tmp_path, segway, T)[kind], kitchen, segway, task)
    assert np.allclose(found.Ts_link_tool[0], T, atol=1e-6)
    assert len(found.Ts_link_tool) == (1 if kind == "own" else 8)
    assert kind == "graspgen" or found.names[0].endswith("score 0.7")
    assert not len(found("plate", None))


def test_a_hand_of_another_kind_may_hold_to_either_side_and_is_pulled_back(
    kitchen: Scene, segway: Robot, task: Task, ours: np.ndarray, tmp_path: Path
) -> None:
    found = load_grasps(as_files(tmp_path, segway, ours[0])["isaac"], kitchen, segway, task)
    hand, T = hand_of(segway), ours[0]
    R = found.Ts_link_tool[:, :3, :3]
    assert np.allclose(R @ hand.approach, T[:3, :3] @ hand.approach)
    assert set(np.round(R @ hand.closing @ (T[:3, :3] @ hand.closing)).tolist()) == {1.0, -1.0}
    back = (T[:3, 3] - found.Ts_link_tool[:, :3, 3]) @ (T[:3, :3] @ hand.approach)
    assert sorted(set(np.round(back, 6).tolist())) == pytest.approx([0.0, 0.01, 0.02, 0.03])


def test_grasps_in_the_world_are_those_in_the_object(
    kitchen: Scene, segway: Robot, task: Task, ours: np.ndarray, tmp_path: Path
) -> None:
    T_world = kitchen.object("cup").T_world_object @ ours[0]
    path = written(tmp_path / "world.json", [{"matrix": T_world.tolist()}])
    found = load_grasps(path, kitchen, segway, task, frame="world")
    assert np.allclose(found.Ts_link_tool[0], ours[0])


def test_alone_only_the_files_grasps_are_tried_and_each_of_ours_is_one(
    kitchen: Scene, segway: Robot, task: Task, ours: np.ndarray, tmp_path: Path
) -> None:
    some = ours[:: max(1, len(ours) // 20)][:20]
    path = written(tmp_path / "own.json", [{"matrix": T.tolist()} for T in some])
    robot = segway.with_grasps(load_grasps(path, kitchen, segway, task))
    config = replace(MotionConfig(), grasps=replace(MotionConfig().grasps, own="only"))
    motion = task_motion(kitchen, robot, task, config)
    tried = (
        invert(kitchen.object("cup").T_world_object) @ motion.Ts_world_tool[:, motion.grasp_step]
    )
    which = nearest_shifted(tried, some, segway.closing_axis)
    assert set(which.tolist()) == set(range(len(some)))


def test_the_command_takes_the_grasp_of_the_file_and_names_it(
    ours: np.ndarray, tmp_path: Path
) -> None:
    rows = [{"matrix": T.tolist(), "name": f"mine {k}"} for k, T in enumerate(ours)]
    path = str(written(tmp_path / "own.json", rows))
    words = ["place", "pick", "kitchen_small", "cup", "--robot", "segway_ur5e", "--grasps"]
    assert "takes mine" in output_of(*words, path)
    far = str(written(tmp_path / "far.json", [{"xyz": [1, 0, 0], "wxyz": [1, 0, 0, 0]}]))
    assert "(at 1 grasps of your own)" in output_of(*words, far, status=3)
    both = output_of(*words, far, "--set", "motion.grasps.own=first")
    assert "none of your own grasps is taken" in both


def test_mistakes_are_named(kitchen: Scene, segway: Robot, task: Task, tmp_path: Path) -> None:
    for value, words in (
        ([], "has no grasps"),
        ([{"xyz": [0, 0, 0]}], "grasp 1: needs xyz and wxyz"),
        ([{"xyz": [0, 0, 0], "wxyz": [1, 1, 0, 0]}], "grasp 1: quaternion has length"),
        ([{"xyz": [0, 0, 0], "wxyz": [1, 0, 0, 0], "score": "a"}], "score must be a number"),
        ({"grasps": {"a": {"position": [0, 0, 0]}}}, "a: needs position and orientation"),
        ({"grasps": [{"approach": [1, 0, 0], "binormal": [1, 0, 0], "position": [0, 0, 0]}]},
         "right angle"),
    ):  # fmt: skip
        path = written(tmp_path / "wrong.json", value)
        with pytest.raises(InputError, match=words):
            load_grasps(path, kitchen, segway, task)
    np.save(tmp_path / "wrong.npy", np.full((2, 17), math.nan))
    with pytest.raises(InputError, match="finite"):
        load_grasps(tmp_path / "wrong.npy", kitchen, segway, task)
    with pytest.raises(FileFormatError):
        load_grasps(tmp_path / "missing.json", kitchen, segway, task)
    line = error_of("place", "pick", "kitchen_small", "cup", "--grasps", "missing.json")
    assert "missing.json" in line
