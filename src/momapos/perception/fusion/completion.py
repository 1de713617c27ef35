"""Surfaces without depth: black, mirrored and glass fronts, completed from the planes around them.

A hole in a depth image has measured pixels around it. Where many of these lie in one upright plane,
and the others behind it, the hole shows that plane: the front of a dark dishwasher between two
cabinets, or of a fridge above the line where it meets the floor. What only one image claims, or any
image sees through, is left open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.model.records import Cloud, Frame

from .free_space import SeenThrough

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8

TILE = 4
"""Pixels along a square that counts as one [-]."""
RING = 3
"""So wide is what is looked at around a hole [squares]."""
SQUARE = 0.8
"""Surfaces of a plane have at least this along its normal [-]."""
FINEST = 0.005
"""What is added has points no nearer to each other [m]."""
STRAIGHT = 0.5
"""Share of a line of the floor that is where it is believed, at least [-]."""


@dataclass(frozen=True)
class CompletionConfig:
    """Which holes are surfaces."""

    least_area: float = 0.04
    """Of a hole, on its plane [m2]."""
    least_ring: int = 20
    """Squares around a hole with depth, at least [-]."""
    on_plane: float = 0.03
    """What is this near to a plane lies in it [m]."""
    support: float = 0.02
    """Share of a hole's surroundings in its plane, at least [-]."""
    side: tuple[float, float] = (0.5, 0.12)
    """Share of what is at one side of a hole in its plane, at least, for that side to speak for
    it: two must, or one by the second share where the hole ends on the floor [-]."""
    plinth: float = 0.15
    """A front stands so far before the line where the floor ends below it, at most [m]."""
    toe: tuple[float, float] = (0.15, 0.3)
    """Share of what is seen below a front that may lie farther behind it than the first [m], at
    most the second [-]: what stands on the floor hides what is behind it, legs do not."""
    hanging: float = 1.0
    """Fronts whose lower edge is higher hang, and the wall is seen below them [m]."""
    before: tuple[float, float] = (0.08, 0.15)
    """Share of them that may lie farther before the plane than the first [m], at most the second
    [-]: what is seen around a front lies in its plane or behind it."""
    farthest: float = 4.0
    """Holes farther away are left open: depth ends there by itself [m]."""
    grazing: float = 0.25
    """Least cosine between ray and plane [-]."""
    images: int = 2
    """Images that must show the hole there, at least [-]."""
    through: float = 0.1
    """What an image measures this far behind a place has been seen through it [m]."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A hole in one image, on its plane."""

    frame: int
    axis: int
    """Of the plane's normal: 0 for x, 1 for y."""
    sign: float
    """+1 where it is seen from larger coordinates, else -1."""
    offset: float
    """Coordinate of the plane along the axis [m]."""
    places: Float[np.ndarray, "n 2"]
    """The other horizontal coordinate, and the height [m]."""
    colors: UInt8[np.ndarray, "n 3"]


class Ring(NamedTuple):
    """What is seen around a hole."""

    rays: Float[np.ndarray, "r 3"]
    """Of depth 1."""
    points: Float[np.ndarray, "r 3"]
    """Where they end [m]."""
    normals: Float[np.ndarray, "r 3"]
    """Of the surfaces there, toward either side; NaN where not known."""


def complete(
    cloud: Cloud,
    frames: Sequence[Frame],
    walls: Sequence[tuple[int, float]] = (),
    voxel: float = 0.015,
    config: CompletionConfig | None = None,
) -> Cloud:
    """Add surfaces that no depth image shows, though several should.

    Args:
        cloud: Upright, walls and furniture along x and y, floor at z = 0.
        frames: The images, with poses in that world.
        walls: Axis of the normal, 0 or 1, and coordinate [m] of each wall: what is in its plane is
            no front, but a window, or where the room goes on.
        voxel: Distance of the points that are added [m].
        config: Which holes are surfaces.

    Returns:
        The cloud, its own points first.
    """
    config = config or CompletionConfig()
    seen = [(i, frame) for i, frame in enumerate(frames) if frame.depth is not None]
    patches = [patch for i, frame in seen for patch in holes(frame, i, config)]
    parts, seen_through = [cloud], SeenThrough(frames, config.through)
    patches = [patch for patch in patches if not _in_wall(patch, walls, config)]
    for group in _coplanar(patches, config.on_plane):
        points, colors = _agreed(group, max(voxel, FINEST), config.images)
        free = (points[:, 2] < 0.0) | seen_through(points)
        normal = np.zeros(3)
        normal[group[0].axis] = group[0].sign
        points, colors = points[~free], colors[~free]
        parts.append(Cloud(points, np.tile(normal, (len(points), 1)), colors))
    return Cloud(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.colors for part in parts]),
    )


def holes(frame: Frame, index: int, config: CompletionConfig) -> Iterator[Patch]:
    """The holes in the depth of an image that are surfaces.

    Args:
        frame: Its pose in an upright world with the floor at z = 0.
        index: Its place among all images.
        config: Which holes are surfaces.
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
        if inside.sum() < config.least_ring:
            continue
        around = binary_dilation(inside, iterations=RING) & ~inside
        around &= depth[rows, columns] > 0.0
        if around.sum() < config.least_ring:
            continue
        ray = rays[rows, columns][inside]
        ring = Ring(*(values[rows, columns][around] for values in (rays, points, normals)))
        plane = _plane(eye, ring, ray, config)
        if plane is None:
            continue
        axis, offset = plane
        places = eye + ray * ((offset - eye[axis]) / ray[:, axis])[:, None]
        color = frame.color[::TILE, ::TILE][rows, columns][inside]
        sign = float(np.sign(eye[axis] - offset))
        yield Patch(index, axis, sign, offset, places[:, [1 - axis, 2]], color)


def _coarse(frame: Frame) -> Float32[np.ndarray, "a b"]:
    """Depth of squares of pixels [m]; 0 where most of one has none."""
    assert frame.depth is not None
    h, w = (size - size % TILE for size in frame.depth.shape)
    tiles = frame.depth[:h, :w].reshape(h // TILE, TILE, w // TILE, TILE)
    there = (tiles > 0.0).sum(axis=(1, 3))
    mean = tiles.sum(axis=(1, 3)) / np.maximum(there, 1)
    return np.where(there * 2 >= TILE * TILE, mean, 0.0).astype(np.float32)


def _rays(shape: tuple[int, ...], frame: Frame) -> Float[np.ndarray, "a b 3"]:
    """Rays through the middles of the squares, of depth 1, in the world."""
    v, u = np.indices(shape) * TILE + (TILE - 1) / 2
    rays = np.stack([u, v, np.ones(shape)], axis=-1) @ np.linalg.inv(frame.intrinsics).T
    return np.asarray(rays @ frame.T_world_camera[:3, :3].T)


def _normals(points: Float[np.ndarray, "a b 3"]) -> Float[np.ndarray, "a b 3"]:
    """Normals of surfaces from the points beside, NaN where these are not known."""
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
    config: CompletionConfig,
) -> tuple[int, float] | None:
    """The upright plane that a hole shows: axis of its normal and coordinate [m]; None if none.

    Args:
        eye: Where the camera is [m].
        ring: What is around the hole.
        hole: Rays into it, of depth 1.
        config: When it is one.
    """
    best, found = config.support, None
    for axis in (0, 1):
        square = np.abs(ring.normals[:, axis]) > SQUARE
        along = ring.points[square, axis]
        if np.abs(hole[:, axis]).min() < config.grazing * np.linalg.norm(hole, axis=1).max():
            continue
        contact = _contact(eye, ring.points, axis, config.on_plane)
        offsets = np.unique(np.round(along / config.on_plane)) * config.on_plane
        for offset in offsets:
            middle = float(np.median(along[np.abs(along - offset) < config.on_plane]))
            support = _support(eye, ring, hole, axis, middle, contact, config)
            if support > best:
                best, found = support, (axis, middle)
    return found


def _contact(
    eye: Float[np.ndarray, "3"], measured: Float[np.ndarray, "r 3"], axis: int, step: float
) -> float:
    """Where the floor before a hole ends, if that is a line [m]; NaN if not.

    Args:
        eye: Where the camera is [m].
        measured: What is around the hole.
        axis: Along which the line has one coordinate.
        step: What is this near to the line lies in it [m].
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
    return toward * line if (np.abs(ends - line) < step).mean() > STRAIGHT else np.nan


def _support(
    eye: Float[np.ndarray, "3"],
    ring: Ring,
    hole: Float[np.ndarray, "n 3"],
    axis: int,
    offset: float,
    contact: float,
    config: CompletionConfig,
) -> float:
    """Share of what is around a hole that says that it shows a plane; 0 where something denies it.

    See `_plane`; `contact` is where the hole begins on the floor.
    """
    depth = (offset - eye[axis]) / hole[:, axis]
    if not (depth.min() > 0.0 and depth.max() < config.farthest):  # NaN too
        return 0.0
    points = eye + hole * depth[:, None]
    if points[:, 2].min() < -2 * config.on_plane:  # it would go on below the floor: it is nearer
        return 0.0
    across = [1 - axis, 2]
    low, high = np.percentile(points[:, across], [5.0, 95.0], axis=0)
    if np.prod(high - low) < config.least_area:
        return 0.0
    ahead = np.sign(eye[axis] - offset) * (ring.points[:, axis] - offset)
    near = (np.abs(ahead) < config.on_plane) & (np.abs(ring.normals[:, axis]) > SQUARE)
    with np.errstate(divide="ignore", invalid="ignore"):  # rays along the plane meet it nowhere
        at = (eye + ring.rays * ((offset - eye[axis]) / ring.rays[:, axis])[:, None])[:, across]
    sides = [at[:, 1] < low[1], at[:, 1] > high[1], at[:, 0] < low[0], at[:, 0] > high[0]]
    below, floor = sides[0], ring.points[:, 2] < 2 * config.on_plane
    away, most = config.before
    behind, most_behind = config.toe
    if (
        not sides[1].any()  # it goes on beyond the image, as the sky does
        or ((ahead > away) & ~floor).mean() > most
        or (
            low[1] < config.hanging
            and below.any()
            and (ahead[below] < -behind).mean() > most_behind
        )
    ):
        return 0.0
    shares = np.array([near[side].mean() if side.any() else 0.0 for side in sides])
    two, one = config.side
    stands = -config.on_plane < np.sign(eye[axis] - offset) * (offset - contact) < config.plinth
    speaks = (shares >= two).sum() >= 2 or (stands and (shares >= one).any())
    return float(near.mean()) if speaks else 0.0


def _in_wall(patch: Patch, walls: Sequence[tuple[int, float]], config: CompletionConfig) -> bool:
    return any(
        axis == patch.axis and abs(offset - patch.offset) < 2 * config.on_plane
        for axis, offset in walls
    )


def _coplanar(patches: Sequence[Patch], near: float) -> list[list[Patch]]:
    """Patches of one plane, whatever image they are from."""
    groups: list[list[Patch]] = []
    for patch in sorted(patches, key=lambda one: (one.axis, one.sign, one.offset)):
        last = groups[-1][-1] if groups else None
        same = last is not None and (last.axis, last.sign) == (patch.axis, patch.sign)
        if last is not None and same and patch.offset - last.offset < near:
            groups[-1].append(patch)
        else:
            groups.append([patch])
    return groups


def _agreed(
    group: Sequence[Patch], voxel: float, images: int
) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Points on a plane where several images show a hole, and their colors."""
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
