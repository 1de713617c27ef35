"""Move an arm through a set of tool poses at one base pose, and back home.

First the arm states at the poses: all that inverse kinematics finds and that are free. Then their
order: a short path through one state of each pose (RoboTSP: Suarez-Ruiz et al. 2018), by the
largest joint step between states. Then the free motions between them. Where a free motion cannot
end at a pose, because the tool touches something there or nearly does, the hand comes and goes
straight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import improved_order, look, path_length
from momapos.core.geometry import invert, pose_planar
from momapos.model.collision import FREE, CollisionWorld, StraightMotions, build_motions, check
from momapos.model.robots import Robot
from momapos.planning.grasps import PoseTargets, TaskMotion

from .arm_path import follow
from .arm_planner import RESOLUTION, plan_with_clearance
from .config import PlannerConfig
from .hand_clearance import arm_spheres, hand_hits
from .ik_layers import TaskLoads, full_turns, joint_scale, layer_jobs, solve_layers, task_arrays

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_STATES = 1_200
"""Number of arm states at the poses among which the order chooses [-]; their steps take 10 MB."""
MIN_STATES = 3
"""Number of arm states of a pose that are among them [-]."""
ROUNDS = 3
"""How often order and arm states are improved in turn [-]; more rounds rarely change them."""
RETRIES = 3
"""Number of other arm states of a pose that are tried if no motion leads to one [-]."""
STRAIGHT_STEP = 0.01
"""Distance between tool poses of a straight motion [m]."""
_BATCH = 256
"""Pairs of base pose and tool pose between two looks at the clock [-]."""


@dataclass(frozen=True, eq=False)
class PoseArm:
    """The arm of a robot, and the poses it must take in one scene."""

    robot: Robot
    targets: tuple[PoseTargets, ...]
    worlds: tuple[CollisionWorld, ...]
    """The obstacles at the poses of each; at these the hand may touch some. All have all obstacles,
    so that free motions use the first."""
    planner: PlannerConfig
    retreat: float
    """How far the hand comes and goes straight where it must [m]."""
    seed: int = 0

    def reaches(
        self, bases: Float[np.ndarray, "j 3"], poses: Int[np.ndarray, " j"]
    ) -> Bool[np.ndarray, " j"]:
        """Return for pairs of base pose and tool pose whether the arm has a free state there."""
        reached = np.zeros(len(bases), bool)
        for targets, world in zip(self.targets, self.worlds, strict=True):
            own = np.flatnonzero(np.isin(poses, targets.rows))
            arrays = task_arrays(targets.motion, self.robot, world)
            for first in range(0, len(own), _BATCH):
                look()
                rows = own[first : first + _BATCH]
                jobs = layer_jobs(
                    self.robot, targets.motion, bases[rows], targets.modes(poses[rows])
                )
                reached[rows] = solve_layers(jobs, arrays, np.zeros(1, np.int64)).passed > 0
        return reached

    def states(
        self, base: Float[np.ndarray, "3"], poses: Int[np.ndarray, " p"]
    ) -> list[Float[np.ndarray, "_ n"]]:
        """Return all free arm states at each of some poses."""
        found: dict[int, np.ndarray] = {}
        for targets, world in zip(self.targets, self.worlds, strict=True):
            own = poses[np.isin(poses, targets.rows)]
            if not len(own):
                continue
            motion = targets.motion
            arrays = task_arrays(motion, self.robot, world)
            bases = np.tile(base, (len(own), 1))
            jobs = layer_jobs(self.robot, motion, bases, targets.modes(own))
            layers = solve_layers(jobs, arrays, np.zeros(1, np.int64))
            free = layers.checked.copy()
            rows = np.flatnonzero(~free)
            q = np.ascontiguousarray(layers.q[rows])
            free[rows] = self._hits(q, base, motion, world) == FREE
            ends = np.stack([layers.first[:, 0], layers.counts[:, 0]], 1)
            for pose, (first, count) in zip(own.tolist(), ends.tolist(), strict=True):
                part = slice(first, first + count)
                found[pose] = layers.q[part][free[part]]
        return [found[pose] for pose in poses.tolist()]

    def _hits(
        self, q: Float[np.ndarray, "s n"], base: Float[np.ndarray, "3"], motion: TaskMotion,
        world: CollisionWorld,
    ) -> Int[np.ndarray, " s"]:  # fmt: skip
        """Check arm states without their hands, which are free at the poses."""
        count = len(q)
        return check(
            world, self.robot.chain, arm_spheres(self.robot), q, np.tile(base, (count, 1)),
            np.zeros(count, np.int64), np.full(count, motion.holding[0]),
        )  # fmt: skip

    def sequence(
        self, base: Float[np.ndarray, "3"], poses: Int[np.ndarray, " p"], *, in_order: bool
    ) -> PoseSequence:
        """Plan the motion from home through poses and back; those to which none leads are left out.

        Args:
            base: The base pose x [m], y [m], yaw [rad].
            poses: Indices of the poses.
            in_order: Whether their order is fixed.
        """
        states = self.states(base, poses)
        return _Sequencer.of(self, base, poses, states, in_order=in_order).plan()


def free_hands(robot: Robot, world: CollisionWorld, targets: PoseTargets) -> Int[np.ndarray, " g"]:
    """Return what the hand hits at each tool pose, for any base pose; FREE for nothing."""
    motion = targets.motion
    count = len(targets.pose)
    return hand_hits(
        robot, world, motion.Ts_world_tool[:, 0], np.zeros(count, np.int64),
        np.full(count, motion.holding[0]), np.ones(count, bool),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PoseSequence:
    """The motion of an arm through poses, from home and back."""

    poses: Int[np.ndarray, " p"]
    """Indices of the poses that are reached, in their order."""
    q: Float[np.ndarray, "s n"]
    """Close arm states from home to home."""
    at: Int[np.ndarray, " p"]
    """The state at each pose."""


@dataclass(eq=False)
class _Sequencer:
    """The search of a motion through poses at one base pose."""

    arm: PoseArm
    base: Float[np.ndarray, "3"]
    poses: Int[np.ndarray, " p"]
    q: Float[np.ndarray, "m n"]
    """Arm states at the poses."""
    owner: Int[np.ndarray, " m"]
    """The pose of each state, as an index into the poses; ascending."""
    in_order: bool
    _visits: dict[int, _Visit | None] = field(default_factory=dict)
    """By state."""
    _legs: dict[tuple[bytes, bytes], Float[np.ndarray, "s n"] | None] = field(default_factory=dict)
    _free: dict[bool, StraightMotions] = field(default_factory=dict)

    @classmethod
    def of(
        cls, arm: PoseArm, base: Float[np.ndarray, "3"], poses: Int[np.ndarray, " p"],
        states: Sequence[Float[np.ndarray, "_ n"]], *, in_order: bool,
    ) -> _Sequencer:  # fmt: skip
        """Prepare the search with the states of each pose that are nearest to home."""
        chain, most = arm.robot.chain, max(MIN_STATES, MAX_STATES // len(states))
        scale, turns = joint_scale(chain), full_turns(chain)
        kept = [
            one[
                np.argsort(_steps(arm.robot.home[None], one, scale, turns)[0], kind="stable")[:most]
            ]
            for one in states
        ]
        owner = np.repeat(np.arange(len(kept)), [len(one) for one in kept])
        return cls(arm, base, poses, np.concatenate(kept), owner, in_order)

    @cached_property
    def _lengths(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"]]:
        """Steps from home to each state, and between the states."""
        chain = self.arm.robot.chain
        scale, turns = joint_scale(chain), full_turns(chain)
        first = _steps(self.arm.robot.home[None], self.q, scale, turns)[0]
        return first, _steps(self.q, self.q, scale, turns)

    def plan(self) -> PoseSequence:
        """Plan the motion; without arm states to which none leads, and at last without poses."""
        tried, usable = np.zeros(len(self.poses), int), np.ones(len(self.q), bool)
        while usable.any():
            order = self._ordered(np.flatnonzero(usable))
            failed = [state for state in order.tolist() if self._visit(state) is None]
            if not failed:
                found = self._joined(order)
                if isinstance(found, PoseSequence):
                    return found
                failed = [found]
            for state in failed:
                k = self.owner[state]
                usable[state] = False
                tried[k] += 1
                if tried[k] == RETRIES:
                    usable[self.owner == k] = False
        none = np.zeros(0, np.int64)
        return PoseSequence(none, self.arm.robot.home[None], none)

    def _ordered(self, usable: Int[np.ndarray, " u"]) -> Int[np.ndarray, " k"]:
        """Return one state of each pose that has some, in the order of the poses."""
        left, owner = np.unique(self.owner[usable], return_inverse=True)
        first, between = self._lengths[0][usable], self._lengths[1][np.ix_(usable, usable)]
        starts = np.searchsorted(owner, np.arange(len(left) + 1))
        order = np.arange(len(left))
        if not self.in_order:
            order = _nearest(first, between, owner, len(left))
        rows = _best_states(order, first, between, starts)
        for _ in range(0 if self.in_order else ROUNDS):
            D, ends = between[np.ix_(rows, rows)], first[rows]
            better = improved_order(order, ends, D, ends) if len(left) > 1 else order
            if path_length(better, ends, D, ends) >= path_length(order, ends, D, ends) - 1e-9:
                break
            order = better
            rows = _best_states(order, first, between, starts)
        return usable[rows[order]]

    def _visit(self, state: int) -> _Visit | None:
        """Return how the hand comes to a state and goes; None if it does not."""
        if state not in self._visits:
            self._visits[state] = self._new_visit(int(self.poses[self.owner[state]]), self.q[state])
        return self._visits[state]

    def _new_visit(self, pose: int, q: Float[np.ndarray, " n"]) -> _Visit | None:
        """Return how the hand comes to a pose and goes: at once, or straight."""
        free = self._motions(0.0, fine=True)
        if free(q, q):
            return _Visit(q[None])
        arm = self.arm
        k = next(i for i, one in enumerate(arm.targets) if pose in one.rows)
        motion, world, chain = arm.targets[k].motion, arm.worlds[k], arm.robot.chain
        T = pose_planar(self.base) @ chain.tool_poses(q[None])[0]
        count = int(np.ceil(arm.retreat / STRAIGHT_STEP))
        Ts = np.tile(T, (count + 1, 1, 1))
        back = np.linspace(0.0, arm.retreat, count + 1)[:, None]
        Ts[:, :3, 3] -= back * (T[:3, :3] @ arm.robot.approach_axis)
        path = follow(arm.robot, np.tile(q, (count + 1, 1)), invert(pose_planar(self.base)) @ Ts)
        if path is None or (arm._hits(path, self.base, motion, world) != FREE).any():
            return None
        none = np.zeros(count + 1, np.int64)
        held, exact = np.full(count + 1, motion.holding[0]), np.ones(count + 1, bool)
        if (hand_hits(arm.robot, world, Ts, none, held, exact) != FREE).any():
            return None
        return _Visit(path) if free(path[-1], path[-1]) else None

    def _motions(self, extra_clearance: float, *, fine: bool, **_: object) -> StraightMotions:
        key = fine
        if key not in self._free:
            arm = self.arm
            self._free[key] = build_motions(
                arm.worlds[0], arm.robot.chain, arm.robot.spheres.by_hulls, self.base, value=0,
                holding=False, step=RESOLUTION, extra_clearance=extra_clearance, fine=fine,
            )  # fmt: skip
        return self._free[key]

    def _joined(self, order: Int[np.ndarray, " k"]) -> PoseSequence | int:
        """Return the whole motion through states, or the one to which no free motion leads."""
        robot, chain = self.arm.robot, self.arm.robot.chain
        turns = full_turns(chain)
        parts, at, count = [robot.home[None]], [], 1
        now = robot.home
        for state in order.tolist():
            look()
            visit = self._visit(state)
            assert visit is not None
            path = _near(visit.path, now, turns, chain.lower, chain.upper)
            leg = self._leg(now, path[-1], by_home=True)
            if leg is None:
                return int(state)
            parts += [leg[1:], path[::-1][1:], path[1:]]
            at.append(count + len(leg) + len(path) - 3)
            count += len(leg) + 2 * len(path) - 3
            now = path[-1]
        home = self._leg(now, robot.home)
        if home is None:
            return int(order[-1])
        parts.append(home[1:])
        reached = self.poses[self.owner[order]]
        return PoseSequence(reached, np.concatenate(parts), np.array(at))

    def _leg(
        self,
        start: Float[np.ndarray, " n"],
        goal: Float[np.ndarray, " n"],
        *,
        by_home: bool = False,
    ) -> Float[np.ndarray, "s n"] | None:
        """Return close states of a motion from state to state, if need be by home; None without."""
        key = start.tobytes(), goal.tobytes()
        if key not in self._legs:
            self._legs[key] = self._new_leg(start, goal)
        found = self._legs[key]
        if found is not None or not by_home:
            return found
        there = self._leg(self.arm.robot.home, goal)
        back = None if there is None else self._leg(start, self.arm.robot.home)
        return None if there is None or back is None else np.concatenate([back, there[1:]])

    def _new_leg(
        self, start: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "s n"] | None:
        """Plan a free motion that motors and base bear."""
        arm, chain = self.arm, self.arm.robot.chain
        loads = TaskLoads(arm.robot, arm.targets[0].motion)
        ends = start, goal, chain.lower, chain.upper
        path = plan_with_clearance(*ends, self._motions, config=arm.planner, seed=arm.seed)
        if path is None:
            return None
        states = path.states()
        if not loads.free(states).refused.any():
            return states
        bounded = partial(
            build_motions, arm.worlds[0], chain, arm.robot.spheres.by_hulls, self.base, value=0,
            holding=False, step=RESOLUTION, load=loads.of_hand(None),
        )  # fmt: skip
        path = plan_with_clearance(*ends, bounded, config=arm.planner, seed=arm.seed)
        return None if path is None else path.states()


@dataclass(frozen=True, eq=False)
class _Visit:
    """Arm states from a pose straight back to where a free motion ends."""

    path: Float[np.ndarray, "s n"]


def _steps(
    a: Float[np.ndarray, "s n"], b: Float[np.ndarray, "t n"], scale: Float[np.ndarray, " n"],
    turns: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "s t"]:  # fmt: skip
    """Return the largest joint difference between states, in the shorter direction [rad]."""
    worst = np.zeros((len(a), len(b)))
    for k in range(a.shape[1]):
        d = np.abs(a[:, None, k] - b[None, :, k])
        if turns[k]:
            d = np.abs((d + np.pi) % (2 * np.pi) - np.pi)
        np.maximum(worst, d * scale[k], out=worst)
    return worst


def _nearest(
    first: Float[np.ndarray, " m"], between: Float[np.ndarray, "m m"], owner: Int[np.ndarray, " m"],
    count: int,
) -> Int[np.ndarray, " p"]:  # fmt: skip
    """Order the poses by the nearest state of a pose that is left, again and again."""
    left, row, order = np.ones(len(first), bool), first, []
    for _ in range(count):
        state = int(np.where(left, row, np.inf).argmin())
        order.append(int(owner[state]))
        left &= owner != owner[state]
        row = between[state]
    return np.array(order)


def _best_states(
    order: Int[np.ndarray, " p"], first: Float[np.ndarray, " m"], between: Float[np.ndarray, "m m"],
    starts: Int[np.ndarray, " p1"],
) -> Int[np.ndarray, " p"]:  # fmt: skip
    """Return the states with the shortest path through the poses in their order, pose by pose."""
    parts = [slice(starts[k], starts[k + 1]) for k in order.tolist()]
    best, parents = first[parts[0]], []
    for before, part in pairwise(parts):
        lengths = best[:, None] + between[before, part]
        parents.append(lengths.argmin(0))
        best = lengths.min(0)
    at = int((best + first[parts[-1]]).argmin())
    rows = [at]
    for parent in reversed(parents):
        rows.append(int(parent[rows[-1]]))
    out = np.empty(len(order), np.int64)
    for k, part, row in zip(order.tolist(), parts, reversed(rows), strict=True):
        out[k] = part.start + row
    return out


def _near(
    path: Float[np.ndarray, "s n"], now: Float[np.ndarray, " n"], turns: Bool[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"], upper: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "s n"]:  # fmt: skip
    """Shift joints that turn fully by whole turns toward a state, within their limits."""
    shift = np.where(turns, 2 * np.pi * np.round((now - path[-1]) / (2 * np.pi)), 0.0)
    fits = ((path + shift >= lower) & (path + shift <= upper)).all(0)
    return path + np.where(fits, shift, 0.0)
