"""Read 2-D detections in the images of a scan: Detectron2's COCO results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import FileFormatError, read_bytes_bounded
from momapos.model.records import Frame, ImageDetection

from .coco import label_of_class

MAX_BYTES = 200_000_000
"""Larger files are refused [B]."""


def read_coco(path: Path, frames: Sequence[Frame]) -> dict[str, list[ImageDetection]]:
    """Read Detectron2's `coco_instances_results.json`.

    A result belongs to the frame whose name is its `image_id`, or whose index in the scan it is.

    Raises:
        FileFormatError: The file is not a list of COCO results; the message names the entry.
    """
    try:
        data = json.loads(read_bytes_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not a JSON list of COCO detections ({error})") from error
    if not isinstance(data, list):
        raise FileFormatError(f"{path}: must be a list of COCO detections")
    names = {str(index): frame.name for index, frame in enumerate(frames)}
    names |= {frame.name: frame.name for frame in frames}
    found: dict[str, list[ImageDetection]] = {}
    for index, item in enumerate(data):
        image, result = _coco_entry(item, f"{path}: detection {index}")
        if image in names:
            found.setdefault(names[image], []).append(result)
    if data and not found:
        raise FileFormatError(
            f"{path}: none of its image_id names a frame of the scan, such as {frames[0].name!r}"
            if frames
            else f"{path}: the scan has no images"
        )
    return found


def _coco_entry(item: Any, where: str) -> tuple[str, ImageDetection]:
    values = item.get("bbox") if isinstance(item, dict) else None
    if not isinstance(values, list) or len(values) != 4:
        raise FileFormatError(f"{where}: 'bbox' must be [left, top, width, height]")
    try:
        left, top, width, height = (float(v) for v in values)
        score, category = float(item["score"]), int(item["category_id"])
        image = item["image_id"]
        if type(image) not in (str, int):
            raise TypeError("image_id must be a string or an integer")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileFormatError(
            f"{where}: needs image_id, category_id, bbox and score ({error})"
        ) from error
    if not np.isfinite([left, top, width, height, score]).all() or width <= 0 or height <= 0:
        raise FileFormatError(f"{where}: bbox and score must be finite, and bbox not empty")
    box = (left, top, left + width, top + height)
    return str(image), ImageDetection(box, label_of_class(category), score)
