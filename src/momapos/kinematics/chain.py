"""The arm as a product of exponentials, and its batched forward kinematics.

At the zero configuration every frame is aligned with the base, so that a chain is three arrays:
unit axes `h`, offsets `d` from joint to joint, and a joint kind. Segment 0 is the base, segment
i moves with joint i. Source: Lynch and Park, Modern Robotics, chapter 4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.compiled import B1, F1, F2, F3, entry, kernel
from momapos.errors import RobotError
from momapos.geometry.transforms import invert
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.records import ChainArrays, JointLimits

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Chain:
    """A serial chain in the base frame."""

    names: tuple[str, ...]
    h: Float[np.ndarray, "n 3"]
    """Unit joint axes at zero, in the base frame."""
    d: Float[np.ndarray, "n 3"]
    """Offset of each joint from the one before it (the base's origin for the first) [m]."""
    prismatic: Bool[np.ndarray, " n"]
    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    """Limits [rad] or [m]; infinite for continuous joints."""
    velocity: Float[np.ndarray, " n"]
    tool_offset: Float[np.ndarray, "3"]
    """Tool origin from the last joint at zero, in the base frame [m]."""
    tool_rotation: Float[np.ndarray, "3 3"]
    """Tool axes at zero, in the base frame."""

    @property
    def size(self) -> int:
        """Number of joints."""
        return len(self.names)

    @property
    def upright(self) -> bool:
        """Whether the first turning axis, and what slides below it, are vertical."""
        first = int(np.argmin(self.prismatic))
        return bool(np.abs(self.h[: first + 1, 2]).min() >= 1 - 1e-4)

    def tool_poses(self, q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch 4 4"]:
        """Tool poses in the base frame."""
        q = np.asarray(q, float)
        flat = tool_poses(
            q.reshape(-1, self.size),
            self.h,
            self.d,
            self.prismatic,
            self.tool_offset,
            self.tool_rotation,
        )
        return flat.reshape(*q.shape[:-1], 4, 4)


@dataclass(frozen=True)
class Segments:
    """Which segment of the chain each link of the robot moves with."""

    of_link: dict[str, int]
    T_segment_link: dict[str, Float[np.ndarray, "4 4"]]
    """Pose of the link relative to its segment's joint origin, base-aligned at zero."""


def chain_arrays(chain: Chain) -> ChainArrays:
    """The chain as the kernels take it."""
    return ChainArrays(chain.h, chain.d, chain.prismatic, chain.tool_offset, chain.tool_rotation)


def chain_limits(chain: Chain) -> JointLimits:
    """The limits of its joints as the kernels take them."""
    return JointLimits(chain.lower, chain.upper)


def build_chain(
    model: Articulated, base_link: str, tool_link: str, joints: Sequence[str]
) -> tuple[Chain, Segments]:
    """Cut the arm out of a robot; all other joints stay at rest.

    Raises:
        RobotError: The joints do not form a chain from base to tool, in this order.
    """
    for link in (base_link, tool_link):
        if link not in model.urdf.links:
            from momapos.errors import unknown_name

            raise unknown_name("link", link, model.urdf.links, model.urdf.name)
    records = [model.joint(name) for name in joints]
    _check_order(model, base_link, tool_link, joints)
    zero = _poses_at_zero(model, base_link, joints)
    origins = []
    axes = []
    for joint in records:
        T = zero[joint.parent] @ joint.T_parent_joint
        origins.append(T[:3, 3])
        axes.append(T[:3, :3] @ joint.axis)
    origin = np.array(origins)
    chain = Chain(
        names=tuple(joints),
        h=np.array(axes),
        d=np.diff(origin, axis=0, prepend=np.zeros((1, 3))),
        prismatic=np.array([j.kind == "prismatic" for j in records]),
        lower=np.array([j.lower for j in records]),
        upper=np.array([j.upper for j in records]),
        velocity=np.array([j.velocity for j in records]),
        tool_offset=zero[tool_link][:3, 3] - origin[-1],
        tool_rotation=zero[tool_link][:3, :3].copy(),
    )
    return chain, _segments(model, zero, joints, origin)


def _poses_at_zero(
    model: Articulated, base_link: str, joints: Sequence[str]
) -> Mapping[str, Float[np.ndarray, "4 4"]]:
    poses = model.link_poses(dict.fromkeys(joints, 0.0))
    T_base_root = invert(poses[base_link])
    return {name: T_base_root @ T for name, T in poses.items()}


def _check_order(model: Articulated, base_link: str, tool_link: str, joints: Sequence[str]) -> None:
    if not joints:
        raise RobotError(f"{model.urdf.name}: arm_joints is empty; name the joints base to tool")
    if len(set(joints)) != len(joints):
        raise RobotError(f"{model.urdf.name}: arm_joints names a joint twice")
    if tool_link not in model.moved_by(joints[-1]):
        raise RobotError(
            f"{model.urdf.name}: tool link {tool_link!r} does not move with {joints[-1]!r}; "
            "arm_joints must be the chain from base to tool"
        )
    for before, after in pairwise(joints):
        if model.joint(after).child not in model.moved_by(before) or before == after:
            raise RobotError(
                f"{model.urdf.name}: joint {after!r} does not follow {before!r}; "
                "arm_joints must be a chain, base first"
            )
    if base_link in model.moved_by(joints[0]):
        raise RobotError(
            f"{model.urdf.name}: base link {base_link!r} moves with {joints[0]!r}; "
            "the base must come before the arm"
        )


def _segments(
    model: Articulated,
    zero: Mapping[str, Float[np.ndarray, "4 4"]],
    joints: Sequence[str],
    origin: Float[np.ndarray, "n 3"],
) -> Segments:
    of_link = dict.fromkeys(model.links, 0)
    for index, name in enumerate(joints):
        for link in model.moved_by(name):
            of_link[link] = index + 1
    shift = np.vstack([np.zeros((1, 3)), origin])
    local = {}
    for link, segment in of_link.items():
        T = zero[link].copy()
        T[:3, 3] -= shift[segment]
        local[link] = T
    return Segments(of_link, local)


@kernel
def rotate_by(R: np.ndarray, axis: np.ndarray, angle: float, out: np.ndarray) -> None:
    """Write R times the rotation about a unit axis (Rodrigues) to `out` (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    v = 1.0 - c
    m00, m01, m02 = c + x * x * v, x * y * v - z * s, x * z * v + y * s
    m10, m11, m12 = x * y * v + z * s, c + y * y * v, y * z * v - x * s
    m20, m21, m22 = x * z * v - y * s, y * z * v + x * s, c + z * z * v
    for i in range(3):
        a, b, d = R[i, 0], R[i, 1], R[i, 2]
        out[i, 0] = a * m00 + b * m10 + d * m20
        out[i, 1] = a * m01 + b * m11 + d * m21
        out[i, 2] = a * m02 + b * m12 + d * m22


@entry
def stand_at_origin(
    R: F3,
    p: F2,
) -> None:
    """Put segment 0 at the origin; written out, as array assignment is slow to compile."""
    for i in range(3):
        p[0, i] = 0.0
        for j in range(3):
            R[0, i, j] = 1.0 if i == j else 0.0


@entry
def forward(
    q: F1,
    h: F2,
    d: F2,
    prismatic: B1,
    R: F3,
    p: F2,
) -> None:
    """Fill rotations R (n + 1, 3, 3) and origins p (n + 1, 3); entry 0 is the base's pose."""
    for i in range(len(q)):
        for k in range(3):
            p[i + 1, k] = (
                p[i, k] + R[i, k, 0] * d[i, 0] + R[i, k, 1] * d[i, 1] + R[i, k, 2] * d[i, 2]
            )
        if prismatic[i]:
            for k in range(3):
                p[i + 1, k] += q[i] * (
                    R[i, k, 0] * h[i, 0] + R[i, k, 1] * h[i, 1] + R[i, k, 2] * h[i, 2]
                )
                for j in range(3):
                    R[i + 1, k, j] = R[i, k, j]
        else:
            rotate_by(R[i], h[i], q[i], R[i + 1])


@entry
def tool_poses(
    q: F2,
    h: F2,
    d: F2,
    prismatic: B1,
    tool_offset: F1,
    tool_rotation: F2,
) -> np.ndarray:
    """Tool poses (m, 4, 4) of configurations (m, n), in the base frame."""
    count, n = q.shape
    out = np.zeros((count, 4, 4))
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    stand_at_origin(R, p)
    for m in range(count):
        forward(q[m], h, d, prismatic, R, p)
        for i in range(3):
            out[m, i, 3] = p[n, i]
            for k in range(3):
                out[m, i, 3] += R[n, i, k] * tool_offset[k]
                for j in range(3):
                    out[m, i, j] += R[n, i, k] * tool_rotation[k, j]
        out[m, 3, 3] = 1.0
    return out
