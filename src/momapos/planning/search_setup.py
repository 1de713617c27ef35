"""A question made ready to be searched: what every way to choose base poses shares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ReachScorer
from momapos.model.scene import Scene
from momapos.planning.arm_motion import Feasibility, fitted_bases
from momapos.planning.grasps import FULL, TaskMotion
from momapos.planning.navigation import clear_at_home
from momapos.planning.placement import AttemptPose, PlaceConfig, Problem, Search, search_in_order
from momapos.planning.reachability import ReachMap

from .base_paths import Drives, WaysOn
from .query import PlacementQuery
from .regrasp import TwoHolds, every_two_holds, two_hold_searches
from .result import PlacementResult, plan_of
from .robust import RobustChecks
from .sliding_grasp import SlidingHook, sliding_hooks
from .task_setup import PreparedTask, driving_lengths, prepare, start_pose

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

DOUBT = 1.0
"""So many cells outside its boundary a map may be wrong: there the grid asks the arm [-]."""
_SEARCHING = ("search", "way", "exact check")
"""Stages that count for the time limit."""
_FINE = 64
"""Base poses without an arm path that are looked at more finely, the nearest [-]."""


@dataclass(frozen=True)
class ReadySearch:
    """A question with its room modeled, and the checks of its base poses."""

    query: PlacementQuery
    prepared: PreparedTask
    problem: Problem
    """One hold, or one hand that turns about a bar."""
    feasible: Feasibility
    """The check of base poses behind that of the problem."""
    drives: Drives
    robust: RobustChecks | None
    """What asks for room around base poses, where that is asked for."""

    def slides(self) -> Iterator[SlidingHook]:
        """The task by a hook that slides along the handle, if some hook can."""
        return sliding_hooks(self.prepared, self.feasible, self.query.config)

    def two_holds(self) -> Iterator[TwoHolds]:
        """The task in two holds, for each value at which the hand may let go."""
        query = self.query
        return every_two_holds(
            self.prepared, query.config, query.seed,
            out_of_time=self.problem.out_of_time, watch=query.watch,
        )  # fmt: skip

    def more_holds(self) -> Iterator[SlidingHook | TwoHolds]:
        """The task in more than one hold, the ways in which it may be in turn."""
        yield from self.slides()
        yield from self.two_holds()

    def finely(self, found: Search, place: PlaceConfig) -> Search:
        """Look again from where inverse kinematics may have overlooked an arm path.

        A redundant arm that is locked at more values passes where it hit, or broke off. Few poses
        of a "no" come so far that it matters.

        Args:
            found: A search of the whole grid that found nothing.
            place: How to search.
        """
        robot, problem = self.query.robot, self.problem
        poses = found.without_path()
        if robot.ik.complete or problem.fit is not None or not (len(poses) and place.grid):
            return Search()
        order = np.argsort(problem.travel_cost(poses[:, :2]), kind="stable")
        fine = replace(self.feasible, robot=robot.finer)
        problem = replace(
            problem, reach=problem.grid_reach, screen=fine.screen,
            attempt=_accepted(fine, self.drives, self.robust),
        )  # fmt: skip
        # As on the grid every grasp counts.
        every = replace(place, grasps=self.prepared.motion.turning.ways)
        return search_in_order(problem, iter([poses[order[:_FINE]]]), every)

    def otherwise(self, place: PlaceConfig) -> Iterator[tuple[Problem, PlaceConfig]]:
        """The same problem in more than one hold, and how to search it; each is made when it is
        asked for, since mostly the first is enough."""
        for slide in self.slides():
            yield self.held_so(slide), place
        for two, again in two_hold_searches(self.two_holds(), place):
            yield self.held_so(two), again

    def held_so(self, way: SlidingHook | TwoHolds) -> Problem:
        """The same problem, to be done in more than one hold."""
        return replace(way.problem(self.problem), attempt=_accepted(way, self.drives, self.robust))

    def result(self, found: Search) -> PlacementResult:
        """The answer that a search leads to."""
        start = self.problem.start
        plan = plan_of(self.query, self.prepared, found, start, self.drives.path(found.base))
        if self.robust is not None and plan.motion is not None:
            plan = replace(plan, tolerance=self.robust.tolerance)
        return PlacementResult(plan, self.prepared, found, start, self.query)


def ready_search(query: PlacementQuery, modeled: Scene, motion: TaskMotion) -> ReadySearch:
    """Make a question ready.

    Args:
        query: What is asked.
        modeled: The room as it is to be modeled.
        motion: The task's motion in any version of the room.

    Raises:
        SceneError: The start is no free pose.
    """
    robot, config, watch = query.robot, query.config, query.watch
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
    spent = sum(watch.seconds.get(stage, 0.0) for stage in _SEARCHING)
    left, begun = config.timeout - spent, watch.clock()

    def out_of_time() -> bool:
        return watch.clock() - begun > left

    feasible = prepared.feasibility(config, query.seed, out_of_time=out_of_time, watch=watch)
    drives, moves = Drives(query, start), query.task.joint is not None
    asked = config.place.robust_radius > 0.0 or config.place.robust_turn > 0.0
    robust = RobustChecks(query) if asked else None
    problem = Problem(
        geometry=prepared.geometry,
        reach=query.reach,
        grid_reach=_in_doubt(query.reach),
        ways=prepared.ways,
        travel_cost=travel_cost,
        attempt=_accepted(feasible, drives, robust),
        screen=feasible.screen,
        takes_hold=prepared.motion.grasp_step,
        infeasible_reason=infeasible_reason,
        start=start,
        out_of_time=out_of_time,
        pose_filter=query.pose_filter,
        goes_home=partial(_goes_home, query) if moves else None,
        leads_on=WaysOn(drives) if moves and _asks_way_on(config.place) else None,
        region=query.region,
        rules=() if robust is None else (robust.rule(prepared.geometry),),
        fit=None if robot.chain.size >= FULL else partial(fitted_bases, robot, prepared.motion),
    )
    return ReadySearch(query, prepared, problem, feasible, drives, robust)


def _asks_way_on(place: PlaceConfig) -> bool:
    """Whether base poses are asked for a way on: other methods choose theirs without."""
    return place.way_on and place.method == "ours"


def _goes_home(query: PlacementQuery, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """From which base poses the robot can start anew when the task is done."""
    return clear_at_home(poses, query.robot, query.outlines_after)


def _accepted(check: AttemptPose, drives: Drives, robust: RobustChecks | None) -> AttemptPose:
    """A check that asks for a way to the base pose as well, and for room around it."""
    drivable = drives.drivable(check)
    return drivable if robust is None else robust.around(drivable)


def _in_doubt(reach: ReachScorer) -> ReachScorer:
    """A map that calls reachable what may be: lines up to some cells outside the boundary."""
    if isinstance(reach, ReachMap):
        return replace(reach, threshold=reach.threshold - DOUBT)
    return reach
