"""How far a part can be moved where it cannot be moved as far as asked."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from momapos.core import Clock, Stopwatch
from momapos.model.records import PlacementPlan, ReachScorer
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import slides

from .config import PipelineConfig
from .max_opening import values_per_waypoint
from .max_opening_plan import farthest_plan, values_short_of
from .plan import answer
from .query import PlacementQuery

DEFAULT = PipelineConfig()
TIMEOUT = 10.0
"""Time to find it [s]."""


def smaller_opening(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    config: PipelineConfig = DEFAULT,
    clock: Clock = time.perf_counter,
) -> PlacementPlan:
    """Add to a plan that finds no way to move a part how far it can be moved, and from where.

    The value is one for which there is a plan, in whole degrees or centimeters. Where the time is
    enough, the grid has ruled out what lies a waypoint beyond it.

    Args:
        plan: The plan; all but an infeasible one for a joint comes back as it is.
        scene: The room.
        robot: The robot.
        reach: Its reachability map.
        config: How the plan was searched for.
        clock: Measures the time.
    """
    task = plan.task
    if plan.status != "infeasible" or task.joint is None:
        return plan
    start = None if plan.start is None else np.array(plan.start)
    watch = Stopwatch(clock)
    query = PlacementQuery(
        scene, robot, task, reach, start, None, config, plan.seed, watch, region=plan.region
    )
    waypoint = values_per_waypoint(config.motion, slides=slides(scene, task))
    values = values_short_of(query)
    best, sure = farthest_plan(query, answer, values, within=waypoint, timeout=TIMEOUT)
    if best is None:
        return plan
    return replace(
        plan, feasible_to=best.plan.task.to, feasible_from=best.plan.base_pose, feasible_sure=sure
    )
