"""Answer a placement query with any method: same scene, checks, arm motions and time limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import KeyObjects
from momapos.planning.config import RANKERS, PipelineConfig
from momapos.planning.grasps import TaskMotion, task_motion
from momapos.planning.importance import rank
from momapos.planning.max_opening import plan_max_opening
from momapos.planning.placement import OURS, Search, search_in_order
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.refine_model import initial_selection
from momapos.planning.result import PlacementResult
from momapos.planning.search_setup import SearchSetup, prepare_search

from .habitat_placer import habitat
from .m3_placer import m3
from .map_placers import reuleaux, rm4d
from .paper_placer import AuthorsPlacer, PaperPlacer
from .placer_room import BasePlacer, PlacerRoom
from .samplers import behavior, momagen, pycram

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
PLACERS: dict[str, BasePlacer] = {
    "habitat": habitat, "m3": m3, "reuleaux": reuleaux, "rm4d": rm4d, "pycram": pycram,
    "behavior": behavior, "momagen": momagen,
}  # fmt: skip
"""Base placers that know the whole scene and no importance."""


def plan_with_method(query: PlacementQuery) -> PlacementResult:
    """Answer as `plan_placement` does, by the method that `config.place.method` names.

    The method decides in which order base poses are tried; the same check judges each of them and
    returns the motion. "Infeasible" from a method other than ours means that it gave up.

    Raises:
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
        OutOfTimeError: The time was over before the search began.
    """
    method = query.config.place.method
    if method in OURS:
        return plan_placement(query)
    answer = _by_importance if method in RANKERS else _by_placer(PLACERS[method])
    if query.task.farthest:
        return plan_max_opening(query, answer)
    with query.in_time():
        return answer(query)


def _by_placer(placer: BasePlacer) -> Callable[[PlacementQuery], PlacementResult]:
    """Return a planner with all objects modeled."""

    def answer(query: PlacementQuery) -> PlacementResult:
        with query.watch.stage("model"):
            motion = task_motion(query.scene, query.robot, query.task, query.config.motion)
        ready = prepare_search(query, query.scene, motion)
        first = query.config.baselines.first_pose
        used = _proposing(_first_pose(ready, placer)) if first else placer
        return _timed(ready.result(_search(ready, used)), query, None)

    return answer


def _by_importance(query: PlacementQuery) -> PlacementResult:
    """Plan as MoMa-Pos: model the key objects, draw more samples, then lower alpha."""
    scene, task, config = query.scene, query.task, query.config
    with query.watch.stage("importance"):
        ranked = rank(scene, task.object, config.ranking, joint=task.joint, seed=query.seed)
    placer: BasePlacer = PaperPlacer(config.paper, query.watch)
    if config.place.method == "authors":
        holders = zip(ranked.names, ranked.relations, strict=True)
        holder = next((name for name, how in holders if how in ("carries", "contains")), "")
        placer = AuthorsPlacer(config.paper, holder, query.watch)
    with query.watch.stage("model"):
        boxed = scene.with_box_proxies({task.object})
        motion: TaskMotion = task_motion(boxed, query.robot, task, config.motion)
    selection = initial_selection(query, ranked, motion)
    while True:
        ready = prepare_search(query, scene.with_box_proxies(selection.names), motion)
        if config.baselines.first_pose and not config.paper.check_stops:
            stop = _first_pose(ready, placer)
            true = prepare_search(query, scene, motion)
            result, decided = true.result(_search(true, _proposing(stop))), len(stop) > 0
        else:
            result = ready.result(_search(ready, placer, last=not selection.boxes))
            decided = result.plan.status != "infeasible"
        if decided or not selection.boxes:
            return _timed(result, query, selection.record())
        selection = selection.relax_alpha()


def _first_pose(ready: SearchSetup, placer: BasePlacer) -> Float[np.ndarray, "n 3"]:
    """Return the first base pose that a placer proposes; (0, 3) if it proposes none."""
    rng = np.random.default_rng(ready.query.seed)
    with ready.query.watch.stage("search"):
        batches = placer(_room(ready), rng)
        return next((poses[:1] for poses in batches if len(poses)), np.zeros((0, 3)))


def _proposing(poses: Float[np.ndarray, "n 3"]) -> BasePlacer:
    """Return a placer that proposes given base poses."""
    return lambda _room, _rng: iter([poses])


def _room(ready: SearchSetup) -> PlacerRoom:
    query, problem = ready.query, ready.problem
    return PlacerRoom(
        ready.prepared, query.reach, problem.travel_cost, problem.start, query.config.place.grasps,
        query.config.baselines,
    )  # fmt: skip


def _search(ready: SearchSetup, placer: BasePlacer, *, last: bool = True) -> Search:
    """Check the poses that a placer proposes, in its order.

    Args:
        ready: The query and its checks.
        placer: Proposes the poses.
        last: Whether to try regrasps at all poses if no pose works with one grasp.
    """
    query, problem = ready.query, ready.problem
    place, watch = query.config.place, query.watch
    room = _room(ready)
    proposed: list[Float[np.ndarray, "n 3"]] = []

    def proposals() -> Iterator[Float[np.ndarray, "n 3"]]:
        for poses in placer(room, np.random.default_rng(query.seed)):
            proposed.append(poses)
            yield poses

    with watch.stage("search"):
        found = search_in_order(problem, proposals(), place)
    for way in ready.multi_grasp_variants() if last and found.is_no else ():
        again = ready.with_grasps(way)
        with watch.stage("search"):
            # If no single grasp can work, the placer has not been called yet.
            poses = list(proposed) if proposed else proposals()
            found.merge(search_in_order(again, iter(poses), place))
        if not found.is_no:
            break
    return found


def _timed(
    result: PlacementResult, query: PlacementQuery, key_objects: KeyObjects | None
) -> PlacementResult:
    """Add the timing and the modeled objects to the plan."""
    timing = query.watch.timing
    return replace(result, plan=replace(result.plan, key_objects=key_objects, timing=timing))
