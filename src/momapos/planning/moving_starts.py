"""Find base poses at which a short arm takes hold, if the base then slides without turning.

An arm of five degrees of freedom reaches a grasp only from base poses on a surface, which samples
miss. On a base that slides in both directions it reaches any position, so that each yaw and grasp
has a few base poses, or none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert, pose_planar, rotation
from momapos.model.kinematics import solve_ik
from momapos.model.robots import Robot
from momapos.planning.arm_motion import DrivingArm, waypoint_name
from momapos.planning.grasps import TaskMotion

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

REACH = 3.0
"""How far the base slides to the grasp, more than the length of such arms and a door [m]."""
YAWS = 36
"""Number of yaws at which grasps are examined [-]."""
MAX_GRASPS = 4
"""Largest number of grasps to which a base pose is fitted [-]."""
_GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)
"""Its multiples modulo 1 are spread evenly, for any count [-]."""


@dataclass(frozen=True, eq=False)
class ShortArmStarts:
    """Shifts base poses so that a short arm takes hold there, each with one of the grasps."""

    robot: Robot
    motion: TaskMotion

    def __call__(
        self, poses: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
        """Shift base poses.

        Returns:
            The shifted poses, and the grasp of each; -1 for an unchanged pose without one.
        """
        order, count = self._grasps
        poses, own = poses.copy(), np.full(len(poses), -1)
        column = np.rint(poses[:, 2] / (2 * np.pi / YAWS)).astype(np.int64) % YAWS
        for turn in range(MAX_GRASPS):
            left = np.flatnonzero((own < 0) & (turn < count[column]))
            share = (_GOLDEN_RATIO * left + turn / MAX_GRASPS) % 1.0
            rank = (share * count[column[left]]).astype(np.int64)
            chosen = order[rank, column[left]]
            q, found = self._solve(poses[left], chosen, self.motion.grasp_step)
            rows = np.flatnonzero(found > 0)
            slides = q[rows, :, :2]
            # Solutions come first, and NaN is the largest.
            best = slides[np.arange(len(rows)), np.hypot(*slides.T).T.argsort(1)[:, 0]]
            R = rotation(poses[left[rows], 2])
            poses[left[rows], :2] += np.einsum("nij,nj->ni", R, best)
            own[left[rows]] = chosen[rows]
        return poses, own

    @cached_property
    def _arm(self) -> DrivingArm:
        return DrivingArm(self.robot, np.eye(3)[:2], REACH)

    @cached_property
    def _grasps(self) -> tuple[Int[np.ndarray, "g y"], Int[np.ndarray, " y"]]:
        """Return the grasps in the order of trying them at each yaw, and how many are possible."""
        return np.argsort(~self.possible, axis=0, kind="stable"), self.possible.sum(0)

    @property
    def possible(self) -> Bool[np.ndarray, "g y"]:
        """Return with which grasps and at which yaws the arm reaches every waypoint from somewhere.

        Yaws are multiples of a full turn over `YAWS`. The base keeps its yaw.
        """
        return self._examined[0]

    @property
    def no_way(self) -> str:
        """Return why no grasp is possible at any yaw; "" if one is."""
        possible, last = self._examined
        if possible.any():
            return ""
        return f"no grasp is within reach at {waypoint_name(last)}, wherever the base moves"

    @cached_property
    def _examined(self) -> tuple[Bool[np.ndarray, "g y"], int]:
        """Return the possible grasps, and the waypoint that left none."""
        steps = self.motion.waypoint_steps
        position = self.motion.Ts_world_tool[0, self.motion.grasp_step, :2, 3]
        possible = np.ones((len(self.motion.Ts_world_tool), YAWS), bool)
        # The grasp and the end exclude most.
        count = len(steps)
        for waypoint in dict.fromkeys([1, count - 1, *range(count)]):
            step = int(steps[waypoint])
            grasp, column = np.nonzero(possible)
            yaw = column * (2 * np.pi / YAWS)
            poses = np.column_stack([np.tile(position, (len(yaw), 1)), yaw])
            possible[grasp, column] = self._solve(poses, grasp, step)[1] > 0
            if not possible.any():
                return possible, waypoint
        return possible, -1

    def _solve(
        self, poses: Float[np.ndarray, "n 3"], grasps: Int[np.ndarray, " n"], step: int
    ) -> tuple[Float[np.ndarray, "n b m"], Int[np.ndarray, " n"]]:
        """Solve for slides and arm at a step of the motion, see `solve_ik`."""
        Ts = invert(pose_planar(poses)) @ self.motion.Ts_world_tool[grasps, step]
        return solve_ik(self._arm.chain, self._arm.ik, Ts)
