"""Arms with more freedoms than the robot's own: a hand that turns, a base that slides."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import pose_planar, rotation
from momapos.model.kinematics import Chain, IkModel, build_ik, with_base_slides
from momapos.model.robots import Robot

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class TurningArm:
    """A robot's arm whose last degree of freedom is the turn of its hand about the grasp."""

    robot: Robot
    chain: Chain
    """Kinematic chain, including the turn."""
    ik: IkModel


@dataclass(frozen=True, eq=False)
class DrivingArm:
    """An arm whose first degrees of freedom are slides of the base, without turning."""

    arm: Robot | TurningArm
    directions: Float[np.ndarray, "k 3"]
    """Unit directions in the frame of the base."""
    travel: float
    """How far the base slides to either side [m]."""

    @cached_property
    def chain(self) -> Chain:
        """Return the kinematic chain, slides first."""
        return with_base_slides(self.arm.chain, self.directions, self.travel)

    @cached_property
    def ik(self) -> IkModel:
        """Return the inverse kinematics of slides and arm."""
        return build_ik(self.chain)


ArmModel: TypeAlias = Robot | TurningArm | DrivingArm


def robot_of(arm: ArmModel) -> Robot:
    """Return the robot of an arm."""
    if isinstance(arm, Robot):
        return arm
    return arm.robot if isinstance(arm, TurningArm) else robot_of(arm.arm)


def standing_arm(arm: ArmModel) -> Robot | TurningArm:
    """Return the arm without the slides of its base."""
    return arm.arm if isinstance(arm, DrivingArm) else arm


def slides_of(arm: ArmModel) -> Float[np.ndarray, "k 3"]:
    """Return the directions in which the base slides; none if it stands."""
    return arm.directions if isinstance(arm, DrivingArm) else np.zeros((0, 3))


def split_states(
    arm: ArmModel, base: Float[np.ndarray, "*d 3"], states: Float[np.ndarray, "d n"]
) -> tuple[Float[np.ndarray, "d 3"], Float[np.ndarray, "d m"]]:
    """Return the base pose at each state, and the states of the arm on it.

    Args:
        arm: The arm.
        base: Base pose without the slides, one for all states or one for each.
        states: Values of all degrees of freedom.
    """
    slides = slides_of(arm)
    poses = np.array(np.broadcast_to(base, (len(states), 3)))
    if len(slides):
        R = rotation(poses[:, 2])
        poses[:, :2] += np.einsum("dij,dj->di", R, states[:, : len(slides)] @ slides[:, :2])
    return poses, states[:, len(slides) :]


def hand_poses(
    arm: Robot | TurningArm,
    bases: Float[np.ndarray, "d 3"],
    states: Float[np.ndarray, "d n"],
    Ts_world_tool: Float[np.ndarray, "d 4 4"],
) -> Float[np.ndarray, "d 4 4"]:
    """Return the tool poses in the world: the given ones, or those of the turned hand."""
    if not isinstance(arm, TurningArm):
        return Ts_world_tool
    return pose_planar(bases) @ arm.robot.chain.tool_poses(states[:, :-1])
