"""What a robot's joints bear and where its weight falls, from the poses of its bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import GRAVITY, owner_cache
from momapos.core.geometry import pose_planar
from momapos.model.robots import support_outline
from momapos.model.urdf import Articulated

from .link_bodies import LinkBodies
from .polygon import outside

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


_DOWN = np.array([0.0, 0.0, -GRAVITY])
"""Acceleration by gravity [m/s^2]."""


@dataclass(frozen=True, eq=False)
class RobotEfforts:
    """The masses of a robot's bodies, and the effort limits of its arm."""

    mass: Float[np.ndarray, " b"]
    """[kg]"""
    center: Float[np.ndarray, "b 3"]
    """Center of each mass in the body's frame [m]."""
    names: tuple[str, ...]
    """The joints with a motor: those of the arm that do not follow another."""
    limits: Float[np.ndarray, " n"]
    """Their effort limits [Nm] or [N]; infinite if the file has none."""
    joints: tuple[tuple[int, int, float, bool], ...]
    """For each joint of the arm: its body, its motor, its ratio to it, and whether it slides."""
    axes: Float[np.ndarray, "m 3"]
    """Axis of each of these joints in its body's frame."""
    beyond: Bool[np.ndarray, "m b"]
    """The bodies that each of them moves."""
    support: Float[np.ndarray, "k 2"] | None
    """Outline of the wheels' contacts in the base frame [m]; None if unknown."""

    def efforts(
        self,
        Ts: Float[np.ndarray, "s b 4 4"],
        force: Float[np.ndarray, "s 3"],
        point: Float[np.ndarray, "s 3"],
    ) -> Float[np.ndarray, "s n"]:
        """Return what each motor must exert at rest [Nm] or [N].

        It balances the forces on all bodies that its joints move, by the principle of virtual work.

        Args:
            Ts: World poses of the bodies at each state.
            force: Force on the hand or on what it holds, in the world [N].
            point: Where it acts [m].
        """
        centers = np.einsum("sbij,bj->sbi", Ts[..., :3, :3], self.center) + Ts[..., :3, 3]
        out = np.zeros((len(Ts), len(self.names)))
        for (body, motor, ratio, slides), axis, beyond in zip(
            self.joints, self.axes, self.beyond, strict=True
        ):
            along = Ts[:, body, :3, :3] @ axis
            if slides:
                work = -GRAVITY * self.mass[beyond].sum() * along[:, 2] + (along * force).sum(1)
            else:
                origin = Ts[:, body, :3, 3]
                moment = self.mass[beyond] @ (centers[:, beyond] - origin[:, None])
                down = _cross(moment, _DOWN)
                work = (along * (down + _cross(point - origin, force))).sum(1)
            out[:, motor] -= ratio * work
        return out

    def stability(
        self,
        base_pose: Sequence[float] | Float[np.ndarray, "s 3"],
        Ts: Float[np.ndarray, "s b 4 4"],
        force: Float[np.ndarray, "s 3"],
        point: Float[np.ndarray, "s 3"],
    ) -> Float[np.ndarray, " s"] | None:
        """Return how far inside the support the floor's reaction acts at each state [m].

        None if masses or wheels are unknown; negative where the robot tips over. The base is at
        one pose or at a pose per state.
        """
        if self.support is None:
            return None
        centers = np.einsum("sbij,bj->sbi", Ts[..., :3, :3], self.center) + Ts[..., :3, 3]
        weight = GRAVITY * self.mass.sum()
        moment = _cross(centers, _DOWN).transpose(0, 2, 1) @ self.mass
        moment += _cross(point, force)
        up = weight - force[:, 2]
        # The reaction (0, 0, up) at (x, y, 0) has the moment (y up, -x up, 0).
        reaction = np.column_stack([moment[:, 1], -moment[:, 0]]) / up[:, None]
        T = pose_planar(np.array(base_pose))
        local = np.einsum("...i,...ij->...j", reaction - T[..., :2, 3], T[..., :2, :2])
        return np.where(up > 0.0, -outside(self.support, local), -np.inf)


def _cross(
    a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*#batch 3"]
) -> Float[np.ndarray, "*batch 3"]:
    """Return the cross product; `np.cross` takes several times as long for few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


@owner_cache(8)
def robot_efforts(
    model: Articulated, bodies: LinkBodies, base_link: str, arm_joints: tuple[str, ...]
) -> RobotEfforts:
    """Return the masses of a robot's bodies and the effort limits of its arm.

    Args:
        model: The robot.
        bodies: Its bodies.
        base_link: Link on the floor.
        arm_joints: All joints that the arm moves.
    """
    mass, center = _body_masses(model, bodies)
    records = [model.joint(name) for name in arm_joints]
    motors = [joint.name for joint in records if joint.mimic is None]
    joints, beyond = [], np.zeros((len(records), len(bodies)), bool)
    for k, joint in enumerate(records):
        body = bodies.of_joint[joint.name]
        leader = joint.name if joint.mimic is None else joint.mimic.joint
        ratio = 1.0 if joint.mimic is None else joint.mimic.ratio
        joints.append((body, motors.index(leader), ratio, joint.kind == "prismatic"))
        beyond[k] = [_is_beyond(bodies, other, body) for other in range(len(bodies))]
    moved = set(np.flatnonzero(beyond.any(0)).tolist())
    standing = [link for link, body in bodies.of_link.items() if body not in moved]
    on_base = sum(model.urdf.links[link].mass for link in standing)
    return RobotEfforts(
        mass=mass,
        center=center,
        names=tuple(motors),
        limits=np.array([model.joint(name).effort for name in motors]),
        joints=tuple(joints),
        axes=np.array([joint.axis for joint in records]),
        beyond=beyond,
        support=support_outline(model, base_link, standing) if on_base > 0 else None,
    )


def _body_masses(
    model: Articulated, bodies: LinkBodies
) -> tuple[Float[np.ndarray, " b"], Float[np.ndarray, "b 3"]]:
    mass, moment = np.zeros(len(bodies)), np.zeros((len(bodies), 3))
    for name, body in bodies.of_link.items():
        link, T = model.urdf.links[name], bodies.T_body_link[name]
        mass[body] += link.mass
        moment[body] += link.mass * (T[:3, :3] @ link.center + T[:3, 3])
    return mass, moment / np.maximum(mass, 1e-12)[:, None]


def _is_beyond(bodies: LinkBodies, body: int, joint_body: int) -> bool:
    """Check whether a body moves with the joint of another one."""
    while body not in (joint_body, -1):
        body = bodies.parent[body]
    return body == joint_body
