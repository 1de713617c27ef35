"""Records of a URDF: links with their shapes, and joints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from momapos.core.geometry import rotation_about

if TYPE_CHECKING:
    from jaxtyping import Float, Int

JointKind = Literal["revolute", "continuous", "prismatic", "fixed"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in memory."""

    vertices: Float[np.ndarray, "v 3"]
    """[m]"""
    faces: Int[np.ndarray, "f 3"]
    """Vertex indices, from 0."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """One shape of a link."""

    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    """box: edges; cylinder: radius, length; sphere: radius [m]; mesh: scale per axis [-]."""
    T_link_geometry: Float[np.ndarray, "4 4"]
    """Pose in the link frame; cylinders lie along z."""
    name: str = ""
    """Name of the `collision` or `visual` element, often empty."""
    mesh: Path | Mesh | None = None
    """File of a mesh, or the mesh itself if it was made in code."""
    piece: str = ""
    """Number and mesh of a convex piece, in words; "" for a whole shape."""
    whole: Geometry | None = None
    """The mesh that a convex piece is cut from."""


@dataclass(frozen=True)
class Link:
    """A rigid body."""

    name: str
    collisions: tuple[Geometry, ...]
    visuals: tuple[Geometry, ...]
    mass: float = 0.0
    """Mass according to the file [kg]; 0 if it gives none."""
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Center of that mass in the link frame [m]."""

    def with_shapes(self, change: Callable[[Geometry], Geometry]) -> Link:
        """Return the link with each of its shapes changed."""
        collisions, visuals = map(change, self.collisions), map(change, self.visuals)
        return replace(self, collisions=tuple(collisions), visuals=tuple(visuals))


@dataclass(frozen=True)
class Mimic:
    """Mimic relation: a joint's value is ratio times the leader's, plus an offset."""

    joint: str
    """The leader, which is not a mimic joint itself."""
    ratio: float = 1.0
    offset: float = 0.0
    """Offset [rad] or [m]."""

    def at(self, value: Any) -> Any:
        """Return the joint's value or values for a value or values of the leader."""
        return self.ratio * value + self.offset


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links."""

    name: str
    kind: JointKind
    parent: str
    child: str
    T_parent_joint: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, "3"]
    """Unit axis in the joint frame."""
    lower: float
    upper: float
    """Limits [rad] or [m]; infinite for continuous joints."""
    velocity: float
    """Speed limit [rad/s] or [m/s]; infinite if the file has none."""
    mimic: Mimic | None = None
    """Mimic relation, if any."""
    effort: float = math.inf
    """Largest torque [Nm] or force [N]; infinite if the file has none."""
    acceleration: float = math.inf
    """Limit of acceleration and deceleration, the smaller one [rad/s^2] or [m/s^2]; infinite if
    the file has none."""
    jerk: float = math.inf
    """Limit of the jerk [rad/s^3] or [m/s^3]; infinite if the file has none."""
    friction: float = 0.0
    """Dry friction by the file of furniture [Nm] or [N]; 0 if it has none. That of robots is not
    read."""
    damping: float = 0.0
    """Damping by the file of furniture [Nms/rad] or [Ns/m]; 0 if it has none."""

    @property
    def movable(self) -> bool:
        """Return whether the joint is not fixed."""
        return self.kind != "fixed"


@dataclass(frozen=True)
class Urdf:
    """A tree of links and joints, parents before children."""

    name: str
    path: Path | None
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]
    scale: float = 1.0
    """Factor applied to all lengths of the file [-]."""
    rigid: tuple[str, ...] = ()
    """Planar or floating joints that carry the whole model, treated as fixed."""
    notes: tuple[str, ...] = ()
    """What the reader assumed or left out, in words."""
    without_axis: tuple[str, ...] = ()
    """Movable joints without an `<axis>` in the file; their axis is x, as URDF says."""


def joint_motion(
    joint: Joint, value: float | Float[np.ndarray, " *batch"]
) -> Float[np.ndarray, "*batch 4 4"]:
    """Return transforms of a joint's child at values [rad] or [m], in the joint's frame."""
    values = np.asarray(value)
    T = np.tile(np.eye(4), (*values.shape, 1, 1))
    if joint.kind == "prismatic":
        T[..., :3, 3] = values[..., None] * joint.axis
    else:
        T[..., :3, :3] = rotation_about(joint.axis, values)
    return T
