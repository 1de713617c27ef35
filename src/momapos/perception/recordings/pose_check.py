"""Whether recorded poses agree with depth: what one image measured is looked for in another.

Of each pair of images the small motion that brings their surfaces together is found, point to
plane (Chen and Medioni, 1991). Between neighbors it is the noise of poses and depth; between
images of one place that were taken far apart in time it is how far the poses have drifted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.records import Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

STRIDE = 8
"""Of the pixels that are looked up [px]."""
GATE = 0.15
"""Surfaces farther apart than this are different ones [m]."""
SHARED = 0.25
"""Two images show one place where at least this share of the pixels of one is in the other [-]."""
FITTING = 0.5
"""Of the pixels of one that are in the other at least this share lies on its surfaces [-]: a floor
fits to itself however far a camera was moved along it."""
ROUNDS = 3
"""Of matching and aligning [-]."""
DAMPING = 1e-2
"""What surfaces do not tell, as sliding along a wall, is taken for no motion [-]."""
PAIRS = 40
"""Pairs far apart in time that are compared at most [-]."""
LATER, LEAST_LATER = 0.2, 10
"""Far apart in time is this share of the walk, and this many frames [-]."""
NEAR, ALIKE = 1.0, np.cos(np.radians(35.0))
"""Such pairs were taken from places this near [m], looking alike."""
JUMP = 0.08
"""A frame this far off from both its neighbors, which agree, was lost by the tracking [m]."""
DRIFTED = 0.03
"""Poses that are farther off than this blur what is fused [m]."""


@dataclass(frozen=True)
class PoseCheck:
    """How well poses agree with depth."""

    neighbors: float
    """Median distance by which images that follow each other are apart [m]."""
    drift: float | None
    """The same of images of one place, taken far apart in time [m]; None where no place was
    seen twice."""
    lost: tuple[int, ...] = ()
    """Indices of frames that do not fit to their neighbors."""

    def text(self) -> str:
        """One line for people."""
        near = f"poses agree with depth within {100 * self.neighbors:.1f} cm from frame to frame"
        if self.drift is None:
            return f"{near}; no place was seen twice, so drift is not known"
        return f"{near}, {100 * self.drift:.1f} cm where a place was seen again later"


def check_poses(frames: Sequence[Frame]) -> PoseCheck | None:
    """Measure how well poses agree with depth.

    Args:
        frames: In the order in which they were recorded.

    Returns:
        None where no two images that follow each other show one place.
    """
    clouds = [_Surface.of(frame) for frame in frames if frame.depth is not None]
    if len(clouds) < len(frames) or len(clouds) < 2:
        return None
    steps = [offset(a, b) for a, b in pairwise(clouds)]
    known = [step for step in steps if step is not None]
    if not known:
        return None
    far = [offset(clouds[i], clouds[j]) for i, j in _far_apart(frames)]
    later = [step for step in far if step is not None]
    lost = tuple(k for k in range(1, len(clouds) - 1) if _is_lost(k, steps, clouds))
    return PoseCheck(float(np.median(known)), float(np.median(later)) if later else None, lost)


def _is_lost(k: int, steps: Sequence[float | None], clouds: Sequence[_Surface]) -> bool:
    """Whether a frame fits to neither neighbor, and these to each other."""
    before, after = steps[k - 1], steps[k]
    if before is None or after is None or min(before, after) < JUMP:
        return False
    around = offset(clouds[k - 1], clouds[k + 1])
    return around is not None and around < JUMP / 2


def _far_apart(frames: Sequence[Frame]) -> list[tuple[int, int]]:
    """Pairs of frames of one place, taken far apart in time; the most alike first."""
    places = np.array([frame.T_world_camera[:3, 3] for frame in frames])
    ways = np.array([frame.T_world_camera[:3, 2] for frame in frames])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    alike = ways @ ways.T
    later = max(LEAST_LATER, round(LATER * len(frames)))
    i, j = np.nonzero(np.triu((apart < NEAR) & (alike > ALIKE), later))
    order = np.argsort(apart[i, j] / NEAR - alike[i, j], kind="stable")[:PAIRS]
    return list(zip(i[order].tolist(), j[order].tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class _Surface:
    """What one depth image measured, on a coarse raster."""

    points: Float[np.ndarray, "h w 3"]
    """In the camera's frame [m]."""
    normals: Float[np.ndarray, "h w 3"]
    """Of unit length; 0 where a neighbor is missing or there is an edge."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Of the raster."""
    T_world_camera: Float[np.ndarray, "4 4"]

    @classmethod
    def of(cls, frame: Frame) -> _Surface:
        assert frame.depth is not None
        depth = frame.depth[::STRIDE, ::STRIDE].astype(float)
        K = frame.intrinsics.copy()
        K[:2] /= STRIDE
        v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
        rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1)
        points = rays * depth[..., None]
        normals = np.zeros_like(points)
        across = points[1:-1, 2:] - points[1:-1, :-2]
        down = points[2:, 1:-1] - points[:-2, 1:-1]
        normal = np.cross(across, down)
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        middle = depth[1:-1, 1:-1]
        beside = (depth[1:-1, 2:], depth[1:-1, :-2], depth[2:, 1:-1], depth[:-2, 1:-1])
        ring = np.stack([middle, *beside])
        flat = (ring.min(axis=0) > 0) & (np.ptp(ring, axis=0) < 0.1 * ring.max(axis=0))
        unit = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
        normals[1:-1, 1:-1] = unit * flat[..., None]
        return cls(points, normals, K, frame.T_world_camera)


def offset(a: _Surface, b: _Surface) -> float | None:
    """How far what one image measured must move to lie on what another one did [m].

    Returns:
        The mean distance that its points move; None where the images share too little, and
        `GATE` where they should share enough and their surfaces are nowhere near.
    """
    points = a.points[a.points[..., 2] > 0]
    T = invert(b.T_world_camera) @ a.T_world_camera
    start = apply(T, points)
    moved = start
    used = np.zeros(len(points), bool)
    for _ in range(ROUNDS):
        used, on, normals, shared = _matched(moved, b)
        if used.mean() < SHARED or used.sum() < FITTING * shared.sum():
            return GATE if shared.mean() > 1.5 * SHARED else None
        moved = moved + _alignment(moved, used, on, normals)
    return float(np.linalg.norm((moved - start)[used], axis=1).mean())


def _matched(
    points: Float[np.ndarray, "n 3"], b: _Surface
) -> tuple[
    Bool[np.ndarray, " n"],
    Float[np.ndarray, "m 3"],
    Float[np.ndarray, "m 3"],
    Bool[np.ndarray, " n"],
]:
    """Which points lie on the surface of an image, the places and normals there, and which points
    are in the image at all, where it measured something."""
    height, width = b.points.shape[:2]
    depth = np.where(points[:, 2] > 0.1, points[:, 2], np.inf)
    pixels = np.round((points @ b.intrinsics.T)[:, :2] / depth[:, None]).astype(int)
    u, v = pixels.T
    inside = np.isfinite(depth) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    on, normals = b.points[v, u], b.normals[v, u]
    apart = np.einsum("ni,ni->n", points - on, normals)
    used = inside & (normals != 0).any(axis=1) & (np.abs(apart) < GATE)
    used &= np.abs(points[:, 2] - on[:, 2]) < 2 * GATE
    return used, on[used], normals[used], inside & (on[:, 2] > 0)


def _alignment(
    points: Float[np.ndarray, "n 3"],
    used: Bool[np.ndarray, " n"],
    on: Float[np.ndarray, "m 3"],
    normals: Float[np.ndarray, "m 3"],
) -> Float[np.ndarray, "n 3"]:
    """How all points move by the small turn and shift that bring the used ones onto planes."""
    middle = points[used].mean(axis=0)
    local = points[used] - middle
    apart = np.einsum("ni,ni->n", points[used] - on, normals)
    weights = 1.0 / np.maximum(np.abs(apart), 0.01)  # far ones are other things more often
    rows = np.hstack([np.cross(local, normals), normals])
    A = (rows * weights[:, None]).T @ rows
    A += np.diag(np.full(6, DAMPING * np.trace(A) / 6))
    turn_shift = np.linalg.solve(A, -(rows * weights[:, None]).T @ apart)
    return np.cross(turn_shift[:3], points - middle) + turn_shift[3:]
