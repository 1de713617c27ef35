"""Latches in physics: a part is locked until its latch is turned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cupboards import LATCHES, latched_room

from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.simulation.config import ExecutionConfig
from momapos.simulation.execute import AttemptOutcome, attempt
from momapos.simulation.execution_run import Stage
from momapos.simulation.simulation import Simulation

Trace = list[tuple[float, float, bool]]
"""Values of part and latch, and whether the part is locked."""


def carried_out(there: Scene, believed: Scene, hold: str) -> tuple[AttemptOutcome, Trace]:
    """Plan in the believed scene, carry the plan out in the true one, and watch the latch."""
    robot, trace = load_robot("fetch"), Trace()
    task = make_task(believed, "open", "cupboard")
    plan = plan_base_placement(believed, robot, task).plan

    def watch(world: Simulation, _: float, __: Stage) -> None:
        latch, data = world.latch, world.data
        locked = bool(data.eq_active[latch.lock])
        trace.append((float(data.qpos[world.part_q]), float(data.qpos[latch.value_q]), locked))

    config = ExecutionConfig(hold=hold)  # type: ignore[arg-type]
    return attempt(there, robot, plan.base_pose, plan.motion, task, config, watch=watch), trace


@pytest.mark.parametrize(
    ("kind", "hold"),
    [
        ("a lever", "contact"), pytest.param("a sliding bolt", "weld", marks=pytest.mark.slow),
        pytest.param("a T-handle", "contact", marks=pytest.mark.slow),
        pytest.param("a lever with another inside", "weld", marks=pytest.mark.slow),
        pytest.param("a lever on a drawer", "contact", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_latched_part_opens_once_the_hand_has_turned_the_latch(
    tmp_path: Path, kind: str, hold: str
) -> None:
    scene = latched_room(tmp_path, kind)
    outcome, trace = carried_out(scene, scene, hold)
    assert outcome.execution.success, outcome.execution.reason
    part, latch, locked = (np.array(column) for column in zip(*trace, strict=True))
    to = LATCHES[kind][1]
    assert locked[0]
    assert not locked[-1]
    assert np.abs(part[locked]).max() < 2e-3
    assert (np.abs(latch[~locked][:1]) > 0.9 * abs(to)).all()
    assert abs(latch[-1] - to) < 0.2 * abs(to)
    assert outcome.execution.slip.position < 0.01


def test_a_part_does_not_open_while_its_latch_is_not_turned(tmp_path: Path) -> None:
    scene = latched_room(tmp_path, "a lever")
    plain = replace(scene.object("cupboard"), latch=None)
    outcome, trace = carried_out(scene, replace(scene, objects=(plain,)), "weld")
    assert not outcome.execution.success
    assert "its latch turn is not turned" in outcome.execution.reason
    assert all(locked for *_, locked in trace)
    assert max(abs(part) for part, *_ in trace) < 5e-3
