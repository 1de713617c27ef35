"""Find the conventions of a recording, and check its poses against depth.

The small motion that aligns the surfaces of two images is estimated by point-to-plane ICP (Chen and
Medioni, 1991). Between consecutive images it is the noise of poses and depth. Between images of one
place that were taken far apart in time it is the drift of the poses.

Files rarely state their conventions. Under the right ones, the surfaces of an image lie on those of
the next image after the motion of the camera; under wrong ones, they don't. The comparison is
relative to the depth, so that a wrong unit does not look more exact.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import InputError
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
    clouds = [DepthSurface.of(frame) for frame in frames if frame.depth is not None]
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


def _is_lost(k: int, steps: Sequence[float | None], clouds: Sequence[DepthSurface]) -> bool:
    """Check whether a frame agrees with neither neighbor, and these with each other."""
    before, after = steps[k - 1], steps[k]
    if before is None or after is None or min(before, after) < JUMP:
        return False
    around = offset(clouds[k - 1], clouds[k + 1])
    return around is not None and around < JUMP / 2


def _jumps(good: Sequence[int], clouds: Sequence[DepthSurface]) -> tuple[int, ...]:
    """Return the first frames after jumps of the poses, among frames that are not lost."""
    steps = [_agreement_of(clouds[a], clouds[b]) for a, b in pairwise(good)]
    known = [step for step in steps if np.isfinite(step)]
    least = AGREES_OVER_JUMP * float(np.median(known)) if known else 0.0
    return tuple(
        good[n + 1]
        for n, step in enumerate(steps)
        if not step >= least and _is_jump(n + 1, least, [clouds[k] for k in good])
    )


def _is_jump(first: int, least: float, clouds: Sequence[DepthSurface]) -> bool:
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


def _agreement_of(a: DepthSurface, b: DepthSurface) -> float:
    return agreement(a, b, invert(b.T_world_camera) @ a.T_world_camera)


def agreement(a: DepthSurface, b: DepthSurface, T_b_a: Float[np.ndarray, "4 4"]) -> float:
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
class DepthSurface:
    """Surface of one depth image, on a coarse raster."""

    points: Float[np.ndarray, "h w 3"]
    """In the camera's frame [m]."""
    normals: Float[np.ndarray, "h w 3"]
    """Unit vectors; 0 at edges and where a neighbor is missing."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Intrinsics of the raster."""
    T_world_camera: Float[np.ndarray, "4 4"]

    @classmethod
    def of(cls, frame: Frame) -> DepthSurface:
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


def offset(a: DepthSurface, b: DepthSurface) -> float | None:
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
    points: Float[np.ndarray, "n 3"], b: DepthSurface
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


PoseDirection = Literal["given", "inverted"]
"""Poses map from the camera to the world, or the other way."""
CameraAxes = Literal["opencv", "opengl"]
"""Camera axes: x right, y down, z forward; or x right, y up, z backward."""
SCALES = (1.0, 1000.0, 5000.0, 256.0)
"""Usual units of integer depth per meter: meters, millimeters, TUM, KITTI [1/m]."""
PAIRS = 16
"""Number of pairs of images that are compared [-]."""
AGREED = 0.4
"""Minimum agreement of other conventions than the usual [-]: right ones reach 0.6 to 0.85 in
rendered and recorded kitchens, wrong poses and axes 0.25."""
REFUSED = 0.25
"""Recordings that agree less are refused [-]; noise and drift lower the agreement, too."""
CLEAR = 0.05
"""Agreement of a pair that differs by less is equal [-]."""
BETTER_SHARE = 0.8
"""Conventions are better by far if they are in this share of the pairs that differ [-]."""
MIN_PAIRS = 3
"""A recording with fewer pairs that can be compared is not refused [-]."""
FACTORS = (0.1, 0.2, 0.4, 0.5, 0.63, 1.6, 2.0, 2.5, 5.0, 10.0)
"""Other units of depth are told by the agreement at these multiples of the chosen one [-]."""
PLAUSIBLE = (0.3, 10.0)
"""Range of the median depth in a room [m]."""
OPTIONS = "--poses, --camera-axes, --depth-scale and --up"
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Conventions:
    """Meaning of the numbers in a recording."""

    poses: PoseDirection = "given"
    axes: CameraAxes = "opencv"
    scale: float = 1000.0
    """Units of integer depth per meter [1/m]."""

    def text(self) -> str:
        """Return them in words."""
        where = "camera to world" if self.poses == "given" else "world to camera"
        axes = "OpenCV" if self.axes == "opencv" else "OpenGL"
        return f"poses from {where}, {axes} camera axes, depth in 1/{self.scale:g} m"


@dataclass(frozen=True)
class Stated:
    """Conventions that the user states; None where they are to be found."""

    poses: PoseDirection | None = None
    axes: CameraAxes | None = None
    scale: float | None = None


def with_conventions(
    frames: Sequence[Frame], usual: float, stated: Stated, where: str
) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Return frames with poses from camera to world, OpenCV axes and depth in meters.

    Args:
        frames: As read: in recording order, with depth in units of 1 / `usual` meters.
        usual: Units per meter by which the depth was divided.
        stated: What the user states; nothing else is tried for it.
        where: Name of the scan in errors.

    Returns:
        The frames, and one line if they are not as usual.

    Raises:
        InputError: Surfaces agree under no conventions.
    """
    usually = Conventions("given", "opencv", usual)
    first = Conventions(stated.poses or "given", stated.axes or "opencv", stated.scale or usual)
    poses = [frame.T_world_camera for frame in frames]
    surfaces = [DepthSurface.of(frame) for frame in frames] if _with_depth(frames) else []
    pairs = _pairs(len(surfaces))
    tried = list(dict.fromkeys((first, *_possible(first, stated, _median_depth(frames), usually))))
    trial = _Trial(surfaces, poses, pairs, usual)
    best = _choose(tried, trial)
    if best is None:
        most = max(trial.mean(one) for one in tried)
        raise InputError(
            f"{where}: surfaces of neighboring images agree under no usual poses, camera axes and "
            f"unit of depth (at best to {100 * most:.0f} %); state them by {OPTIONS}, or check "
            "the poses"
        )
    if stated.scale is None and trial.is_known(best):
        _refuse_other_unit(best, trial, where)
    said: tuple[str, ...] = ()
    if best != first:
        said = (
            f"{where}: read with {best.text()}; surfaces agree to {100 * trial.mean(best):.0f} % "
            f"then, and to {100 * trial.mean(first):.0f} % with {first.text()}",
        )
    return tuple(_applied(frame, best, usual) for frame in frames), said


def _with_depth(frames: Sequence[Frame]) -> bool:
    return len(frames) > 1 and all(frame.depth is not None for frame in frames)


def _median_depth(frames: Sequence[Frame]) -> float:
    seen = [f.depth[::8, ::8][f.depth[::8, ::8] > 0] for f in frames if f.depth is not None]
    flat = np.concatenate([np.zeros(0), *seen])
    return float(np.median(flat)) if len(flat) else 0.0


def _possible(
    first: Conventions, stated: Stated, depth: float, usual: Conventions
) -> Iterable[Conventions]:
    """Return all conventions that the user does not exclude, with depth of a room."""
    directions: tuple[PoseDirection, ...] = (
        (stated.poses,) if stated.poses else ("given", "inverted")
    )
    axes: tuple[CameraAxes, ...] = (stated.axes,) if stated.axes else ("opencv", "opengl")
    scales = (stated.scale,) if stated.scale else (first.scale, *SCALES)
    for direction, way, scale in product(directions, axes, scales):
        low, high = PLAUSIBLE
        if scale == first.scale or low <= depth * usual.scale / scale <= high:
            yield Conventions(direction, way, scale)


def _pairs(count: int) -> list[tuple[int, int]]:
    """Return pairs of neighbors, spread over the recording."""
    starts = np.unique(np.linspace(0, count - 2, min(PAIRS, max(count - 1, 0))).astype(int))
    return [(int(k), int(k) + 1) for k in starts] if count > 1 else []


@dataclass(frozen=True, eq=False)
class _Trial:
    """Pairs of images on which conventions are tried."""

    surfaces: Sequence[DepthSurface]
    poses: Sequence[Float[np.ndarray, "4 4"]]
    pairs: Sequence[tuple[int, int]]
    usual: float
    """Units of depth per meter by which it was divided [1/m]."""
    _known: dict[Conventions, Float[np.ndarray, " pairs"]] = field(default_factory=dict)

    def scores(self, one: Conventions) -> Float[np.ndarray, " pairs"]:
        """Return the agreement of each pair, in [0, 1]; NaN for pairs that share too little."""
        if one not in self._known:
            found = []
            for a, b in self.pairs:
                T = invert(_pose(self.poses[b], one)) @ _pose(self.poses[a], one)
                T[:3, 3] *= one.scale / self.usual  # in the unit in which depth was read
                found.append(agreement(self.surfaces[a], self.surfaces[b], T))
            self._known[one] = np.array(found)
        return self._known[one]

    def is_known(self, one: Conventions) -> bool:
        """Tell whether enough pairs can be compared."""
        scores = self.scores(one)
        return bool(2 * np.isfinite(scores).sum() >= max(len(scores), 1))

    def mean(self, one: Conventions) -> float:
        """Return the mean agreement; 0 if too few pairs can be compared."""
        return float(np.nanmean(self.scores(one))) if self.is_known(one) else 0.0

    def is_better_by_far(self, one: Conventions, other: Conventions) -> bool:
        """Tell whether one agrees better in nearly all pairs that tell the two apart."""
        apart = np.nan_to_num(self.scores(one)) - np.nan_to_num(self.scores(other))
        clear = apart[np.abs(apart) > CLEAR]
        return bool(
            len(clear) >= min(2, len(self.pairs))
            and (clear > 0).mean() >= BETTER_SHARE
            and apart.mean() > CLEAR
        )


def _choose(tried: Sequence[Conventions], trial: _Trial) -> Conventions | None:
    """Return the conventions to use; None if none agree.

    The first are kept if no others are better by far, or if nothing can be compared. Motions that
    do not tell two others apart decide for the one that changes less.
    """
    first = tried[0]
    best = max(tried, key=trial.mean)
    if trial.mean(best) >= AGREED and trial.is_better_by_far(best, first):
        alike = [one for one in tried if not trial.is_better_by_far(best, one)]
        return min(alike, key=lambda one: (_changes(one, first), -trial.mean(one)))
    known = trial.scores(first)[np.isfinite(trial.scores(first))]
    return None if len(known) >= MIN_PAIRS and known.mean() < REFUSED else first


def _refuse_other_unit(best: Conventions, trial: _Trial, where: str) -> None:
    """Raise InputError if the surfaces agree better by far with another unit of depth."""
    other = [replace(best, scale=best.scale * factor) for factor in FACTORS]
    better = max(other, key=trial.mean)
    if trial.mean(better) > trial.mean(best) and trial.is_better_by_far(better, best):
        about = float(f"{better.scale:.2g}")
        raise InputError(
            f"{where}: depth is in none of the usual units: surfaces agree to "
            f"{100 * trial.mean(better):.0f} % with about {about:g} units per meter, and to "
            f"{100 * trial.mean(best):.0f} % with {best.scale:g}; state the unit by --depth-scale"
        )


def _changes(one: Conventions, other: Conventions) -> int:
    return sum((one.poses != other.poses, one.axes != other.axes, one.scale != other.scale))


def _pose(T: Float[np.ndarray, "4 4"], one: Conventions) -> Float[np.ndarray, "4 4"]:
    T = T if one.poses == "given" else invert(T)
    return T @ _OPENGL if one.axes == "opengl" else T.copy()


def _applied(frame: Frame, one: Conventions, usual: float) -> Frame:
    depth = frame.depth
    if depth is not None and one.scale != usual:
        depth = depth * np.float32(usual / one.scale)
    return replace(frame, depth=depth, T_world_camera=_pose(frame.T_world_camera, one))
