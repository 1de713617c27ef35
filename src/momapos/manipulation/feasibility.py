"""Is a base pose feasible? Path over the waypoints, approach from home, exact check."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from momapos.geometry.transforms import apply, invert, pose_planar
from momapos.kinematics.collision import FREE
from momapos.kinematics.hulls import Boxes
from momapos.kinematics.spheres import Spheres, box_spheres, carry
from momapos.kinematics.world import World, check, check_hand
from momapos.manipulation.arm_path import FOUND, HIT, UNREACHABLE, ArmPath, find_paths
from momapos.manipulation.motion import TaskMotion
from momapos.manipulation.planner import PlannerConfig, interpolate, plan_motion
from momapos.robots.robot import Robot
from momapos.types import Attempt, Motion

Refusal = Callable[[Float[np.ndarray, "3"], Motion], str | None]
"""The exact check: None where a motion holds, else what is wrong with it."""
_FIRST = 4
"""Grasps that are tried together before the rest [-]."""
_BATCH = 256
"""Pairs of base pose and grasp that are screened together [-]."""
_THREADS = 2


@dataclass(frozen=True)
class Feasibility:
    """Checks base poses for one robot, room and task."""

    robot: Robot
    world: World
    motion: TaskMotion
    planner: PlannerConfig
    refuse: Refusal
    seed: int
    out_of_time: Callable[[], bool]
    """Asked between steps of the screening."""

    def __call__(self, base: Float[np.ndarray, "3"], grasps: Int[np.ndarray, " k"]) -> Attempt:
        """Check one base pose with some grasps, best first.

        Args:
            base: Base pose x [m], y [m], yaw [rad].
            grasps: Indices into the family of grasps.
        """
        at_home = self._check(self.robot.home[None], base, self.robot.spheres)[0]
        if at_home != FREE:
            return Attempt(None, f"arm at home hits {self.world.reason(int(at_home))}")
        furthest: ArmPath | None = None
        last = ""
        chunks = np.split(grasps, range(_FIRST, len(grasps), 4 * _FIRST))
        for chunk in chunks:
            bases = np.tile(base, (len(chunk), 1))
            paths = find_paths(self.robot, self.world, self.motion, bases, chunk)
            for grasp, path in zip(chunk, paths, strict=True):
                if path.status != FOUND:
                    if furthest is None or path.passed > furthest.passed:
                        furthest = path
                    continue
                motion, last = self._complete(base, path, int(grasp))
                if motion is not None:
                    return Attempt(motion, "")
        return Attempt(None, last or self._reason(furthest))

    def screen(
        self, bases: Float[np.ndarray, "n 3"], scores: Float[np.ndarray, "n g"]
    ) -> Bool[np.ndarray, " n"] | None:
        """Tell at which base poses some grasp has an arm path, many poses at a time.

        Args:
            bases: Base poses that stand clear.
            scores: Reachability of each grasp from each; only those above 0 are tried.

        Returns:
            Whether there is a path, or None when the time was up before all had been tried.
        """
        order = np.argsort(-scores, axis=1, kind="stable")
        reached = (scores > 0).sum(1)
        found = np.zeros(len(bases), bool)
        home = self._check(np.tile(self.robot.home, (len(bases), 1)), bases, self.robot.spheres)
        first, width = 0, 2
        while first < scores.shape[1]:
            left = np.flatnonzero(~found & (reached > first) & (home == FREE))
            ranks = np.arange(first, min(first + width, scores.shape[1]))
            jobs = np.stack(np.broadcast_arrays(left[:, None], ranks[None]), -1).reshape(-1, 2)
            jobs = jobs[jobs[:, 1] < reached[jobs[:, 0]]]
            chunks = np.array_split(jobs, max(1, len(jobs) // _BATCH))
            with ThreadPoolExecutor(_THREADS) as pool:
                for chunk, good in zip(chunks, pool.map(
                    lambda c: self._found(bases[c[:, 0]], order[c[:, 0], c[:, 1]]), chunks
                ), strict=True):  # fmt: skip
                    found[chunk[good, 0]] = True
            if self.out_of_time():
                return None
            first, width = first + width, 3 * width
        return found

    def _found(
        self, bases: Float[np.ndarray, "j 3"], grasps: Int[np.ndarray, " j"]
    ) -> Bool[np.ndarray, " j"]:
        if self.out_of_time():
            return np.zeros(len(grasps), bool)
        paths = find_paths(self.robot, self.world, self.motion, bases, grasps)
        return np.array([path.status == FOUND for path in paths], bool)

    def _check(
        self, q: Float[np.ndarray, "m n"], base: Float[np.ndarray, "*m 3"], spheres: Spheres
    ) -> Int[np.ndarray, " m"]:
        """What states on the way from home hit; a carried object is already in the hand.

        The base pose is one for all states, or one for each.
        """
        carrying = self.motion.task.verb == "place"
        return check(
            self.world, self.robot.chain, spheres, np.ascontiguousarray(q),
            np.array(np.broadcast_to(base, (len(q), 3))),
            np.full(len(q), self.motion.value[0]),
            np.full(len(q), carrying),
        )  # fmt: skip

    def _with_load(self, grasp: int) -> Spheres:
        """The robot's spheres, with the object in its hand where the task is to place it."""
        if self.motion.task.verb != "place":
            return self.robot.spheres
        chain, m = self.robot.chain, self.motion.moving
        center, radius = box_spheres(Boxes(m.center[-1], m.rotation[-1], m.half[-1]))
        T_tool_world = invert(self.motion.Ts_world_tool[grasp, 0])
        in_tool = apply(T_tool_world, center)
        return carry(
            self.robot.spheres, chain.size,
            chain.tool_offset + in_tool @ chain.tool_rotation.T, radius,
        )  # fmt: skip

    def _complete(self, base: np.ndarray, path: ArmPath, grasp: int) -> tuple[Motion | None, str]:
        """Add the approach from home, and let the exact check decide."""
        assert path.q is not None
        chain, hold = self.robot.chain, self.motion.hold
        spheres = self._with_load(grasp)
        q = near_home(path.q, self.robot.home, chain.lower, chain.upper)

        def free(states: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
            return self._check(states, base, spheres) == FREE

        way = plan_motion(
            self.robot.home,
            q[0],
            chain.lower,
            chain.upper,
            free,
            config=self.planner,
            seed=self.seed + grasp,
        )
        if way is None:
            return None, "no approach from home"
        approach = np.concatenate([interpolate(way), q[1 : hold + 1]])
        motion = Motion(
            approach, q[hold:], self.motion.object_q[hold:], self._tools(q[hold:], base)
        )
        refusal = self.refuse(base, motion)
        return (motion, "") if refusal is None else (None, f"exact check: {refusal}")

    def _tools(self, q: np.ndarray, base: np.ndarray) -> Float[np.ndarray, "m 4 4"]:
        return pose_planar(base) @ self.robot.chain.tool_poses(q)

    def _reason(self, path: ArmPath | None) -> str:
        if path is None:
            return "no grasp within reach"
        where = "the pre-grasp" if path.waypoint == 0 else f"waypoint {path.waypoint}"
        if path.status == UNREACHABLE:
            return f"out of reach at {where}"
        if path.status == HIT:
            return f"arm hits {self.world.reason(path.obstacle)} at {where}"
        return "no continuous branch"


def hand_clears(
    robot: Robot, world: World, motion: TaskMotion
) -> tuple[Bool[np.ndarray, " g"], str]:
    """Which grasps the hand itself has room for at every waypoint, wherever the base stands.

    Returns:
        A mask over the grasps, and what stops most of the others.
    """
    Ts = motion.Ts_world_tool[:, motion.coarse]
    grasps, count = Ts.shape[:2]
    value = np.tile(motion.value[motion.coarse], grasps)
    holding = np.tile(motion.holding[motion.coarse], grasps)
    codes = check_hand(
        world, robot.chain, robot.spheres, Ts.reshape(-1, 4, 4), value, holding
    ).reshape(grasps, count)
    free = (codes == FREE).all(1)
    hits = codes[codes != FREE]
    worst = world.reason(int(np.bincount(hits).argmax())) if len(hits) else ""
    return free, worst


def near_home(
    q: Float[np.ndarray, "d n"], home: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> Float[np.ndarray, "d n"]:
    """Shift joints that turn fully by whole turns, so that a path starts as near home as it can."""
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
