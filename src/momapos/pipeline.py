"""The method, one call a stage.

Perception, driving and physics are stages of their own; here a scene is known, and the answer is
where to stand and how to move.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.config import PipelineConfig
from momapos.expand_model import expand_model, first_selection
from momapos.farthest_plan import as_far_as_possible
from momapos.importance.key_objects import Selection
from momapos.importance.rank import rank
from momapos.manipulation.free_turn import fitted_bases
from momapos.manipulation.motion import TaskMotion, task_motion
from momapos.manipulation.tasks import hand_path
from momapos.navigation.global_path import BasePath, plan_path
from momapos.outcomes import PoseOutcome, PoseStatus
from momapos.placement.place import AttemptPose, PoseFilter, Problem, search
from momapos.placement_result import PlacementResult, plan_of
from momapos.prepare import driving_lengths, prepare, start_pose
from momapos.protocols import Clock, ReachScorer
from momapos.query import PlacementQuery
from momapos.reachability.map import ReachMap
from momapos.reachability.store import load_reach
from momapos.regrasp import every_two_holds, two_hold_searches
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.stopwatch import Stopwatch
from momapos.types import ArmPathResult, Attempt, Task

if TYPE_CHECKING:
    from jaxtyping import Float, Int

DEFAULT = PipelineConfig()
DOUBT = 1.0
"""So many cells outside its boundary a map may be wrong: there the grid asks the arm [-]."""


def plan_base_placement(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    pose_filter: PoseFilter | None = None,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> PlacementResult:
    """Answer where the robot must stand, and how it moves, to do a task.

    Objects that matter are modeled, all others are boxes; what turns out to matter later is
    modeled then. A "no" is given with everything modeled.

    A task that asks for as far as possible is answered for the farthest value that works, to a
    degree or a centimeter, and the plan's task names that value. Where the time runs out before all
    beyond it are ruled out, the plan's task does not call it the farthest.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        task: What is to be done, see `make_task`.
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        pose_filter: Rules base poses out, such as those that were driven to in vain.
        config: How to search.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same answer.
        clock: Measures the stages and the timeout.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
    """
    watch = Stopwatch(clock)
    if reach is None:
        reach = load_reach(robot, cache_dir)
    query = PlacementQuery(scene, robot, task, reach, start, pose_filter, config, seed, watch)
    return as_far_as_possible(query, answer) if task.farthest else answer(query)


def answer(query: PlacementQuery) -> PlacementResult:
    """The answer for the value that the task names."""
    scene, robot, task, config = query.scene, query.robot, query.task, query.config
    watch = query.watch
    with watch.stage("importance"):
        path = hand_path(scene, task.object, task.joint, task.to)
        ranked = rank(scene, task.object, config.ranking, path=path, seed=query.seed)
    with watch.stage("model"):
        motion = task_motion(scene.with_box_proxies({task.object}), robot, task, config.motion)
    selection = first_selection(query, ranked, motion)
    while True:
        result = _search(query, selection, motion)
        if result.plan.status == "solved":
            selection, holds = expand_model(query, selection, result)
            if holds:
                break
        elif result.plan.status == "timeout" or not selection.boxes:
            break
        else:
            selection = selection.relax_alpha()
    timing = {**watch.seconds, "total": watch.total}
    plan = replace(result.plan, key_objects=selection.record(), timing=timing)
    return replace(result, plan=plan)


def _in_doubt(reach: ReachScorer) -> ReachScorer:
    """A map that calls reachable what may be: lines up to some cells outside the boundary."""
    if isinstance(reach, ReachMap):
        return replace(reach, threshold=reach.threshold - DOUBT)
    return reach


def _search(query: PlacementQuery, selection: Selection, motion: TaskMotion) -> PlacementResult:
    """Search base poses with the selected objects modeled."""
    robot, config, watch = query.robot, query.config, query.watch
    modeled = query.scene.with_box_proxies(selection.names)
    clearance = config.place.clearance
    prepared = prepare(
        modeled, robot, query.task, config, clearance=clearance, motion=motion, watch=watch
    )
    with watch.stage("exact model"):
        infeasible_reason = prepared.infeasible_reason
    with watch.stage("drive"):
        start = start_pose(query.scene, robot, prepared.motion, query.start, query.nav_map)
        travel_cost = driving_lengths(prepared, start)

    # What is compiled and read before, once after installation, is not the search's time.
    left, begun = config.timeout - watch.seconds.get("search", 0.0), watch.clock()

    def out_of_time() -> bool:
        return watch.clock() - begun > left

    feasible = prepared.feasibility(config, query.seed, out_of_time=out_of_time, watch=watch)
    paths: dict[bytes, BasePath | None] = {}

    def drivable(check: AttemptPose) -> AttemptPose:
        """A motion at a base pose that can be driven to with the arm at home."""

        def attempt(
            base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
        ) -> Attempt:
            found = check(base, screened, ways)
            if found.motion is None:
                return found
            with watch.stage("way"):
                path = paths[base.tobytes()] = plan_path(query.nav_map, start, base)
            if path is None:
                return Attempt(None, PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME))
            return found

        return attempt

    problem = Problem(
        geometry=prepared.geometry,
        reach=query.reach,
        grid_reach=_in_doubt(query.reach),
        ways=prepared.ways,
        travel_cost=travel_cost,
        attempt=drivable(feasible),
        screen=feasible.screen,
        infeasible_reason=infeasible_reason,
        start=start,
        out_of_time=out_of_time,
        pose_filter=query.pose_filter,
        fit=partial(fitted_bases, query.robot, prepared.motion),
    )
    # Only a room without stand-ins can tell that there is no base pose at all; in any other one
    # round of samples has to do.
    brief = replace(config.place, grid=False, rounds=min(1, config.place.rounds))
    search_config = brief if selection.boxes else config.place
    with watch.stage("search"):
        found = search(problem, search_config, np.random.default_rng(query.seed))
    if found.is_no and not selection.boxes:
        ready = every_two_holds(prepared, config, query.seed, out_of_time=out_of_time, watch=watch)
        for two, place in two_hold_searches(ready, search_config):
            again = replace(two.problem(problem), attempt=drivable(two))
            with watch.stage("search"):
                found.join(search(again, place, np.random.default_rng(query.seed)))
            if not found.is_no:
                break
    path = None if found.base is None else paths.get(found.base.tobytes())
    return PlacementResult(plan_of(query, found, start, path), prepared, found, start)
