"""An arm whose hand turns about what it holds, as one more degree of freedom."""

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
    """A robot's arm, the last degree of freedom of which is the turn of its hand."""

    robot: Robot
    chain: Chain
    """With the turn."""
    ik: IkModel


Arm: TypeAlias = Robot | TurningArm


def robot_of(arm: Arm) -> Robot:
    """The robot that an arm belongs to."""
    return arm.robot if isinstance(arm, TurningArm) else arm


def hand_poses(
    arm: Arm,
    base: Float[np.ndarray, "3"],
    states: Float[np.ndarray, "d n"],
    asked: Float[np.ndarray, "d 4 4"],
) -> Float[np.ndarray, "d 4 4"]:
    """Tool poses in the world: those asked for, or where the hand has turned to."""
    if not isinstance(arm, TurningArm):
        return asked
    return pose_planar(base) @ arm.robot.chain.tool_poses(states[:, :-1])
