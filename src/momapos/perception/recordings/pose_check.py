"""Check whether recorded poses agree with depth, by comparing the depth of pairs of images.

The small motion that aligns the surfaces of two images is estimated by point-to-plane ICP (Chen and
Medioni, 1991). Between consecutive images it is the noise of poses and depth. Between images of one
place that were taken far apart in time it is the drift of the poses.
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
"""Pixel stride [px]."""
MAX_DISTANCE = 0.15
"""Surfaces farther apart are different surfaces [m]."""
MIN_SHARED = 0.25
"""Two images show one place if at least this share of one's pixels project into the other [-]."""
MIN_MATCHED = 0.5
"""Share of these pixels that must lie on the other's surfaces [-]: a floor matches itself however
far a camera moved along it."""
ROUNDS = 3
"""Iterations of matching and aligning [-]."""
DAMPING = 1e-2
"""Regularization toward zero motion in unobservable directions, such as along a wall [-]."""
MAX_PAIRS = 40
"""Number of pairs far apart in time that are compared [-]."""
LATER, MIN_LATER = 0.2, 10
"""Far apart in time means this share of the recording, and this many frames [-]."""
MAX_BASELINE, MIN_COSINE = 1.0, np.cos(np.radians(35.0))
"""Distance between the cameras of such a pair [m], and cosine between their directions [-]."""
JUMP = 0.08
"""Tracking failed at a frame this far off from both neighbors, which agree [m]."""
MIN_PIXELS = 150
"""Minimum number of flat pixels that two images share [-]; the raster has about 4,800."""
MIN_SHARED = 0.15
"""The same as a share of the flat pixels of the first image [-]."""
TOLERANCE = 0.02
"""Depth that differs by this share agrees by 1/e [-]; noise and drift are about 1 %."""
MIN_NORMAL_COSINE = 0.8
"""Between normals of one surface [-]."""
JUMP_FRAMES, JUMP_PAIRS, MIN_JUMP_PAIRS = 10, 12, 4
"""Frames on each side of a suspected jump, the most similar pairs of them that are compared, and
the number that must be comparable [-]."""
JUMP_BASELINE, JUMP_COSINE = 1.5, 0.7
"""Distance between the cameras of such a pair [m], and cosine between their directions [-]."""
AGREES_OVER_JUMP = 0.6
"""At a jump no pair agrees to this share of what neighbors do [-]. Without a jump the best pair
reaches 0.7 to 1, with one of 30 cm 0.02 to 0.5, except along a plane that is all that is seen."""
MAX_DRIFT = 0.03
"""Larger drift blurs the fused surfaces [m]."""


@dataclass(frozen=True)
class PoseCheck:
    """Agreement of poses with depth."""

    neighbors: float
    """Median misalignment of consecutive images [m]."""
    drift: float | None
    """Median misalignment of images of one place taken far apart in time [m]; None if no place was
    seen twice."""
    lost: tuple[int, ...] = ()
    """Indices of frames that do not agree with their neighbors."""
    jumps: tuple[int, ...] = ()
    """Indices of the first frames after a jump of the poses."""

    def text(self) -> str:
        """Return one line for users."""
        near = f"poses agree with depth to {100 * self.neighbors:.1f} cm between consecutive frames"
        if self.drift is None:
            return f"{near}; drift is unknown because no place was seen twice"
        return f"{near}, and to {100 * self.drift:.1f} cm between visits of the same place"


def check_poses(frames: Sequence[Frame]) -> PoseCheck | None:
    """Measure how well poses agree with depth.

    Args:
        frames: In recording order.

    Returns:
        The agreement; None if no two consecutive images show one place.
    """
    clouds = [Surface.of(frame) for frame in frames if frame.depth is not None]
    if len(clouds) < len(frames) or len(clouds) < 2:
        return None
    steps = [offset(a, b) for a, b in pairwise(clouds)]
    known = [step for step in steps if step is not None]
    if not known:
        return None
    far = [offset(clouds[i], clouds[j]) for i, j in _far_apart(frames)]
    later = [step for step in far if step is not None]
    lost = tuple(k for k in range(1, len(clouds) - 1) if _is_lost(k, steps, clouds))
    jumps = _jumps([k for k in range(len(clouds)) if k not in lost], clouds)
    drift = float(np.median(later)) if later else None
    return PoseCheck(float(np.median(known)), drift, lost, jumps)


def _is_lost(k: int, steps: Sequence[float | None], clouds: Sequence[Surface]) -> bool:
    """Check whether a frame agrees with neither neighbor, and these with each other."""
    before, after = steps[k - 1], steps[k]
    if before is None or after is None or min(before, after) < JUMP:
        return False
    around = offset(clouds[k - 1], clouds[k + 1])
    return around is not None and around < JUMP / 2


def _jumps(good: Sequence[int], clouds: Sequence[Surface]) -> tuple[int, ...]:
    """Return the first frames after jumps of the poses, among frames that are not lost."""
    steps = [_agreement_of(clouds[a], clouds[b]) for a, b in pairwise(good)]
    known = [step for step in steps if np.isfinite(step)]
    least = AGREES_OVER_JUMP * float(np.median(known)) if known else 0.0
    return tuple(
        good[n + 1]
        for n, step in enumerate(steps)
        if not step >= least and _is_jump(n + 1, least, [clouds[k] for k in good])
    )


def _is_jump(first: int, least: float, clouds: Sequence[Surface]) -> bool:
    """Check whether frames before `first` see other surfaces at the same places as those after."""
    begin = max(0, first - JUMP_FRAMES)
    T = np.array([one.T_world_camera for one in clouds[begin : first + JUMP_FRAMES]])
    before, after = T[: first - begin], T[first - begin :]
    apart = np.linalg.norm(before[:, None, :3, 3] - after[None, :, :3, 3], axis=-1)
    alike = before[:, :3, 2] @ after[:, :3, 2].T
    i, j = np.nonzero((apart < JUMP_BASELINE) & (alike > JUMP_COSINE))
    order = np.argsort(apart[i, j] - alike[i, j], kind="stable")[:JUMP_PAIRS]
    pairs = zip(i[order].tolist(), j[order].tolist(), strict=True)
    found = [_agreement_of(clouds[begin + one], clouds[first + other]) for one, other in pairs]
    known = [value for value in found if np.isfinite(value)]
    return len(known) >= MIN_JUMP_PAIRS and max(known) < least


def _agreement_of(a: Surface, b: Surface) -> float:
    return agreement(a, b, invert(b.T_world_camera) @ a.T_world_camera)


def agreement(a: Surface, b: Surface, T_b_a: Float[np.ndarray, "4 4"]) -> float:
    """Return the share of the flat pixels of an image that lie on the surfaces of another one.

    Args:
        a, b: The surfaces of both; the unit of length may be any.
        T_b_a: From the first camera to the second.

    Returns:
        The share in [0, 1]; NaN if the images share too little.
    """
    flat = (a.normals != 0).any(axis=-1)
    points = a.points[flat] @ T_b_a[:3, :3].T + T_b_a[:3, 3]
    normals = a.normals[flat] @ T_b_a[:3, :3].T
    height, width = b.points.shape[:2]
    depth = np.where(points[:, 2] > 1e-9, points[:, 2], np.inf)
    u, v = np.round((points @ b.intrinsics.T)[:, :2] / depth[:, None]).T.astype(int)
    inside = np.isfinite(depth) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = u[inside], v[inside]
    on = (b.normals[v, u] != 0).any(axis=-1)
    if on.sum() < max(MIN_PIXELS, MIN_SHARED * len(points)):
        return np.nan
    seen, there = b.points[v[on], u[on]], points[inside][on]
    apart = np.abs((there - seen) * b.normals[v[on], u[on]]).sum(axis=1) / seen[:, 2]
    alike = (normals[inside][on] * b.normals[v[on], u[on]]).sum(axis=1) > MIN_NORMAL_COSINE
    return float((np.exp(-((apart / TOLERANCE) ** 2)) * alike).mean())


def _far_apart(frames: Sequence[Frame]) -> list[tuple[int, int]]:
    """Return pairs of frames of one place, taken far apart in time; the most similar first."""
    places = np.array([frame.T_world_camera[:3, 3] for frame in frames])
    directions = np.array([frame.T_world_camera[:3, 2] for frame in frames])
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    alike = directions @ directions.T
    later = max(MIN_LATER, round(LATER * len(frames)))
    i, j = np.nonzero(np.triu((apart < MAX_BASELINE) & (alike > MIN_COSINE), later))
    order = np.argsort(apart[i, j] / MAX_BASELINE - alike[i, j], kind="stable")[:MAX_PAIRS]
    return list(zip(i[order].tolist(), j[order].tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface of one depth image, on a coarse raster."""

    points: Float[np.ndarray, "h w 3"]
    """In the camera's frame [m]."""
    normals: Float[np.ndarray, "h w 3"]
    """Unit vectors; 0 at edges and where a neighbor is missing."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Intrinsics of the raster."""
    T_world_camera: Float[np.ndarray, "4 4"]

    @classmethod
    def of(cls, frame: Frame) -> Surface:
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


def offset(a: Surface, b: Surface) -> float | None:
    """Return the distance by which one image's surface must move to lie on another's [m].

    Returns:
        The mean distance; None if the images share too little, and `MAX_DISTANCE` if they should
        share enough but no surfaces match.
    """
    points = a.points[a.points[..., 2] > 0]
    if not len(points):
        return None
    T = invert(b.T_world_camera) @ a.T_world_camera
    start = apply(T, points)
    moved = start
    used = np.zeros(len(points), bool)
    for _ in range(ROUNDS):
        used, on, normals, shared = _matched(moved, b)
        if used.mean() < MIN_SHARED or used.sum() < MIN_MATCHED * shared.sum():
            return MAX_DISTANCE if shared.mean() > 1.5 * MIN_SHARED else None
        moved = moved + _alignment(moved, used, on, normals)
    return float(np.linalg.norm((moved - start)[used], axis=1).mean())


def _matched(
    points: Float[np.ndarray, "n 3"], b: Surface
) -> tuple[
    Bool[np.ndarray, " n"],
    Float[np.ndarray, "m 3"],
    Float[np.ndarray, "m 3"],
    Bool[np.ndarray, " n"],
]:
    """Match points to the surface of an image: which points lie on it, the places and normals
    there, and which points project to measured pixels at all."""
    height, width = b.points.shape[:2]
    depth = np.where(points[:, 2] > 0.1, points[:, 2], np.inf)
    pixels = np.round((points @ b.intrinsics.T)[:, :2] / depth[:, None]).astype(int)
    u, v = pixels.T
    inside = np.isfinite(depth) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    on, normals = b.points[v, u], b.normals[v, u]
    apart = np.einsum("ni,ni->n", points - on, normals)
    used = inside & (normals != 0).any(axis=1) & (np.abs(apart) < MAX_DISTANCE)
    used &= np.abs(points[:, 2] - on[:, 2]) < 2 * MAX_DISTANCE
    return used, on[used], normals[used], inside & (on[:, 2] > 0)


def _alignment(
    points: Float[np.ndarray, "n 3"],
    used: Bool[np.ndarray, " n"],
    on: Float[np.ndarray, "m 3"],
    normals: Float[np.ndarray, "m 3"],
) -> Float[np.ndarray, "n 3"]:
    """Return the motion of all points by the small rotation and shift that align the used ones."""
    middle = points[used].mean(axis=0)
    local = points[used] - middle
    apart = np.einsum("ni,ni->n", points[used] - on, normals)
    weights = 1.0 / np.maximum(np.abs(apart), 0.01)  # far ones are more often other objects
    rows = np.hstack([np.cross(local, normals), normals])
    A = (rows * weights[:, None]).T @ rows
    A += np.diag(np.full(6, DAMPING * np.trace(A) / 6))
    turn_shift = np.linalg.solve(A, -(rows * weights[:, None]).T @ apart)
    return np.cross(turn_shift[:3], points - middle) + turn_shift[3:]
