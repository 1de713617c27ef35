"""Locate objects in images, and transfer parts between faces in one plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import UprightBox, apply, invert, pose, rotation_about
from momapos.model.records import Frame, ImageDetection, Part

from .faces import MIN_DEPTH, Face

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


MIN_INSIDE = 0.6
"""Share of a part that must lie on the face [-]."""
HANDLE_PROTRUSION = 0.04
"""Typical protrusion of handles [m]."""
MIN_COSINE, MAX_PLANE_DISTANCE = 0.99, 0.12
"""Two faces are coplanar if the cosine between their normals is above the first, and their distance
below the second [m]."""
MAX_OVERLAP = 0.5
"""Of two parts that share this much of the smaller one, one is dropped [-]."""


def transferred(parts: Sequence[Part], source: Face, target: Face) -> tuple[Part, ...]:
    """Express parts of one face as parts of another face in its plane.

    Args:
        parts: Rectangles as fractions of `source`.
        source: The face on which they were detected.
        target: The other face.

    Returns:
        Rectangles as fractions of `target`, clipped to it, without parts that lie mostly outside.
        Empty if the faces are not coplanar.
    """
    T = invert(target.T_world_face) @ source.T_world_face
    if T[2, 2] < MIN_COSINE or abs(T[2, 3]) > MAX_PLANE_DISTANCE:
        return ()
    scale = np.array([source.width / target.width, source.height / target.height] * 2)
    at = np.array([T[0, 3] / target.width, -T[1, 3] / target.height] * 2)

    def moved(box: tuple[float, ...]) -> Float[np.ndarray, "4"]:
        return (np.array(box) - 0.5) * scale + 0.5 + at

    there = []
    for part in parts:
        box = moved(part.box)
        kept = np.clip(box, 0.0, 1.0)
        if np.prod(kept[2:] - kept[:2]) > MIN_INSIDE * np.prod(box[2:] - box[:2]):
            grip = None if part.handle is None else _rectangle(moved(part.handle))
            there.append(replace(part, box=_rectangle(kept), handle=grip))
    return tuple(there)


def adjacent_parts(parts: Sequence[Part], source: Face, target: Face) -> tuple[Part, ...]:
    """Express parts of one face that lie next to another face in its plane.

    Args:
        parts: Rectangles as fractions of `source`.
        source: The face on which they were detected.
        target: The other face.

    Returns:
        Rectangles as fractions of `target`, left or right of it by at most its width.
    """
    wide = replace(target, width=3 * target.width)
    there = [(part, np.array(part.box)) for part in transferred(parts, source, wide)]
    scaled = [(part, box * (3, 1, 3, 1) - (1, 0, 1, 0)) for part, box in there]
    return tuple(
        replace(part, box=(float(box[0]), float(box[1]), float(box[2]), float(box[3])), handle=None)
        for part, box in scaled
        if box[[0, 2]].mean() < 0.0 or box[[0, 2]].mean() > 1.0
    )


def shift_handles(
    parts: Sequence[Part], face: Face, camera: Float[np.ndarray, "3"], *, undo: bool = False
) -> tuple[Part, ...]:
    """Shift handles from their true place on a face to where they appear in an image, or back.

    Args:
        parts: Rectangles as fractions of the face.
        face: The face.
        camera: Position of the camera, in the face's frame [m].
        undo: Shift from where they appear to where they are.
    """
    sign = 1.0 if undo else -1.0
    size, origin = np.array([face.width, face.height]), np.array([camera[0], -camera[1]])

    def moved(handle: tuple[float, ...]) -> tuple[float, float, float, float]:
        box = np.array(handle).reshape(2, 2)
        middle = (box.mean(axis=0) - 0.5) * size
        return _rectangle(
            (box + sign * HANDLE_PROTRUSION * (origin - middle) / camera[2] / size).ravel()
        )

    return tuple(p if p.handle is None else replace(p, handle=moved(p.handle)) for p in parts)


def most_confident(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Drop the less confident of overlapping parts; the most confident come first.

    A part gives way to several parts inside it that have handles of their own, if it has no handle
    or shares one of theirs. The inner handles must not be pieces of the same bar.
    """

    def gives_way(part: Part) -> bool:
        inner = _apart([one for one in parts if one.handle is not None and _is_inside(one, part)])
        theirs = [one.handle for one in inner if one.handle is not None]
        own = part.handle
        known = own is None or any(common_area(own, handle) for handle in theirs)
        return known and any(not common_area(*pair) for pair in combinations(theirs, 2))

    return _apart([part for part in parts if not gives_way(part)])


def _apart(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Drop the less confident of overlapping parts; the most confident come first."""
    kept: list[Part] = []
    for part in sorted(parts, key=lambda p: -p.score):
        if all(overlap_share(part, other) < MAX_OVERLAP for other in kept):
            kept.append(part)
    return tuple(kept)


def _is_inside(small: Part, large: Part) -> bool:
    """Check whether a part lies mostly inside a larger one."""
    return area(small.box) < area(large.box) and overlap_share(small, large) >= MAX_OVERLAP


def overlap_share(a: Part, b: Part) -> float:
    """Return the common area of two parts as a share of the smaller [-]."""
    least = min(area(a.box), area(b.box))
    return common_area(a.box, b.box) / least if least > 0 else 1.0


def _rectangle(values: Float[np.ndarray, "4"]) -> tuple[float, float, float, float]:
    left, top, right, bottom = np.clip(values, 0.0, 1.0).tolist()
    return left, top, right, bottom
