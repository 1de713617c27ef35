"""Two holds: pull a door ajar, let go, push it on from behind, from the same base pose."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch
from momapos.core.geometry import pose_planar
from momapos.model.collision import motion_checker
from momapos.model.records import ArmPathResult, Attempt, Motion, PoseOutcome, PoseStatus, Task
from momapos.model.urdf import opening_of
from momapos.planning.arm_motion import (
    RESOLUTION,
    Feasibility,
    brief,
    interpolate,
    near_home,
    plan_with_room,
)
from momapos.planning.grasps import FULL, GraspFilter, stays, task_motion
from momapos.planning.placement import PlaceConfig, Problem, ScoreWays, scores_of_two_holds

from .config import PipelineConfig
from .task_setup import PreparedTask, prepare

if TYPE_CHECKING:
    from jaxtyping import Float, Int

AJAR = (np.radians(30.0), np.radians(40.0), np.radians(50.0))
"""How far a door is pulled before it is pushed, the first that works [rad]."""


@dataclass(frozen=True)
class TwoHolds:
    """A door's opening in two holds, made ready; the check of base poses."""

    whole: PreparedTask
    """The task as it was asked."""
    first: Feasibility
    """Pulls the door ajar and draws the hand back."""
    second: Feasibility
    """Pushes it on."""
    config: PipelineConfig
    seed: int
    _pulled: dict[bytes, ArmPathResult] = field(default_factory=dict)
    """Arm paths of the first hold, by base pose."""
    _in_reach: list[int] = field(default_factory=list)
    """From how many of the base poses that were asked for the first hold and the end of the second
    are within reach."""

    @property
    def _pulls(self) -> int:
        """Ways of the first hold: columns of scores that come before those of the second."""
        return len(self.first.motion.Ts_world_tool)

    @property
    def ways(self) -> tuple[ScoreWays, ...]:
        """How base poses reach the ways of both holds, those of the first before."""
        first, second = self.first.motion, self.second.motion
        Ts = (m.Ts_world_tool[:, m.waypoint_steps] for m in (first, second))
        one, other = (np.ascontiguousarray(T) for T in Ts)
        return (scores_of_two_holds(one, other, self._in_reach.append),)

    @property
    def in_reach(self) -> bool:
        """Whether the first hold and the end of the second are within reach of any base pose that
        was asked for."""
        return any(self._in_reach)

    @property
    def ends(self) -> frozenset[bytes]:
        """Where the hand can be when the second hold is over, to the micrometer."""
        Ts = np.round(self.second.motion.Ts_world_tool[:, -1], 6) + 0.0
        return frozenset(T.tobytes() for T in Ts)

    def problem(self, problem: Problem) -> Problem:
        """The search's problem, for two holds."""
        second = self.second.motion
        pushing = np.ascontiguousarray(second.Ts_world_tool[:, second.waypoint_steps])
        return replace(
            problem,
            geometry=replace(problem.geometry, Ts_world_tool=pushing),
            ways=self.ways,
            screen=self.screen,
            attempt=self,
            takes_hold=second.grasp_step,
            infeasible_reason="",
        )

    def screen(
        self, bases: Float[np.ndarray, "n 3"], scores: Float[np.ndarray, "n h"], most: int | None
    ) -> list[ArmPathResult] | None:
        """Look for arm paths of both holds, see `Feasibility.screen`."""
        pulled = self.first.screen(bases, scores[:, : self._pulls], most)
        if pulled is None:
            return None
        found = np.array([one.q is not None for one in pulled])
        if not found.any():
            return pulled
        pushed = self.second.screen(bases[found], scores[found, self._pulls :], most)
        if pushed is None:
            return None
        results = list(pulled)
        for i, result in zip(np.flatnonzero(found).tolist(), pushed, strict=True):
            self._pulled[bases[i].tobytes()] = pulled[i]
            results[i] = result
        return results

    def __call__(
        self, base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
    ) -> Attempt:
        """Complete both holds at a base pose: the way from home, between them, the exact check."""
        pulls = ways[ways < self._pulls]
        pulled = self.first(base, self._pulled[base.tobytes()], pulls)
        if pulled.motion is None:
            return pulled
        assert screened.q is not None
        chain = self.second.robot.chain
        start = chain.freedom_values(pulled.motion.q[-1])
        q = near_home(screened.q, start, chain.lower, chain.upper)
        between = self._between(base, start, q[0])
        if between is None:
            return Attempt(None, PoseOutcome(PoseStatus.NO_APPROACH))
        motion = self._joined(base, pulled.motion, between, replace(screened, q=q))
        if self.config.motion.home_again:
            home = self.second.way_home(base, q[-1], screened.grasp)
            if home is None:
                return Attempt(None, PoseOutcome(PoseStatus.NO_WAY_HOME))
            motion = replace(motion, home=home)
        refusal = self.whole.violation(base, motion)
        if refusal is not None:
            return Attempt(None, PoseOutcome(PoseStatus.EXACT_CHECK, refusal))
        return Attempt(motion, PoseOutcome(PoseStatus.FEASIBLE))

    def _between(
        self, base: Float[np.ndarray, "3"], start: Float[np.ndarray, " n"], goal: np.ndarray
    ) -> Float[np.ndarray, "k n"] | None:
        """A free way of the arm while the door stands ajar."""
        chain = self.second.robot.chain
        checker = partial(
            motion_checker, self.second.world, chain, self.second.robot.spheres, base,
            value=int(self.second.motion.value[0]), holding=False, step=RESOLUTION,
        )  # fmt: skip
        return plan_with_room(
            start, goal, chain.lower, chain.upper, checker,
            config=brief(self.config.arm_planner), seed=self.seed,
        )  # fmt: skip

    def _joined(
        self,
        base: Float[np.ndarray, "3"],
        pulled: Motion,
        between: Float[np.ndarray, "k n"],
        pushed: ArmPathResult,
    ) -> Motion:
        """One motion of both holds; the door rests between them."""
        assert pushed.q is not None
        way, second = interpolate(between)[1:], self.second.motion
        chain = self.second.robot.chain
        q = np.concatenate([chain.freedom_values(pulled.q), way, pushed.q[1:]])
        ajar = np.repeat(pulled.object_q[-1], len(way))
        object_q = np.concatenate([pulled.object_q, ajar, second.object_q[1:]])
        begin = len(pulled.q) + len(way) - 1 + second.grasp_step
        (push,) = second.holds(pushed.grasp)
        hold = replace(push, first=begin, last=begin + push.last)
        Ts = pose_planar(base) @ chain.tool_poses(q)
        return Motion(
            pulled.approach, chain.joint_values(q), object_q, Ts, holds=(*pulled.holds, hold)
        )


def every_two_holds(
    whole: PreparedTask,
    config: PipelineConfig,
    seed: int,
    *,
    grasp_filter: GraspFilter | None = None,
    out_of_time: Callable[[], bool] = lambda: False,
    watch: Stopwatch | None = None,
) -> Iterator[TwoHolds]:
    """Make a task ready to be done in two holds, for each value at which the hand may let go.

    Each is made when it is asked for: mostly the first is enough. An arm that needs the turn of its
    hand to reach at all holds nothing twice.
    """
    watch = watch or Stopwatch(lambda: 0.0)
    pushes = "push" in config.motion.grasps.families and whole.robot.chain.size >= FULL
    for ajar in AJAR if pushes and not whole.blocked else ():
        two = _two_holds(whole, config, seed, ajar, grasp_filter, out_of_time, watch)
        if two is not None:
            yield two


def two_hold_searches(
    ready: Iterable[TwoHolds], place: PlaceConfig
) -> Iterator[tuple[TwoHolds, PlaceConfig]]:
    """Searches to be tried in turn: samples for every value first, the grids after them.

    Where no base pose reaches both the pull to a value and an end of the push, none does for the
    values that follow, which are farther to pull to; only what they add to the ends is asked for.
    """
    sampled: list[TwoHolds] = []
    beyond: frozenset[bytes] = frozenset()
    for two in ready:
        if two.ends <= beyond:
            continue
        yield two, replace(place, grid=False)
        if place.grid and not sampled and not two.in_reach:
            yield two, replace(place, rounds=0)
            if not two.in_reach:
                beyond |= two.ends
                continue
        sampled.append(two)
    for two in sampled if place.grid else ():
        yield two, replace(place, rounds=0)


def _two_holds(
    whole: PreparedTask,
    config: PipelineConfig,
    seed: int,
    ajar: float,
    grasp_filter: GraspFilter | None,
    out_of_time: Callable[[], bool],
    watch: Stopwatch,
) -> TwoHolds | None:
    """Make a task ready to be done in two holds.

    Args:
        whole: The task.
        config: How to plan.
        seed: Same seed, same motion.
        ajar: How far the door is pulled, from where it is shut [rad].
        grasp_filter: Rules grasps out by which it might be pulled.
        out_of_time: Asked between steps of the work.
        watch: Counts the stages.

    Returns:
        None where that makes no sense: what slides, what closes, what is to be opened less far,
        what does not stay where the hand lets go of it, and where the hand finds no room.
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
    resistance = config.motion.grasps.resistance
    if not (on_the_way and turns and stays(item, task.joint, value, resistance)):
        return None
    pull, opened = (
        Task("open", task.object, task.joint, value),
        scene.with_joint(task.object, task.joint, value),
    )
    with watch.stage("model"):
        pulling = task_motion(scene, robot, pull, replace(config.motion, home_again=True))
        pushing = task_motion(opened, robot, task, config.motion, inside=True)
    clearance = whole.geometry.clearance
    first = prepare(
        scene, robot, pull, config, clearance=clearance, motion=pulling,
        grasp_filter=grasp_filter, watch=watch,
    )  # fmt: skip
    second = prepare(opened, robot, task, config, clearance=clearance, motion=pushing, watch=watch)
    if first.no_grasp or second.no_grasp:
        return None
    one, other = (
        replace(
            part.feasibility(config, seed, out_of_time=out_of_time, watch=watch), home_again=False
        )
        for part in (first, second)
    )
    return TwoHolds(whole, one, other, config, seed)
