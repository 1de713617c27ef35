"""Laws of several answers to one query."""

from __future__ import annotations

from itertools import islice, pairwise

import numpy as np
import pytest
from tests.rooms import Everywhere

from momapos.core.errors import InputError
from momapos.model.records.plans import BaseRegion, Task
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import iter_placements, plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.verification.exact_check import PlanVerifier

CONFIG = PipelineConfig(place=PlaceConfig(count=1024), timeout=300.0)


@pytest.fixture(scope="module")
def task(kitchen: Scene) -> Task:
    return make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")


def test_the_first_answer_is_the_plan_and_the_others_are_valid_and_ordered(
    kitchen: Scene, segway: Robot, task: Task
) -> None:
    one = plan_base_placement(kitchen, segway, task, Everywhere(), config=CONFIG).plan
    given = iter_placements(kitchen, segway, task, Everywhere(), config=CONFIG)
    plans = [answer.plan for answer in islice(given, 6)]
    given.close()  # type: ignore[attr-defined]
    assert plans[0].base_pose == one.base_pose
    assert len({plan.base_pose for plan in plans}) == len(plans) == 6
    for before, after in pairwise(plans[1:]):
        assert before.navigation_cost <= after.navigation_cost
    verifier = PlanVerifier(kitchen, segway, task)
    for plan in plans:
        assert verifier.check(plan.base_pose, plan.motion).valid
        np.testing.assert_allclose(plan.base_path[-1], plan.base_pose)


def test_no_answer_lies_outside_the_region(kitchen: Scene, segway: Robot, task: Task) -> None:
    config = PipelineConfig(place=PlaceConfig(count=512, rounds=1, grid=False), timeout=300.0)
    every = list(iter_placements(kitchen, segway, task, Everywhere(), config=config))
    costs = [answer.plan.navigation_cost or 0.0 for answer in every]
    most = float(np.median(costs))
    region = BaseRegion(most_driving=most)
    near = list(iter_placements(kitchen, segway, task, Everywhere(), region=region, config=config))
    assert 0 < len(near) < len(every)
    assert all((answer.plan.navigation_cost or 0.0) <= most for answer in near)
    nowhere = BaseRegion(most_driving=0.0)
    assert not list(
        iter_placements(kitchen, segway, task, Everywhere(), region=nowhere, config=config)
    )


def test_the_time_of_the_caller_does_not_count(kitchen: Scene, segway: Robot, task: Task) -> None:
    now = 0.0
    config = PipelineConfig(place=PlaceConfig(count=64), timeout=1.0)
    given = iter_placements(kitchen, segway, task, Everywhere(), config=config, clock=lambda: now)
    for answer in islice(given, 3):
        assert answer.plan.status == "solved"
        now += 100.0


def test_a_task_without_a_value_is_refused(kitchen: Scene, segway: Robot) -> None:
    most = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide", "max")
    with pytest.raises(InputError, match="needs a value"):
        next(iter_placements(kitchen, segway, most, Everywhere(), config=CONFIG))
    other = PipelineConfig(place=PlaceConfig(method="habitat"))
    with pytest.raises(InputError, match="habitat"):
        next(iter_placements(kitchen, segway, most, Everywhere(), config=other))
