"""An infeasible answer names a change with which a plan exists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import HINGE, carcass, furniture_room, link

from momapos.apps.cli.main import main
from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.records.tasks import BaseRegion
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import save_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.planning.advice import objects_in_the_way, with_advice
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery

DOOR = link(
    "door", ((0.02, 0.59, 0.88), (0, 0.295, 0)), handle=((0.02, 0.02, 0.16), (-0.05, 0.53, 0.1))
)


@pytest.fixture
def room(tmp_path: Path) -> Scene:
    scene = furniture_room(tmp_path, [carcass(), DOOR, HINGE])
    crate = SceneObject.box("crate", (1.4, 5.0, 0.6), (-0.35, 0.0, 0.3), category="crate")
    vase = SceneObject.box("vase", (0.1, 0.1, 0.3), (0.8, 0.1, 1.05), category="vase")
    start = np.array([-2.5, 0.0, 0.0])
    full = replace(scene, objects=(*scene.objects, vase, crate), start=start)
    return save_scene(full, tmp_path / "scene.json")


def test_the_object_that_keeps_the_robot_away_is_named(
    robots: Callable[[str], Robot], room: Scene, tmp_path: Path
) -> None:
    query = PlacementQuery.of(room, robots("fetch"), make_task(room, "open", "cupboard"))
    answer = plan_placement(query)
    assert answer.plan.status == "infeasible"
    assert set(objects_in_the_way(answer, query)) == {"vase", "crate"}
    advised = with_advice(answer).plan
    assert advised.advice.startswith("feasible without crate, from (")
    write_plan(advised, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").advice == advised.advice


def test_a_restriction_of_the_base_pose_is_named(
    robots: Callable[[str], Robot], room: Scene
) -> None:
    free = replace(room, objects=tuple(o for o in room.objects if o.name != "crate"))
    far = BaseRegion(keep_in=(((-9.0, -9.0), (-7.0, -9.0), (-7.0, -7.0)),))
    task = make_task(free, "open", "cupboard")
    answer = plan_placement(PlacementQuery.of(free, robots("fetch"), task, region=far))
    advised = with_advice(answer).plan
    assert advised.advice.startswith("feasible without the restrictions of the base pose, from (")


def test_solved_answers_and_late_trials_get_no_advice(
    robots: Callable[[str], Robot], room: Scene
) -> None:
    query = PlacementQuery.of(room, robots("fetch"), make_task(room, "open", "cupboard"))
    answer = plan_placement(query)
    ticks = iter(np.arange(0.0, 1e9, 100.0))
    assert with_advice(answer, clock=lambda: float(next(ticks))).plan.advice == ""
    free = replace(room, objects=room.objects[:1])
    solved = plan_placement(replace(query, scene=free))
    assert with_advice(solved) is solved


def test_the_command_prints_the_advice_unless_told_not_to(
    room: Scene, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["place", "open", str(room.path), "cupboard", "--robot", "fetch"]
    assert main(words) == 3
    assert "\n  advice      feasible without crate, from (" in capsys.readouterr().out
    assert main([*words, "--no-advice"]) == 3
    assert "advice" not in capsys.readouterr().out
