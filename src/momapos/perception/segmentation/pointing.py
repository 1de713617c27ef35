"""Find the object at a point or pixel, and measure how much of its surface was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, unknown_name
from momapos.core.geometry import UprightBox, along_edges, apply, box_axes, to_local
from momapos.model.records import Cloud, Detection, Frame

from .room_shell import CELL, area

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


MAX_DISTANCE = 0.15
"""A point this far outside of a box still selects it [m]."""


@dataclass(frozen=True)
class PointAt:
    """A point in the scene's frame."""

    point: tuple[float, float, float]
    """[m]"""


@dataclass(frozen=True)
class PixelOf:
    """A pixel of an image."""

    frame: str
    """Name of the frame."""
    u: float
    """Column, from the left [px]."""
    v: float
    """Row, from the top [px]."""


def pointed_at(
    where: PointAt | PixelOf, objects: Sequence[Detection], frames: Sequence[Frame]
) -> Detection:
    """Return the object at a point or pixel.

    Args:
        where: The point or pixel.
        objects: Objects in the world.
        frames: With poses in the same world.

    Raises:
        InputError: No object is there.
        UnknownNameError: No frame has that name.
    """
    if isinstance(where, PointAt):
        return _at(np.array(where.point, float), objects, f"at {_text(where.point)} m")
    names = [frame.name for frame in frames]
    if where.frame not in names:
        raise unknown_name("frame", where.frame, names, "the scan")
    frame = frames[names.index(where.frame)]
    height, width = frame.color.shape[:2]
    said = f"at pixel ({where.u:g}, {where.v:g}) of frame {where.frame}"
    if not (0 <= where.u < width and 0 <= where.v < height):
        raise InputError(f"{said}: outside the image of {width} x {height} pixels")
    ray = np.linalg.solve(frame.intrinsics, np.array([where.u, where.v, 1.0]))
    depth = 0.0 if frame.depth is None else float(frame.depth[int(where.v), int(where.u)])
    if depth > 0:
        point = apply(frame.T_world_camera, (ray * depth)[None])[0]
        return _at(point, objects, f"{said}, which shows {_text(point)} m,")
    start, direction = frame.T_world_camera[:3, 3], frame.T_world_camera[:3, :3] @ ray
    hits = [(_distance_along(item, start, direction), k) for k, item in enumerate(objects)]
    distance, k = min(hits, default=(np.inf, 0))
    if not np.isfinite(distance):
        raise InputError(f"{said} there is no object; choose a pixel that shows one")
    return objects[k]


def _at(point: Float[np.ndarray, "3"], objects: Sequence[Detection], said: str) -> Detection:
    """Return the object with the nearest box; of several around the point, the smallest."""

    def rank(item: Detection) -> tuple[float, float]:
        beyond = np.abs(to_local(point[None], item.box)[0]) - item.box.size / 2
        outside = float(np.linalg.norm(np.maximum(beyond, 0)))
        return round(outside, 2), float(np.prod(item.box.size))

    nearest = min(objects, key=rank)
    if rank(nearest)[0] > MAX_DISTANCE:
        center = _text(nearest.box.center)
        raise InputError(
            f"{said} there is no object; the nearest is {nearest.name}, around {center} m"
        )
    return nearest


def _distance_along(
    item: Detection, start: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> float:
    """Return where a ray enters a box, in lengths of its direction; infinite if it misses."""
    axes = np.eye(3)
    axes[:2, :2] = box_axes(item.box.yaw)
    origin, ray = axes @ (start - item.box.center), axes @ direction
    with np.errstate(divide="ignore", invalid="ignore"):
        cuts = (np.array([[-0.5], [0.5]]) * item.box.size - origin) / ray
    enter, leave = float(np.nanmin(cuts, axis=0).max()), float(np.nanmax(cuts, axis=0).min())
    return max(enter, 0.0) if leave >= max(enter, 0.0) else np.inf


def _text(point: Sequence[float] | Float[np.ndarray, "3"]) -> str:
    return "(" + ", ".join(f"{float(value):.2f}" for value in point) + ")"


SIDES = ((0, 1.0), (1, 1.0), (0, -1.0), (1, -1.0), (2, 1.0))
"""Axis and sign of the relevant faces: outward along x, y, -x, -y, up."""
MAX_POINT_DISTANCE = 0.08
"""Surfaces this close to a face's plane belong to it: doors and handles protrude [m]."""
CLEARANCE = 0.05
"""A face is visible where it is free at this distance in front of it [m]."""
MIN_COSINE = 0.5
"""Between the normal of a surface and the face's [-]."""
SAMPLES = 6
"""Samples along each edge of a face [-]."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Coverage of a box; faces are outward along its x, y, -x, -y, and up."""

    open: Float[np.ndarray, "5"]
    """Share of each face that nothing stands against [-]."""
    seen: Float[np.ndarray, "5"]
    """Share of each face on which surfaces were measured [-]."""
    areas: Float[np.ndarray, "5"]
    """Area of each face [m2]."""

    @property
    def share(self) -> float:
        """Share of the visible surface that was seen, in [0, 1]; 0 if nothing is visible."""
        can = self.open * self.areas
        if not can.any():
            return 0.0
        return float((np.minimum(self.seen, self.open) * self.areas).sum() / can.sum())


def coverage(cloud: Cloud, item: Detection, others: Sequence[UprightBox]) -> Coverage:
    """Measure how much of an object was seen.

    Args:
        cloud: Upright, floor at z = 0.
        item: Object with members in the cloud.
        others: Boxes of all other objects, including walls.
    """
    box, size = item.box, np.asarray(item.box.size)
    local = to_local(cloud.points[item.members], box)
    facing = along_edges(cloud.normals[item.members], box.yaw)
    cell = min(CELL, float(size.min()) / 3)
    seen, areas = [], []
    for axis, sign in SIDES:
        a, b = (k for k in range(3) if k != axis)
        away = np.abs(sign * local[:, axis] - size[axis] / 2)
        on = local[
            (away < min(MAX_POINT_DISTANCE, size[axis] / 2)) & (sign * facing[:, axis] > MIN_COSINE)
        ]
        areas.append(float(size[a] * size[b]))
        seen.append(min(1.0, area(on[:, a], on[:, b], cell) / areas[-1]) if len(on) else 0.0)
    free = ~_taken(_places(box), others).reshape(len(SIDES), -1)
    return Coverage(free.mean(axis=1), np.array(seen), np.array(areas))


def with_coverage(
    objects: Sequence[Detection],
    cloud: Cloud,
    walls: Sequence[Detection],
    measured: int | None = None,
) -> list[Detection]:
    """Return objects with their coverage and share of completed points.

    Args:
        objects: Objects with members in the cloud.
        cloud: Upright, floor at z = 0.
        walls: Walls of the room.
        measured: Number of measured points; completed points follow them. All if None.
    """
    found = []
    for item in objects:
        others = [one.box for one in (*objects, *walls) if one is not item]
        seen = replace(item, members=item.members[item.members < (measured or len(cloud.points))])
        share = coverage(cloud, seen, others).share
        lacking = 1.0 - len(seen.members) / max(len(item.members), 1)
        found.append(replace(item, seen=share, completed=lacking))
    return found


def _places(box: UprightBox) -> Float[np.ndarray, "n 3"]:
    """Return sample points in front of the faces of a box, the same number for each face."""
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    local = np.zeros((len(SIDES), SAMPLES, SAMPLES, 3))
    for places, (axis, sign) in zip(local, SIDES, strict=True):
        a, b = (k for k in range(3) if k != axis)
        places[..., a], places[..., b] = (steps * box.size[a])[:, None], (steps * box.size[b])[None]
        places[..., axis] = sign * (box.size[axis] / 2 + CLEARANCE)
    return along_edges(local.reshape(-1, 3), -box.yaw) + box.center


def _taken(
    places: Float[np.ndarray, "n 3"], others: Sequence[UprightBox]
) -> Bool[np.ndarray, " n"]:
    """Tell which places are below the floor or in a box."""
    below = places[:, 2] < 0.0
    if not others:
        return below
    center = np.array([box.center for box in others])
    half = np.array([box.size for box in others]) / 2
    yaw = np.array([box.yaw for box in others])
    away = places[:, None] - center
    c, s = np.cos(yaw), np.sin(yaw)
    inside = np.abs(c * away[..., 0] + s * away[..., 1]) < half[:, 0]
    inside &= np.abs(c * away[..., 1] - s * away[..., 0]) < half[:, 1]
    inside &= np.abs(away[..., 2]) < half[:, 2]
    return below | inside.any(axis=1)
