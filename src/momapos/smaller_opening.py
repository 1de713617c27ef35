"""How far a part can be opened where it cannot be opened as far as asked."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.config import PipelineConfig
from momapos.manipulation.tasks import slides
from momapos.pipeline import plan_base_placement
from momapos.protocols import Clock, ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.types import PlacementPlan, Task

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
SHARES = (0.75, 0.5, 0.25)
"""Of the way asked for; the first that works is the answer [-]."""
TIMEOUT = 10.0
"""Time for all of them [s]."""


def smaller_opening(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    config: PipelineConfig = DEFAULT,
    clock: Clock = time.perf_counter,
) -> PlacementPlan:
    """Add to a plan that finds no way to open a part how far it can be opened, if it can.

    Three smaller values are tried, with one round of samples each: what works, works; that
    nothing was found does not mean that nothing does.

    Args:
        plan: The plan; all but an infeasible one to open something comes back as it is.
        scene: The room.
        robot: The robot.
        reach: Its reachability map.
        config: How the plan was searched for.
        clock: Measures the time.
    """
    task = plan.task
    if plan.status != "infeasible" or task.verb != "open" or task.joint is None or task.to is None:
        return plan
    begin, began = scene.object(task.object).values()[task.joint], clock()
    start = None if plan.start is None else np.array(plan.start)
    for share in SHARES:
        to = rounded(begin + share * (task.to - begin), slides(scene, task))
        left = TIMEOUT - (clock() - began)
        if left <= 0 or abs(to - begin) < 1e-3:
            break
        if _works(scene, robot, replace(task, to=to), reach, start, config, plan.seed, left, clock):
            return replace(plan, feasible_to=to)
    return plan


def _works(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer,
    start: Float[np.ndarray, "3"] | None,
    config: PipelineConfig,
    seed: int,
    timeout: float,
    clock: Clock,
) -> bool:
    quick = replace(config.place, rounds=1, grid=False, method="ours")
    some = replace(config, place=quick, timeout=timeout)
    found = plan_base_placement(
        scene, robot, task, reach, start=start, config=some, seed=seed, clock=clock
    )
    return found.plan.status == "solved"


def rounded(value: float, slides: bool) -> float:
    """A value that can be written in whole degrees or centimeters [rad] or [m]."""
    return round(100 * value) / 100 if slides else math.radians(round(math.degrees(value)))
