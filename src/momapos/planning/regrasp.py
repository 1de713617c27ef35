"""Open a door with two grasps from one base pose: pull it ajar, let go, push it from behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch
from momapos.core.geometry import pose_planar
from momapos.model import with_close_states
from momapos.model.collision import build_motions
from momapos.model.records import (
    ArmPathResult,
    Attempt,
    Family,
    Motion,
    PoseOutcome,
    PoseStatus,
    Task,
)
from momapos.model.scene import Scene, resistance_along, stays_in_place
from momapos.model.urdf import opening_of
from momapos.planning.arm_motion import (
    RESOLUTION,
    Feasibility,
    PlannerConfig,
    brief_config,
    near_home,
    plan_with_clearance,
    quick_config,
    world_tools,
)
from momapos.planning.grasps import FULL_DOF, GraspFilter, TaskMotion, task_motion
from momapos.planning.placement import (
    GraspModeScorer,
    PlaceConfig,
    PlacementGeometry,
    Problem,
    is_within_reach,
    two_grasp_scorer,
)

from .config import PipelineConfig
from .task_setup import PreparedTask, prepare

if TYPE_CHECKING:
    from jaxtyping import Float, Int

AJAR_ANGLES = (np.radians(30.0), np.radians(40.0), np.radians(50.0))
"""Angles to which a door is pulled before it is pushed; the first that works is used [rad]."""
_PUSHED_VALUES = 16
"""Joint values at which the weight of a pushed part is evaluated [-]."""


@dataclass(frozen=True, eq=False)
class TwoMotions:
    """The motions of two grasps: pull the door ajar, push it farther."""

    pulling: TaskMotion
    pushing: TaskMotion

    @property
    def pulls(self) -> int:
        """Return the number of score columns of the first grasp, which precede the second's."""
        return len(self.pulling.Ts_world_tool)

    def scorer(self, report: Callable[[int], None] = lambda _: None) -> GraspModeScorer:
        """Return the scorer of both grasps, see `two_grasp_scorer`."""
        return two_grasp_scorer(_at_waypoints(self.pulling), _at_waypoints(self.pushing), report)

    def problem(self, problem: Problem, report: Callable[[int], None]) -> Problem:
        """Return a search's problem with the base poses and the scores of two grasps."""
        geometry = replace(problem.geometry, Ts_world_tool=_at_waypoints(self.pushing))
        return replace(
            problem, geometry=geometry, mode_scorers=(self.scorer(report),), infeasible_reason=""
        )


def _at_waypoints(motion: TaskMotion) -> Float[np.ndarray, "g w 4 4"]:
    return np.ascontiguousarray(motion.Ts_world_tool[:, motion.waypoint_steps])


@dataclass(frozen=True)
class TwoGrasps:
    """The check of base poses for opening a door with two grasps."""

    whole: PreparedTask
    """The whole task."""
    first: Feasibility
    """Pulls the door ajar and draws the hand back."""
    second: Feasibility
    """Pushes it farther."""
    config: PipelineConfig
    seed: int
    quick: bool = False
    """Whether a long search for a way between the grasps is postponed."""
    postponed: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    """Base poses at which a short search found no way between the grasps."""
    _pulled: dict[bytes, ArmPathResult] = field(default_factory=dict)
    """Arm paths of the first grasp, by base pose."""

    @cached_property
    def motions(self) -> TwoMotions:
        """Return both motions, with the grasps in which the hand is free."""
        return TwoMotions(self.first.motion, self.second.motion)

    @property
    def mode_scorers(self) -> tuple[GraspModeScorer, ...]:
        """Return the scorer of both grasps, the first one's columns first."""
        return (self.motions.scorer(),)

    @property
    def pulling(self) -> PlacementGeometry:
        """Return the scene and the first grasp as placement takes them."""
        return replace(self.whole.geometry, Ts_world_tool=_at_waypoints(self.first.motion))

    def problem(self, problem: Problem) -> Problem:
        """Return the search's problem, for two grasps."""
        return replace(
            self.motions.problem(problem, lambda _: None),
            screen=self.screen,
            attempt=self,
            near=None,  # both grasps would have to follow
            grasp_step=self.second.motion.grasp_step,
        )

    def screen(
        self, bases: Float[np.ndarray, "n 3"], scores: Float[np.ndarray, "n h"], most: int | None
    ) -> list[ArmPathResult]:
        """Search arm paths for both grasps, see `Feasibility.screen`."""
        pulled = self.first.screen(bases, scores[:, : self.motions.pulls], most)
        found = np.array([one.q is not None for one in pulled])
        if not found.any():
            return pulled
        pushed = self.second.screen(bases[found], scores[found, self.motions.pulls :], most)
        results = list(pulled)
        for i, result in zip(np.flatnonzero(found).tolist(), pushed, strict=True):
            self._pulled[bases[i].tobytes()] = pulled[i]
            results[i] = result
        return results

    def __call__(
        self, base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
    ) -> Attempt:
        """Complete both grasps at a base pose: approach, path between them, exact check."""
        pulls, pushes = (
            ways[ways < self.motions.pulls],
            ways[ways >= self.motions.pulls] - self.motions.pulls,
        )
        pulled = self.first(base, self._pulled[base.tobytes()], pulls)
        if pulled.motion is None:
            return pulled
        outcomes = []
        short = quick_config(self.config.arm_planner)
        for pushed in self._pushes(base, screened, pushes, pulled.motion):
            if pushed.grasp in self.second.unheld:
                refusal = self.second.unheld[pushed.grasp]
                outcomes.append(PoseOutcome(PoseStatus.EXACT_CHECK, refusal))
                continue
            attempt = self._joined(base, pulled.motion, pushed, short)
            if attempt.motion is not None:
                return attempt
            outcomes.append(attempt.outcome)
        if PoseOutcome(PoseStatus.NO_APPROACH) in outcomes:
            if not self.quick:
                long = brief_config(self.config.arm_planner)
                return self._joined(base, pulled.motion, screened, long)
            self.postponed.append(base)
        return Attempt(None, max(outcomes, key=lambda one: one.progress))

    def _pushes(
        self,
        base: Float[np.ndarray, "3"],
        screened: ArmPathResult,
        pushes: Int[np.ndarray, " k"],
        pulled: Motion,
    ) -> list[ArmPathResult]:
        """Return the arm paths of the second grasp, those that begin nearest to the first one's end
        first.
        """
        start = self.second.robot.chain.freedom_values(pulled.q[-1])
        found = [screened, *self.second.arm_paths(base, pushes[pushes != screened.grasp])]
        states = [self._near(one, start) for one in found]
        far = [float(np.abs(q[0] - start).max()) for q in states]
        return [replace(found[k], q=states[k]) for k in np.argsort(far, kind="stable")]

    def _near(
        self, pushed: ArmPathResult, start: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "d n"]:
        """Return the states of the second grasp, by whole turns nearest to the first one's end."""
        assert pushed.q is not None
        chain = self.second.robot.chain
        return near_home(pushed.q, start, chain.lower, chain.upper)

    def _joined(
        self,
        base: Float[np.ndarray, "3"],
        pulled: Motion,
        pushed: ArmPathResult,
        config: PlannerConfig,
    ) -> Attempt:
        """Complete the motion of both grasps, given each one's."""
        start = self.second.robot.chain.freedom_values(pulled.q[-1])
        q = self.second.with_smooth_posture(base, self._near(pushed, start), pushed.grasp)
        between = self._between(base, start, q[0], config)
        if between is None:
            return Attempt(None, PoseOutcome(PoseStatus.NO_APPROACH))
        motion = self._motion(base, pulled, between, replace(pushed, q=q))
        if self.config.motion.home_again:
            home = self.second.path_home(base, q[-1], pushed.grasp)
            if home is None:
                return Attempt(None, PoseOutcome(PoseStatus.NO_WAY_HOME))
            motion = replace(motion, home=home)
        refusal = self.whole.violation(base, motion)
        if refusal is not None:
            # The pull has passed this check.
            return Attempt(None, self.second.refused(pushed.grasp, refusal))
        return Attempt(motion, PoseOutcome(PoseStatus.FEASIBLE))

    def _between(
        self,
        base: Float[np.ndarray, "3"],
        start: Float[np.ndarray, " n"],
        goal: Float[np.ndarray, " n"],
        config: PlannerConfig,
    ) -> Float[np.ndarray, "k n"] | None:
        """Return states of a free arm path while the door stands ajar."""
        chain = self.second.robot.chain
        checker = partial(
            build_motions, self.second.world, chain, self.second.robot.spheres.by_hulls, base,
            value=int(self.second.motion.value[0]), holding=False, step=RESOLUTION,
        )  # fmt: skip
        path = plan_with_clearance(
            start, goal, chain.lower, chain.upper, checker,
            config=config, seed=self.seed,
        )  # fmt: skip
        return None if path is None else path.states()

    def _motion(
        self,
        base: Float[np.ndarray, "3"],
        pulled: Motion,
        between: Float[np.ndarray, "k n"],
        pushed: ArmPathResult,
    ) -> Motion:
        """Join both grasps into one motion; the door rests between them."""
        assert pushed.q is not None
        free, second = between[1:], self.second.motion
        chain = self.second.robot.chain
        q = np.concatenate([chain.freedom_values(pulled.q), free, pushed.q[1:]])
        ajar = np.repeat(pulled.object_q[-1], len(free))
        object_q = np.concatenate([pulled.object_q, ajar, second.object_q[1:]])
        begin = len(pulled.q) + len(free) - 1 + second.grasp_step
        (push,) = second.holds(pushed.grasp)
        hold = replace(push, first=begin, last=begin + push.last)
        Ts = pose_planar(base) @ chain.tool_poses(q)
        joined = Motion(
            pulled.approach, chain.joint_values(q), object_q, Ts, holds=(*pulled.holds, hold)
        )
        return with_close_states(joined, partial(world_tools, chain, base))


@dataclass(frozen=True, eq=False)
class AjarDoor:
    """A door that is pulled to a value and pushed from there, before the hand is checked."""

    whole: PreparedTask
    """The whole task."""
    opened: Scene
    """The scene with the door ajar."""
    pull: Task
    pushing: TaskMotion
    """The second motion, with all grasps."""
    config: PipelineConfig
    watch: Stopwatch

    @property
    def ends(self) -> frozenset[bytes]:
        """Return the tool poses at the end of the second grasp, rounded to the micrometer."""
        Ts = np.round(self.pushing.Ts_world_tool[:, -1], 6) + 0.0
        return frozenset(T.tobytes() for T in Ts)

    @cached_property
    def motions(self) -> TwoMotions:
        """Return both motions, with all grasps."""
        whole, config = self.whole, replace(self.config.motion, home_again=True)
        with self.watch.stage("model"):
            pulling = task_motion(whole.scene, whole.robot, self.pull, config)
        return TwoMotions(pulling, self.pushing)

    def is_within_reach(self, problem: Problem, place: PlaceConfig) -> tuple[bool, bool]:
        """Return whether some base pose of the grid reaches both grasps, and the end of both.

        Unknown, and so true, if the first grasp is of another handle than the whole task's.
        """
        if self.motions.pulling.handle != self.whole.motion.handle:
            return True, True
        ends: list[int] = []
        found = is_within_reach(self.motions.problem(problem, ends.append), place)
        return found, any(ends)

    def prepared(self, seed: int, keep_grasps: GraspFilter | None) -> TwoGrasps | None:
        """Prepare both grasps; None if the hand has no free one.

        Args:
            seed: The same seed gives the same motion.
            keep_grasps: Returns which grasps may be used for pulling.
        """
        whole, robot = self.whole, self.whole.robot
        config, watch = self.config, self.watch
        clearance = whole.geometry.clearance
        first = prepare(
            whole.scene, robot, self.pull, config, clearance=clearance,
            motion=self.motions.pulling, keep_grasps=keep_grasps, watch=watch,
        )  # fmt: skip
        if first.no_grasp:
            return None
        second = prepare(
            self.opened, robot, whole.task, config, clearance=clearance,
            motion=self.pushing, watch=watch,
        )  # fmt: skip
        if second.no_grasp:
            return None
        one, other = (
            replace(part.feasibility(config, seed, watch=watch), home_again=False)
            for part in (first, second)
        )
        return TwoGrasps(whole, one, other, config, seed)


def ajar_doors(whole: PreparedTask, config: PipelineConfig, watch: Stopwatch) -> Iterator[AjarDoor]:
    """Yield the task with two grasps, for each value at which the hand may let go.

    Arms of fewer than six degrees of freedom cannot do it.

    Args:
        whole: The task.
        config: How to plan.
        watch: Counts the stages.
    """
    pushes = Family.PUSH in config.motion.grasps.families and whole.robot.chain.size >= FULL_DOF
    pushes &= config.motion.grasps.own != "only"
    pushes &= whole.motion.latch_q is None  # the hand that turned the latch keeps it turned
    for ajar in AJAR_ANGLES if pushes and not whole.blocked else ():
        door = _ajar_door(whole, config, ajar, watch)
        if door is not None:
            yield door


def iter_two_grasps(
    whole: PreparedTask,
    config: PipelineConfig,
    seed: int,
    *,
    keep_grasps: GraspFilter | None = None,
    watch: Stopwatch | None = None,
) -> Iterator[TwoGrasps]:
    """Yield the task with two grasps, prepared, see `ajar_doors` and `AjarDoor.prepared`."""
    watch = watch or Stopwatch(lambda: 0.0)
    for door in ajar_doors(whole, config, watch):
        two = door.prepared(seed, keep_grasps)
        if two is not None:
            yield two


def _ajar_door(
    whole: PreparedTask, config: PipelineConfig, ajar: float, watch: Stopwatch
) -> AjarDoor | None:
    """Return the motions with two grasps, given the angle to which the door is pulled [rad].

    Returns:
        None if the part slides, closes, opens less far, does not stay where the hand lets go, or
        falls open from there.
    """
    scene, robot, task = whole.scene, whole.robot, whole.task
    if task.verb != "open" or task.joint is None or task.to is None:
        return None
    item = scene.object(task.object)
    opening = opening_of(item.model, task.joint)
    value = opening.closed + opening.sign * ajar
    start = item.values()[task.joint]
    on_the_way = opening.sign * start < opening.sign * value < opening.sign * task.to
    turns = item.model.joint(task.joint).kind != "prismatic"
    if not (on_the_way and turns):
        return None
    pushed = np.linspace(value, task.to, _PUSHED_VALUES)
    resistance = config.motion.grasps.resistance
    if not stays_in_place(item, task.joint, pushed[:1], resistance)[0]:
        return None
    if resistance_along(item, task.joint, pushed, 1.0, resistance).along.min() < 0.0:
        return None  # the part would fall open, away from the hand
    pull, opened = (
        Task("open", task.object, task.joint, value),
        scene.with_joint(task.object, task.joint, value),
    )
    with watch.stage("model"):
        pushing = task_motion(opened, robot, task, config.motion, inside=True)
    return AjarDoor(whole, opened, pull, pushing, config, watch)
