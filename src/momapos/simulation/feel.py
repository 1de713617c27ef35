"""Force sensing of the robot: the wrench at its wrist and the load of its finger pads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class SensedForces:
    """Forces that the robot senses, without the hand's own weight."""

    force: Float[np.ndarray, "3"]
    """Force on the hand, in the world [N]."""
    torque: Float[np.ndarray, "3"]
    """Torque on the hand about the tool's origin, in the world [Nm]."""
    pads: tuple[float, float]
    """Load of the pads of the two sides, against their closing [N]."""
    arm: Float[np.ndarray, " n"]
    """Load of the arm's joints that neither its motion nor the hand explains, from contacts of its
    links [Nm] or [N]."""

    @property
    def size(self) -> tuple[float, float]:
        """Magnitudes of force [N] and torque [Nm]."""
        return float(np.linalg.norm(self.force)), float(np.linalg.norm(self.torque))


def sense_forces(world: Simulation) -> SensedForces:
    """Return the forces on the robot from contacts and from the weld."""
    model, data = world.model, world.data
    mujoco.mj_rnePostConstraint(model, data)
    wrench = data.cfrc_ext[world.hand_bodies].sum(0)
    center = data.subtree_com[model.body_rootid[world.tool_body]]
    force = wrench[3:].copy()
    torque = wrench[:3] + np.cross(center - data.xpos[world.tool_body], force)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], world.tool_body)
    of_hand = np.concatenate([force, torque]) @ jacobian
    loads = (_outside(world) - of_hand)[world.arm_v]
    return SensedForces(force, torque, pad_loads(world), loads)


def _outside(world: Simulation) -> Float[np.ndarray, " v"]:
    """Return the load of all joints from contacts and couplings, without limits [Nm] or [N]."""
    data, load = world.data, np.zeros(world.model.nv)
    if data.nefc:
        own = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        mujoco.mj_mulJacTVec(world.model, data, load, np.where(own, 0.0, data.efc_force))
    return load


def pad_loads(world: Simulation) -> tuple[float, float]:
    """Return the load of the pads on sides -1 and 1 [N]."""
    sides = world.pad_side[world.data.contact.geom]
    one = (sides != 0).sum(1) == 1  # two pads in contact hold nothing
    rows = np.flatnonzero(one & (world.data.contact.efc_address >= 0))
    if not len(rows):
        return 0.0, 0.0
    axis = world.T_world_tool[:3, :3] @ world.hand.axis
    loads, wrench = {-1: 0.0, 1: 0.0}, np.empty(6)
    for i in rows.tolist():
        mujoco.mj_contactForce(world.model, world.data, i, wrench)
        push = float(world.data.contact.frame[i].reshape(3, 3).T @ wrench[:3] @ axis)
        for side, sign in zip(sides[i].tolist(), (-1, 1), strict=True):  # force of one on other
            if side:
                loads[side] += side * sign * push
    return loads[-1], loads[1]
