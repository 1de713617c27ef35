"""Forward kinematics from a URDF in plain numpy, independent of the planner's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import invert
from momapos.model.urdf import Articulated, Joint, Mimic

if TYPE_CHECKING:
    from jaxtyping import Float


Values: TypeAlias = "Mapping[str, float | Float[np.ndarray, ' s']]"


@dataclass(frozen=True, eq=False)
class LinkBodies:
    """The links of a model, grouped into rigid bodies; body 0 holds the root link.

    The frame of a body is that of the joint that moves it, or the root link's for body 0.
    """

    joints: tuple[Joint | None, ...]
    """The joint that moves each body; None for body 0."""
    parent: tuple[int, ...]
    """The parent body, -1 for body 0; parents come before children."""
    Ts_parent_joint: Float[np.ndarray, "b 4 4"]
    of_link: Mapping[str, int]
    T_body_link: Mapping[str, Float[np.ndarray, "4 4"]]
    of_joint: Mapping[str, int]
    """The body that a movable joint moves."""
    rest: Mapping[str, float]

    def __len__(self) -> int:
        return len(self.parent)

    def moved_by(self, joint: str) -> frozenset[int]:
        """Return the bodies that move with a joint and with its mimic joints."""
        moved = {self.of_joint[joint]}
        moved |= {body for body, other in enumerate(self.joints) if _leader(other) == joint}
        for body, parent in enumerate(self.parent):
            if parent in moved:
                moved.add(body)
        return frozenset(moved)

    def depth(self, joint: str) -> int:
        """Return how many movable joints lead to the body that a joint moves."""
        body, depth = self.of_joint[joint], 0
        while body > 0:
            body, depth = self.parent[body], depth + 1
        return depth


def bodies_of(model: Articulated) -> LinkBodies:
    """Group a model's links into bodies."""
    joints: list[Joint | None] = [None]
    parent, offsets = [-1], [np.eye(4)]
    of_link, T_body_link = {model.urdf.root: 0}, {model.urdf.root: np.eye(4)}
    for joint in model.urdf.joints:
        body = of_link[joint.parent]
        T = T_body_link[joint.parent] @ joint.T_parent_joint
        if joint.movable:
            joints.append(joint)
            parent.append(body)
            offsets.append(T)
            body, T = len(parent) - 1, np.eye(4)
        of_link[joint.child], T_body_link[joint.child] = body, T
    of_joint = {joint.name: body for body, joint in enumerate(joints) if joint is not None}
    return LinkBodies(
        tuple(joints), tuple(parent), np.array(offsets), of_link, T_body_link, of_joint, model.rest
    )


def body_poses(
    bodies: LinkBodies, values: Values, T_world_root: Float[np.ndarray, "*#s 4 4"]
) -> Float[np.ndarray, "s b 4 4"]:
    """Return world poses of all bodies for a batch of states.

    Args:
        bodies: The model.
        values: Joint values [rad] or [m], one per joint or one per state; other joints are at rest.
        T_world_root: Pose of the root link, one for all states or one for each.
    """
    poses = [T_world_root.reshape(-1, 4, 4)]
    count = max([len(poses[0]), *(np.size(value) for value in values.values())])
    for body in range(1, len(bodies)):
        joint = bodies.joints[body]
        assert joint is not None
        value = np.atleast_1d(np.asarray(_value(joint, values, bodies), float))
        T = poses[bodies.parent[body]]
        poses.append(T @ joint_motions(joint, value, bodies.Ts_parent_joint[body]))
    return np.stack([np.broadcast_to(T, (count, 4, 4)) for T in poses], axis=1)


def _value(joint: Joint, values: Values, bodies: LinkBodies) -> float | np.ndarray:
    """Return a joint's value: as given, from its leader, or at rest."""
    if joint.name in values:
        return values[joint.name]
    if joint.mimic is not None and joint.mimic.joint in values:
        return following(joint.mimic, np.atleast_1d(values[joint.mimic.joint]))
    return bodies.rest[joint.name]


def following(mimic: Mimic, leader: Float[np.ndarray, "*s"]) -> Float[np.ndarray, "*s"]:
    """Return a mimic joint's value for its leader's value [rad] or [m]."""
    return mimic.ratio * leader + mimic.offset


def _leader(joint: Joint | None) -> str | None:
    return None if joint is None or joint.mimic is None else joint.mimic.joint


def joint_motions(
    joint: Joint,
    values: Float[np.ndarray, " s"],
    T_parent_joint: Float[np.ndarray, "4 4"] | None = None,
) -> Float[np.ndarray, "s 4 4"]:
    """Return poses of a joint's child.

    Args:
        joint: The joint.
        values: Joint values [rad] or [m].
        T_parent_joint: The joint's frame in its parent; if given, poses are in the parent's frame,
            otherwise in the joint's frame.
    """
    T = np.tile(np.eye(4) if T_parent_joint is None else T_parent_joint, (len(values), 1, 1))
    R, (x, y, z) = T[0, :3, :3].copy() if len(T) else np.eye(3), joint.axis
    if joint.kind == "prismatic":
        T[:, :3, 3] += values[:, None] * (R @ joint.axis)
        return T
    # Rodrigues: the component along the axis stays, the component across it turns.
    along = np.outer(joint.axis, joint.axis)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    cosine, sine = np.cos(values)[:, None, None], np.sin(values)[:, None, None]
    T[:, :3, :3] = R @ along + cosine * (R @ (np.eye(3) - along)) + sine * (R @ across)
    return T


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
