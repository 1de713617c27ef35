"""Prepare the search of a query: what all methods of choosing base poses share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ReachScorer
from momapos.model.scene import Scene
from momapos.planning.arm_motion import Feasibility, fitted_bases
from momapos.planning.grasps import FULL_DOF, TaskMotion
from momapos.planning.navigation import TravelLengths, clear_at_home
from momapos.planning.placement import (
    AttemptPose,
    PlaceConfig,
    Problem,
    Search,
    search,
    search_in_order,
)
from momapos.planning.reachability import ReachMap

from .base_paths import AreaRule, BasePaths, OnwardPaths, PassageRule
from .carrying import Carrying
from .query import PlacementQuery
from .regrasp import TwoGrasps, ajar_doors, iter_two_grasps
from .result import PlacementResult, plan_of
from .robust import RobustChecks
from .sliding_grasp import SlidingHook, sliding_hooks
from .task_setup import PreparedTask, cost_map, prepare, start_pose
from .time_limit import cut_short, with_note

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

DOUBT = 1.0
"""Cells outside the map's boundary in which the grid uses exact inverse kinematics [-]."""
_MAX_REFINED_POSES = 64
"""Base poses without an arm path that finer inverse kinematics checks again, the nearest [-]."""


@dataclass(frozen=True)
class SearchSetup:
    """A query with its scene modeled, and the checks of its base poses."""

    query: PlacementQuery
    prepared: PreparedTask
    problem: Problem
    """The search with one grasp, rigid or turning about a bar."""
    feasible: Feasibility
    """The check of base poses that the problem's check is built on."""
    drives: BasePaths
    passage: PassageRule
    robust: RobustChecks | None
    """The check of base-pose robustness, if the query requires it."""

    def slides(self) -> Iterator[SlidingHook]:
        """Yield the task with a hook that slides along the handle, if some hook can."""
        return sliding_hooks(self.prepared, self.feasible, self.query.config)

    def multi_grasp_variants(self) -> Iterator[SlidingHook | TwoGrasps]:
        """Yield all variants of the task with more than one grasp."""
        query = self.query
        yield from self.slides()
        yield from iter_two_grasps(
            self.prepared, query.config, query.seed, keep_grasps=query.keep_grasps,
            watch=query.watch,
        )  # fmt: skip

    def refine(self, found: Search, place: PlaceConfig) -> Search:
        """Check base poses again, from which coarse inverse kinematics may have missed an arm path.

        A redundant arm that is locked at more values avoids more collisions. Few poses of an
        infeasible task come this far.

        Args:
            found: A search of the whole grid that found nothing.
            place: How to search.
        """
        robot, problem = self.query.robot, self.problem
        if robot.ik.complete or problem.fit is not None or not place.grid:
            return Search()
        poses = found.without_path()
        if not len(poses):
            return Search()
        order = np.argsort(problem.travel_cost(poses), kind="stable")
        fine = replace(self.feasible, robot=robot.finer)
        problem = replace(
            problem, reach=problem.grid_reach, screen=fine.screen, near=fine.follows,
            attempt=_accepted(fine, self.drives, self.robust),
        )  # fmt: skip
        # As on the grid every grasp counts.
        every = replace(place, grasps=self.prepared.motion.turning.modes)
        return search_in_order(problem, iter([poses[order[:_MAX_REFINED_POSES]]]), every)

    def multi_grasp_searches(self, place: PlaceConfig) -> Iterator[Callable[[], Search]]:
        """Yield the searches with more than one grasp, in the order of trying them.

        Base poses at which a quick search finds no way between two grasps are tried again last.
        """
        seed = self.query.seed
        for slide in self.slides():
            yield partial(search, self.with_grasps(slide), place, np.random.default_rng(seed))
        tried: list[TwoGrasps] = []
        for two in self._two_grasps(place):
            tried.append(two)
            quick = self.with_grasps(replace(two, quick=True))
            samples = replace(place, grid=False)
            yield partial(search, quick, samples, np.random.default_rng(seed))
        for two in tried if place.grid else ():
            quick = self.with_grasps(replace(two, quick=True))
            grid = replace(place, rounds=0)
            yield partial(search, quick, grid, np.random.default_rng(seed))
        for two in tried:
            poses = np.array(two.postponed)
            if len(poses):
                yield partial(search_in_order, self.with_grasps(two), iter([poses]), place)

    def _two_grasps(self, place: PlaceConfig) -> Iterator[TwoGrasps]:
        """Yield the task with two grasps, for each value at which the hand may let go.

        If no base pose reaches both the pull to a value and an end of the push, none does for
        larger values; these are prepared only if they add ends.
        """
        query = self.query
        beyond: frozenset[bytes] = frozenset()
        for door in ajar_doors(self.prepared, query.config, query.watch):
            if door.ends <= beyond:
                continue
            with query.watch.stage("search"):
                reached, reached_end = door.is_within_reach(self.problem, place)
            if not reached_end:
                beyond |= door.ends
            two = door.prepared(query.seed, query.keep_grasps) if reached else None
            if two is not None:
                yield two

    def accepted(self, check: AttemptPose) -> AttemptPose:
        """Extend a check by the path to the base pose and by base-pose robustness."""
        return _accepted(check, self.drives, self.robust)

    def with_grasps(self, variant: SlidingHook | TwoGrasps) -> Problem:
        """Return the problem, solved with more than one grasp."""
        attempt = self.accepted(variant)
        problem = variant.problem(self.problem)
        also = [variant.pulling] if isinstance(variant, TwoGrasps) else []
        reason = problem.infeasible_reason or self.passage.no_way(problem.geometry, *also)
        return replace(problem, attempt=attempt, infeasible_reason=reason)

    def result(self, found: Search) -> PlacementResult:
        """Return the answer that a search found."""
        start = self.problem.start
        plan = plan_of(
            self.query, self.prepared, found, start, self.drives.path(found.base, found.motion)
        )
        if self.robust is not None and plan.motion is not None:
            plan = replace(plan, tolerance=self.robust.tolerance)
        answer = PlacementResult(plan, self.prepared, found, start, self.query)
        return with_note(answer, cut_short("the search")) if found.ended_early else answer


def prepare_search(query: PlacementQuery, modeled: Scene, motion: TaskMotion) -> SearchSetup:
    """Prepare the search of a query.

    Args:
        query: The question.
        modeled: The scene as it must be modeled.
        motion: The task's motion in any version of the scene.

    Raises:
        SceneError: The robot collides at its start pose.
    """
    robot, config, watch = query.robot, query.config, query.watch
    clearance = config.place.clearance
    prepared = prepare(
        modeled, robot, query.task, config, clearance=clearance, motion=motion,
        keep_grasps=query.keep_grasps, watch=watch,
    )  # fmt: skip
    with watch.stage("exact model"):
        infeasible_reason = prepared.infeasible_reason
    with watch.stage("drive"):
        start = start_pose(query.scene, robot, prepared.motion, query.start, query.nav_map)
        costs = cost_map(prepared, start, query.region.keep_out)

    areas = AreaRule(query, start, cost_map(prepared, start)) if query.region.keep_out else None
    carrying = Carrying(query, prepared, start) if query.task.verb == "place" else None
    drives, moves = BasePaths(query, start, areas, carrying), query.task.joint is not None
    feasible = prepared.feasibility(
        config, query.seed, watch=watch,
        homes=None if carrying is None else drives.homes,
    )  # fmt: skip
    if carrying is not None and not infeasible_reason:
        with watch.stage("path"):
            infeasible_reason = carrying.reason
    required = config.place.robust_radius > 0.0 or config.place.robust_turn > 0.0
    robust = RobustChecks(query) if required else None
    passage = PassageRule(query, start, costs, areas)
    problem = Problem(
        geometry=prepared.geometry,
        reach=query.reach,
        grid_reach=optimistic(query.reach),
        mode_scorers=prepared.mode_scorers,
        travel_cost=TravelLengths(costs, query.robot, start),
        attempt=_accepted(feasible, drives, robust),
        screen=feasible.screen,
        near=feasible.follows,
        grasp_step=prepared.motion.grasp_step,
        infeasible_reason=infeasible_reason or passage.no_way(prepared.geometry),
        start=start,
        keep_poses=None if query.keep_poses is None else query.kept,
        own_cost=None if query.pose_cost is None else query.own_cost,
        home_is_free=partial(_home_is_free, query) if moves else None,
        approach=drives,
        departure=OnwardPaths(drives) if moves and _checks_departure(config.place) else None,
        region=query.region,
        way_rules=() if areas is None else (areas,),
        rules=(passage,) if robust is None else (passage, robust.rule(prepared.geometry)),
        fit=None if robot.chain.size >= FULL_DOF else partial(fitted_bases, robot, prepared.motion),
    )
    return SearchSetup(query, prepared, problem, feasible, drives, passage, robust)


def _checks_departure(place: PlaceConfig) -> bool:
    """Return whether base poses must let the robot drive on; other methods ignore that."""
    return place.departure and place.method == "ours"


def _home_is_free(query: PlacementQuery, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Return at which base poses the arm can return home after the task."""
    return clear_at_home(poses, query.robot, query.outlines_after)


def _accepted(check: AttemptPose, drives: BasePaths, robust: RobustChecks | None) -> AttemptPose:
    """Extend a check by the path to the base pose and by base-pose robustness."""
    drivable = drives.drivable(check)
    return drivable if robust is None else robust.around(drivable)


def optimistic(reach: ReachScorer) -> ReachScorer:
    """Return a map that also accepts lines up to `DOUBT` cells outside its boundary."""
    if isinstance(reach, ReachMap):
        return replace(reach, threshold=reach.threshold - DOUBT)
    return reach
