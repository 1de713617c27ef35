"""Read detections in the images of a scan: results of Detectron2 and of Omni3D's Cube R-CNN.

Detectron2's `COCOEvaluator` writes a list of results, whose `category_id` are those of the dataset:
for COCO 1 to 90 with gaps. Omni3D's evaluator adds the corners of a 3-D box in the camera's frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import FileFormatError
from momapos.model.records import Frame, ImageDetection

from .categories import Categories, categories_of, read_categories, read_json
from .coco import CATEGORIES, COCO80, label_of_name
from .mask_boxes import box_of_mask

MAX_DISTANCE = 1e3
"""Of a corner of a 3-D box from the camera [m]."""
Corners = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Results:
    """Detections of another program."""

    found: dict[str, list[ImageDetection]]
    """By the name of the frame."""
    warnings: tuple[str, ...] = ()
    """What was skipped or assumed, one line each."""


@dataclass(frozen=True)
class _Entry:
    image: str
    category: int
    box: tuple[float, float, float, float] | None
    """None if it is empty."""
    score: float
    corners: Corners | None


def read_coco(path: Path, frames: Sequence[Frame], categories: Path | None = None) -> Results:
    """Read `coco_instances_results.json` of Detectron2, or `omni_instances_results.json` of Omni3D.

    Its `image_id` are the names of images, or numbers: of images in the file of categories, of
    names such as frame-000012, or of images in the recording, from which a scan uses some, counted
    from 0 or from 1. One of these meanings holds for a whole file: the first one that most results
    have an image by.

    Args:
        path: A list of results; or a dataset file with "annotations" and "categories".
        frames: The images of the scan.
        categories: File with the names of the categories. Without one, and without "categories" in
            the file, the numbers are COCO's; 3-D boxes then have no labels.

    Returns:
        The detections. An empty box is replaced by that of the mask; without one it is left out.

    Raises:
        FileFormatError: A file is damaged, no detection is in an image of the scan, or a category
            has no name; the message names the entry.
    """
    data, given = read_json(path), None
    if isinstance(data, dict) and "annotations" in data:
        given = categories_of(data, path)
        data = data["annotations"]
    if categories is not None:
        own = {} if given is None else given.images
        given = read_categories(categories)
        given = Categories(given.names, {**own, **given.images})
    if not isinstance(data, list):
        raise FileFormatError(f"{path}: must be a list of COCO detections")
    entries = [_entry(item, f"{path}: detection {index}") for index, item in enumerate(data)]
    labels, warnings = _labels(entries, given, path, categories)
    found, warnings = dict[str, list[ImageDetection]](), [*warnings]
    used = {entry.image for entry in entries}
    names, first = frame_names(used, frames, {} if given is None else given.images)
    if first is not None and "0" not in used:
        warnings.append(
            f"{path}: its image_id are read as indices of images counted from {first}; a file of "
            "categories with the names of its images says otherwise"
        )
    for entry in entries:
        image = names.get(entry.image)
        if image is not None and entry.box is not None:
            item = ImageDetection(entry.box, labels[entry.category], entry.score, entry.corners)
            found.setdefault(image, []).append(item)
    empty = sum(entry.box is None for entry in entries)
    if empty:
        warnings.append(f"{path}: skipped {empty} of {len(entries)} detections with an empty box")
    others = used - set(names)
    if others and found:
        count = sum(entry.image in others for entry in entries)
        warnings.append(
            f"{path}: {count} of {len(entries)} detections are in {len(others)} images that the "
            f"scan does not use, such as image_id {min(others)}"
        )
    if len(entries) > empty and not found:
        raise FileFormatError(
            f"{path}: none of its image_id names a frame of the scan, such as {frames[0].name!r}"
            if frames
            else f"{path}: the scan has no images"
        )
    return Results(found, tuple(warnings))


def frame_names(
    used: Set[str], frames: Sequence[Frame], images: Mapping[str, str]
) -> tuple[dict[str, str], int | None]:
    """Return the name of the frame that each `image_id` means, see `read_coco`.

    Also return from what number the images of the recording are counted, if they are.

    Args:
        used: Each `image_id` of a file.
        frames: The images of the scan.
        images: Names of images by `image_id`, if the file has them.
    """
    known = {frame.name: frame.name for frame in frames}
    listed = {number: known[name] for number, name in images.items() if name in known}
    numbers = [_number_in(frame.name) for frame in frames]
    numbered = {str(n): f.name for n, f in zip(numbers, frames, strict=True) if n is not None}
    if len(numbered) < len(frames):  # some have no number, or two have the same
        numbered = {}
    places = [k if frame.index is None else frame.index for k, frame in enumerate(frames)]
    from_0 = {str(k): frame.name for k, frame in zip(places, frames, strict=True)}
    from_1 = {str(k + 1): frame.name for k, frame in zip(places, frames, strict=True)}
    # Numbers without a 0 that end one beyond the last image are counted from 1.
    last = max((int(one) for one in used if one.isdecimal()), default=0)
    start = int("0" not in used and last == max(places, default=0) + 1)
    if images:
        return known | listed, None
    by_name, by_index = known | numbered, known | (from_1 if start else from_0)
    if len(used & set(by_index)) > len(used & set(by_name)):
        return by_index, start
    return by_name, None


def _number_in(name: str) -> int | None:
    """Return the number at the end of a name."""
    found = re.search(r"\d{1,18}$", name)
    return None if found is None else int(found[0])


def _labels(
    entries: Sequence[_Entry], given: Categories | None, path: Path, file: Path | None
) -> tuple[dict[int, str], list[str]]:
    """Return the label of each category, and assumptions.

    Raises:
        FileFormatError: A category has no name.
    """
    numbers = sorted({entry.category for entry in entries})
    if given is not None:
        table, where = given.names, f"the categories of {file or path}"
    elif any(entry.corners is not None for entry in entries):
        text = f"{path}: its 3-D boxes have no labels; --categories category_meta.json names them"
        return dict.fromkeys(numbers, ""), [text]
    else:
        table, where = CATEGORIES, "COCO's, 1 to 90 with gaps; --categories FILE gives others"
    unknown = [number for number in numbers if number not in table]
    if not unknown:
        return {number: label_of_name(table[number]) for number in numbers}, []
    if given is None and set(numbers) <= set(range(len(COCO80))):
        text = (
            f"{path}: category {unknown[0]} is not in COCO's files, so its categories are read as "
            "detectors count them, 0 to 79; --categories FILE says otherwise"
        )
        return {number: label_of_name(COCO80[number]) for number in numbers}, [text]
    raise FileFormatError(f"{path}: category {unknown[0]} is not among {where}")


def _entry(item: Any, where: str) -> _Entry:
    values = item.get("bbox") if isinstance(item, dict) else None
    if not isinstance(values, list) or len(values) != 4:
        raise FileFormatError(f"{where}: 'bbox' must be [left, top, width, height]")
    try:
        left, top, width, height = (float(v) for v in values)
        score, category = float(item.get("score", 1.0)), int(item["category_id"])
        image = item["image_id"]
        if type(image) not in (str, int):
            raise TypeError("image_id must be a string or an integer")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FileFormatError(
            f"{where}: needs image_id, category_id, bbox and score ({error})"
        ) from error
    if not np.isfinite([left, top, width, height, score]).all() or min(width, height) < 0:
        raise FileFormatError(f"{where}: bbox and score must be finite, and bbox not negative")
    box: tuple[float, float, float, float] | None = (left, top, left + width, top + height)
    if min(width, height) == 0:
        box = _box_of(item["segmentation"], where) if "segmentation" in item else None
    corners = _corners(item["bbox3D"], where) if "bbox3D" in item else None
    return _Entry(str(image), category, box, score, corners)


def _box_of(mask: Any, where: str) -> tuple[float, float, float, float] | None:
    try:
        return box_of_mask(mask)
    except ValueError as error:
        raise FileFormatError(f"{where}: bbox is empty and segmentation {error}") from error


def _corners(values: Any, where: str) -> Corners | None:
    """Return the corners of a 3-D box; None for the placeholder of a detector without 3-D boxes."""
    try:
        corners = np.array(values, float)
    except (ValueError, TypeError) as error:
        raise FileFormatError(f"{where}: bbox3D must be numbers ({error})") from error
    if corners.shape != (8, 3) or not (np.abs(corners) < MAX_DISTANCE).all():
        raise FileFormatError(f"{where}: bbox3D must be 8 corners of 3 finite numbers, in meters")
    solid = (np.linalg.norm(corners[[1, 3, 4]] - corners[0], axis=1) > 0).all()
    return tuple((x, y, z) for x, y, z in corners.tolist()) if solid else None
