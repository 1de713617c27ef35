"""One question, answered by any method: the same room, checks, arm motions and time for all."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, Stopwatch
from momapos.model.records import ANYWHERE, BaseRegion, KeyObjects, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps import TaskMotion, task_motion
from momapos.planning.importance import rank
from momapos.planning.max_opening_plan import as_far_as_possible
from momapos.planning.placement import OURS, PoseFilter, Search, search_in_order
from momapos.planning.plan import plan_base_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability import load_reach
from momapos.planning.refine_model import first_selection
from momapos.planning.result import PlacementResult
from momapos.planning.search_setup import ReadySearch, ready_search

from .habitat_placer import habitat
from .m3_placer import m3
from .map_placers import reuleaux, rm4d
from .paper_placer import PaperPlacer
from .placer_room import BasePlacer, Room
from .samplers import behavior, momagen, pycram

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
PLACERS: dict[str, BasePlacer] = {
    "habitat": habitat, "m3": m3, "reuleaux": reuleaux, "rm4d": rm4d, "pycram": pycram,
    "behavior": behavior, "momagen": momagen,
}  # fmt: skip
"""Base placers that know the whole room and no importance."""


def plan_by_method(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    pose_filter: PoseFilter | None = None,
    region: BaseRegion = ANYWHERE,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> PlacementResult:
    """Answer as `plan_base_placement` does, by the method that `config.place.method` names.

    The method says in which order base poses are tried; the same check decides about each, and
    gives the motion. What others than ours answer with "infeasible" is that they gave up.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        task: What is to be done, see `make_task`.
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        pose_filter: Rules base poses out, such as those that were driven to in vain.
        region: Where the base is allowed to stand.
        config: How to search.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same answer.
        clock: Measures the stages and the timeout.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
    """
    method = config.place.method
    if method in OURS:
        return plan_base_placement(
            scene, robot, task, reach, start=start, pose_filter=pose_filter, region=region,
            config=config, cache_dir=cache_dir, seed=seed, clock=clock,
        )  # fmt: skip
    if reach is None:
        reach = load_reach(robot, cache_dir)
    query = PlacementQuery(
        scene,
        robot,
        task,
        reach,
        start,
        pose_filter,
        config,
        seed,
        Stopwatch(clock),
        region=region,
    )
    answer = _as_printed if method == "paper" else _by_placer(PLACERS[method])
    return as_far_as_possible(query, answer) if task.farthest else answer(query)


def _by_placer(placer: BasePlacer) -> Callable[[PlacementQuery], PlacementResult]:
    """Answers in the whole room, as it is."""

    def answer(query: PlacementQuery) -> PlacementResult:
        with query.watch.stage("model"):
            motion = task_motion(query.scene, query.robot, query.task, query.config.motion)
        ready = ready_search(query, query.scene, motion)
        return _timed(ready.result(_search(ready, placer)), query, None)

    return answer


def _as_printed(query: PlacementQuery) -> PlacementResult:
    """MoMa-Pos: key objects are modeled, more samples are drawn, then alpha falls."""
    scene, task, config = query.scene, query.task, query.config
    placer = PaperPlacer(config.paper)
    with query.watch.stage("importance"):
        ranked = rank(scene, task.object, config.ranking, seed=query.seed)
    with query.watch.stage("model"):
        boxed = scene.with_box_proxies({task.object})
        motion: TaskMotion = task_motion(boxed, query.robot, task, config.motion)
    selection = first_selection(query, ranked, motion)
    while True:
        ready = ready_search(query, scene.with_box_proxies(selection.names), motion)
        result = ready.result(_search(ready, placer, last=not selection.boxes))
        if result.plan.status != "infeasible" or not selection.boxes:
            return _timed(result, query, selection.record())
        selection = selection.relax_alpha()


def _search(ready: ReadySearch, placer: BasePlacer, *, last: bool = True) -> Search:
    """Ask a placer for base poses and check them in its order.

    Args:
        ready: The question and its checks.
        placer: Who proposes the poses.
        last: Whether more holds are tried at all of them where one hold works at none.
    """
    query, problem = ready.query, ready.problem
    place, watch = query.config.place, query.watch
    room = Room(ready.prepared, query.reach, problem.travel_cost, problem.start, place.grasps)
    proposed: list[Float[np.ndarray, "n 3"]] = []

    def proposals() -> Iterator[Float[np.ndarray, "n 3"]]:
        for poses in placer(room, np.random.default_rng(query.seed)):
            proposed.append(poses)
            yield poses

    with watch.stage("search"):
        found = search_in_order(problem, proposals(), place)
    for way in ready.more_holds() if last and found.is_no else ():
        again = ready.held_so(way)
        with watch.stage("search"):
            # Where no single hold can work, nobody has been asked yet.
            poses = list(proposed) if proposed else proposals()
            found.join(search_in_order(again, iter(poses), place))
        if not found.is_no:
            break
    return found


def _timed(
    result: PlacementResult, query: PlacementQuery, key_objects: KeyObjects | None
) -> PlacementResult:
    """The result with the time that it took, and what was modeled."""
    timing = query.watch.timing
    return replace(result, plan=replace(result.plan, key_objects=key_objects, timing=timing))
