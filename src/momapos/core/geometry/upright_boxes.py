"""Boxes with vertical edges: their axes, corners, and points in their frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class UprightBox:
    """A box with vertical edges."""

    center: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    """Edge lengths along its own x, y, z [m]."""
    yaw: float = 0.0
    """Angle of its x axis about the world's z [rad]."""


def box_axes(yaw: float) -> Float[np.ndarray, "2 2"]:
    """Return the x and y axes of a box in the world, as rows."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, s], [-s, c]])


def to_local(points: Float[np.ndarray, "n 3"], box: UprightBox) -> Float[np.ndarray, "n 3"]:
    """Map world points to the frame at a box's center, along its edges."""
    return along_edges(points - box.center, box.yaw)


def along_edges(vectors: Float[np.ndarray, "n 3"], yaw: float) -> Float[np.ndarray, "n 3"]:
    """Map world vectors to axes turned by yaw [rad]."""
    turned = np.array(vectors, float)
    turned[:, :2] = turned[:, :2] @ box_axes(yaw).T
    return turned


def between(
    points: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "3"] | Sequence[float],
    high: Float[np.ndarray, "3"] | Sequence[float],
) -> Bool[np.ndarray, " n"]:
    """Return which points lie between two corners; per coordinate, which is faster."""
    x, y, z = points.T
    inside = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    return np.asarray(inside & (z > low[2]) & (z < high[2]))


def corners(box: UprightBox) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the low and high corner, in the box's axes about the world's origin."""
    center = along_edges(np.asarray(box.center)[None], box.yaw)[0]
    return center - box.size / 2, center + box.size / 2


def from_corners(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], yaw: float = 0.0
) -> UprightBox:
    """Return the box between two corners, in axes turned by yaw [rad] about the world's origin."""
    center = (low + high) / 2
    center[:2] = center[:2] @ box_axes(yaw)
    return UprightBox(center, high - low, yaw)


def bottom(box: UprightBox) -> float:
    """Return the height of a box's bottom [m]."""
    return float(box.center[2] - box.size[2] / 2)


def top(box: UprightBox) -> float:
    """Return the height of a box's top [m]."""
    return float(box.center[2] + box.size[2] / 2)
