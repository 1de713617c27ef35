"""Motions in which the hand lets go, turns, or pushes, in physics."""

from __future__ import annotations

import numpy as np
import pytest

from momapos.execution.config import Ending, ExecutionConfig, Hold
from momapos.execution.run import execute
from momapos.manipulation.tasks import make_task
from momapos.pipeline import plan_base_placement
from momapos.reachability.store import load_reach_map
from momapos.robots.robot import load_robot
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene
from momapos.types import PlacementPlan


@pytest.fixture(scope="module")
def kitchen() -> Scene:
    return load_scene("kitchen_island")


@pytest.fixture(scope="module")
def plans(kitchen: Scene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, PlacementPlan]:
    robot = load_robot("segway_ur5e")
    reach = load_reach_map(robot, tmp_path_factory.mktemp("maps"))
    return {
        name: plan_base_placement(
            kitchen, robot, make_task(kitchen, "open", name, "door_hinge"), reach
        ).plan
        for name in ("cabinet_back", "fridge")
    }


@pytest.mark.parametrize("hold", ["contact", "weld"])
@pytest.mark.parametrize("item", ["cabinet_back", "fridge"])
def test_a_door_opens_in_two_holds_and_about_a_bar(
    item: str, hold: Hold, kitchen: Scene, plans: dict[str, PlacementPlan]
) -> None:
    plan = plans[item]
    assert plan.motion is not None
    assert plan.base_pose is not None
    two, turns = len(plan.motion.holds) == 2, plan.motion.holds[0].turn_axis is not None
    assert (two, turns) == ((True, False) if item == "cabinet_back" else (False, True))
    done = execute(
        kitchen, load_robot("segway_ur5e"), plan.base_pose, plan.motion, plan.task,
        ExecutionConfig(hold=hold), np.random.default_rng(0),
    )  # fmt: skip
    assert done.success, done.reason
    assert done.ending in (Ending.DONE, Ending.STOPPED_AT_END)
    assert done.hold == hold
