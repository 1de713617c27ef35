"""From instances to boxes: outliers off, faces on surfaces, backs on walls, bottoms on floors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from momapos.core import InputError
from momapos.core.geometry import (
    UprightBox,
    along_edges,
    bottom,
    box_axes,
    corners,
    from_corners,
    to_local,
    top,
)
from momapos.model.records import UNKNOWN, Cloud, Detection, Instance, LabelSource

from .room_shell import Room, area, peaks
from .size_labels import Stand, guesses_of, looks_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

PIECE = 0.9
"""A thing is a piece of another whose box holds more than this share of its points [-]."""


@dataclass(frozen=True)
class BoxConfig:
    """How a box is drawn around points."""

    outlier: float = 0.03
    """Points whose eight nearest are farther than this on average are outliers [m]."""
    percentile: float = 1.0
    """Share of points that may stick out on each side [%]."""
    search: float = 0.08
    """A face is looked for this far from where the outermost points put it [m]: handles stand
    out by 3 to 6 cm."""
    search_given: float = 0.035
    """The same where a segmenter gave the box: it knows better how far a top overhangs [m]."""
    face: float = 0.2
    """Share of a face that a surface must cover to be that face [-]."""
    sharp: float = 0.008
    """Points of one surface are within this of its plane [m]."""
    floor: float = 0.12
    """Bottoms nearer to the floor than this stand on it: the lowest part is rarely seen [m]."""
    wall: float = 0.1
    """Backs nearer to a wall than this touch it: they are never seen [m]."""
    support: float = 0.1
    """Bottoms nearer to a surface than this stand on it [m]."""
    turned: float = 7.0
    """A thing whose faces are turned by more from x and y gets a turned box [degrees]."""
    oriented: bool = False
    """Whether every thing gets the box of least area, whatever its yaw."""
    small: float = 0.35
    """Things smaller than this are completed where no side of them was seen [m]."""
    sheet: float = 0.12
    """Larger ones are completed where all that was seen of them is thinner than this [m]."""
    least_points: int = 10
    """Instances without a box and with fewer points are left out [-]."""
    smallest: float = 0.01
    """Least edge [m]."""
    wall_thickness: float = 0.1
    """Of the boxes of walls [m]."""


def boxes(
    cloud: Cloud, instances: Sequence[Instance], room: Room, config: BoxConfig | None = None
) -> list[Detection]:
    """Draw boxes around instances and name them.

    Args:
        cloud: Upright: z up, floor at z = 0.
        instances: With members, or a box, or both.
        room: Walls that backs are snapped to.
        config: Constants.

    Returns:
        One detection for each instance that has a box or enough points, named `<label>_<k>`: for
        every label, k counts from 1 by the distance from the world's origin.

    Raises:
        InputError: Members are not indices of the cloud.
    """
    config = config or BoxConfig()
    drawn = []
    for instance in instances:
        members = _members(cloud, instance, config)
        if len(members) >= config.least_points or instance.box is not None:
            box = _draw(cloud, members, instance.box, config)
            drawn.append((instance, members, _snapped(box, room, config)))
    drawn.sort(key=lambda row: bottom(row[2]))
    tops: list[UprightBox] = []
    standing = []
    for instance, members, box in drawn:
        box, stand = _stood(box, tops, config)
        if stand == "support" and instance.box is None:
            box = _completed(cloud, members, box, room, config)
        tops.append(box)
        standing.append((instance, members, box, stand))
    found = []
    for instance, members, box, stand in standing:
        label, score, guesses = instance.label, instance.score, instance.guesses
        if not label:
            guesses = guesses_of(looks_of(cloud, members, box, stand, tops, room)) or (UNKNOWN,)
            label, fit = guesses[0]
            score = min(score, fit)
        source: LabelSource = "size" if guesses else "segmenter"
        found.append(Detection("", label, score, box, members, source, guesses))
    return named(found)


def named(detections: Sequence[Detection]) -> list[Detection]:
    """Give detections names, `<label>_<k>`, in the order of labels and of distance."""

    def rank(detection: Detection) -> tuple[str, float, tuple[float, ...]]:
        center = np.round(detection.box.center, 3)
        return detection.label, round(float(np.hypot(*center[:2])), 2), tuple(center.tolist())

    counts: dict[str, int] = {}
    out = []
    for detection in sorted(detections, key=rank):
        k = counts[detection.label] = counts.get(detection.label, 0) + 1
        out.append(replace(detection, name=f"{detection.label.replace(' ', '_')}_{k}"))
    return out


def without_pieces(detections: Sequence[Detection], cloud: Cloud) -> list[Detection]:
    """Leave out what no rule names and whose points lie in the box of something larger.

    It is a piece of that: the rim of a door, a shadow's edge. As a thing of its own it would stand
    in the door's way.
    """

    def piece(item: Detection) -> bool:
        points, volume = cloud.points[item.members], np.prod(item.box.size)
        larger = (other.box for other in detections if np.prod(other.box.size) > volume)
        return any(inside(points, box).mean() > PIECE for box in larger)

    return [d for d in detections if d.label != "object" or not len(d.members) or not piece(d)]


def inside(points: Float[np.ndarray, "n 3"], box: UprightBox) -> Bool[np.ndarray, " n"]:
    """Which points lie in a box, or within 1 cm of it."""
    return (np.abs(to_local(points, box)) <= box.size / 2 + 0.01).all(axis=1)


def wall_detections(room: Room, config: BoxConfig | None = None) -> list[Detection]:
    """The walls as boxes behind what is seen of them; a robot must not drive there."""
    config = config or BoxConfig()
    out = []
    for wall in room.walls:
        center, size = np.empty(3), np.empty(3)
        center[wall.axis] = wall.offset - wall.sign * config.wall_thickness / 2
        center[1 - wall.axis], center[2] = (wall.low + wall.high) / 2, wall.top / 2
        size[wall.axis], size[1 - wall.axis] = config.wall_thickness, wall.high - wall.low
        size[2] = wall.top
        out.append(Detection("", "wall", 0.8, UprightBox(center, size), np.zeros(0, int)))
    return named(out)


# ---------------------------------------------------------------- points


def _members(cloud: Cloud, instance: Instance, config: BoxConfig) -> Int[np.ndarray, " k"]:
    """Points of an instance, outliers removed."""
    if instance.members is not None:
        members = np.asarray(instance.members)
        if len(members) and not (members.min() >= 0 and members.max() < len(cloud.points)):
            raise InputError(
                f"members of an instance must be indices below {len(cloud.points)}, the number "
                f"of points; they reach from {members.min()} to {members.max()}"
            )
    elif instance.box is not None:
        members = np.flatnonzero(inside(cloud.points, instance.box))
    else:
        return np.zeros(0, int)
    if len(members) < 12:
        return members
    distances, _ = cKDTree(cloud.points[members]).query(cloud.points[members], k=9)
    return members[distances[:, 1:].mean(axis=1) < config.outlier]


# ---------------------------------------------------------------- faces


def _draw(
    cloud: Cloud, members: Int[np.ndarray, " k"], given: UprightBox | None, config: BoxConfig
) -> UprightBox:
    """The box around points, or a given one, with its faces on the surfaces seen."""
    points, normals = cloud.points[members], cloud.normals[members]
    yaw = given.yaw if given is not None else _yaw(points, normals, config)
    turned, facing = along_edges(points, yaw), along_edges(normals, yaw)
    if given is not None:
        low, high = corners(given)
    else:
        low, high = np.percentile(turned, [config.percentile, 100 - config.percentile], axis=0)
    faces = [low.copy(), high.copy()]
    for axis in range(3):
        for side, sign in ((0, -1.0), (1, 1.0)):
            on = sign * facing[:, axis] > 0.8
            start = (low, high)[side][axis]
            reach = config.search if given is None else config.search_given
            reach = min(reach, 0.4 * (high - low)[axis])
            near = on & (np.abs(turned[:, axis] - start) < reach)
            found = _surface(turned[near], axis, low, high, config)
            if found is not None:
                faces[side][axis] = found
    thin = faces[1] - faces[0] < config.smallest
    middle = (faces[0] + faces[1]) / 2
    faces[0][thin] = middle[thin] - config.smallest / 2
    faces[1][thin] = middle[thin] + config.smallest / 2
    return from_corners(faces[0], faces[1], yaw)


def _surface(
    points: Float[np.ndarray, "n 3"],
    axis: int,
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    config: BoxConfig,
) -> float | None:
    """Where the largest plane across an axis is, among points that face along it."""
    found = peaks(points[:, axis], config.sharp, 8, config.sharp)
    if not found:
        return None
    on = points[np.abs(points[:, axis] - found[0]) < 2 * config.sharp]
    a, b = (k for k in range(3) if k != axis)
    whole = (high[a] - low[a]) * (high[b] - low[b])
    seen = area(on[:, a], on[:, b], 0.025)
    return found[0] if seen > config.face * whole else None


def _yaw(
    points: Float[np.ndarray, "n 3"], normals: Float[np.ndarray, "n 3"], config: BoxConfig
) -> float:
    """Turn of a thing's box: none, unless its faces say so."""
    least = _least_area(points[:, :2])
    if config.oriented:
        return least
    upright = np.abs(normals[:, 2]) < 0.3
    if upright.sum() < 30:
        return 0.0
    angle = np.arctan2(normals[upright, 1], normals[upright, 0])
    mean = np.exp(4j * angle).mean()
    offset = float(np.angle(mean)) / 4
    # Round things have faces on all sides: their normals cancel.
    clear = abs(mean) > 0.5 and abs(offset) > np.radians(config.turned)
    return offset if clear else 0.0


def _least_area(points: Float[np.ndarray, "n 2"]) -> float:
    """Yaw of the smallest rectangle around points, in (-pi/4, pi/4] [rad]."""
    if len(points) < 3:
        return 0.0
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:
        return 0.0  # all on one line
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.mod(np.arctan2(edges[:, 1], edges[:, 0]) + np.pi / 4, np.pi / 2) - np.pi / 4
    areas = [np.prod(np.ptp(hull @ box_axes(angle).T, axis=0)) for angle in angles]
    return float(angles[int(np.argmin(areas))])


# ---------------------------------------------------------------- snapping


def _snapped(box: UprightBox, room: Room, config: BoxConfig) -> UprightBox:
    """A box on the floor and at the walls that it nearly touches."""
    low, high = corners(box)
    if low[2] < config.floor:
        low[2] = 0.0
    if abs(box.yaw) < 1e-9:
        for wall in room.walls:
            if wall.beside(box.center[None], 0.3)[0]:
                face = low if wall.sign > 0 else high
                if abs(face[wall.axis] - wall.offset) < config.wall:
                    face[wall.axis] = wall.offset
    if (high - low < config.smallest).any():
        return box
    return from_corners(low, high, box.yaw)


def _stood(
    box: UprightBox, tops: Sequence[UprightBox], config: BoxConfig
) -> tuple[UprightBox, Stand]:
    """A box on what is below it, and what it stands on."""
    at = bottom(box)
    if at <= 0.0:
        return box, "floor"
    below = [
        top(other)
        for other in tops
        if (np.abs(to_local(box.center[None], other)[0, :2]) < other.size[:2] / 2).all()
        and top(other) < top(box) - config.smallest
        and -config.support < at - top(other) < config.support
    ]
    if not below:
        return box, "hung"
    low, high = corners(box)
    low[2] = min(below, key=lambda height: abs(height - at))
    return from_corners(low, high, box.yaw), "support"


def _completed(
    cloud: Cloud, members: Int[np.ndarray, " k"], box: UprightBox, room: Room, config: BoxConfig
) -> UprightBox:
    """Make a thing as deep as it is wide, where its far side was never seen.

    Of a cup on a counter the half that faces the wall stays hidden, of a microwave below a shelf
    all but its front. A flat top that was seen from above shows the whole outline: then nothing
    is added.
    """
    sheet = min(box.size[:2]) < config.sheet
    if (max(box.size) > config.small and not sheet) or len(members) < 10:
        return box
    local = to_local(cloud.points[members], box)
    facing = along_edges(cloud.normals[members], box.yaw)
    flat = (facing[:, 2] > 0.9) & (local[:, 2] > box.size[2] / 2 - 0.02)
    top_seen = area(local[flat, 0], local[flat, 1], 0.02) > 0.5 * box.size[0] * box.size[1]
    if top_seen and max(box.size) < config.small:
        return box
    low, high = corners(box)
    axis = 0 if box.size[0] < box.size[1] else 1
    missing = box.size[1 - axis] - box.size[axis]
    sides = [(sign * facing[:, axis] > 0.5).mean() for sign in (-1.0, 1.0)]
    if min(sides) < 0.1 * max(sides):
        if sides[0] < sides[1]:
            low[axis] -= missing
        else:
            high[axis] += missing
    return _before_walls(from_corners(low, high, box.yaw), room)


def _before_walls(box: UprightBox, room: Room) -> UprightBox:
    """A box, cut off at the walls that it would reach through."""
    if abs(box.yaw) > 1e-9:
        return box
    low, high = corners(box)
    for wall in room.walls:
        if wall.beside(box.center[None], 0.3)[0]:
            if wall.sign > 0 and high[wall.axis] > wall.offset:
                low[wall.axis] = max(low[wall.axis], wall.offset)
            if wall.sign < 0 and low[wall.axis] < wall.offset:
                high[wall.axis] = min(high[wall.axis], wall.offset)
    return from_corners(low, high)
