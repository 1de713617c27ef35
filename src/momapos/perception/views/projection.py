"""Locate objects in images, by projecting their boxes or by 2-D detections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import UprightBox, apply, invert, pose, rotation_about
from momapos.model.records import Frame, ImageDetection

from .faces import MIN_DEPTH

if TYPE_CHECKING:
    from jaxtyping import Float

Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom."""

MIN_IOU = 0.3
"""A 2-D detection belongs to a projected box from this IoU on [-]."""
_CORNERS = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]), -1).reshape(-1, 3)


@dataclass(frozen=True)
class Observation:
    """One object in one image."""

    frame: int
    """Index of the frame."""
    box: Rectangle
    """Left, top, right, bottom [px]."""
    off_center: float
    """Distance of its middle from the image's, as a fraction of the image's half diagonal."""


def corners(box: UprightBox) -> Float[np.ndarray, "8 3"]:
    """Return the corners of a box in the world [m]."""
    R = rotation_about(np.array([0.0, 0.0, 1.0]), box.yaw)
    return apply(pose(box.center, R), _CORNERS * box.size)


def observations(
    box: UprightBox,
    frames: Sequence[Frame],
    found: Mapping[str, Sequence[ImageDetection]] | None = None,
    least: float = 0.0,
) -> list[Observation]:
    """Return the images that show a box, the one where it is most central first (MoMa-Pos, III-B).

    Args:
        box: Box of the object, in the world.
        frames: All images.
        found: 2-D detections by frame name; if None, the box's projection is used.
        least: Minimum score of a detection [-].
    """
    seen = []
    for index, frame in enumerate(frames):
        rectangle = projection(box, frame)
        if rectangle is not None and found is not None:
            sure = [item for item in found.get(frame.name, ()) if item.score >= least]
            match = _match(rectangle, sure)
            rectangle = None if match is None else match.box
        if rectangle is not None:
            seen.append(Observation(index, rectangle, _off_center(rectangle, frame)))
    return sorted(seen, key=lambda s: (s.off_center, s.frame))


def projection(box: UprightBox, frame: Frame) -> Rectangle | None:
    """Return the rectangle around a projected box [px]; None unless all of the box is in front of
    the camera and its middle projects into the image."""
    points = apply(invert(frame.T_world_camera), np.vstack([corners(box), box.center]))
    if points[:, 2].min() < MIN_DEPTH:
        return None
    pixels = points @ frame.intrinsics.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    height, width = frame.color.shape[:2]
    if not (0 <= pixels[-1, 0] < width and 0 <= pixels[-1, 1] < height):
        return None
    low = np.clip(pixels.min(0), 0, [width, height])
    high = np.clip(pixels.max(0), 0, [width, height])
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _match(rectangle: Rectangle, found: Sequence[ImageDetection]) -> ImageDetection | None:
    overlaps = [overlap(rectangle, item.box) for item in found]
    best = int(np.argmax(overlaps)) if overlaps else -1
    return found[best] if best >= 0 and overlaps[best] >= MIN_IOU else None


def overlap(a: Rectangle, b: Rectangle) -> float:
    """Return the intersection over union of two rectangles."""
    both = common_area(a, b)
    return both / (area(a) + area(b) - both) if both else 0.0


def common_area(a: Rectangle, b: Rectangle) -> float:
    """Return the area that two rectangles share."""
    wide = min(a[2], b[2]) - max(a[0], b[0])
    tall = min(a[3], b[3]) - max(a[1], b[1])
    return wide * tall if wide > 0 and tall > 0 else 0.0


def area(a: Rectangle) -> float:
    """Return the area of a rectangle."""
    return (a[2] - a[0]) * (a[3] - a[1])


def _off_center(rectangle: Rectangle, frame: Frame) -> float:
    height, width = frame.color.shape[:2]
    half = np.array([width, height]) / 2
    middle = np.array([rectangle[0] + rectangle[2], rectangle[1] + rectangle[3]]) / 2
    return float(np.linalg.norm(middle - half) / np.linalg.norm(half))
