"""Exact images of a painted box, by intersecting rays with it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply, invert, pose
from momapos.model.records.scans import Frame

K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
FRIDGE = UprightBox(np.array([2.0, 0.5, 0.9]), np.array([0.6, 0.8, 1.8]), 0.2)
Paint = Callable[[np.ndarray, np.ndarray], np.ndarray]


def camera(eye: tuple[float, ...], target: tuple[float, ...]) -> np.ndarray:
    """Return an upright camera at `eye` that looks at `target`."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return pose(eye, np.stack([right, np.cross(forward, right), forward], axis=1))


def image(
    T_world_camera: np.ndarray, box: UprightBox, paint: Paint, *, name: str = "frame"
) -> Frame:
    """Render a box whose faces are painted by world points and outward normals."""
    v, u = np.mgrid[0:480, 0:640].astype(float)
    rays = np.stack([(u - 320) / 500, (v - 240) / 500, np.ones_like(u)], -1).reshape(-1, 3)
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    T_world_box = pose(box.center, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))
    T = invert(T_world_box) @ T_world_camera
    directions = rays @ T[:3, :3].T
    origin = T[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        near = (-np.sign(directions) * box.size / 2 - origin) / directions
    near = np.where(np.isfinite(near), near, -np.inf)
    axis = near.argmax(1)
    distance = near.max(1)
    local = origin + distance[:, None] * directions
    inside = (np.abs(local) <= box.size / 2 + 1e-9).all(1) & (distance > 0)
    normals = np.zeros_like(local)
    normals[np.arange(len(axis)), axis] = -np.sign(directions[np.arange(len(axis)), axis])
    color = np.zeros((len(rays), 3), np.uint8)
    world = apply(T_world_box, local[inside])
    color[inside] = paint(world, normals[inside] @ T_world_box[:3, :3].T)
    depth = np.where(inside, distance, 0.0).astype(np.float32)
    return Frame(name, color.reshape(480, 640, 3), depth.reshape(480, 640), K, T_world_camera)
