"""Compute the slope of surfaces in a depth image, and its largest depth per tile."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from jaxtyping import Float, Float32

TILE = 16  # [px] edge of the tiles by which hidden blocks are found


@njit(cache=True)
def facing_of(
    depth: Float32[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"], edge: float, grazing: float
) -> Float32[np.ndarray, "h w"]:
    """Return the component of the ray to depth 1 along the surface normal at each pixel [-].

    It converts a difference of depth to a distance from the surface's plane. It is 0 for unused
    pixels: without depth, next to a depth step, or on a surface at a grazing angle.
    """
    h, w = depth.shape
    out = np.zeros((h, w), np.float32)
    r = 2
    for v in range(r, h - r):
        for u in range(r, w - r):
            d = depth[v, u]
            if d <= 0:
                continue
            left, right, up, down = (
                depth[v, u - r],
                depth[v, u + r],
                depth[v - r, u],
                depth[v + r, u],
            )
            lowest, highest = min(left, right, up, down), max(left, right, up, down)
            if lowest <= 0 or d - lowest > edge * d or highest - d > edge * d:
                continue
            x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
            # With depth d(u, v), the surface's normal is along (-fx du, -fy dv, d + ...): its
            # product with the ray (x, y, 1) is d, for every slope.
            nx = -K[0, 0] * (right - left) / (2 * r)
            ny = -K[1, 1] * (down - up) / (2 * r)
            nz = d - x * nx - y * ny
            along = d / np.sqrt(nx * nx + ny * ny + nz * nz)
            if along > grazing * np.sqrt(x * x + y * y + 1):
                out[v, u] = along
    return out


def deepest_of(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "a b"]:
    """Return the largest depth in each tile of pixels."""
    h, w = depth.shape
    padded = np.pad(depth, ((0, -h % TILE), (0, -w % TILE)))
    return padded.reshape(-(-h // TILE), TILE, -(-w // TILE), TILE).max(axis=(1, 3))
