"""Where things are in the pictures: from their boxes in space, or from a 2-D detector's file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.errors import FileFormatError
from momapos.geometry.transforms import apply, invert, pose, rotation_about
from momapos.perception.faces import NEAREST
from momapos.types import Frame, UprightBox

if TYPE_CHECKING:
    from jaxtyping import Float

Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom."""

MAX_BYTES = 200_000_000
"""Detector files larger than this are refused [B]."""
LEAST_OVERLAP = 0.3
"""A 2-D detection belongs to a box whose picture it overlaps this much (IoU) [-]."""
_CORNERS = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]), -1).reshape(-1, 3)

COCO = {
    40: "bottle", 42: "cup", 46: "bowl", 47: "banana", 48: "apple", 57: "chair", 58: "couch",
    61: "table", 63: "tv", 69: "microwave", 70: "oven", 71: "toaster", 72: "sink",
    73: "fridge",
}  # fmt: skip
"""Our labels for the furniture and kitchen things of COCO, by Detectron2's category number + 1."""


@dataclass(frozen=True)
class Sight:
    """One thing in one picture."""

    frame: int
    """Index of the frame."""
    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""
    off_center: float
    """Distance of its middle from the picture's, as a fraction of the picture's half diagonal."""


@dataclass(frozen=True)
class PictureBox:
    """What a 2-D detector found."""

    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""
    label: str
    score: float


def corners(box: UprightBox) -> Float[np.ndarray, "8 3"]:
    """Corners of a box in the world [m]."""
    R = rotation_about(np.array([0.0, 0.0, 1.0]), box.yaw)
    return apply(pose(box.center, R), _CORNERS * box.size)


def sights(
    box: UprightBox,
    frames: Sequence[Frame],
    found: Mapping[str, Sequence[PictureBox]] | None = None,
) -> list[Sight]:
    """The pictures that show a box, the one where it is most central first (MoMa-Pos, III-B).

    Args:
        box: The thing, in the world.
        frames: All pictures.
        found: What a 2-D detector found, by the frame's name; by default a box is taken to be
            where its projection is.
    """
    seen = []
    for index, frame in enumerate(frames):
        rectangle = projection(box, frame)
        if rectangle is not None and found is not None:
            match = _match(rectangle, found.get(frame.name, ()))
            rectangle = None if match is None else match.box
        if rectangle is not None:
            seen.append(Sight(index, rectangle, _off_center(rectangle, frame)))
    return sorted(seen, key=lambda s: (s.off_center, s.frame))


def projection(box: UprightBox, frame: Frame) -> tuple[float, float, float, float] | None:
    """Rectangle that holds a box's picture [px]; None unless all of it lies before the camera and
    its middle in the picture."""
    points = apply(invert(frame.T_world_camera), np.vstack([corners(box), box.center]))
    if points[:, 2].min() < NEAREST:
        return None
    pixels = points @ frame.intrinsics.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    height, width = frame.colour.shape[:2]
    if not (0 <= pixels[-1, 0] < width and 0 <= pixels[-1, 1] < height):
        return None
    low = np.clip(pixels.min(0), 0, [width, height])
    high = np.clip(pixels.max(0), 0, [width, height])
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def vote_label(
    box: UprightBox, frames: Sequence[Frame], found: Mapping[str, Sequence[PictureBox]]
) -> str:
    """The label that a 2-D detector gave a thing most often, weighted by score; "" for none."""
    votes: Counter[str] = Counter()
    for frame in frames:
        rectangle = projection(box, frame)
        match = None if rectangle is None else _match(rectangle, found.get(frame.name, ()))
        if match is not None and match.label:
            votes[match.label] += match.score  # type: ignore[assignment]
    return votes.most_common(1)[0][0] if votes else ""


def _match(
    rectangle: tuple[float, float, float, float], found: Sequence[PictureBox]
) -> PictureBox | None:
    overlaps = [overlap(rectangle, item.box) for item in found]
    best = int(np.argmax(overlaps)) if overlaps else -1
    return found[best] if best >= 0 and overlaps[best] >= LEAST_OVERLAP else None


def overlap(a: Rectangle, b: Rectangle) -> float:
    """Intersection over union of two rectangles."""
    both = common_area(a, b)
    return both / (area(a) + area(b) - both) if both else 0.0


def common_area(a: Rectangle, b: Rectangle) -> float:
    """Area of what two rectangles share."""
    wide = min(a[2], b[2]) - max(a[0], b[0])
    tall = min(a[3], b[3]) - max(a[1], b[1])
    return wide * tall if wide > 0 and tall > 0 else 0.0


def area(a: Rectangle) -> float:
    """Area of a rectangle."""
    return (a[2] - a[0]) * (a[3] - a[1])


def _off_center(rectangle: tuple[float, float, float, float], frame: Frame) -> float:
    height, width = frame.colour.shape[:2]
    half = np.array([width, height]) / 2
    middle = np.array([rectangle[0] + rectangle[2], rectangle[1] + rectangle[3]]) / 2
    return float(np.linalg.norm(middle - half) / np.linalg.norm(half))


def read_coco(path: Path, frames: Sequence[Frame]) -> dict[str, list[PictureBox]]:
    """Read Detectron2's `coco_instances_results.json`.

    A result belongs to the frame whose name is its `image_id`, or to the frame of that position
    in the scan.

    Raises:
        FileFormatError: The file is no list of COCO results; the message names the entry.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FileFormatError(f"{path}: larger than {MAX_BYTES // 1_000_000} MB")
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: no JSON list of COCO detections ({error})") from error
    if not isinstance(data, list):
        raise FileFormatError(f"{path}: must be a list of COCO detections")
    names = {str(index): frame.name for index, frame in enumerate(frames)}
    names |= {frame.name: frame.name for frame in frames}
    found: dict[str, list[PictureBox]] = {}
    for index, item in enumerate(data):
        image, result = _coco_entry(item, f"{path}: detection {index}")
        if image in names:
            found.setdefault(names[image], []).append(result)
    if data and not found:
        raise FileFormatError(
            f"{path}: none of its image_id names a frame of the scan, such as {frames[0].name!r}"
            if frames
            else f"{path}: the scan has no pictures"
        )
    return found


def _coco_entry(item: Any, where: str) -> tuple[str, PictureBox]:
    values = item.get("bbox") if isinstance(item, dict) else None
    if not isinstance(values, list) or len(values) != 4:
        raise FileFormatError(f"{where}: 'bbox' must be [left, top, width, height]")
    try:
        left, top, width, height = (float(v) for v in values)
        score, category = float(item["score"]), int(item["category_id"])
        image = str(item["image_id"])
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{where}: needs image_id, category_id, bbox and score ({error})"
        ) from error
    if not np.isfinite([left, top, width, height, score]).all() or width <= 0 or height <= 0:
        raise FileFormatError(f"{where}: bbox and score must be finite, its size above 0")
    box = (left, top, left + width, top + height)
    return image, PictureBox(box, COCO.get(category + 1, ""), score)
