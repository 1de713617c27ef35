"""Rigid transforms as 4x4 matrices.

`T_a_b` maps coordinates in b to a; `Ts_` is a batch over leading axes.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


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
    return pose(xyz, Rotation.from_euler("xyz", rpy).as_matrix())


def pose_wxyz(xyz: tuple[float, ...], wxyz: tuple[float, ...]) -> Float[np.ndarray, "4 4"]:
    """Build a transform from a translation [m] and a quaternion (w first, any length > 0)."""
    return pose(xyz, Rotation.from_quat(wxyz, scalar_first=True).as_matrix())


def pose_planar(base: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Build the transforms of bases that stand on the floor at (x [m], y [m], yaw [rad])."""
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
    """Rotate by `angle` [rad] about a unit axis (Rodrigues)."""
    vectors = np.asarray(angle)[..., None] * np.asarray(axis)
    flat = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return flat.reshape(*vectors.shape[:-1], 3, 3)


def rotation_angle(
    A: Float[np.ndarray, "*batch 3 3"], B: Float[np.ndarray, "*batch 3 3"]
) -> Float[np.ndarray, " *batch"]:
    """Angle [rad] between rotations; exact for small angles, unlike arccos of the trace."""
    D = np.swapaxes(A, -1, -2) @ B
    v = np.stack(
        [D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], -1
    )
    return np.arctan2(0.5 * np.linalg.norm(v, axis=-1), 0.5 * (np.trace(D, axis1=-2, axis2=-1) - 1))


def wrap_angle(angle: float | Float[np.ndarray, " *batch"]) -> Float[np.ndarray, " *batch"]:
    """Wrap angles [rad] into (-pi, pi]."""
    wrapped = -(np.mod(-np.asarray(angle) + np.pi, 2 * np.pi) - np.pi)
    # Just above pi, the remainder rounds up to a full turn.
    return np.maximum(wrapped, np.nextafter(-np.pi, 0.0))


def upright_frame(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation about z that follows a frame: its x axis seen from above, or else its y axis."""
    axis = R[:2, 0] if abs(R[2, 0]) < 0.8 else R[:2, 1]
    c, s = axis / np.linalg.norm(axis)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def orthonormal(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return some unit vector perpendicular to `axis`, the same one for the same axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    v = np.cross(axis, helper)
    return v / np.linalg.norm(v)
