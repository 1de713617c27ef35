"""Estimate the carried weight at the wrist, so that the arm bears it instead of yielding to it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .feel import SensedForces
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float


class Payload:
    """Weight of a movable object in the hand, and its line of action.

    The downward force at the wrist counts as weight, through a slow filter: a sudden push acts on
    the arm first. A lasting push would count as weight, but a support only ever reduces it.
    """

    def __init__(self, filter_time: float, step: float) -> None:
        """`filter_time` is the time constant of the weight's low-pass filter [s]."""
        self._share = step / (filter_time + step)
        self._felt, self._carried = np.zeros(6), False

    def remove_weight(self, touch: SensedForces, *, carried: bool) -> SensedForces:
        """Update the estimate and subtract the weight from the sensed forces.

        Args:
            touch: The sensed forces.
            carried: Whether the hand holds a movable object.
        """
        self._carried = carried
        if not carried:
            self._felt = np.zeros(6)
            return touch
        wrench = np.concatenate([touch.force, touch.torque])
        self._felt += self._share * (wrench - self._felt)
        weight = self.weight
        return replace(touch, force=touch.force - weight[:3], torque=touch.torque - weight[3:])

    @property
    def weight(self) -> Float[np.ndarray, "6"]:
        """Force [N] and torque about the tool's origin [Nm] of the weight, in the world."""
        down = np.zeros(6)
        if self._felt[2] < 0.0:
            down[2:] = self._felt[2:]
        return down

    def lead(self, world: Simulation) -> Float[np.ndarray, " n"]:
        """Return the lead of the motors' set-points that bears the weight [rad] or [m]."""
        if not self._carried:
            return np.zeros(len(world.arm_v))
        J = np.zeros((6, world.model.nv))
        mujoco.mj_jacBody(world.model, world.data, J[:3], J[3:], world.tool_body)
        load = self.weight @ J[:, world.arm_v]
        return np.asarray(-load / world.model.actuator_gainprm[world.arm_motor, 0])
