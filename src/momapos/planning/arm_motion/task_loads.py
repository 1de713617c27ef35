"""Check what the motors bear along a task, and that the base does not tip over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, rotation
from momapos.model.records import MAX_EFFORT_SHARE, PoseOutcome, PoseStatus
from momapos.model.robots import Robot, RobotLoads, StateLoads, robot_loads
from momapos.planning.grasps import TaskMotion

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class TaskLoads:
    """The loads of a robot at the states of a task."""

    robot: Robot
    motion: TaskMotion

    @cached_property
    def limits(self) -> RobotLoads:
        """Return the robot's masses, effort limits and wheels."""
        return robot_loads(self.robot)

    def at(
        self,
        base: Float[np.ndarray, "3"],
        q: Float[np.ndarray, "s n"],
        grasps: Int[np.ndarray, " s"],
        steps: Int[np.ndarray, " s"],
    ) -> StateLoads:
        """Return the loads at steps of the motion.

        Args:
            base: Base pose x [m], y [m], yaw [rad].
            q: Values of the degrees of freedom.
            grasps: The grasp at each state.
            steps: The step of the motion at each.
        """
        force, point = (x[grasps, steps] for x in self.motion.hand_loads)
        return self._in_base(base, q, force, point)

    def carrying(self, q: Float[np.ndarray, "s n"], grasp: int, step: int) -> StateLoads:
        """Return the loads of a free motion with the object in the hand as at a step."""
        force, point = (x[grasp, step] for x in self.motion.hand_loads)
        in_tool = apply(invert(self.motion.Ts_world_tool[grasp, step]), point[None])[0]
        T_base_tool = self.robot.chain.tool_poses(q)
        points = T_base_tool[:, :3, :3] @ in_tool + T_base_tool[:, :3, 3]
        return self.limits.at(q, np.tile(force, (len(q), 1)), points)

    def _in_base(
        self,
        base: Float[np.ndarray, "3"],
        q: Float[np.ndarray, "s n"],
        force: Float[np.ndarray, "s 3"],
        point: Float[np.ndarray, "s 3"],
    ) -> StateLoads:
        turned, moved = force.copy(), point - [base[0], base[1], 0.0]
        R = rotation(float(base[2]))
        turned[:, :2], moved[:, :2] = force[:, :2] @ R, moved[:, :2] @ R
        return self.limits.at(q[:, : self.robot.chain.size], turned, moved)

    def excess(self, loads: StateLoads) -> Float[np.ndarray, " s"]:
        """Return by how much states exceed the limits: above 0 what the robot cannot bear [-]."""
        # A centimeter of tipping counts as a tenth of an effort limit.
        tips = np.where(np.isfinite(loads.stability), -10.0 * loads.stability, -np.inf)
        return np.maximum(loads.shares.max(1) - MAX_EFFORT_SHARE, tips)

    def refused(self, loads: StateLoads) -> Bool[np.ndarray, " s"]:
        """Find the states that need too much, or at which the base tips over."""
        return np.asarray(self.excess(loads) > 0.0)

    def outcome(self, loads: StateLoads, where: str) -> PoseOutcome | None:
        """Return the outcome of a base pose for its worst state; None if that is borne."""
        excess = self.excess(loads)
        state = int(excess.argmax())
        if excess[state] <= 0.0:
            return None
        joint = int(loads.shares[state].argmax())
        if loads.shares[state, joint] <= MAX_EFFORT_SHARE:
            return PoseOutcome(PoseStatus.TIPS_OVER, self.robot.title, where)
        chain, limits = self.robot.chain, self.limits.limits
        unit = "N" if chain.prismatic[joint] else "Nm"
        need = f"{abs(loads.efforts[state, joint]):.3g} of {limits[joint]:.3g} {unit} at {where}"
        return PoseOutcome(PoseStatus.OVERLOAD, chain.names[joint], need)
