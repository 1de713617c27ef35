"""Clouds and free space of a cupboard with an open leaf, made of boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momapos.core.geometry.transforms import apply, invert
from momapos.model.records.open_leaf import OpenLeaf
from momapos.model.records.scans import Cloud

STEP = 0.015
"""Point spacing [m]."""
WALL = 0.018
"""Thickness of the cupboard's walls [m]."""


@dataclass(frozen=True)
class Solid:
    """A box that may be turned: its inside is occupied, its faces are visible."""

    low: np.ndarray
    high: np.ndarray
    T_world_box: np.ndarray

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Points of its six faces, and their normals."""
        points, normals = [], []
        for axis in range(3):
            a, b = (np.arange(self.low[k] + STEP / 2, self.high[k], STEP) for k in others(axis))
            for at, sign in ((self.low[axis], -1.0), (self.high[axis], 1.0)):
                face = np.zeros((len(a) * len(b), 3))
                face[:, axis] = at
                grid = np.stack(np.meshgrid(a, b, indexing="ij"), -1).reshape(-1, 2)
                face[:, list(others(axis))] = grid
                normal = np.zeros(3)
                normal[axis] = sign
                points.append(face)
                normals.append(np.tile(normal, (len(face), 1)))
        R = self.T_world_box[:3, :3]
        return apply(self.T_world_box, np.concatenate(points)), np.concatenate(normals) @ R.T

    def holds(self, points: np.ndarray, margin: float) -> np.ndarray:
        """Which points are in it or this near to it [m]."""
        local = apply(invert(self.T_world_box), points)
        return np.asarray(((local > self.low - margin) & (local < self.high + margin)).all(1))


def others(axis: int) -> tuple[int, int]:
    """Return the other two axes."""
    return {0: (1, 2), 1: (0, 2), 2: (0, 1)}[axis]


@dataclass(frozen=True)
class Room:
    """A few boxes in front of a wall at y = 0; cameras are at y < 0."""

    solids: tuple[Solid, ...]

    def cloud(self) -> Cloud:
        """What is seen of it, with a noise of 2 mm."""
        points, normals = (
            np.concatenate(both)
            for both in zip(*(one.surface() for one in self.solids), strict=True)
        )
        hidden = np.zeros(len(points), bool)
        for one in self.solids:
            hidden |= one.holds(points + 0.004 * normals, 0.0)
        hidden |= points[:, 1] > 0.001
        rng = np.random.default_rng(0)
        points = points[~hidden] + rng.normal(0.0, 2e-3, (int((~hidden).sum()), 3))
        return Cloud(points, normals[~hidden], np.full(points.shape, 120, np.uint8))

    def free(self, points: np.ndarray) -> np.ndarray:
        """What is seen to be empty."""
        out = (points[:, 1] < 0.0) & (points[:, 2] > 0.0)
        for one in self.solids:
            out &= ~one.holds(points, 0.01)
        return np.asarray(out)


def box(low: tuple[float, ...], high: tuple[float, ...], T: np.ndarray | None = None) -> Solid:
    """Return a solid."""
    return Solid(np.array(low, float), np.array(high, float), np.eye(4) if T is None else T)


def cupboard(leaf: OpenLeaf, *, hollow: bool = True) -> Room:
    """Return a 0.6 x 0.5 x 0.8 m cupboard whose front is y = -0.5, with one leaf and a neighbor."""
    x0, x1, y0, z0, z1 = 0.0, 0.6, -0.48, 0.4, 1.2
    body = [
        box((x0, y0, z0), (x0 + WALL, 0.0, z1)),
        box((x1 - WALL, y0, z0), (x1, 0.0, z1)),
        box((x0, y0, z0), (x1, 0.0, z0 + WALL)),
        box((x0, y0, z1 - WALL), (x1, 0.0, z1)),
        box((x0, -WALL, z0), (x1, 0.0, z1)),
    ]
    if not hollow:
        body = [box((x0, -0.5, z0), (x1, 0.0, z1))]
    neighbor = box((x1, -0.5, z0), (1.4, 0.0, z1))
    wall = box((-1.5, 0.0, 0.0), (2.5, 0.1, 2.4))
    local = np.stack([leaf.along, leaf.out, leaf.across], axis=1)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = local, leaf.corner
    slab = box((0.0, -leaf.thickness, 0.0), (leaf.size[0], 0.0, leaf.size[1]),
               invert(leaf.T_closed_open) @ T)  # fmt: skip
    return Room((*body, neighbor, wall, slab))


def leaf_of(kind: str, value: float) -> OpenLeaf:
    """Return the leaf of the cupboard, its axis in the front at one of the edges."""
    x0, x1, z0, z1 = 0.002, 0.598, 0.402, 1.198
    up, right, out = np.eye(3)[2], np.eye(3)[0], np.array([0.0, -1.0, 0.0])
    along = {"door_left": right, "door_right": -right, "door_down": up, "door_up": -up}[kind]
    corner = {
        "door_left": np.array([x0, -0.5, z0]), "door_right": np.array([x1, -0.5, z0]),
        "door_down": np.array([x0, -0.5, z0]), "door_up": np.array([x0, -0.5, z1]),
    }[kind]  # fmt: skip
    size = (x1 - x0, z1 - z0) if kind in ("door_left", "door_right") else (z1 - z0, x1 - x0)
    return OpenLeaf(corner, along, out, size, corner, value, 0.02)
