"""The exact check of a suite assumes what the plan assumes."""

from __future__ import annotations

from dataclasses import replace

import momapos
from momapos.apps.bench.job import Step, _verify
from momapos.model.records.plans import JointResistance


def test_a_plan_is_checked_with_the_resistance_that_it_assumes() -> None:
    scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("segway_ur5e")
    task = momapos.make_task(scene, "open", "fridge", "door_hinge")
    plan = momapos.plan_base_placement(scene, robot, task).plan
    step = Step(scene, task, None)
    assert _verify(step, plan, robot) == (True, "")
    heavy = JointResistance(seal_force=400.0, friction=200.0)
    valid, why = _verify(
        step, replace(plan, resistance={"fridge": {"door_hinge": heavy}}), robot
    )  # the same motion
    assert not valid
    assert "effort" in why or "tipping" in why
