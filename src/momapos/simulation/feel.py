"""What the robot feels: the wrench at its wrist and the load of its pads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Touch:
    """What the hand feels, its own weight left out."""

    force: Float[np.ndarray, "3"]
    """Of things on the hand, in the world [N]."""
    torque: Float[np.ndarray, "3"]
    """Likewise about the tool's origin [Nm]."""
    pads: tuple[float, float]
    """How hard things press on the pads of the two sides, against their closing [N]."""
    arm: Float[np.ndarray, " n"]
    """Load of the arm's joints that neither its motion nor the hand explains: what its links meet
    [Nm] or [N]."""

    @property
    def size(self) -> tuple[float, float]:
        """Force [N] and torque [Nm], without their directions."""
        return float(np.linalg.norm(self.force)), float(np.linalg.norm(self.torque))


def feel(world: Simulation) -> Touch:
    """Feel what touches the hand, in contacts and in the weld."""
    model, data = world.model, world.data
    mujoco.mj_rnePostConstraint(model, data)
    wrench = data.cfrc_ext[world.hand_bodies].sum(0)
    center = data.subtree_com[model.body_rootid[world.tool_body]]
    force = wrench[3:].copy()
    torque = wrench[:3] + np.cross(center - data.xpos[world.tool_body], force)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], world.tool_body)
    of_hand = np.concatenate([force, torque]) @ jacobian
    return Touch(force, torque, pad_loads(world), (_outside(world) - of_hand)[world.arm_v])


def _outside(world: Simulation) -> Float[np.ndarray, " v"]:
    """Load of all joints by contacts and couplings, not by their own limits [Nm] or [N]."""
    data, load = world.data, np.zeros(world.model.nv)
    if data.nefc:
        own = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        mujoco.mj_mulJacTVec(world.model, data, load, np.where(own, 0.0, data.efc_force))
    return load


def pad_loads(world: Simulation) -> tuple[float, float]:
    """How hard things press on the pads of the two sides [N]: -1, then 1."""
    sides = world.pad_side[world.data.contact.geom]
    one = (sides != 0).sum(1) == 1  # two pads that meet hold nothing
    rows = np.flatnonzero(one & (world.data.contact.efc_address >= 0))
    if not len(rows):
        return 0.0, 0.0
    axis = world.T_world_tool[:3, :3] @ world.hand.axis
    loads, wrench = {-1: 0.0, 1: 0.0}, np.empty(6)
    for i in rows.tolist():
        mujoco.mj_contactForce(world.model, world.data, i, wrench)
        push = float(world.data.contact.frame[i].reshape(3, 3).T @ wrench[:3] @ axis)
        for side, sign in zip(sides[i].tolist(), (-1, 1), strict=True):  # of one on the other
            if side:
                loads[side] += side * sign * push
    return loads[-1], loads[1]
