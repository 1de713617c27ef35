"""Collision shapes as geoms of the physics engine, and the pairs of kinds that collide."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.model.urdf import Geometry, Hull, hull_of

if TYPE_CHECKING:
    from jaxtyping import Float


class Kind(IntEnum):
    """Owner of a geom; each value is one bit of the engine's collision masks."""

    BASE = 1
    ARM = 2
    GRIPPER = 4
    """The palm and the other links of the hand that do not close."""
    ROOM = 8
    PART = 16
    """The moved part or object."""
    FLOOR = 32
    PAD = 64
    """The fingers, or the tip of a hand without fingers."""


ROBOT: tuple[Kind, ...] = (Kind.BASE, Kind.ARM, Kind.GRIPPER, Kind.PAD)
HAND = (Kind.GRIPPER, Kind.PAD)
_MEETS = {
    Kind.BASE: (Kind.ARM, *HAND, Kind.ROOM, Kind.PART),
    Kind.ARM: (Kind.BASE, Kind.ARM, *HAND, Kind.ROOM, Kind.PART, Kind.FLOOR),
    Kind.GRIPPER: (Kind.BASE, Kind.ARM, *HAND, Kind.ROOM, Kind.PART, Kind.FLOOR),
    Kind.ROOM: (Kind.BASE, Kind.ARM, *HAND, Kind.PART),
    Kind.PART: (Kind.BASE, Kind.ARM, Kind.GRIPPER, Kind.ROOM, Kind.FLOOR),
    Kind.FLOOR: (Kind.ARM, *HAND, Kind.PART),
    Kind.PAD: (Kind.BASE, Kind.ARM, *HAND, Kind.ROOM, Kind.FLOOR),
}
_COLORS = {
    Kind.BASE: (0.68, 0.72, 0.76, 1.0),
    Kind.ARM: (0.26, 0.32, 0.38, 1.0),
    Kind.GRIPPER: (0.13, 0.15, 0.18, 1.0),
    Kind.PAD: (0.13, 0.15, 0.18, 1.0),
    Kind.ROOM: (0.90, 0.90, 0.89, 1.0),
    Kind.PART: (0.90, 0.62, 0.0, 1.0),
    Kind.FLOOR: (0.80, 0.75, 0.68, 1.0),
}
"""As on the web page: materials are pale, and the moving part is orange."""
HANDLE_COLOR = (0.35, 0.38, 0.42, 1.0)


def masks(kind: Kind, *, touched: bool) -> tuple[int, int]:
    """Return the engine's `contype` and `conaffinity` of a kind.

    Args:
        kind: Kind of the geom.
        touched: Let the pads collide with the part, as without a weld.
    """
    others = list(_MEETS[kind])
    if touched and kind is Kind.PAD:
        others.append(Kind.PART)
    return int(kind), int(sum(others))


def matrix_quat(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """Return the quaternion wxyz of a rotation matrix, computed by the engine."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R, float).ravel())
    return quat


def place_body(body: Any, T: Float[np.ndarray, "4 4"]) -> Any:
    """Set the pose of a body or geom in its parent's frame."""
    body.pos, body.quat = T[:3, 3], matrix_quat(T[:3, :3])
    return body


def add_shape(
    spec: Any, body: Any, shape: Geometry, T_body_link: Float[np.ndarray, "4 4"], name: str
) -> Any:
    """Add a collision shape: a primitive as it is, a mesh as its convex hull."""
    if shape.kind == "mesh":
        return add_hull(spec, body, hull_of(shape), T_body_link, name)
    geom = body.add_geom(name=name)
    T = T_body_link @ shape.T_link_geometry
    if shape.kind == "box":
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, np.array(shape.size) / 2
    elif shape.kind == "cylinder":
        radius, length = shape.size
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [radius, length / 2, 0]
    else:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [shape.size[0], 0, 0]
    return place_body(geom, T)


def add_hull(
    spec: Any, body: Any, hull: Hull, T_body_link: Float[np.ndarray, "4 4"], name: str
) -> Any:
    """Add a convex hull."""
    spec.add_mesh(
        name=name,
        uservert=hull.vertices.astype(np.float32).ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
    )
    geom = body.add_geom(name=name)
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, name
    return place_body(geom, T_body_link)


def dress(geom: Any, kind: Kind, *, touched: bool, handle: bool = False) -> Any:
    """Set the collision masks and the color of a geom."""
    geom.contype, geom.conaffinity = masks(kind, touched=touched)
    geom.rgba = HANDLE_COLOR if handle else _COLORS[kind]
    return geom
