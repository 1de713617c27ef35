"""Segment a room into objects without a trained network.

Furniture has flat tops and flat fronts. Objects on a top are objects of their own, and everything
below a top is one piece of furniture. Tall and hanging furniture has no visible top: it reaches
from its front back to the wall. The rest is divided into groups of touching points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from momapos.core import InputError
from momapos.core.geometry import UprightBox, corners, from_corners, point_spacing
from momapos.model.records import Cloud, Instance

from .config import (
    BACK_THICKNESS,
    MAX_BACK_HEIGHT,
    MAX_LIP,
    MAX_OBJECT_HEIGHT,
    MAX_OPEN_FLOOR,
    MAX_OVERHANG,
    MAX_SHELF_DEPTH,
    MIN_CLOSED,
    MIN_CORNER,
    MIN_LIFT,
    MIN_POINTS,
    MIN_SLAB_LENGTH,
    MIN_SMALL_POINTS,
    MIN_TALL_TOP,
    MIN_WALL_PROTRUSION,
    SEAT,
    SLAB_THICKNESS,
    SPACING_PERCENT,
    TOUCHING,
    TOUCHING_SMALL,
)
from .front_planes import FrontPlane, attach_handles, attach_hoods, find_front_planes
from .instance_boxes import faces_yaw
from .room_shell import area, ends, find_room, flat_on_wall, floor_seen, in_room, peaks
from .supports import (
    MIN_SUPPORT_HEIGHT,
    OUTLINE_CELL,
    SURFACE_LAYER,
    Rectangle,
    Support,
    components,
    find_supports,
    floor_raster,
    rectangles,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MIN_Z, MIN_DROP = 0.12, 0.1
"""Sides are measured this far above the floor, and this far below the top [m]."""
EAVES = (0.05, 0.4)
"""Smaller overhangs are flush, larger ones are not overhangs [m]."""
MAX_EDGE_DISTANCE = 0.11
"""Surfaces this close to an edge of the top may be the side below it [m]."""
MIN_COVERED = 0.25
"""Minimum share of a side that a surface covers [-]."""
PLANE_TOLERANCE = 0.015
"""Points of one surface are within this of its plane [m]."""


@dataclass(frozen=True)
class _Side:
    """An upright surface below an edge of a top."""

    depth: float
    """Distance from the edge, inward [m]."""
    low: float
    high: float
    """Start and end along the edge [m]."""


def cabinet_extent(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    rectangle: Rectangle,
    height: float,
) -> Rectangle:
    """Return the outline of the furniture below a top that may overhang.

    Each side is the outermost broad surface that faces out, but no farther in than its neighbors
    end, because furniture may be open at a side. Unseen sides and small overhangs are flush with
    the top.

    Args:
        points: Points below the top.
        normals: Normals of the points.
        rectangle: The top seen from above.
        height: Height of the top [m].
    """
    if height - MIN_Z - MIN_DROP < 0.1:
        return rectangle
    sides = [_side(points, normals, rectangle, height, side) for side in range(4)]
    body = list(rectangle)
    for side, found in enumerate(sides):
        if found is None:
            continue
        axis, sign = side % 2, 1.0 if side < 2 else -1.0
        beside = [s for s in (sides[1 - axis], sides[3 - axis]) if s is not None]
        reached = [sign * ((s.low if side < 2 else s.high) - rectangle[side]) for s in beside]
        depth = min([found.depth, *reached])
        if EAVES[0] < depth < EAVES[1]:
            body[side] += sign * depth
    return (body[0], body[1], body[2], body[3])


def _side(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    rectangle: Rectangle,
    height: float,
    side: int,
) -> _Side | None:
    axis, sign = side % 2, -1.0 if side < 2 else 1.0
    start, stop = rectangle[1 - axis], rectangle[3 - axis]
    inward, along = sign * (rectangle[side] - points[:, axis]), points[:, 1 - axis]
    on = (sign * normals[:, axis] > 0.8) & (along > start) & (along < stop)
    on &= (points[:, 2] > MIN_Z) & (points[:, 2] < height - MIN_DROP)
    on &= (inward > -MAX_EDGE_DISTANCE) & (inward < EAVES[1])
    for depth in sorted(peaks(inward[on], PLANE_TOLERANCE, 10, 2 * PLANE_TOLERANCE)):
        flat = on & (np.abs(inward - depth) < PLANE_TOLERANCE)
        covered = area(along[flat], points[flat, 2])
        share = covered / ((stop - start) * (height - MIN_DROP - MIN_Z))
        if share > MIN_COVERED:
            return _Side(depth, *ends(along[flat], 2 * PLANE_TOLERANCE))
    return None


def closed_share(
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    rectangle: Rectangle,
    height: float,
    near: float,
) -> float:
    """Return the share of the fullest side below a surface that upright surfaces cover [-].

    Args:
        points: Points below and around it.
        normals: Normals of the points.
        rectangle: The surface seen from above.
        height: Height of the surface [m].
        near: Points this close to a side belong to it [m].
    """
    low_z, high_z = MIN_Z, height - MIN_DROP
    if high_z - low_z < 0.1:
        return 0.0
    shares = []
    for side in range(4):
        axis = side % 2
        at = (np.abs(normals[:, axis]) > 0.8) & (np.abs(points[:, axis] - rectangle[side]) < near)
        on = points[at & (points[:, 2] > low_z) & (points[:, 2] < high_z)]
        whole = (rectangle[3 - axis] - rectangle[1 - axis]) * (high_z - low_z)
        shares.append(area(on[:, 1 - axis], on[:, 2]) / whole)
    return max(shares)


class ClassicalSegmenter:
    """Segments an upright cloud by planes and touching points; a `Segmenter`.

    A countertop and the furniture below it are two instances. The furniture is one instance from
    end to end, or to the corner of the room; `rows.split_row` divides it between the fronts in the
    images. Tops at another height, such as an oven's between counters, divide it here.
    """

    def __call__(self, cloud: Cloud) -> list[Instance]:
        """Segment a cloud.

        Args:
            cloud: z up, floor at z = 0, furniture along x and y; with normals.

        Returns:
            Furniture first, with boxes; then the rest; then objects on furniture.

        Raises:
            InputError: The cloud is empty or has values that are not finite.
        """
        if not len(cloud.points):
            raise InputError("the cloud is empty")
        if not (np.isfinite(cloud.points).all() and np.isfinite(cloud.normals).all()):
            raise InputError("the cloud has points or normals that are not finite")
        return _Segmentation(cloud).run()


class _Segmentation:
    """One cloud during segmentation, with the points that are still free."""

    def __init__(self, cloud: Cloud) -> None:
        self.cloud = cloud
        self.room = find_room(cloud)
        self.free = ~in_room(self.room, cloud)
        self.raster = floor_raster(cloud.points, OUTLINE_CELL)
        self.touching = min(TOUCHING_SMALL, point_spacing(cloud.points, SPACING_PERCENT))

    def run(self) -> list[Instance]:
        among = np.flatnonzero(self.free)
        if not len(among):
            return []
        supports = find_supports(self.cloud, self.room, among, self.raster)
        supports = self._lengthened(supports, self._fronts())
        small = [one for support in supports for one in self._objects_on(support, supports)]
        tops = [support for support in supports if self.free[support.members].mean() > 0.5]
        fronts = self._fronts()  # without those of objects on a top
        tops = self._lengthened(tops, fronts)
        furniture = [body for top in tops for body in self._below(top)]
        furniture += self._behind_fronts(fronts)
        rest = self._rest([body.box for body in furniture if body.box is not None])
        furniture, rest = attach_handles(furniture, rest, self.cloud)
        return attach_hoods(furniture, rest, self.cloud, TOUCHING) + small

    def _fronts(self) -> list[FrontPlane]:
        among = np.flatnonzero(self.free)
        return find_front_planes(self.cloud, self.room, among)

    # ------------------------------------------------------------ objects on a surface

    def _objects_on(self, support: Support, supports: Sequence[Support]) -> list[Instance]:
        """Return the groups of points that stand on a surface and do not reach beyond it."""
        points = self.cloud.points
        if self._is_seat(support):
            return []
        above = points[:, 2] - support.height
        possible = self.free & (above > MIN_LIFT) & (above < MAX_OBJECT_HEIGHT)
        for other in supports:
            if 0 < other.height - support.height < 0.08:
                possible[other.members] = False  # a neighbor's top, one step higher
        # Sides of taller furniture start at the edge of the surface.
        inner = ndimage.binary_erosion(support.outline)
        inside = np.flatnonzero(possible & self.raster.within(inner, points))
        label = components(points[inside], self.touching)
        found = []
        for k in range(label.max(initial=-1) + 1):
            members = inside[label == k]
            if len(members) < MIN_SMALL_POINTS:
                break
            if above[members].min() < 2 * TOUCHING_SMALL:
                members = self._with_edges(members, possible)
                self.free[members] = False
                found.append(Instance("", 0.5, members))
        return found

    def _is_seat(self, support: Support) -> bool:
        height, size = SEAT
        covers = support.outline.sum() * OUTLINE_CELL**2
        return bool(support.height < height and covers < size)

    def _with_edges(
        self, members: Int[np.ndarray, " k"], possible: Bool[np.ndarray, " n"]
    ) -> Int[np.ndarray, " m"]:
        """Add the points of an object that the erosion of the surface cut off."""
        points, margin = self.cloud.points, 1.5 * OUTLINE_CELL
        low, high = points[members].min(axis=0) - margin, points[members].max(axis=0) + margin
        low[2], high[2] = low[2] + margin, high[2]
        near = np.flatnonzero(possible & ((points > low) & (points < high)).all(axis=1))
        label = components(points[near], self.touching)
        own = np.isin(near, members)
        return near[np.isin(label, np.unique(label[own]))]

    # ------------------------------------------------------------ furniture with a visible top

    def _lengthened(self, tops: Sequence[Support], fronts: Sequence[FrontPlane]) -> list[Support]:
        """Extend tops to the ends of fronts just below them, and merge the tops of one front.

        A low camera sees a counter's front but little of its top, and objects on it hide the
        middle.
        """
        found = list(tops)
        for front in fronts:
            low, high = corners(front.box)
            mask = self.raster.filled((low[0], low[1], high[0], high[1]))
            level = [top for top in found if abs(top.height - high[2]) < MAX_LIP]
            below = [top for top in level if (top.outline & mask).any()]
            if not below or low[2] >= MIN_SUPPORT_HEIGHT:
                continue
            height = min(below, key=lambda top: abs(top.height - high[2])).height
            own = [top for top in below if abs(top.height - height) < SURFACE_LAYER]
            others = np.any([~mask, *(top.outline for top in level if top not in own)], axis=0)
            outline = np.any([~others, *(top.outline for top in own)], axis=0)
            members = np.concatenate([top.members for top in own])
            found = [top for top in found if top not in own]
            found.append(Support(height, outline, members))
        return sorted(found, key=lambda top: -top.height)

    def _below(self, top: Support) -> list[Instance]:
        if top.height > MIN_TALL_TOP:
            return []
        out = []
        pieces = [
            piece
            for rectangle in rectangles(top.outline, self.raster)
            for piece in self._without_corners(rectangle, top.height)
        ]
        shares = [self._closed_share(piece, top.height) for piece in pieces]
        for piece, share in zip(pieces, shares, strict=True):
            # A corner shows no side: it is closed if the rest is and no floor is seen below it.
            hidden = max(shares) >= MIN_CLOSED and not self._shows_floor(piece)
            seen = share >= MIN_CLOSED
            label = "cabinet" if hidden and not seen else ""
            out += self._body(piece, top.height, label, closed=bool(seen or hidden))
        return [self._with_back(body) for body in out] if self._is_seat(top) else out

    def _with_back(self, seat: Instance) -> Instance:
        """Add the thin back of a chair that rises from an edge of its seat."""
        assert seat.box is not None
        points = self.cloud.points
        low, high = corners(seat.box)
        column = self._column((low[0], low[1], high[0], high[1]), high[2] + MAX_BACK_HEIGHT)
        rising = column[points[column, 2] > high[2]]
        if len(rising) < MIN_POINTS or self._goes_on(rising, column):
            return seat
        start, stop = points[rising].min(axis=0), points[rising].max(axis=0)
        thin, wide = np.sort((stop - start)[:2])
        if (
            thin > BACK_THICKNESS
            or wide < float(max((high - low)[:2])) / 2
            or start[2] - high[2] > 0.1
        ):
            return seat
        self.free[rising] = False
        box = from_corners(np.minimum(low, start), np.maximum(high, stop))
        return replace(seat, members=np.concatenate([seat.members, rising]), box=box)

    def _shows_floor(self, rectangle: Rectangle) -> bool:
        low, high = np.array(rectangle[:2]), np.array(rectangle[2:])
        return floor_seen(self.cloud, low, high) > MAX_OPEN_FLOOR

    def _without_corners(self, rectangle: Rectangle, height: float) -> list[Rectangle]:
        """Cut off ends of a row without a front, as in the corner of a room."""
        points, normals = self.cloud.points, self.cloud.normals
        size = rectangle[2] - rectangle[0], rectangle[3] - rectangle[1]
        if max(size) - min(size) < MIN_CORNER:
            return [rectangle]  # too short to divide
        across = 0 if size[0] < size[1] else 1
        along = 1 - across
        low, high = rectangle[along], rectangle[along + 2]
        below = self.free & (points[:, 2] > 0.15) & (points[:, 2] < height - 0.1)
        best = (0.0, low, high)
        for side, sign in ((across, -1.0), (across + 2, 1.0)):
            on = below & (sign * normals[:, across] > 0.8)
            on &= np.abs(points[:, across] - rectangle[side]) < MAX_OVERHANG
            at = points[on, along]
            at = at[(at > low) & (at < high)]
            if len(at) > 4 * MIN_POINTS:
                first, last = np.percentile(at, [1, 99])
                best = max(best, (float(len(at)), float(first), float(last)))
        count, first, last = best
        if not count or last - first < MIN_CORNER:
            return [rectangle]
        edges = [low]
        edges += [first] if first - low > MIN_CORNER else []
        edges += [last] if high - last > MIN_CORNER else []
        pieces = []
        for a, b in zip(edges, [*edges[1:], high], strict=True):
            piece = list(rectangle)
            piece[along], piece[along + 2] = a, b
            pieces.append((piece[0], piece[1], piece[2], piece[3]))
        return pieces

    def _body(
        self, rectangle: Rectangle, height: float, label: str, *, closed: bool
    ) -> list[Instance]:
        points = self.cloud.points
        low, high = np.array(rectangle[:2]), np.array(rectangle[2:])
        members = self._column(rectangle, height)
        if len(members) < MIN_POINTS:
            return []
        if not closed:
            return self._open(members, rectangle, height)
        self.free[members] = False
        normals = self.cloud.normals
        body = cabinet_extent(points[members], normals[members], rectangle, height)
        if max(high - low) < MIN_SLAB_LENGTH and body == rectangle:
            return [Instance(label, 0.7, members, _box(rectangle, 0.0, height))]
        split = height - SLAB_THICKNESS
        is_slab = points[members, 2] > split
        return [
            Instance(label, 0.7, members[~is_slab], _box(body, 0.0, split)),
            Instance("counter", 0.7, members[is_slab], _box(rectangle, split, height)),
        ]

    def _column(self, rectangle: Rectangle, height: float) -> Int[np.ndarray, " k"]:
        """Return the free points below a top, and a little in front of it."""
        points, margin = self.cloud.points, MAX_OVERHANG
        low, high = np.array(rectangle[:2]) - margin, np.array(rectangle[2:]) + margin
        near = self.free & (points[:, 2] < height + MIN_LIFT)
        near &= ((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1)
        return np.flatnonzero(near)

    def _closed_share(self, rectangle: Rectangle, height: float) -> float:
        members = self._column(rectangle, height)
        points, normals = self.cloud.points[members], self.cloud.normals[members]
        return closed_share(points, normals, rectangle, height, MAX_EDGE_DISTANCE)

    def _open(
        self, members: Int[np.ndarray, " k"], rectangle: Rectangle, height: float
    ) -> list[Instance]:
        """Return a table with its visible legs, or a shelf; chairs below a table stay free."""
        points = self.cloud.points
        upper = points[members, 2] > height - 0.12
        below = members[~upper]
        label = components(points[below], TOUCHING)
        low, high = np.array(rectangle[:2]) - 0.05, np.array(rectangle[2:]) + 0.05
        inside = np.all((points[below, :2] > low) & (points[below, :2] < high), axis=1)
        legs = []
        for k in range(label.max(initial=-1) + 1):
            group = label == k
            if inside[group].mean() > 0.95 and not self._goes_on(below[group], members):
                legs.append(below[group])
        own = np.concatenate([members[upper], *legs])
        self.free[own] = False
        corner, far = np.array(rectangle[:2]), np.array(rectangle[2:])
        middle = np.array([[*(corner + far) / 2, height]])
        at_wall = any(
            bool(wall.spans(middle)[0])
            and wall.distance(middle)[0] < (far - corner)[wall.axis] / 2 + 0.12
            for wall in self.room.walls
        )
        if at_wall and min(far - corner) < MAX_SHELF_DEPTH:
            thick = min(float(np.ptp(points[members[upper], 2])), 0.12)
            return [Instance("shelf", 0.5, own, _box(rectangle, height - thick, height))]
        return [Instance("", 0.7, own, _box(rectangle, 0.0, height))]

    def _goes_on(self, group: Int[np.ndarray, " k"], column: Int[np.ndarray, " m"]) -> bool:
        """Check whether a group of points continues outside of a column."""
        points = self.cloud.points
        margin = TOUCHING
        low, high = points[group].min(axis=0) - margin, points[group].max(axis=0) + margin
        near = self.free & ((points > low) & (points < high)).all(axis=1)
        near[column] = False
        return int(near.sum()) > 20

    # ------------------------------------------------------------ furniture without a visible top

    def _behind_fronts(self, fronts: Sequence[FrontPlane]) -> list[Instance]:
        """Return the furniture behind fronts, but not what is turned from x and y.

        A front along x or y holds only a part of turned furniture. That remains a group of
        touching points, whose box is turned.
        """
        out = []
        for front in fronts:
            if self.free[front.members].mean() < 0.6:
                continue
            box = front.box
            members = self._inside(box, MAX_OVERHANG)
            if faces_yaw(self.cloud.normals[members]):
                continue
            self.free[members] = False
            out.append(Instance("", 0.6, members, box))
        return out

    def _inside(self, box: UprightBox, margin: float) -> Int[np.ndarray, " k"]:
        near = np.abs(self.cloud.points - box.center) < box.size / 2 + margin
        return np.flatnonzero(near.all(axis=1) & self.free)

    # ------------------------------------------------------------ remaining points

    def _rest(self, boxes: Sequence[UprightBox]) -> list[Instance]:
        """Return groups of touching points that are not just edges of other objects."""
        points = self.cloud.points
        for box in boxes:
            self.free[self._inside(box, MAX_OVERHANG)] = False
        among = np.flatnonzero(self.free)
        label = components(points[among], TOUCHING)
        out = []
        for k in range(label.max(initial=-1) + 1):
            members = among[label == k]
            if len(members) < MIN_POINTS:
                break
            if not flat_on_wall(self.room, points[members], MIN_WALL_PROTRUSION):
                out.append(Instance("", 0.4, members))
        return out


def _box(rectangle: Rectangle, bottom: float, top: float) -> UprightBox:
    x0, y0, x1, y1 = rectangle
    return from_corners(np.array([x0, y0, bottom]), np.array([x1, y1, top]))
