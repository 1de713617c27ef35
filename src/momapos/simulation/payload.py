"""What the hand carries, felt at the wrist: the arm bears it, and does not give way to it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .feel import Touch
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float


class Payload:
    """The weight of a loose object in the hand, and where it acts.

    The force at the wrist is taken for weight where it points down, and slowly, so that a push of
    something else is felt first. Only then would the arm bear that too: what the object rests on
    takes its weight away, and never adds to it.
    """

    def __init__(self, filter_time: float, step: float) -> None:
        """`filter_time` is that of the low-pass filter of the weight [s]."""
        self._share = step / (filter_time + step)
        self._felt, self._carried = np.zeros(6), False

    def see(self, touch: Touch, *, carried: bool) -> Touch:
        """Take in what the hand feels.

        Args:
            touch: What it feels.
            carried: Whether it holds a loose object.

        Returns:
            What it feels beside the weight of what it carries.
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
        """How far the set-points of the arm's motors lead, so that they bear it [rad] or [m]."""
        if not self._carried:
            return np.zeros(len(world.arm_v))
        J = np.zeros((6, world.model.nv))
        mujoco.mj_jacBody(world.model, world.data, J[:3], J[3:], world.tool_body)
        load = self.weight @ J[:, world.arm_v]
        return np.asarray(-load / world.model.actuator_gainprm[world.arm_motor, 0])
