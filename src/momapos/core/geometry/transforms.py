"""Rigid transforms as 4x4 matrices, and planar poses (x [m], y [m], yaw [rad]).

`T_a_b` maps coordinates in b to a; `Ts_` is a batch over leading axes. Rotations equal those of
`scipy.spatial.transform` to the last bit; that module is slow to import.

Planar points and poses stay rows; `pose_planar` makes a transform of one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, overload

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float


def pose(
    xyz: Float[np.ndarray, "3"] | tuple[float, ...],
    rotation: Float[np.ndarray, "3 3"] | None = None,
) -> Float[np.ndarray, "4 4"]:
    """Build a transform from a translation [m] and a rotation matrix (identity if None)."""
    T = np.eye(4)
    T[:3, 3] = xyz
    if rotation is not None:
        T[:3, :3] = rotation
    return T


def pose_rpy(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> Float[np.ndarray, "4 4"]:
    """Build a transform from a translation [m] and fixed-axis roll, pitch, yaw [rad] (URDF)."""
    r, p, y = (_half_turn(k, float(angle)) for k, angle in enumerate(rpy))
    return pose(xyz, _quaternion_matrix(_quaternion_product(_quaternion_product(r, p), y)))


def rpy_of(R: Float[np.ndarray, "3 3"]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw about fixed axes of a rotation matrix [rad]."""
    flat = math.hypot(R[0, 0], R[1, 0])
    if flat > 1e-6:
        roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    else:  # only the sum or difference of roll and yaw is determined
        roll, yaw = 0.0, math.atan2(-R[0, 1], R[1, 1])
    return roll, math.atan2(-R[2, 0], flat), yaw


def pose_wxyz(xyz: tuple[float, ...], wxyz: tuple[float, ...]) -> Float[np.ndarray, "4 4"]:
    """Build a transform from a translation [m] and a quaternion (w first, any length > 0)."""
    w, x, y, z = map(float, wxyz)
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if length == 0:
        raise ValueError("wxyz must not have length 0")
    return pose(xyz, _quaternion_matrix(np.array([x, y, z, w]) / length))


def pose_planar(base: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Build transforms from planar poses (x [m], y [m], yaw [rad])."""
    base = np.asarray(base, float)
    c, s = np.cos(base[..., 2]), np.sin(base[..., 2])
    T = np.zeros((*base.shape[:-1], 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 1, 0], T[..., 1, 1] = c, -s, s, c
    T[..., 0, 3], T[..., 1, 3] = base[..., 0], base[..., 1]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    return T


def invert(T: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Invert rigid transforms."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", R_t, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def apply(
    T: Float[np.ndarray, "*batch 4 4"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "*batch n 3"]:
    """Map points by one transform or each of a batch."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def rotation_about(
    axis: Float[np.ndarray, "3"], angle: float | Float[np.ndarray, " *batch"]
) -> Float[np.ndarray, "*batch 3 3"]:
    """Return rotations by `angle` [rad] about a unit axis (Rodrigues)."""
    return rotation_of(np.asarray(angle)[..., None] * np.asarray(axis))


def rotation_of(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return rotations about vectors by their lengths [rad]."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    angle = np.sqrt(x * x + y * y + z * z)
    square = angle * angle
    with np.errstate(invalid="ignore"):
        scale = np.where(
            angle <= 1e-3,  # sin(a / 2) / a loses digits, or is 0 / 0
            0.5 - square / 48 + square * square / 3840,
            np.sin(angle / 2) / angle,
        )
    return _quaternion_matrix(
        np.concatenate([scale[..., None] * vectors, np.cos(angle / 2)[..., None]], axis=-1)
    )


def _half_turn(axis: int, angle: float) -> Float[np.ndarray, "4"]:
    """Return the quaternion (w last) of a rotation about x, y or z."""
    q = np.zeros(4)
    q[axis], q[3] = math.sin(angle / 2), math.cos(angle / 2)
    return q


def _quaternion_product(
    p: Float[np.ndarray, "4"], q: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "4"]:
    """Return the quaternion (w last) of p followed by q about fixed axes."""
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(q[:3], p[:3])
    return np.append(vector, p[3] * q[3] - p[:3] @ q[:3])


def _quaternion_matrix(q: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return rotation matrices of unit quaternions (w last)."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0], R[..., 1, 1], R[..., 2, 2] = (
        xx - yy - zz + ww,
        -xx + yy - zz + ww,
        -xx - yy + zz + ww,
    )
    R[..., 0, 1], R[..., 1, 0] = 2 * (x * y - z * w), 2 * (x * y + z * w)
    R[..., 0, 2], R[..., 2, 0] = 2 * (x * z + y * w), 2 * (x * z - y * w)
    R[..., 1, 2], R[..., 2, 1] = 2 * (y * z - x * w), 2 * (y * z + x * w)
    return R


def rotation_angle(
    A: Float[np.ndarray, "*#batch 3 3"], B: Float[np.ndarray, "*#batch 3 3"]
) -> np.float64 | Float[np.ndarray, " *batch"]:
    """Return angles between rotations [rad]; exact if small, unlike arccos of the trace."""
    D = np.swapaxes(A, -1, -2) @ B
    v = np.stack(
        [D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], -1
    )
    return np.arctan2(0.5 * np.linalg.norm(v, axis=-1), 0.5 * (np.trace(D, axis1=-2, axis2=-1) - 1))


@overload
def wrap_angle(angle: float) -> np.float64: ...
@overload
def wrap_angle(angle: Float[np.ndarray, " *batch"]) -> Float[np.ndarray, " *batch"]: ...
def wrap_angle(
    angle: float | Float[np.ndarray, " *batch"],
) -> np.float64 | Float[np.ndarray, " *batch"]:
    """Wrap angles [rad] into (-pi, pi]."""
    wrapped = -(np.mod(-np.asarray(angle) + np.pi, 2 * np.pi) - np.pi)
    # For angles just above pi, the remainder rounds up to a full turn.
    return np.maximum(wrapped, np.nextafter(-np.pi, 0.0))


def upright_frame(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about z given by a frame's horizontal x axis, or else its y axis."""
    axis = R[:2, 0] if abs(R[2, 0]) < 0.8 else R[:2, 1]
    c, s = axis / np.linalg.norm(axis)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def orthonormal(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return a unit vector perpendicular to `axis`, always the same for the same axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    v = np.cross(axis, helper)
    return v / np.linalg.norm(v)


def rotation(yaw: float | Float[np.ndarray, " *batch"]) -> Float[np.ndarray, "*batch 2 2"]:
    """Return rotation matrices for counterclockwise angles [rad]."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def place_points(
    poses: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "n k 2"]:
    """Map points from a planar frame to the world, for each pose of the frame."""
    return np.einsum("nij,kj->nki", rotation(poses[:, 2]), points) + poses[:, None, :2]


def local_points(
    pose: Float[np.ndarray, "3"], points: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "k 2"]:
    """Map points from the world to a planar frame, the inverse of `place_points`."""
    return (points - pose[:2]) @ rotation(pose[2])


def compose(
    frame: Float[np.ndarray, "*#frames 3"], poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Map poses from one planar frame, or from one frame each, to the world."""
    at_x, at_y, turn = frame.T
    c, s = np.cos(turn), np.sin(turn)
    x, y, yaw = poses.T
    return np.stack([at_x + c * x - s * y, at_y + s * x + c * y, wrap_angle(turn + yaw)], -1)
