"""Synthetic rooms for tests: boxes with known poses, as images or as a point cloud."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from momapos.model.records.scans import Cloud, Frame

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Low and high corner of a box [m]."""

FLOOR: Corners = ((-3.0, -3.0, -0.1), (3.0, 1.0, 0.0))
BACK: Corners = ((-3.0, 1.0, 0.0), (3.0, 1.1, 2.4))
LEFT: Corners = ((-3.1, -3.0, 0.0), (-3.0, 1.1, 2.4))
ROOM = (FLOOR, BACK, LEFT)

KITCHEN: dict[str, Corners] = {
    "fridge": ((-2.99, 0.25, 0.0), (-2.3, 1.0, 1.75)),
    "row": ((-2.3, 0.4, 0.0), (-0.3, 1.0, 0.86)),
    "slab": ((-2.3, 0.4, 0.86), (-0.3, 1.0, 0.9)),
    "oven": ((-0.3, 0.4, 0.0), (0.35, 1.0, 0.95)),
    "wall_cabinet": ((-2.1, 0.67, 1.42), (-0.5, 1.0, 2.12)),
    "microwave": ((-1.6, 0.62, 0.9), (-1.1, 0.98, 1.18)),
    "bottle": ((-0.7, 0.5, 0.9), (-0.63, 0.57, 1.14)),
    "cup": ((0.85, -1.3, 0.74), (0.93, -1.22, 0.84)),
}
"""One wall of a kitchen; the table is separate, since it has several boxes."""
TABLE: Corners = ((0.6, -1.7, 0.0), (2.0, -0.8, 0.74))


def table_boxes(corners: Corners = TABLE, leg: float = 0.06) -> list[Corners]:
    """Return the boxes of a table: a top on four legs."""
    (x0, y0, _), (x1, y1, z) = corners
    legs = [
        ((x, y, 0.0), (x + leg, y + leg, z - 0.04)) for x in (x0, x1 - leg) for y in (y0, y1 - leg)
    ]
    return [((x0, y0, z - 0.04), (x1, y1, z)), *legs]


def kitchen() -> list[Corners]:
    """Return all boxes of the kitchen and its room."""
    return [*ROOM, *KITCHEN.values(), *table_boxes()]


def look_at(eye: Sequence[float], target: Sequence[float]) -> Float[np.ndarray, "4 4"]:
    """Return the camera-to-world transform of an upright camera, with OpenCV axes."""
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


@dataclass(frozen=True)
class Camera:
    """A small pinhole camera."""

    width: int = 160
    height: int = 120
    focal: float = 150.0

    @property
    def K(self) -> Float[np.ndarray, "3 3"]:
        """Return the intrinsics [px]."""
        u, v = (self.width - 1) / 2, (self.height - 1) / 2
        return np.array([[self.focal, 0.0, u], [0.0, self.focal, v], [0.0, 0.0, 1.0]])

    def rays(self) -> Float[np.ndarray, "h w 3"]:
        """Return the rays to depth 1 in the camera's frame."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        K = self.K
        x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
        return np.stack([x, y, np.ones_like(x)], axis=-1)


def photograph(
    boxes: Sequence[Corners],
    T_world_camera: Float[np.ndarray, "4 4"],
    camera: Camera = Camera(),
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Frame:
    """Render boxes, each in its own gray; noise is the standard deviation of depth [m]."""
    rays = camera.rays() @ T_world_camera[:3, :3].T
    rays = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
    eye = T_world_camera[:3, 3]
    depth = np.full(rays.shape[:2], np.inf)
    number = np.zeros(rays.shape[:2], int)
    for k, (low, high) in enumerate(boxes):
        a, b = (low - eye) / rays, (high - eye) / rays
        near, far = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        hit = (near < far) & (near > 0.05) & (near < depth)
        depth[hit], number[hit] = near[hit], k
    if rng is not None:
        depth = depth + rng.normal(0.0, noise, depth.shape)
    gray = np.where(np.isfinite(depth), 40 + 10 * number, 0).astype(np.uint8)
    depth = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
    return Frame("frame", np.repeat(gray[..., None], 3, axis=-1), depth, camera.K, T_world_camera)


def cloud_of(
    boxes: Sequence[Corners], rng: np.random.Generator, spacing: float = 0.015, noise: float = 0.002
) -> Cloud:
    """Sample points on the faces of boxes that are visible from inside the room.

    Faces against walls and floor, and faces inside other boxes, are excluded.
    """
    points, normals = [], []
    for low, high in boxes:
        for axis in range(3):
            for side, sign in ((low, -1.0), (high, 1.0)):
                face = _face(np.array(low), np.array(high), axis, side[axis], spacing)
                normal = np.zeros(3)
                normal[axis] = sign
                free = face + 0.01 * normal
                inside = [np.all((free > a) & (free < b), axis=1) for a, b in boxes]
                seen = ~np.any(inside, axis=0) & np.all(
                    (free > [-3.0, -3.0, 0.0]) & (free < [3.0, 1.0, 2.4]), axis=1
                )
                points.append(face[seen])
                normals.append(np.tile(normal, (int(seen.sum()), 1)))
    xyz = np.concatenate(points)
    xyz = xyz + rng.normal(0.0, noise, xyz.shape)
    return Cloud(xyz, np.concatenate(normals), np.full((len(xyz), 3), 128, np.uint8))


def _face(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], axis: int, at: float, spacing: float
) -> Float[np.ndarray, "n 3"]:
    a, b = (k for k in range(3) if k != axis)
    steps = [np.arange(low[k] + spacing / 2, high[k], spacing) for k in (a, b)]
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    out = np.empty((len(grid), 3))
    out[:, a], out[:, b], out[:, axis] = grid[:, 0], grid[:, 1], at
    return out
