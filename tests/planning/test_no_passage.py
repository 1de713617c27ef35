"""A goal behind a passage that is too narrow is refused before arms are checked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.commands import output_of
from tests.rooms import Everywhere, cabinet_room

from momapos.model.records.outcomes import PoseStatus
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.arm_motion.feasibility import Feasibility
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig

FLOOR = np.array([[-2.0, -4.0], [2.0, -4.0], [2.0, 0.1], [-2.0, 0.1]])


def room(folder: Path, width: float, *, cut: float = -2.2) -> Scene:
    """Return a cabinet behind a wall with a doorway."""
    walls = tuple(
        SceneObject.box(name, (2.0, 0.1, 2.0), (side * (width / 2 + 1.0), cut, 1.0))
        for name, side in (("left", -1), ("right", 1))
    )
    scene = cabinet_room(folder)
    return replace(scene, objects=(*scene.objects, *walls), floor_polygon=FLOOR)


@pytest.mark.parametrize("cut", [-2.2, -2.5])
def test_arms_are_not_checked_behind_a_narrow_door(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: float, husky: Robot
) -> None:
    screened: list[int] = []

    def spied(_self: Feasibility, bases: np.ndarray, *_rest: object) -> None:
        screened.append(len(bases))

    monkeypatch.setattr(Feasibility, "screen", spied)
    scene = room(tmp_path, 0.65, cut=cut)
    task, start = make_task(scene, "open", "cabinet", "hinge"), np.array([0.0, -3.2, 0.0])
    plan = plan_base_placement(scene, husky, task, Everywhere(), start=start).plan
    assert plan.status == "infeasible"
    assert not screened
    words = [word for word in plan.candidates.rejections if word.startswith("no way to drive")]
    assert words == [
        "no way to drive there: 65 cm between left and right, and the robot needs 69 cm"
    ] or words == ["no way to drive there: 65 cm between right and left, and the robot needs 69 cm"]


def test_poses_on_the_near_side_of_a_narrow_door_are_still_tried(
    tmp_path: Path, husky: Robot
) -> None:
    """The door stands so close to the cabinet that poses on both sides are within reach."""
    scene = room(tmp_path, 0.6, cut=-1.2)
    task, start = make_task(scene, "open", "cabinet", "hinge"), np.array([0.0, -3.2, 0.0])
    config = PipelineConfig(place=PlaceConfig(count=256, rounds=1, grid=False))
    result = plan_base_placement(scene, husky, task, Everywhere(), start=start, config=config)
    outcomes = np.concatenate(result.search.outcomes)
    poses = np.concatenate(result.search.poses)
    blocked = np.array([one.status is PoseStatus.NO_PASSAGE for one in outcomes])
    assert (poses[blocked, 1] > -1.2).all()
    others = {one.status for one in outcomes[~blocked & (poses[:, 1] < -1.6)]}
    assert others - {PoseStatus.BEYOND_ARM, PoseStatus.BASE_BLOCKED, PoseStatus.OFF_FLOOR}


@pytest.mark.slow
def test_the_command_names_the_passage(tmp_path: Path) -> None:
    save_scene(room(tmp_path, 0.5), tmp_path / "room.json")
    words = ["place", "open", str(tmp_path / "room.json"), "cabinet/hinge", "--robot", "fetch"]
    assert "infeasible  no way to drive there: 50 cm between" in output_of(
        *words, "--start=0,-3.2,0", status=3
    )


@pytest.mark.parametrize(
    ("name", "width"), [("ranger_rm63", 0.5), pytest.param("tiago", 0.54, marks=pytest.mark.slow)]
)
def test_arms_are_checked_at_few_of_the_base_poses_that_are_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, width: float
) -> None:
    """A disc inside the base passes the doorway, but the robot with its arm at home does not."""
    checked: list[int] = []
    screen = Feasibility.screen

    def spied(self: Feasibility, bases: np.ndarray, *rest: Any) -> Any:
        checked.append(len(bases))
        return screen(self, bases, *rest)

    monkeypatch.setattr(Feasibility, "screen", spied)
    scene, robot = room(tmp_path, width), load_robot(name)
    task, start = make_task(scene, "open", "cabinet", "hinge"), np.array([0.0, -3.2, 0.0])
    config = PipelineConfig(place=PlaceConfig(rounds=1, grid=False))
    plan = plan_base_placement(scene, robot, task, Everywhere(), start=start, config=config).plan
    assert plan.status == "infeasible"
    assert plan.candidates.rejections["no base path with the arm at home"] > 100
    # More than 6,000 checks of one or several poses if the search improves each.
    assert sum(checked) < 2000
