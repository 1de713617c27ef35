"""Check base poses: path over the waypoints, approach from home, exact check."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import look, within_limits
from momapos.core.geometry import invert, pose_planar
from momapos.model import with_close_states
from momapos.model.collision import (
    FREE,
    CollisionWorld,
    Spheres,
    StraightMotions,
    build_motions,
    check,
)
from momapos.model.kinematics import Chain
from momapos.model.records import ArmPathResult, Attempt, Motion, PoseOutcome, PoseStatus
from momapos.model.robots import Robot
from momapos.planning.grasps import FULL_DOF, TaskMotion
from momapos.verification import HOLD_CHECK

from .arm_path import (
    FOUND,
    HIT,
    UNREACHABLE,
    ArmPath,
    HandHits,
    StateAtStep,
    find_paths,
    follow,
    waypoint_name,
)
from .arm_planner import RESOLUTION, brief_config, fill_curve, plan_with_clearance
from .config import PlannerConfig
from .free_turn import find_short_paths, smooth_posture
from .hand_clearance import arm_spheres
from .ik_layers import TaskLoads
from .payload import carrying_homes, upright_of, with_payload

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


DescribeContact: TypeAlias = (
    "Callable[[Float[np.ndarray, '3'], Float[np.ndarray, ' n'], float, str], str]"
)
"""Says how deep a base and an arm are in an obstacle: see `PlanVerifier.contact`."""
Refusal: TypeAlias = "Callable[[Float[np.ndarray, '3'], Motion], str | None]"
"""The exact check: return None if a motion is valid, else the reason why not."""
FindPaths: TypeAlias = "Callable[[Float[np.ndarray, 'j 3'], Int[np.ndarray, ' j']], list[ArmPath]]"
"""Searches an arm path for each pair of base pose and grasp mode."""
CarryingStates: TypeAlias = "Callable[[Float[np.ndarray, '3'], int], Iterable[np.ndarray]]"
_BATCH = 128
"""Pairs of base pose and grasp mode that a thread processes together [-]."""
_WIDER = 4
"""Factor by which the number of grasp modes grows from round to round [-]."""
_THREADS = 2
MAX_CARRIED = 2
"""Number of states in which an object is carried that are tried, the nearest ones first [-]."""


@dataclass(frozen=True)
class Feasibility:
    """Checks base poses for one robot, scene and task."""

    robot: Robot
    world: CollisionWorld
    motion: TaskMotion
    planner: PlannerConfig
    refuse: Refusal
    seed: int
    home_again: bool = False
    """Whether the arm returns home at the end."""
    homes: CarryingStates | None = None
    """Yields the arm states in which the robot carries the object to a base pose, or from it after
    a pick, the preferred one first, given also the grasp; None to choose them."""
    find: FindPaths | None = None
    """Searches arm paths for a base that moves; None for a base that stands."""
    describe: DescribeContact | None = None
    refusal_detail: Callable[[str], str] = lambda _: ""
    """Returns the detail of a refusal by the exact check."""
    unheld: dict[int, str] = field(default_factory=dict)
    """Grasps in which the exact check found the hand off the part, and its words."""

    def __call__(
        self, base: Float[np.ndarray, "3"], screened: ArmPathResult, grasps: Int[np.ndarray, " k"]
    ) -> Attempt:
        """Complete a motion at a base pose: approach from home, then exact check.

        Args:
            base: Base pose x [m], y [m], yaw [rad].
            screened: An arm path there.
            grasps: Grasp modes to try, best first, if that path cannot be completed.
        """
        assert screened.q is not None
        motion, outcome = self._complete(base, screened.q, screened.grasp, screened.bases)
        others = self._held(grasps[grasps != screened.grasp])
        for chunk in np.split(others, range(_WIDER, len(others), _WIDER)):
            if motion is not None or not len(chunk):
                break
            for grasp, path in zip(
                chunk.tolist(), self._paths(np.tile(base, (len(chunk), 1)), chunk),
                strict=True,
            ):  # fmt: skip
                if path.q is not None and motion is None:
                    motion, outcome = self._complete(base, path.q, grasp, path.bases)
        moved = None if motion is None else motion.base
        return Attempt(motion, outcome, base=None if moved is None else moved[0])

    def screen(
        self, bases: Float[np.ndarray, "n 3"], scores: Float[np.ndarray, "n g"], most: int | None
    ) -> list[ArmPathResult]:
        """Search an arm path at each of many base poses, the best reached grasp modes first.

        Args:
            bases: Base poses that stand clear.
            scores: Reachability of each grasp mode from each pose; only those above 0 are tried.
            most: Maximum number of grasp modes tried at one pose; None for all.

        Returns:
            The result at each pose.
        """
        scores, unheld = self._held_scores(scores)
        order = np.argsort(-scores, axis=1, kind="stable")[:, :most]
        reached = np.minimum((scores > 0).sum(1), order.shape[1])
        home = self._check(
            np.tile(self.robot.home, (len(bases), 1)), bases, self.robot.spheres.by_hulls
        )
        best: list[tuple[int, ArmPath | None]] = [(-1, None)] * len(bases)
        undecided = home == FREE
        first, width = 0, 1
        while first < order.shape[1]:
            ranks = np.arange(first, min(first + width, order.shape[1]))
            base, rank = np.nonzero(undecided[:, None] & (ranks < reached[:, None]))
            grasps = order[base, ranks[rank]]
            paths = self._paths(bases[base], grasps)
            for i, grasp, path in zip(base.tolist(), grasps.tolist(), paths, strict=True):
                before = best[i][1]
                if before is None or (before.status != FOUND and _farther(path, before)):
                    best[i] = (grasp, path)
                undecided[i] &= path.status != FOUND
            first, width = first + width, _WIDER * width
        return [
            ArmPathResult(
                grasp,
                None if path is None else path.q,
                self._outcome(path, base, int(code), why),
                None if path is None else path.bases,
            )
            for (grasp, path), base, code, why in zip(best, bases, home, unheld, strict=True)
        ]

    def follows(
        self, base: Float[np.ndarray, "3"], path: ArmPathResult, others: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return from which other base poses the hand does the same with arm states near a path's.

        That takes a fraction of the time of a search. Where it fails, another path may exist.

        Args:
            base: A base pose x [m], y [m], yaw [rad].
            path: An arm path there.
            others: Base poses nearby that stand clear.
        """
        assert path.q is not None
        robot, motion, chain = self.robot, self.motion, self.robot.chain
        spheres, count = robot.spheres.by_hulls, len(path.q)
        home = self._check(np.tile(robot.home, (len(others), 1)), others, spheres)
        tools = pose_planar(base) @ chain.tool_poses(path.q)
        found = {
            row: q
            for row in np.flatnonzero(home == FREE).tolist()
            if (q := follow(robot, path.q, invert(pose_planar(others[row])) @ tools)) is not None
        }
        works, rows = np.zeros(len(others), bool), np.array(list(found), int)
        if not found:
            return works
        # The hand is where it was, so its own collisions are known.
        q = np.concatenate(list(found.values()))
        bases = np.repeat(others[rows], count, axis=0)
        value, holding = (np.tile(x, len(rows)) for x in (motion.value, motion.holding))
        codes = check(self.world, chain, arm_spheres(robot), q, bases, value, holding)
        grasp = int(motion.turning.members(np.array([path.grasp]))[0, 0])
        borne = TaskLoads(robot, motion).at(bases, q, grasp, np.tile(np.arange(count), len(rows)))
        works[rows] = ((codes == FREE) & ~borne.refused).reshape(len(rows), count).all(1)
        return works

    def refused(self, grasp: int, why: str) -> PoseOutcome:
        """Return the outcome of a motion that the exact check refused, and remember a bad grasp."""
        if why.startswith(HOLD_CHECK) and grasp < len(self.motion.Ts_world_tool):
            self.unheld[grasp] = why
        return PoseOutcome(PoseStatus.EXACT_CHECK, why, contact=partial(self.refusal_detail, why))

    def _held(self, grasps: Int[np.ndarray, " k"]) -> Int[np.ndarray, " h"]:
        """Return the grasp modes that are not known to miss the part."""
        return grasps[~np.isin(grasps, list(self.unheld))] if self.unheld else grasps

    def _held_scores(
        self, scores: Float[np.ndarray, "n g"]
    ) -> tuple[Float[np.ndarray, "n g"], list[str]]:
        """Return scores, 0 for grasps that miss the part, and why at poses with no other."""
        if not self.unheld:
            return scores, [""] * len(scores)
        missed = list(self.unheld)
        held = scores.copy()
        held[:, missed] = 0.0
        first = (scores[:, missed] > 0).argmax(1).tolist()
        no_other = np.logical_and((scores > 0).any(1), ~(held > 0).any(1)).tolist()
        why = [
            self.unheld[missed[k]] if alone else ""
            for k, alone in zip(first, no_other, strict=True)
        ]
        return held, why

    def arm_paths(
        self, base: Float[np.ndarray, "3"], grasps: Int[np.ndarray, " k"]
    ) -> list[ArmPathResult]:
        """Return the arm paths of those grasp modes that have one."""
        grasps = self._held(grasps)
        paths = self._paths(np.tile(base, (len(grasps), 1)), grasps)
        return [
            ArmPathResult(grasp, path.q, self._outcome(path, base), path.bases)
            for grasp, path in zip(grasps.tolist(), paths, strict=True)
            if path.q is not None
        ]

    def _paths(
        self, bases: Float[np.ndarray, "j 3"], grasps: Int[np.ndarray, " j"]
    ) -> list[ArmPath]:
        """Search arm paths of pairs of base pose and grasp mode."""
        count = min(len(grasps), max(_THREADS, len(grasps) // _BATCH))
        pieces = np.array_split(np.arange(len(grasps)), max(count, 1))

        def work(part: Int[np.ndarray, " p"]) -> list[ArmPath]:
            look()
            return self._search(bases[part], grasps[part])

        found = _threads().map(within_limits(work), pieces) if count > 1 else map(work, pieces)
        return [path for paths in found for path in paths]

    def _search(
        self, bases: Float[np.ndarray, "j 3"], grasps: Int[np.ndarray, " j"]
    ) -> list[ArmPath]:
        if self.find is not None:
            return self.find(bases, grasps)
        given = self.robot, self.world, self.motion, bases, grasps
        if self.robot.chain.size < FULL_DOF:
            return find_short_paths(*given)
        return find_paths(*given, self._hand)

    @cached_property
    def _hand(self) -> HandHits:
        """Cache of the hand's first hits; threads may write the same entry twice."""
        return {}

    def _check(
        self, q: Float[np.ndarray, "m n"], base: Float[np.ndarray, "*m 3"], spheres: Spheres
    ) -> Int[np.ndarray, " m"]:
        """Check states of the approach; an object to be placed is already in the hand.

        The base pose is one for all states, or one for each.
        """
        return check(
            self.world, self.robot.chain, spheres, np.ascontiguousarray(q),
            np.array(np.broadcast_to(base, (len(q), 3))),
            np.full(len(q), self.motion.value[0]),
            np.full(len(q), self._carrying),
        )  # fmt: skip

    @property
    def _carrying(self) -> bool:
        """Whether the object is in the hand from the start."""
        return self.motion.task.verb == "place"

    def _complete(
        self,
        base: Float[np.ndarray, "3"],
        q: Float[np.ndarray, "d n"],
        grasp: int,
        bases: Float[np.ndarray, "d 3"] | None,
    ) -> tuple[Motion | None, PoseOutcome]:
        """Add the approach from home and run the exact check; the base may move after the grasp."""
        chain, hold = self.robot.chain, self.motion.grasp_step
        begin = hold
        if bases is not None:
            base = bases[0]
            # A base that moves before the grasp does so in the manipulation.
            begin = hold if (bases[: hold + 1] == base).all() else 0
        spheres = self.robot.spheres.by_hulls
        if self._carrying:
            spheres = with_payload(self.robot, self.motion, self.motion.Ts_world_tool[grasp, 0], 0)
        checker = partial(
            build_motions, self.world, chain, spheres, base, value=int(self.motion.value[0]),
            holding=self._carrying, step=RESOLUTION,
            upright=upright_of(self.robot, self.motion, grasp) if self._carrying else None,
        )  # fmt: skip
        screened = q
        outcome = PoseOutcome(PoseStatus.NO_ROUTE_CARRYING, self.motion.task.object)
        approach: Float[np.ndarray, "k n"] | None = None
        for begun in self._begins(base, grasp, q[0]):
            outcome = PoseOutcome(PoseStatus.NO_APPROACH)
            q = near_home(screened, begun, chain.lower, chain.upper)
            q = self.with_smooth_posture(base if bases is None else bases, q, grasp)
            approach = self._path(
                begun, q[0], checker, (grasp, 0) if self._carrying else None,
                self.planner, self.seed + grasp, fill_curve(q[: begin + 1], RESOLUTION)[1:],
            )  # fmt: skip
            if approach is not None:
                break
        if approach is None:
            return None, outcome
        Ts_world_tool = pose_planar(base if bases is None else bases) @ chain.tool_poses(q)
        steps, holds = self.motion.executed_steps(grasp, Ts_world_tool)
        steps = steps[begin:]
        holds = tuple(
            replace(one, first=one.first + hold - begin, last=one.last + hold - begin)
            for one in holds
        )
        motion = Motion(
            chain.joint_values(approach), chain.joint_values(q[steps]),
            self.motion.object_q[steps], Ts_world_tool[steps], holds=holds,
            latch_q=None if self.motion.latch_q is None else self.motion.latch_q[steps],
            base=None if bases is None else bases[steps],
        )  # fmt: skip
        motion = with_close_states(motion, partial(world_tools, chain, base))
        if self.home_again:
            home = self.path_home(base if bases is None else bases[-1], q[-1], grasp)
            if home is None:
                return None, PoseOutcome(PoseStatus.NO_WAY_HOME)
            motion = replace(motion, home=home)
        refusal = self.refuse(base, motion)
        if refusal is not None:
            return None, self.refused(grasp, refusal)
        return motion, PoseOutcome(PoseStatus.FEASIBLE)

    def _begins(
        self, base: Float[np.ndarray, "3"], grasp: int, q: Float[np.ndarray, " n"]
    ) -> Iterable[np.ndarray]:
        """Return the arm states in which the robot arrives at a base pose, to go to a state."""
        if not self._carrying:
            return (self.robot.home,)
        return self._carried_near(grasp, q) if self.homes is None else self.homes(base, grasp)

    def _carried_near(self, grasp: int, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k n"]:
        """Return the states nearest to one in which an object in a grasp can be carried."""
        homes = carrying_homes(self.robot, self.motion, grasp)
        return homes[np.argsort(np.abs(homes - q).max(1), kind="stable")][:MAX_CARRIED]

    def with_smooth_posture(
        self, base: Float[np.ndarray, "*d 3"], q: Float[np.ndarray, "d n"], grasp: int
    ) -> Float[np.ndarray, "d n"]:
        """Return arm states with the same tool poses and fewer corners, if they are free.

        Args:
            base: Base pose x [m], y [m], yaw [rad], or one at every step.
            q: Arm states at every step of the motion.
            grasp: The grasp mode.
        """
        smooth, motion = smooth_posture(self.robot, q), self.motion
        if smooth is None:
            return q
        steps = np.arange(len(q))
        codes = check(
            self.world, self.robot.chain, self.robot.spheres.by_hulls, smooth,
            np.array(np.broadcast_to(base, (len(q), 3))), motion.value, motion.holding,
        )  # fmt: skip
        member = int(motion.turning.members(np.array([grasp]))[0, 0])
        borne = TaskLoads(self.robot, motion).at(base, smooth, member, steps)
        return smooth if (codes == FREE).all() and not borne.refused.any() else q

    def path_home(
        self, base: Float[np.ndarray, "3"], q: Float[np.ndarray, " n"], grasp: int
    ) -> Float[np.ndarray, "h m"] | None:
        """Plan all joints' states from the end of the motion (excluded) home; None if impossible.

        The hand carries a picked object, to the nearest state in which it can carry it on; a moved
        part stays.

        Args:
            base: Base pose x [m], y [m], yaw [rad].
            q: Arm state at the end.
            grasp: Index of the grasp, for rigid objects.
        """
        motion, chain, spheres, last = (
            self.motion,
            self.robot.chain,
            self.robot.spheres.by_hulls,
            -1,
        )
        homes, upright = self.robot.home[None], None
        if motion.task.verb == "pick":
            T = motion.Ts_world_tool[grasp, last]
            spheres = with_payload(self.robot, motion, T, last)
            upright = upright_of(self.robot, motion, grasp)
            homes = self._carried_near(grasp, q)
            if self.homes is not None:
                homes = np.array([*self.homes(base, grasp)])
        # A hand that pushed has not retracted from the part.
        pushes = motion.task.joint is not None and motion.release_step is None
        checker = partial(
            build_motions, self.world, chain, spheres, base, value=int(motion.value[last]),
            holding=pushes or motion.task.verb == "pick", step=RESOLUTION, upright=upright,
        )  # fmt: skip
        carried = (grasp, len(motion.value) - 1) if motion.task.verb == "pick" else None
        config = brief_config(self.planner)
        for home in homes:
            none = np.empty((0, len(q)))
            path = self._path(q, home, checker, carried, config, self.seed + grasp, none)
            if path is not None:
                return chain.joint_values(path[1:])
        return None

    def _path(
        self,
        start: Float[np.ndarray, " n"],
        goal: Float[np.ndarray, " n"],
        checker: Callable[..., StraightMotions],
        carried: tuple[int, int] | None,
        config: PlannerConfig,
        seed: int,
        then: Float[np.ndarray, "m n"],
    ) -> Float[np.ndarray, "k n"] | None:
        """Return states of a free arm motion that the motors and the base bear, and what follows.

        Loads rarely decide, so the search considers them only if its first path exceeds them.
        """
        loads, chain = TaskLoads(self.robot, self.motion), self.robot.chain
        ends = start, goal, chain.lower, chain.upper
        path = plan_with_clearance(*ends, checker, config=config, seed=seed)
        if path is None:
            return None
        states = path.states(then)
        if not loads.free(states[: len(states) - len(then)], carried).refused.any():
            return states
        bounded = partial(checker, load=loads.of_hand(carried))
        path = plan_with_clearance(*ends, bounded, config=config, seed=seed)
        return None if path is None else path.states(then)

    def _outcome(
        self,
        path: ArmPath | None,
        base: Float[np.ndarray, "3"],
        at_home: int = FREE,
        unheld: str = "",
    ) -> PoseOutcome:
        if at_home != FREE:
            obstacle = self.world.reason(at_home)
            contact = self._contact((base, self.robot.home, 0), obstacle)
            return PoseOutcome(PoseStatus.HOME_COLLISION, obstacle, contact=contact)
        if path is None and unheld:
            return PoseOutcome(PoseStatus.EXACT_CHECK, unheld)
        if path is None:
            return PoseOutcome(PoseStatus.NO_GRASP_IN_REACH)
        where = waypoint_name(path.waypoint)
        if path.status == FOUND:
            return PoseOutcome(PoseStatus.PATH_FOUND)
        if path.overload is not None:
            return path.overload
        if path.status == UNREACHABLE:
            return PoseOutcome(PoseStatus.WAYPOINT_OUT_OF_REACH, where=where)
        if path.status == HIT:
            obstacle = self.world.reason(path.obstacle)
            hits = PoseStatus.BASE_COLLISION if path.base_hits else PoseStatus.ARM_COLLISION
            return PoseOutcome(hits, obstacle, where, self._contact(path.hit, obstacle))
        return PoseOutcome(PoseStatus.NO_CONTINUOUS_PATH)

    def _contact(self, hit: StateAtStep | None, obstacle: str) -> Callable[[], str] | None:
        """Return a function that says how deep the robot is in the obstacle in a state."""
        if hit is None or self.describe is None:
            return None
        base, q, step = hit
        value = float(self.motion.object_q[step])
        states = self.robot.chain.joint_values(q[None])[0]
        return partial(self.describe, base, states, value, obstacle)


def world_tools(
    chain: Chain,
    base: Float[np.ndarray, "3"],
    q: Float[np.ndarray, "m n"],
    moved: Float[np.ndarray, "m 3"] | None,
) -> Float[np.ndarray, "m 4 4"]:
    """Return the tool's poses at all joints' states, for a base that stands or moves."""
    states = chain.freedom_values(q)
    return pose_planar(base if moved is None else moved) @ chain.tool_poses(states)


@cache
def _threads() -> ThreadPoolExecutor:
    """Return a shared thread pool: starting a thread takes as long as several paths."""
    return ThreadPoolExecutor(_THREADS, "arm paths")


os.register_at_fork(after_in_child=_threads.cache_clear)  # a forked child has no threads


def _farther(path: ArmPath, other: ArmPath) -> bool:
    return path.status == FOUND or path.passed > other.passed


def near_home(
    q: Float[np.ndarray, "d n"], home: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> Float[np.ndarray, "d n"]:
    """Shift joints that turn fully by whole turns so that a path starts nearest to home."""
    out = q.copy()
    turn = 2 * np.pi
    for k in np.flatnonzero(upper - lower > turn + 0.1):
        wanted = np.round((home[k] - q[0, k]) / turn)
        for shift in sorted((-1, 0, 1), key=lambda s: abs(s - wanted)):
            low, high = q[:, k].min() + shift * turn, q[:, k].max() + shift * turn
            if low >= lower[k] and high <= upper[k]:
                out[:, k] += shift * turn
                break
    return out


MAX_OFFSET, MAX_TURN = 0.05, 0.05
"""Maximum change of the base pose per step of the adaptation [m], [rad]."""


def adapt_motion(
    robot: Robot,
    motion: Motion,
    base: Float[np.ndarray, "3"],
    to: Float[np.ndarray, "3"],
    straight: int,
) -> Motion | None:
    """Move the hand the same way from another base pose, with arm states near the old ones.

    Only joint limits and joint steps are checked, neither collisions nor the grasp.

    Args:
        robot: The robot.
        motion: A motion at `base`.
        base, to: x [m], y [m], yaw [rad].
        straight: Number of the last states of the approach, in which the hand moves straight to the
            grasp; the free motion before them is only bent.

    Returns:
        The motion, or None if the arm cannot follow the tool path from there in small steps.
    """
    chain = robot.chain
    approach, q = chain.freedom_values(motion.approach), chain.freedom_values(motion.q)
    first = len(approach) - straight
    if first < 1:
        return None
    # The last state of the free motion is the first of the straight one.
    states = np.concatenate([approach[first - 1 :], q])
    Ts = pose_planar(base) @ chain.tool_poses(states)
    Ts[-len(q) :] = motion.Ts_world_tool
    steps = int(np.ceil(np.abs((to - base) / [MAX_OFFSET, MAX_OFFSET, MAX_TURN]).max()))
    for share in np.arange(1, steps + 1) / max(steps, 1):
        between = base + share * (to - base)
        found = follow(robot, states, invert(pose_planar(between)) @ Ts)
        if found is None:
            return None
        states = found
    free = _bent(approach[:first], states[0])
    reach = np.concatenate([free, states[1 : straight + 1]])
    home = motion.home
    if home is not None:
        ended = np.concatenate([q[-1:], chain.freedom_values(home)])
        home = chain.joint_values(_bent(ended[::-1], states[-1])[::-1][1:])
    return replace(
        motion,
        approach=chain.joint_values(reach),
        q=chain.joint_values(states[straight + 1 :]),
        home=home,
        approach_times=None,
        times=None,
    )


def _bent(path: Float[np.ndarray, "k n"], end: Float[np.ndarray, " n"]) -> Float[np.ndarray, "k n"]:
    """Move the end of a path and all states before it in proportion to their path length."""
    lengths = np.abs(np.diff(path, axis=0)).max(1, initial=0.0)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    share = along / along[-1] if along[-1] > 0.0 else np.linspace(0.0, 1.0, len(path))
    return path + share[:, None] * (end - path[-1])
