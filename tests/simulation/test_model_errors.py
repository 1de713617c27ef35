"""Worlds that differ from their scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.simulation.toy import execute

from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.config import ExecutionConfig, FurnitureConfig, ModelErrorConfig, Stage
from momapos.simulation.simulated_room import Deviation
from momapos.simulation.simulation import Simulation
from momapos.simulation.worlds import draw_deviation, mirrored

TILT = 0.15


def test_a_mirrored_joint_has_the_opposite_offset() -> None:
    axis = np.array([0.0, 1.0, 0.0])
    config = ModelErrorConfig(handle=0.01, axis=0.03, tilt=TILT)
    one = draw_deviation(axis, config, np.random.default_rng(3))
    other = mirrored(one, axis)
    np.testing.assert_allclose(other.shift, -one.shift)
    np.testing.assert_array_equal(other.offset, one.offset)
    assert np.linalg.norm(other.axis) == pytest.approx(1.0)
    assert other.axis @ axis == pytest.approx(one.axis @ axis)
    np.testing.assert_allclose(one.axis + other.axis, 2 * np.cos(TILT) * axis, atol=1e-12)


@pytest.mark.slow
def test_a_drawer_on_a_tilted_slide_stays_closed_until_it_is_pulled(
    kitchen: Scene, segway: Robot
) -> None:
    task = make_task(kitchen, "open", "cabinet_right", "drawer_middle_slide")
    plan = plan_base_placement(kitchen, segway, task).plan
    assert plan.motion is not None
    assert plan.base_pose is not None
    # A heavy drawer without a latch: with the last two seeds it would slide open.
    config = ExecutionConfig(
        furniture=replace(FurnitureConfig(), density=5000.0, latch_force=0.0),
        errors=ModelErrorConfig(tilt=TILT),
    )
    for seed in (4, 7, 8):
        before: list[float] = []

        def watch(world: Simulation, _: float, stage: Stage, before: list[float] = before) -> None:
            if stage in (Stage.SETTLE, Stage.APPROACH):
                before.append(float(world.data.qpos[world.part_q]))

        execute(
            kitchen, segway, plan.base_pose, plan.motion, task, config,
            np.random.default_rng(seed), watch=watch,
        )  # fmt: skip
        assert len(before) > 10
        assert max(before) < 0.005


@pytest.mark.parametrize("verb", [pytest.param("open", marks=pytest.mark.slow), "close"])
def test_only_a_closed_part_is_known_not_to_move_by_its_weight(
    verb: str, monkeypatch: pytest.MonkeyPatch, kitchen: Scene, segway: Robot
) -> None:
    scene = kitchen
    if verb == "close":
        scene = scene.with_joint("cabinet_right", "drawer_middle_slide", 0.15)
    task = make_task(scene, verb, "cabinet_right", "drawer_middle_slide")
    plan = plan_base_placement(scene, segway, task).plan
    assert plan.motion is not None
    assert plan.base_pose is not None
    turned: list[int] = []

    def spy(deviation: Deviation, axis: np.ndarray) -> Deviation:
        turned.append(1)
        return mirrored(deviation, axis)

    monkeypatch.setattr("momapos.simulation.worlds.mirrored", spy)
    config = ExecutionConfig(
        furniture=replace(FurnitureConfig(), density=5000.0, latch_force=0.0),
        errors=ModelErrorConfig(tilt=TILT),
    )
    for seed in (4, 7, 8):
        execute(
            scene, segway, plan.base_pose, plan.motion, task, config, np.random.default_rng(seed)
        )  # fmt: skip
    assert bool(turned) == (verb == "open")
