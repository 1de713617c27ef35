"""The set S in planning: which objects are modeled, which are added, and that none is missed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from momapos.model.plan_files.plan_format import read_plan, write_plan
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.importance.config import ImportanceConfig
from momapos.planning.importance.ranking import Selection, everything, rank
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.result import PlacementResult
from momapos.verification.exact_check import PlanVerifier
from rooms import Everywhere, cabinet_room

QUICK = PipelineConfig(place=PlaceConfig(count=256, polish=1), timeout=600.0)
PORCH = """, {"name": "porch", "category": "porch", "urdf": "porch.urdf", "scale": 1.0,
 "joints": {}, "pose": {"xyz": [0, -1.2, 0], "wxyz": [1, 0, 0, 0]}}"""
"""Four thin posts: the box around them covers the floor in front of the cabinet."""


def porch_room(folder: Path) -> Scene:
    posts = "".join(
        f'<collision><origin xyz="{x} {y} 1"/><geometry><box size="0.04 0.04 2"/></geometry>'
        "</collision>"
        for x in (-1.8, 1.8)
        for y in (-0.9, 0.9)
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "porch.urdf").write_text(
        f'<robot name="porch"><link name="posts">{posts}</link></robot>'
    )
    return cabinet_room(folder, extra=PORCH)


def plan_with(
    scene: Scene, robot: Robot, target: str, alpha: float, scorer: str = "distance"
) -> PlacementResult:
    importance = ImportanceConfig(scorer=scorer, alpha=alpha)  # type: ignore[arg-type]
    config = replace(QUICK, importance=importance)
    start = np.array([0.0, -3.2, np.pi / 2]) if target == "cabinet" else None
    name, _, joint = target.partition("/")
    task = make_task(scene, "open", name, joint or None)
    return plan_base_placement(scene, robot, task, Everywhere(), start=start, config=config)


def test_lowering_alpha_ends_with_all_objects_and_never_drops_one(kitchen: Scene) -> None:
    ranked = rank(kitchen, "fridge")
    selection, sizes = Selection(ranked, 1.0), []
    while selection.boxes:
        before, selection = set(selection.names), selection.relax_alpha()
        assert before < set(selection.names)
        sizes.append(len(selection.names))
    assert sizes[-1] == len(ranked.names)
    assert len(sizes) <= np.ceil(np.log2(len(ranked.names)))
    assert everything(ranked).names == ranked.names


def test_an_added_object_stays_regardless_of_its_score(kitchen: Scene) -> None:
    ranked = rank(kitchen, "fridge")
    selection = Selection(ranked, 1.0).join(["cup"])
    assert set(selection.names) == {"fridge", "cup"}
    assert "cup" not in selection.boxes
    assert "cup" in selection.relax_alpha().names


def test_an_object_whose_box_blocks_the_task_is_modeled(tmp_path: Path, segway: Robot) -> None:
    """The robot fits between four posts, but not into the box around them."""
    scene = porch_room(tmp_path)
    assert (
        plan_with(scene.with_box_proxies({"cabinet"}), segway, "cabinet", 0.0).plan.status
        == "infeasible"
    )
    answer = plan_with(scene, segway, "cabinet", 1.0)
    assert answer.plan.status == "solved"
    assert set(answer.plan.key_objects.names) == {"cabinet", "porch"}


@pytest.mark.parametrize("scorer", ["deepwalk", "distance", "size"])
@pytest.mark.parametrize("target", ["fridge/door_hinge", "microwave"])
def test_a_plan_among_boxes_is_valid_among_the_objects(
    scorer: str, target: str, kitchen: Scene, segway: Robot
) -> None:
    answer = plan_with(kitchen, segway, target, 1.0, scorer)
    plan, key = answer.plan, answer.plan.key_objects
    assert plan.status == "solved"
    assert (
        PlanVerifier(kitchen, segway, plan.task).first_violation(plan.base_pose, plan.motion)
        is None
    )
    assert plan.task.object in key.names
    assert len(key.names) < len(kitchen.objects)
    assert set(key.scores) == {item.name for item in kitchen.objects}


def test_an_object_near_the_plan_is_added_and_the_plan_is_checked_again(
    kitchen: Scene, segway: Robot
) -> None:
    """The counter below the microwave scores less than 1 by walks; the hand passes over it."""
    key = plan_with(kitchen, segway, "microwave", 1.0, "deepwalk")
    joined = key.plan.key_objects
    assert joined.rounds > 0
    assert {"microwave", "counter"} <= set(joined.names)
    assert joined.scores["counter"] < joined.alpha


def test_the_plan_file_lists_the_modeled_objects(
    tmp_path: Path, kitchen: Scene, segway: Robot
) -> None:
    answer = plan_with(kitchen, segway, "microwave", 0.9)
    write_plan(answer.plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").key_objects == answer.plan.key_objects


def test_each_box_contains_its_object() -> None:
    """So a pose that is free among boxes is free among objects."""
    scene = load_scene("kitchen_island")
    for item in scene.objects:
        box = item.box_proxy
        half = np.array(box.model.urdf.links["box"].collisions[0].size) / 2
        local = (item.vertices - box.T_world_object[:3, 3]) @ box.T_world_object[:3, :3]
        assert (np.abs(local) <= half + 1e-9).all()
        assert not box.model.joints
