"""The method, one call a stage.

Perception, driving and physics are stages of their own; here a scene is known, and the answer is
where to stand and how to move.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, InputError, Stopwatch
from momapos.model.records import ANYWHERE, BaseRegion, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import TaskMotion, hand_path, task_motion
from momapos.planning.importance import Selection, rank
from momapos.planning.placement import OURS, PoseFilter, search
from momapos.planning.reachability import load_reach

from .config import PipelineConfig
from .max_opening_plan import as_far_as_possible
from .query import AlsoAtPose, PlacementQuery
from .refine_model import expand_model, first_selection
from .result import PlacementResult
from .search_setup import ready_search

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()


def plan_base_placement(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    pose_filter: PoseFilter | None = None,
    also: AlsoAtPose | None = None,
    region: BaseRegion = ANYWHERE,
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
        also: Asked of base poses where a motion and a way there were found.
        region: Where the base is allowed to stand.
        config: How to search.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same answer.
        clock: Measures the stages and the timeout.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
        InputError: The configuration names a method that only `plan_by_method` knows.
    """
    if config.place.method not in OURS:
        raise InputError(
            f"plan_base_placement searches by {' or '.join(OURS)}, not by "
            f"{config.place.method!r}; plan_by_method knows the others"
        )
    watch = Stopwatch(clock)
    if reach is None:
        reach = load_reach(robot, cache_dir)
    query = PlacementQuery(
        scene, robot, task, reach, start, pose_filter, config, seed, watch, region=region,
        also=also,
    )  # fmt: skip
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
    timing = watch.timing
    plan = replace(result.plan, key_objects=selection.record(), timing=timing)
    return replace(result, plan=plan)


def _search(query: PlacementQuery, selection: Selection, motion: TaskMotion) -> PlacementResult:
    """Search base poses with the selected objects modeled."""
    place, watch = query.config.place, query.watch
    ready = ready_search(query, query.scene.with_box_proxies(selection.names), motion)
    # Only a room without stand-ins can tell that there is no base pose at all; in any other one
    # round of samples has to do.
    brief = replace(place, grid=False, rounds=min(1, place.rounds))
    config = brief if selection.boxes else place
    with watch.stage("search"):
        found = search(ready.problem, config, np.random.default_rng(query.seed))
    if found.timed_out or not selection.boxes:
        found.settle()
    if found.is_no and not selection.boxes:
        with watch.stage("search"):
            found.join(ready.finely(found, config))
        found.settle()
    if found.is_no and not selection.boxes:
        for problem, again in ready.otherwise(config):
            with watch.stage("search"):
                found.join(search(problem, again, np.random.default_rng(query.seed)))
            found.settle()
            if not found.is_no:
                break
    return ready.result(found)
