"""Find the object at a point of the room or at a pixel of an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, unknown_name
from momapos.core.geometry import apply, box_axes, to_local
from momapos.model.records import Detection, Frame

if TYPE_CHECKING:
    from jaxtyping import Float

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
