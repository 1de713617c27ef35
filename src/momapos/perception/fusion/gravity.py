"""Align a scan with gravity: z up, the floor at z = 0, walls along x and y.

A room is mostly horizontal and vertical surfaces, and cameras are held roughly upright or on their
side. Up is the direction near the cameras' own up that most normals are parallel or perpendicular
to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError
from momapos.core.geometry import pose
from momapos.model.records import Cloud, Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

EDGES = np.array([1.0, 0.99, 0.99, 0.98])
"""Prior weights of the top, right, left and lower edge of an image to be up [-]."""
DOWN_WEIGHT = 0.005
"""Weight of the camera looking down [-]."""
STEEP = 0.25
"""Cosine of the pitch below which an image taken steeply up or down counts less [-]."""
MAX_FRAMES = 100
"""Number of images that are used; more do not help [-]."""
SEARCHED = ((4.0, 0.25), (0.25, 0.05))
"""Yaw angles that are tried, coarse and fine: range around the best one, and step [deg]."""
MIN_FLOOR_SHARE = 0.06
"""The floor is the lowest plane with this share of the upward points [-]."""
MIN_STEADINESS = 0.5
"""Smaller rotations are ignored [deg]: the source of the scan is more accurate than planes in a
noisy cloud."""
UP_CONE = 60.0
"""Up is searched within this angle of the cameras' mean up direction [deg]; cameras look down at a
kitchen, so their up leans forward."""
DIRECTION_SPREAD = 6.0
"""Normals within this angle belong to a direction [deg]."""
HALF_LAYER = 0.03
"""Half the thickness of a horizontal plane [m]."""
PLANE_TOLERANCE = 0.01
"""Points of one upright plane share a coordinate within this [m]."""
LEVEL_BONUS = 0.1
"""Score of the axis along which a room is shortest, as a share of its points [-]."""
BETTER_UP = 0.15
"""Another axis than z is up if its score is larger by this [-]. One wall with a row of cabinets
faces one side as much as its floor faces up."""
MAX_POINTS = 40_000
"""Number of points by which directions are counted; more do not help [-]."""


def align_to_gravity(
    cloud: Cloud, frames: Sequence[Frame], up: Float[np.ndarray, "3"] | None = None
) -> Float[np.ndarray, "4 4"]:
    """Estimate the transform that makes a scan upright.

    Args:
        cloud: Surfaces with normals, in the world of the scan.
        frames: Images with camera poses.
        up: Rough direction of up, if known. Else it is found by the cameras; without images, an
            axis of the world is roughly up, see `axis_up`.

    Returns:
        `T_up_cloud`: z is up, the floor is at z = 0, walls and furniture are along x and y. The
        rotation about z is the smallest possible, at most 45 degrees.

    Raises:
        InputError: The cloud has too few points, or no horizontal surface.
    """
    if len(cloud.points) < 100:
        raise InputError(f"a cloud of {len(cloud.points)} points is too small to find up")
    step = -(-len(cloud.points) // MAX_POINTS)
    points, normals = cloud.points[::step], cloud.normals[::step]
    if up is None:
        up = _camera_up(frames) if frames else axis_up(points, normals)
    up = _search(normals, up)
    if not _along(normals, up).any():
        raise InputError("the scan shows no horizontal surface, so up is unknown")
    for _ in range(3):
        up = _fit(points, normals, up)
    R_up_cloud = _least_turn(up)
    offset = _yaw_offset(points @ R_up_cloud.T, normals @ R_up_cloud.T)
    R_up_cloud = Rotation.from_euler("z", -offset).as_matrix() @ R_up_cloud
    if np.degrees(Rotation.from_matrix(R_up_cloud).magnitude()) < MIN_STEADINESS:
        R_up_cloud = np.eye(3)
    along = _along(normals, R_up_cloud[2])
    z_floor = _floor_height(points[along] @ R_up_cloud[2])
    return pose((0.0, 0.0, -z_floor), R_up_cloud)


def axis_up(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "3"]:
    """Return the axis of the world that points up in a cloud without cameras.

    Floor and tops of furniture face up, and scans rarely show what faces down. The floor is the
    lowest layer, and a room is less high than long. The z axis is taken unless another one fits
    better by far.
    """
    axes = np.concatenate([np.eye(3)[[2, 1, 0]], -np.eye(3)[[2, 1, 0]]])
    extent = np.ptp(np.percentile(points, (1, 99), axis=0), axis=0)
    scores = [_upness(points @ axis, normals @ axis) for axis in axes]
    fits = np.array(scores) + LEVEL_BONUS * (np.abs(axes) @ extent <= 1.05 * extent.min())
    best = int(np.argmax(fits))
    return axes[best] if fits[best] > fits[0] + BETTER_UP else axes[0]


def _upness(heights: Float[np.ndarray, " n"], cosines: Float[np.ndarray, " n"]) -> float:
    """Return the share of points that face up less those that face down, plus the floor's share."""
    low, high = np.percentile(heights, (1, 99))
    facing = np.cos(np.radians(20.0))
    floor = (heights < low + max(HALF_LAYER, 0.05 * (high - low))) & (cosines > facing)
    return float((cosines > facing).mean() - (cosines < -facing).mean() + floor.mean())


def _camera_up(frames: Sequence[Frame]) -> Float[np.ndarray, "3"]:
    """Estimate up from the cameras, which are held upright or on their side.

    Whatever its pitch, a camera is held level: one of the four edges of nearly every image points
    up, and the two adjacent ones are perpendicular to up. If the cameras' yaw and pitch vary, only
    one direction satisfies this. Otherwise the top edge is preferred, and the direction for which
    the cameras look down.
    """
    step = -(-len(frames) // MAX_FRAMES)
    R = np.array([frame.T_world_camera[:3, :3] for frame in frames[::step]], float)
    edges = np.stack([-R[:, :, 1], R[:, :, 0], -R[:, :, 0], R[:, :, 1]], axis=1)
    tried = np.concatenate([edges.reshape(-1, 3), *map(_square_to, (R[:, :, 0], R[:, :, 1]))])
    along = np.einsum("fek,tk->tfe", edges, tried)
    in_image = np.hypot(along, along[..., [1, 0, 3, 2]])
    held = along / np.maximum(in_image, 1e-9) * np.minimum(in_image / STEEP, 1.0)
    down = -R[:, :, 2] @ tried.T
    best = tried[
        np.argmax((held * EDGES).max(axis=2).mean(axis=1) + DOWN_WEIGHT * down.mean(axis=0))
    ]
    own = np.argmax(edges @ best * EDGES, axis=1)
    mean = edges[np.arange(len(edges)), own].mean(axis=0)
    length = np.linalg.norm(mean)
    return mean / length if length > 0.1 else np.array([0.0, 0.0, 1.0])


def _square_to(edges: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 3"]:
    """Return the direction most perpendicular to all of some unit vectors, and its opposite."""
    direction = np.linalg.eigh(edges.T @ edges)[1][:, 0]
    return np.stack([direction, -direction])


def _search(
    normals: Float[np.ndarray, "n 3"], guess: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction near a guess that most normals are parallel or perpendicular to."""
    directions = _cap(guess, np.radians(UP_CONE), 1200)
    width = np.radians(DIRECTION_SPREAD)
    cosines = normals[:: max(1, len(normals) // 5000)] @ directions.T
    # Both scores are smooth, so that the best of a coarse set is near the global optimum.
    along = np.exp((np.minimum(cosines, 1.0) - 1) / (1 - np.cos(width))).mean(axis=0)
    square = np.exp(-((cosines / np.sin(width)) ** 2)).mean(axis=0)
    # Walls confirm any direction in their plane, so they count less.
    return directions[np.argmax(along + 0.5 * square)]


def _cap(axis: Float[np.ndarray, "3"], angle: float, count: int) -> Float[np.ndarray, "count 3"]:
    """Return unit vectors within an angle [rad] of an axis, evenly distributed on a spiral."""
    k = np.arange(count) + 0.5
    z = 1 - (1 - np.cos(angle)) * k / count
    turn = np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    local = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    return local @ _least_turn(axis)


def _least_turn(up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return the smallest rotation that maps a unit vector to the z axis."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, up[2])).as_matrix()


def _along(normals: Float[np.ndarray, "n 3"], up: Float[np.ndarray, "3"]) -> Bool[np.ndarray, " n"]:
    return normals @ up > np.cos(np.radians(2 * DIRECTION_SPREAD))


def _fit(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    up: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"]:
    """Fit parallel planes to all horizontal surfaces at once; their common normal is up."""
    flat = points[_along(normals, up)]
    layer = _layers(flat @ up)
    flat, layer = flat[layer >= 0], layer[layer >= 0]
    if not len(flat):
        return up
    means = np.stack(
        [np.bincount(layer, flat[:, a]) / np.maximum(np.bincount(layer), 1) for a in range(3)], 1
    )
    spread = flat - means[layer]
    values, vectors = np.linalg.eigh(spread.T @ spread)
    fitted = vectors[:, 0] * np.sign(vectors[:, 0] @ up)
    # A single narrow strip leaves one direction open; the mean normal is better then.
    if values[1] < 20 * values[0]:
        fitted = normals[_along(normals, up)].mean(axis=0)
    return fitted / np.linalg.norm(fitted)


def _layers(z: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Number the planes among heights by histogram peaks; -1 for points between them."""
    low, histogram = _histogram(z, HALF_LAYER)
    out = np.full(len(z), -1)
    for number in range(8):
        peak = int(np.argmax(histogram))
        if histogram[peak] < 0.02 * len(z):
            break
        height = low + (peak + 0.5) * HALF_LAYER
        out[(np.abs(z - height) < HALF_LAYER) & (out < 0)] = number
        histogram[max(0, peak - 2) : peak + 3] = 0
    return out


def _histogram(z: Float[np.ndarray, " n"], width: float) -> tuple[float, Int[np.ndarray, " bins"]]:
    """Count heights in layers: the lower end of the first layer, and the counts."""
    low = float(np.percentile(z, 0.1)) - width
    bins = np.floor((z - low) / width).astype(int)
    return low, np.bincount(bins[bins >= 0], minlength=1)


def _floor_height(z: Float[np.ndarray, " n"]) -> float:
    low, histogram = _histogram(z, HALF_LAYER)
    window = np.convolve(histogram, np.ones(2, int), "same")
    large = window >= MIN_FLOOR_SHARE * len(z)
    first = int(np.argmax(large)) if large.any() else int(np.argmax(window))
    stop = min(first + 3, len(histogram))
    peak = first + int(np.argmax(histogram[first:stop]))
    height = low + (peak + 0.5) * HALF_LAYER
    return float(np.median(z[np.abs(z - height) < HALF_LAYER]))


def _yaw_offset(points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"]) -> float:
    """Return the yaw of vertical surfaces from x and y, in (-pi/4, pi/4] [rad].

    Normals give it to a few degrees. Then the yaw is refined so that most points share a coordinate
    across their surface.
    """
    upright = np.abs(normals[:, 2]) < np.sin(np.radians(2 * DIRECTION_SPREAD))
    if upright.sum() < 50:
        return 0.0
    places, facing = points[upright, :2], normals[upright, :2]
    # Directions 90 degrees apart are equivalent: counted on a circle of a quarter turn.
    quarter = np.mod(np.arctan2(facing[:, 1], facing[:, 0]), np.pi / 2)
    bins = np.bincount((quarter / (np.pi / 2) * 90).astype(int) % 90, minlength=90)
    smooth = sum(np.roll(bins, shift) for shift in range(-2, 3))
    turn = (float(np.argmax(smooth)) + 0.5) / 90 * np.pi / 2
    for reach, step in SEARCHED:
        tried = turn + np.radians(np.arange(-reach, reach + step / 2, step))
        turn = tried[np.argmax([_sharpness(places, facing, one) for one in tried])]
    return float(np.mod(turn + np.pi / 4, np.pi / 2) - np.pi / 4)


def _sharpness(
    places: Float[np.ndarray, "n 2"],
    facing: Float[np.ndarray, "n 2"],
    turn: float,
) -> float:
    """Return how well points share a coordinate across their surface after a yaw rotation [rad]."""
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, -s], [s, c]])
    along = np.abs(facing @ axes) > np.cos(np.radians(2 * DIRECTION_SPREAD))
    counts = [
        _histogram(at[own], PLANE_TOLERANCE)[1].astype(float)
        for at, own in zip((places @ axes).T, along.T, strict=True)
        if own.any()
    ]
    return float(sum(count @ count for count in counts))
