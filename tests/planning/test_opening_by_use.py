"""Laws of refusals that name how far each use of the base moves a part."""

from __future__ import annotations

import time

import numpy as np
import pytest

from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.base_use import plan_moving
from momapos.planning.config import BaseUse, PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.partial_opening import with_max_opening
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.query import PlacementQuery

SAMPLED = PlaceConfig(rounds=1, grid=False)
FREEZER = "fridge/freezer_door_hinge"
USES = ("from one base pose, ", "from up to 3 stops, ", "with a moving base, ")


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_small")


def refused(scene: Scene, item: str, base: BaseUse) -> PlacementPlan:
    """Return the plan of a Stretch, which opens neither lid nor wall cabinet."""
    robot = load_robot("stretch")
    config = PipelineConfig(place=SAMPLED, base=base)
    task = make_task(scene, "open", *item.split("/"))
    answer = plan_base_placement(scene, robot, task, config=config, clock=time.process_time)
    assert answer.plan.status == "infeasible"
    return with_max_opening(answer, clock=time.process_time).plan


def test_a_refusal_names_how_far_each_use_moves_the_part_and_what_stops_it(kitchen: Scene) -> None:
    plan = refused(kitchen, FREEZER, "auto")
    assert [words.startswith(use) for words, use in zip(plan.notes, USES, strict=True)] == [
        True
    ] * 3
    still, _, moving = plan.notes
    assert "no motion even to 11 deg was found: " in still
    assert plan.feasible_to is not None
    assert not plan.feasible_sure
    assert moving.startswith(
        f"{USES[2]}the part moves at least to {np.degrees(plan.feasible_to):.0f} deg; farther: "
    )
    task = make_task(kitchen, "open", *FREEZER.split("/"), plan.feasible_to)
    config = PipelineConfig(place=SAMPLED)
    again = plan_moving(PlacementQuery.of(kitchen, load_robot("stretch"), task, config=config))
    assert again.plan.base_pose == plan.feasible_from


@pytest.mark.parametrize(("base", "count"), [("fixed", 0), ("stops", 2)])
def test_only_uses_that_were_allowed_are_named(kitchen: Scene, base: BaseUse, count: int) -> None:
    plan = refused(kitchen, "wall_cabinet/door_left_hinge", base)
    assert len(plan.notes) == count
    assert all("no motion even to 11 deg was found: " in words for words in plan.notes)
    assert plan.feasible_to is None
