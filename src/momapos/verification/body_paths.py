"""The bodies that a joint and its mimic joints move, and their poses at the joint's values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model.urdf import Joint

from .link_bodies import LinkBodies, following, joint_motions

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class BodyPaths:
    """Bodies that move with some joints; bodies with other joints between them count as one."""

    joints: tuple[Joint, ...]
    """The joint that moves each body: a leader or a mimic joint; none for a whole object."""
    parent: tuple[int, ...]
    """Index of the body that carries each one, before it; -1 for what stands still."""
    offsets: Float[np.ndarray, "b 4 4"]
    """Pose of each joint's frame in that body or in the world."""
    frame: int = -1
    """Index of the body in whose frame poses are given; -1 for the world."""

    def at(self, values: Mapping[str, Float[np.ndarray, " s"]]) -> Float[np.ndarray, "s b 4 4"]:
        """Return poses of the bodies at values of the leaders [rad] or [m], by name."""
        poses: list[np.ndarray] = []
        for joint, parent, offset in zip(self.joints, self.parent, self.offsets, strict=True):
            mimic = joint.mimic
            own = values[joint.name] if mimic is None else following(mimic, values[mimic.joint])
            T = offset if parent < 0 else poses[parent] @ offset
            poses.append(T @ joint_motions(joint, own))
        return self.in_frame(np.stack(poses, axis=1))

    def in_frame(self, Ts_world_body: Float[np.ndarray, "s b 4 4"]) -> Float[np.ndarray, "s b 4 4"]:
        """Return world poses of the bodies in the frame in which this record gives poses."""
        if self.frame < 0:
            return Ts_world_body
        return invert(Ts_world_body[:, self.frame, None]) @ Ts_world_body


def paths_of(
    bodies: LinkBodies, leaders: Sequence[str], Ts_world_body: Float[np.ndarray, "b 4 4"]
) -> tuple[BodyPaths, Mapping[int, int]]:
    """Return the paths of what a joint moves, and which of its bodies carries each moved body.

    Args:
        bodies: The bodies of the object.
        leaders: The joint, and joints of what it moves that move, too.
        Ts_world_body: Poses of the bodies in the scene.
    """
    joints: list[Joint] = []
    parent: list[int] = []
    offsets: list[np.ndarray] = []
    carrier: dict[int, int] = {}
    first: list[int] = []
    for body in sorted(bodies.moved_by(leaders[0])):
        joint, above = bodies.joints[body], bodies.parent[body]
        assert joint is not None
        if (joint.name if joint.mimic is None else joint.mimic.joint) not in leaders:
            carrier[body] = carrier[above]
            continue
        T_world_joint = Ts_world_body[above] @ bodies.Ts_parent_joint[body]
        at = carrier.get(above, -1)
        offsets.append(
            T_world_joint if at < 0 else invert(Ts_world_body[first[at]]) @ T_world_joint
        )
        carrier[body] = len(joints)
        joints.append(joint)
        parent.append(at)
        first.append(body)
    return BodyPaths(tuple(joints), tuple(parent), np.array(offsets)), carrier
