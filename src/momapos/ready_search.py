"""A question made ready to be searched: what every way to choose base poses shares."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.manipulation.feasibility import Feasibility
from momapos.manipulation.free_turn import fitted_bases
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.turning import FULL
from momapos.navigation.global_path import BasePath, plan_path
from momapos.navigation.start import clear_at_home
from momapos.outcomes import PoseOutcome, PoseStatus
from momapos.placement.config import PlaceConfig
from momapos.placement.problem import AttemptPose, Problem, Search
from momapos.placement_result import PlacementResult, plan_of
from momapos.prepare import PreparedTask, driving_lengths, prepare, start_pose
from momapos.protocols import ReachScorer
from momapos.query import PlacementQuery
from momapos.reachability.map import ReachMap
from momapos.regrasp import TwoHolds, every_two_holds, two_hold_searches
from momapos.robust import RobustChecks
from momapos.scene.scene import Scene
from momapos.sliding_hook import SlidingHook, sliding_hooks
from momapos.types import ArmPathResult, Attempt

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

DOUBT = 1.0
"""So many cells outside its boundary a map may be wrong: there the grid asks the arm [-]."""


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


@dataclass(frozen=True)
class Drives:
    """The ways to base poses with the arm at home."""

    query: PlacementQuery
    start: Float[np.ndarray, "3"]
    _paths: dict[bytes, BasePath | None] = field(default_factory=dict)

    def path(self, base: Float[np.ndarray, "3"] | None) -> BasePath | None:
        """The way to a base pose that was checked, if there is one."""
        return None if base is None else self._paths.get(base.tobytes())

    def drivable(self, check: AttemptPose) -> AttemptPose:
        """A check that asks for a way to the base pose as well, and what the query does."""

        def attempt(
            base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
        ) -> Attempt:
            found = check(base, screened, ways)
            if found.motion is None:
                return found
            with self.query.watch.stage("way"):
                path = self._paths[base.tobytes()] = plan_path(self.query.nav_map, self.start, base)
            if path is None:
                return Attempt(None, PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME))
            also = self.query.also
            refused = None if also is None else also(base)
            return found if refused is None else Attempt(None, refused)

        return attempt


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
    left, begun = config.timeout - watch.seconds.get("search", 0.0), watch.clock()

    def out_of_time() -> bool:
        return watch.clock() - begun > left

    feasible = prepared.feasibility(config, query.seed, out_of_time=out_of_time, watch=watch)
    drives = Drives(query, start)
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
        goes_home=None if query.task.joint is None else partial(_goes_home, query),
        region=query.region,
        rules=() if robust is None else (robust.rule(prepared.geometry),),
        fit=None if robot.chain.size >= FULL else partial(fitted_bases, robot, prepared.motion),
    )
    return ReadySearch(query, prepared, problem, feasible, drives, robust)


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
