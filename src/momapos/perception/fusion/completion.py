"""Complete surfaces without depth (black, mirrored and glass fronts) from the planes around them.

A hole in a depth image is surrounded by measured pixels. If many of them lie in one upright plane,
and the others behind it, the hole shows that plane, such as the front of a dark dishwasher between
two cabinets, or of a fridge above the line where it meets the floor. Holes that only one image
shows, or that any image sees through, stay open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.records import Cloud, Frame

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, Int, UInt8


MIN_DEPTH = 0.1
"""Places closer to a camera are ignored [m]."""
MAX_PROJECTED = 100_000
"""Number of places times images that are projected together, to bound memory [-]."""
SEEN_BEYOND = 0.1
"""An image sees through a place if it measures something this far behind it [m]."""


class SeenThrough:
    """Tells whether any image with depth measures something far enough behind a place.

    Each batch of places is projected into all images at once, which takes an eighth of the time of
    one image after the other.

    Args:
        frames: Images; those without depth are ignored.
    """

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._depths = [frame.depth for frame in frames if frame.depth is not None]
        seeing = [frame for frame in frames if frame.depth is not None]
        self._T_camera_world = np.array([invert(frame.T_world_camera) for frame in seeing]).reshape(
            -1, 4, 4
        )
        self._intrinsics = np.array([frame.intrinsics for frame in seeing]).reshape(-1, 3, 3)
        shapes = np.array([depth.shape for depth in self._depths]).reshape(-1, 2)
        self._height, self._width = shapes.T[..., None]

    def __call__(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Tell which places in the images' world [m] are seen through."""
        step = max(1, MAX_PROJECTED // max(1, len(self._depths)))
        parts = [self._seen(points[at : at + step]) for at in range(0, len(points), step)]
        return np.concatenate(parts) if parts else np.zeros(0, bool)

    def _seen(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        local = apply(self._T_camera_world, points)
        z = np.maximum(local[..., 2], 1e-3)
        pixels = local @ np.swapaxes(self._intrinsics, -1, -2)
        u, v = (np.round(pixels[..., k] / z).astype(int) for k in (0, 1))
        there = (local[..., 2] > MIN_DEPTH) & (u >= 0) & (v >= 0)
        there &= (u < self._width) & (v < self._height)
        out = np.zeros(len(points), bool)
        for k in np.flatnonzero(there.any(axis=1)):
            on = np.flatnonzero(there[k] & ~out)
            out[on] = self._depths[k][v[k, on], u[k, on]] > z[k, on] + SEEN_BEYOND
        return out


TILE = 4
"""Edge length of the tiles that a hole is made of [px]."""
RING = 3
"""Width of the surroundings of a hole [tiles]."""
MIN_COSINE = 0.8
"""Between the normal of a surface and that of its plane [-]."""
MIN_SPACING = 0.005
"""Of added points [m]."""
MIN_STRAIGHT = 0.5
"""Share of the floor's edge that must be on one line [-]."""
HANGING_HEIGHT = 1.0
"""Fronts whose lower edge is higher hang, and the wall is visible below them [m]."""
MIN_PLANE_AREA = 0.04
"""Minimum area of a hole on its plane [m2]."""
MIN_RING = 20
"""Minimum number of tiles of a hole, and of tiles with depth around it [-]."""
MAX_PLANE_DISTANCE = 0.03
"""Points this close to a plane lie in it [m]."""
PLINTH_HEIGHT = 0.15
"""Maximum distance of a front from the line below it where the floor ends [m]."""
TOE_SPACE = (0.15, 0.3)
"""Below a front, at most the second share [-] lies farther behind it than the first [m]:
standing furniture hides what is behind it, legs do not."""
MIN_SUPPORT = 0.02
"""Minimum share of a hole's surroundings in its plane [-]."""
SIDE_SUPPORT = (0.5, 0.12)
"""Minimum share of a hole's surroundings on one side that lie in its plane. Two sides must have the
first, or one side the second if the hole ends at the floor [-]."""
MAX_IN_FRONT = (0.08, 0.15)
"""At most the second share [-] of the surroundings lies farther in front of the plane than the
first [m]."""
MAX_DEPTH = 4.0
"""Holes farther away stay open: they are beyond the sensor's range [m]."""
MIN_INCIDENCE = 0.25
"""Minimum cosine between ray and normal [-]."""
MIN_IMAGES = 2
"""Minimum number of images that show the hole [-]."""


@dataclass(frozen=True, eq=False)
class HolePatch:
    """A hole in one image, on its plane."""

    frame: int
    axis: int
    """Axis of the plane's normal: 0 for x, 1 for y."""
    sign: float
    """+1 if it is seen from larger coordinates, else -1."""
    offset: float
    """Coordinate of the plane along the axis [m]."""
    places: Float[np.ndarray, "n 2"]
    """The other horizontal coordinate, and the height [m]."""
    colors: UInt8[np.ndarray, "n 3"]


class Ring(NamedTuple):
    """Measured surroundings of a hole."""

    rays: Float[np.ndarray, "r 3"]
    """Rays of depth 1."""
    points: Float[np.ndarray, "r 3"]
    """Surface points on the rays [m]."""
    normals: Float[np.ndarray, "r 3"]
    """Normals of the surfaces, of either sign; NaN where unknown."""


def complete(
    cloud: Cloud,
    frames: Sequence[Frame],
    walls: Sequence[tuple[int, float]] = (),
    voxel: float = 0.015,
) -> Cloud:
    """Add surfaces where several images should measure depth but none does.

    Args:
        cloud: Upright, walls and furniture along x and y, floor at z = 0.
        frames: The images, with poses in that world.
        walls: Axis of the normal, 0 or 1, and coordinate [m] of each wall; holes in walls are
            windows or openings, not fronts.
        voxel: Spacing of added points [m].

    Returns:
        The cloud, its own points first.
    """
    seen = [(i, frame) for i, frame in enumerate(frames) if frame.depth is not None]
    patches = [patch for i, frame in seen for patch in holes(frame, i)]
    parts, seen_through = [cloud], SeenThrough(frames)
    patches = [patch for patch in patches if not _in_wall(patch, walls)]
    for group in _coplanar(patches, MAX_PLANE_DISTANCE):
        points, colors = _confirmed(group, max(voxel, MIN_SPACING), MIN_IMAGES)
        free = (points[:, 2] < 0.0) | seen_through(points)
        normal = np.zeros(3)
        normal[group[0].axis] = group[0].sign
        points, colors = points[~free], colors[~free]
        parts.append(Cloud(points, np.tile(normal, (len(points), 1)), colors))
    return Cloud(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.colors for part in parts]),
        cloud.rows,
    )


def holes(frame: Frame, index: int) -> Iterator[HolePatch]:
    """Yield the holes in the depth of an image that are surfaces.

    Args:
        frame: With its pose in an upright world with the floor at z = 0.
        index: Index of the image.
    """
    from scipy.ndimage import binary_dilation, find_objects, label

    depth = _coarse(frame)
    if min(depth.shape) < 2 * RING:
        return
    regions, _ = label(depth == 0.0)
    rays = _rays(depth.shape, frame)
    eye = frame.T_world_camera[:3, 3]
    points = eye + rays * np.where(depth > 0.0, depth, np.nan)[..., None]
    normals = _normals(points)
    for number, box in enumerate(find_objects(regions), start=1):
        rows, columns = (slice(max(s.start - RING, 0), s.stop + RING) for s in box)
        inside = regions[rows, columns] == number
        if inside.sum() < MIN_RING:
            continue
        around = binary_dilation(inside, iterations=RING) & ~inside
        around &= depth[rows, columns] > 0.0
        if around.sum() < MIN_RING:
            continue
        ray = rays[rows, columns][inside]
        ring = Ring(*(values[rows, columns][around] for values in (rays, points, normals)))
        plane = _plane(eye, ring, ray)
        if plane is None:
            continue
        axis, offset = plane
        places = eye + ray * ((offset - eye[axis]) / ray[:, axis])[:, None]
        color = frame.color[::TILE, ::TILE][rows, columns][inside]
        sign = float(np.sign(eye[axis] - offset))
        yield HolePatch(index, axis, sign, offset, places[:, [1 - axis, 2]], color)


def _coarse(frame: Frame) -> Float32[np.ndarray, "a b"]:
    """Return the depth of tiles [m]; 0 where most of a tile has none."""
    assert frame.depth is not None
    h, w = (size - size % TILE for size in frame.depth.shape)
    tiles = frame.depth[:h, :w].reshape(h // TILE, TILE, w // TILE, TILE)
    there = (tiles > 0.0).sum(axis=(1, 3))
    mean = tiles.sum(axis=(1, 3)) / np.maximum(there, 1)
    return np.where(there * 2 >= TILE * TILE, mean, 0.0).astype(np.float32)


def _rays(shape: tuple[int, ...], frame: Frame) -> Float[np.ndarray, "a b 3"]:
    v, u = np.indices(shape) * TILE + (TILE - 1) / 2
    rays = np.stack([u, v, np.ones(shape)], axis=-1) @ np.linalg.inv(frame.intrinsics).T
    return np.asarray(rays @ frame.T_world_camera[:3, :3].T)


def _normals(points: Float[np.ndarray, "a b 3"]) -> Float[np.ndarray, "a b 3"]:
    """Return normals of surfaces from adjacent points, NaN where these are unknown."""
    normals = np.full_like(points, np.nan)
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    right = points[1:-1, 2:] - points[1:-1, :-2]
    across = np.cross(down, right)
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    normals[1:-1, 1:-1] = across / np.where(length > 0.0, length, np.nan)
    return normals


def _plane(
    eye: Float[np.ndarray, "3"],
    ring: Ring,
    hole: Float[np.ndarray, "n 3"],
) -> tuple[int, float] | None:
    """Return the upright plane that a hole shows: axis of its normal and coordinate [m]; or None.

    Args:
        eye: Camera position [m].
        ring: Surroundings of the hole.
        hole: Rays into the hole, of depth 1.
    """
    best, found = MIN_SUPPORT, None
    for axis in (0, 1):
        square = np.abs(ring.normals[:, axis]) > MIN_COSINE
        along = ring.points[square, axis]
        if np.abs(hole[:, axis]).min() < MIN_INCIDENCE * np.linalg.norm(hole, axis=1).max():
            continue
        contact = _contact(eye, ring.points, axis, MAX_PLANE_DISTANCE)
        offsets = np.unique(np.round(along / MAX_PLANE_DISTANCE)) * MAX_PLANE_DISTANCE
        for offset in offsets:
            middle = float(np.median(along[np.abs(along - offset) < MAX_PLANE_DISTANCE]))
            support = _support(eye, ring, hole, axis, middle, contact)
            if support > best:
                best, found = support, (axis, middle)
    return found


def _contact(
    eye: Float[np.ndarray, "3"], measured: Float[np.ndarray, "r 3"], axis: int, step: float
) -> float:
    """Return where the floor in front of a hole ends, if that is a line [m]; else NaN.

    Args:
        eye: Camera position [m].
        measured: Surroundings of the hole.
        axis: Axis along which the line has one coordinate.
        step: Points this close to the line lie on it [m].
    """
    floor = measured[measured[:, 2] < 2 * step]
    if len(floor) < 2:
        return np.nan
    toward = float(np.sign(floor[:, axis].mean() - eye[axis]))
    bins = np.floor(floor[:, 1 - axis] / (2 * step)).astype(int)
    ends = np.full(int(np.ptp(bins)) + 1, -np.inf)
    np.maximum.at(ends, bins - bins.min(), toward * floor[:, axis])
    ends = ends[np.isfinite(ends)]
    line = float(np.median(ends))
    return toward * line if (np.abs(ends - line) < step).mean() > MIN_STRAIGHT else np.nan


def _support(
    eye: Float[np.ndarray, "3"],
    ring: Ring,
    hole: Float[np.ndarray, "n 3"],
    axis: int,
    offset: float,
    contact: float,
) -> float:
    """Return the share of a hole's surroundings that supports a plane; 0 if any contradicts it.

    See `_plane`; `contact` is where the floor in front of the hole ends.
    """
    depth = (offset - eye[axis]) / hole[:, axis]
    if not (depth.min() > 0.0 and depth.max() < MAX_DEPTH):  # NaN too
        return 0.0
    points = eye + hole * depth[:, None]
    if points[:, 2].min() < -2 * MAX_PLANE_DISTANCE:  # it would extend below the floor
        return 0.0
    across = [1 - axis, 2]
    low, high = np.percentile(points[:, across], [5.0, 95.0], axis=0)
    if np.prod(high - low) < MIN_PLANE_AREA:
        return 0.0
    ahead = np.sign(eye[axis] - offset) * (ring.points[:, axis] - offset)
    near = (np.abs(ahead) < MAX_PLANE_DISTANCE) & (np.abs(ring.normals[:, axis]) > MIN_COSINE)
    with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the plane
        at = (eye + ring.rays * ((offset - eye[axis]) / ring.rays[:, axis])[:, None])[:, across]
    sides = [at[:, 1] < low[1], at[:, 1] > high[1], at[:, 0] < low[0], at[:, 0] > high[0]]
    below, floor = sides[0], ring.points[:, 2] < 2 * MAX_PLANE_DISTANCE
    away, most = MAX_IN_FRONT
    behind, most_behind = TOE_SPACE
    if (
        not sides[1].any()  # it extends beyond the image
        or ((ahead > away) & ~floor).mean() > most
        or (
            low[1] < HANGING_HEIGHT
            and below.any()
            and (ahead[below] < -behind).mean() > most_behind
        )
    ):
        return 0.0
    shares = np.array([near[side].mean() if side.any() else 0.0 for side in sides])
    two, one = SIDE_SUPPORT
    stands = -MAX_PLANE_DISTANCE < np.sign(eye[axis] - offset) * (offset - contact) < PLINTH_HEIGHT
    speaks = (shares >= two).sum() >= 2 or (stands and (shares >= one).any())
    return float(near.mean()) if speaks else 0.0


def _in_wall(patch: HolePatch, walls: Sequence[tuple[int, float]]) -> bool:
    return any(
        axis == patch.axis and abs(offset - patch.offset) < 2 * MAX_PLANE_DISTANCE
        for axis, offset in walls
    )


def _coplanar(patches: Sequence[HolePatch], near: float) -> list[list[HolePatch]]:
    groups: list[list[HolePatch]] = []
    for patch in sorted(patches, key=lambda one: (one.axis, one.sign, one.offset)):
        last = groups[-1][-1] if groups else None
        same = last is not None and (last.axis, last.sign) == (patch.axis, patch.sign)
        if last is not None and same and patch.offset - last.offset < near:
            groups[-1].append(patch)
        else:
            groups.append([patch])
    return groups


def _confirmed(
    group: Sequence[HolePatch], voxel: float, images: int
) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Return points on a plane where several images show a hole, and their colors."""
    from scipy.ndimage import binary_closing

    places = np.concatenate([patch.places for patch in group])
    low = places.min(axis=0) - voxel
    shape = tuple((np.ptp(places, axis=0) / voxel).astype(int) + 4)
    count, color = np.zeros(shape, int), np.zeros((*shape, 3), np.uint8)
    for number in sorted({patch.frame for patch in group}):
        here = np.zeros(shape, bool)
        for patch in group:
            if patch.frame == number:
                cells: Int[np.ndarray, "n 2"] = ((patch.places - low) / voxel).astype(int)
                here[tuple(cells.T)] = True
                color[tuple(cells.T)] = patch.colors
        count += here | binary_closing(here, iterations=2)
    cells = np.argwhere(count >= images)
    axis = group[0].axis
    weights = [len(patch.places) for patch in group]
    points = np.empty((len(cells), 3))
    points[:, axis] = np.average([patch.offset for patch in group], weights=weights)
    points[:, [1 - axis, 2]] = low + (cells + 0.5) * voxel
    return points, color[tuple(cells.T)]
