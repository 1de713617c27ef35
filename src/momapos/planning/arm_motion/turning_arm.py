"""Model the turn of the hand about its grasp as an additional degree of freedom of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from momapos.core.geometry import pose_planar
from momapos.model.kinematics import Chain, IkModel
from momapos.model.robots import Robot

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class TurningArm:
    """A robot's arm whose last degree of freedom is the turn of its hand about the grasp."""

    robot: Robot
    chain: Chain
    """Kinematic chain, including the turn."""
    ik: IkModel


ArmModel: TypeAlias = Robot | TurningArm


def robot_of(arm: ArmModel) -> Robot:
    """Return the robot of an arm."""
    return arm.robot if isinstance(arm, TurningArm) else arm


def hand_poses(
    arm: ArmModel,
    base: Float[np.ndarray, "3"],
    states: Float[np.ndarray, "d n"],
    Ts_world_tool: Float[np.ndarray, "d 4 4"],
) -> Float[np.ndarray, "d 4 4"]:
    """Return the tool poses in the world: the given ones, or those of the turned hand."""
    if not isinstance(arm, TurningArm):
        return Ts_world_tool
    return pose_planar(base) @ arm.robot.chain.tool_poses(states[:, :-1])
