"""What the motors and the base bear along a task."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, rotation
from momapos.model.collision import HandLoad
from momapos.model.kinematics import LoadArrays
from momapos.model.robots import Robot, RobotLoads, StateLoads, robot_loads
from momapos.planning.grasps import TaskMotion

from .arm_models import ArmModel, robot_of, standing_arm

if TYPE_CHECKING:
    from jaxtyping import Float, Int


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
        base: Float[np.ndarray, "*s 3"],
        q: Float[np.ndarray, "s n"],
        grasp: int,
        steps: Int[np.ndarray, " s"],
    ) -> StateLoads:
        """Return the loads at steps of the motion.

        Args:
            base: Base pose x [m], y [m], yaw [rad], or one at each state.
            q: Values of the degrees of freedom; further ones are ignored.
            grasp: The grasp.
            steps: The step of the motion at each state.
        """
        force, point = (x[grasp, steps] for x in self.motion.hand_loads)
        turned, moved, R = force.copy(), point.copy(), rotation(base[..., 2])
        moved[:, :2] -= base[..., :2]
        turned[:, :2], moved[:, :2] = ((x[:, None, :2] @ R)[:, 0] for x in (force, moved))
        return self.limits.at(q[:, : self.robot.chain.size], turned, moved)

    def free(
        self, q: Float[np.ndarray, "s n"], carried: tuple[int, int] | None = None
    ) -> StateLoads:
        """Return the loads of a free motion of the arm.

        Args:
            q: Values of the degrees of freedom.
            carried: The grasp and a step of the motion at which the hand holds the object that it
                carries; None for an empty hand.
        """
        if carried is None:
            return self.limits.at(q)
        hand = self.of_hand(carried)
        T_base_tool = self.robot.chain.tool_poses(q)
        points = T_base_tool[:, :3, :3] @ hand.in_tool + T_base_tool[:, :3, 3]
        return self.limits.at(q, np.tile(hand.force, (len(q), 1)), points)

    def of_hand(self, carried: tuple[int, int] | None) -> HandLoad:
        """Return what the arm bears in a free motion, see `free`."""
        if carried is None:
            return HandLoad(self.limits.arrays, np.zeros(3), np.zeros(3))
        force, point = (x[carried] for x in self.motion.hand_loads)
        in_tool = apply(invert(self.motion.Ts_world_tool[carried]), point[None])[0]
        return HandLoad(self.limits.arrays, np.array(force), in_tool)


def load_arrays(arm: ArmModel) -> LoadArrays:
    """Return an arm's masses and limits for kernels; a turn of the hand needs nothing."""
    arrays, chain = robot_loads(robot_of(arm)).arrays, standing_arm(arm).chain
    more = chain.last + 1 - len(arrays.mass)
    if not more:
        return arrays
    return arrays._replace(
        mass=np.append(arrays.mass, np.zeros(more)),
        center=np.vstack([arrays.center, np.zeros((more, 3))]),
        limit=np.append(arrays.limit, np.full(more, np.inf)),
    )
