"""Laws of refusals that name how far each use of the base moves a part."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest

from momapos.model.records.plans import PlacementPlan
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
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


def refused(scene: Scene, item: str, base: BaseUse) -> PlacementPlan:
    """Return the plan of a Stretch, which opens neither lid nor wall cabinet."""
    robot = load_robot("stretch")
    config = PipelineConfig(place=SAMPLED, base=base)
    task = make_task(scene, "open", *item.split("/"))
    answer = plan_base_placement(scene, robot, task, config=config, clock=time.process_time)
    assert answer.plan.status == "infeasible"
    return with_max_opening(answer, clock=time.process_time).plan


@pytest.fixture(scope="module")
def plan(kitchen: Scene) -> PlacementPlan:
    """Return the plan for a freezer whose door no use of the base opens."""
    return refused(kitchen, FREEZER, "auto")


def test_a_refusal_names_how_far_each_use_moves_the_part_and_what_stops_it(
    kitchen: Scene, plan: PlacementPlan, stretch: Robot
) -> None:
    assert [words.startswith(use) for words, use in zip(plan.notes, USES, strict=True)] == [
        True
    ] * 3
    still, _, moving = plan.notes
    assert "no motion even to 11 deg was found: " in still
    assert not plan.feasible_sure
    assert moving.startswith(
        f"{USES[2]}the part moves at least to {np.degrees(plan.feasible_to):.0f} deg; no motion to "
    )
    task = make_task(kitchen, "open", *FREEZER.split("/"), plan.feasible_to)
    config = PipelineConfig(place=SAMPLED)
    again = plan_moving(PlacementQuery.of(kitchen, stretch, task, config=config))
    assert again.plan.base_pose == plan.feasible_from


def test_what_a_refusal_states_is_what_direct_questions_find(
    kitchen: Scene, plan: PlacementPlan, stretch: Robot
) -> None:
    """Each stated value that is reached has a plan, and each other one has none."""
    count = 0
    for note in plan.notes:
        use = dict(zip(USES, ("fixed", "stops", "moving"), strict=True))[f"{note.split(', ')[0]}, "]
        for words, number in re.findall(r"(at least|even|no motion) to ([\d.]+) deg", note):
            task = make_task(kitchen, "open", *FREEZER.split("/"), f"{number}deg")
            config = PipelineConfig(place=SAMPLED, base=use)
            found = plan_base_placement(kitchen, stretch, task, config=config)
            assert (found.plan.status == "solved") == (words == "at least"), note
            count += 1
    assert count >= 3


@pytest.mark.parametrize(("base", "count"), [("fixed", 0), ("stops", 2)])
def test_only_uses_that_were_allowed_are_named(kitchen: Scene, base: BaseUse, count: int) -> None:
    plan = refused(kitchen, "wall_cabinet/door_left_hinge", base)
    assert len(plan.notes) == count
    assert all("no motion even to 11 deg was found: " in words for words in plan.notes)
    assert plan.feasible_to is None
