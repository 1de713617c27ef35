"""Read detections of other programs in the images of a scan: boxes, masks, categories, scores.

Mask2Former leaves `bbox` at zero. A mask is the lengths of alternating runs of 0 and 1, column by
column. As text, each is a variable-length number of 5 bits per character, and from the third on the
difference to the one before the last (cocoapi, common/maskApi.c).

Category names are read from COCO's dataset files ("categories", "images"), Omni3D's
category_meta.json ("thing_classes", "thing_dataset_id_to_contiguous_id"), and a list of names
counted from 0.

Detectron2's `COCOEvaluator` writes a list of results, whose `category_id` are those of the dataset:
for COCO 1 to 90 with gaps. Omni3D's evaluator adds the corners of a 3-D box in the camera's frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from momapos.core import FileFormatError, parse_json, read_text_bounded
from momapos.model.records import Frame, ImageDetection

COCO80: tuple[str, ...] = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat",
    "traffic light", "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog",
    "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella",
    "handbag", "tie", "suitcase", "frisbee", "skis", "snowboard", "sports ball", "kite",
    "baseball bat", "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle",
    "wine glass", "cup", "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich",
    "orange", "broccoli", "carrot", "hot dog", "pizza", "donut", "cake", "chair", "couch",
    "potted plant", "bed", "dining table", "toilet", "tv", "laptop", "mouse", "remote",
    "keyboard", "cell phone", "microwave", "oven", "toaster", "sink", "refrigerator", "book",
    "clock", "vase", "scissors", "teddy bear", "hair drier", "toothbrush",
)  # fmt: skip
"""Class names by class number of a detector trained on COCO."""

GAPS = frozenset((12, 26, 29, 30, 45, 66, 68, 69, 71, 83))
"""Numbers from 1 to 90 that COCO's files don't use."""
CATEGORIES: Mapping[int, str] = dict(
    zip((number for number in range(1, 91) if number not in GAPS), COCO80, strict=True)
)
"""Class names by the `category_id` of COCO's files, such as Detectron2's results."""

RENAMED: Mapping[str, str] = {
    "dining table": "table",
    "refrigerator": "fridge",
    "tv": "screen",
    "potted plant": "plant",
}
"""Our labels, where they differ from COCO's."""
INDOORS = frozenset((
    "backpack", "umbrella", "handbag", "suitcase", "bottle", "wine glass", "cup", "fork", "knife",
    "spoon", "bowl", "banana", "apple", "orange", "bench", "chair", "couch", "potted plant", "bed",
    "dining table", "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone",
    "microwave", "oven", "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors",
))  # fmt: skip
"""Classes of objects in homes, without people, animals, traffic and meals."""
LABELS: frozenset[str] = frozenset(RENAMED.get(name, name) for name in INDOORS)
"""All labels of a detector of COCO's classes."""


WITHOUT_DOORS: frozenset[str] = LABELS - {"fridge", "oven", "microwave", "sink", "table"}
"""Labels of objects without doors and drawers."""


def label_of_class(index: int) -> str:
    """Return our label for a class of COCO; "" for other classes and numbers."""
    return label_of_name(COCO80[index]) if 0 <= index < len(COCO80) else ""


def label_of_name(name: str) -> str:
    """Return our label for a class name of any detector; "" for those of COCO not in homes."""
    name = name.strip().lower()
    return "" if name in COCO80 and name not in INDOORS else RENAMED.get(name, name)


MAX_SIDE = 100_000
"""Maximum height and width of a mask [px]."""
MAX_RUNS = 1_000_000


def box_of_mask(mask: Any) -> tuple[float, float, float, float] | None:
    """Return left, top, right, bottom of a mask [px]; None if it is empty.

    Args:
        mask: {"size": [height, width], "counts": text or list of run lengths}.

    Raises:
        ValueError: It is something else, or its runs do not fill the image.
    """
    if not isinstance(mask, dict) or not isinstance(mask.get("size"), list):
        raise ValueError("needs 'size' and 'counts'")
    size, counts = mask["size"], mask.get("counts")
    if len(size) != 2 or not all(type(v) is int and 0 < v <= MAX_SIDE for v in size):
        raise ValueError("'size' must be [height, width]")
    runs = _runs(counts) if isinstance(counts, str) else counts
    if not isinstance(runs, list) or not all(type(v) is int and v >= 0 for v in runs):
        raise ValueError("'counts' must be run lengths")
    height, width = size
    if len(runs) > MAX_RUNS or sum(runs) != height * width:
        raise ValueError(f"its runs do not fill {height} x {width} pixels")
    ends = np.cumsum(np.array(runs, np.int64))
    first, last = ends[:-1:2], ends[1::2] - 1  # of the runs of 1
    solid = last >= first[: len(last)]
    first, last = first[: len(last)][solid], last[solid]
    if not len(first):
        return None
    whole = last // height > first // height  # runs over several columns have all rows between
    top = 0 if whole.any() else int((first % height).min())
    bottom = height - 1 if whole.any() else int((last % height).max())
    return float(first[0] // height), float(top), float(last[-1] // height + 1), float(bottom + 1)


def _runs(text: str) -> list[int]:
    runs: list[int] = []
    value = shift = 0
    for character in text:
        code = ord(character) - 48
        if not 0 <= code < 64 or shift > 40:
            raise ValueError("'counts' has a character that is none of run lengths")
        value |= (code & 31) << shift
        shift += 5
        if not code & 32:
            if code & 16:
                value -= 1 << shift
            runs.append(value + (runs[-2] if len(runs) > 2 else 0))
            value = shift = 0
    return runs


MAX_BYTES = 50_000_000
"""Larger files are refused [B]: a dataset file lists all its images."""
MAX_NAME = 100
"""Maximum length of a name [-]."""
_ACCEPTED = (
    "expected \"categories\" with id and name, as in COCO's dataset files, Omni3D's "
    "category_meta.json, or a list of names"
)


@dataclass(frozen=True)
class Categories:
    """Names behind the numbers of a file of detections."""

    names: Mapping[int, str]
    """Class names by `category_id`."""
    images: Mapping[str, str] = field(default_factory=dict)
    """Names of images, without folder and ending, by `image_id`; empty if the file has none."""


def read_categories(path: Path) -> Categories:
    """Read a file of categories.

    Raises:
        FileFormatError: It has no categories, or one has no number or name.
    """
    return categories_of(read_json(path), path)


def categories_of(data: Any, path: Path) -> Categories:
    """Return the categories in the content of a file, see `read_categories`."""
    if isinstance(data, dict) and "thing_classes" in data:
        return Categories(_omni3d(data, path))
    listed = data.get("categories") if isinstance(data, dict) else data
    if not isinstance(listed, list) or not listed:
        raise FileFormatError(f"{path}: has no categories; {_ACCEPTED}")
    names: dict[int, str] = {}
    for index, entry in enumerate(listed):
        number = entry.get("id") if isinstance(entry, dict) else index
        name = entry.get("name") if isinstance(entry, dict) else entry
        if type(number) is not int or not isinstance(name, str) or len(name) > MAX_NAME:
            raise FileFormatError(f"{path}: category {index} needs a whole 'id' and a 'name'")
        if names.setdefault(number, name) != name:
            raise FileFormatError(f"{path}: has category {number} twice")
    return Categories(names, _images(data, path) if isinstance(data, dict) else {})


def read_json(path: Path) -> Any:
    """Read a JSON file of bounded size.

    Raises:
        FileFormatError: It is missing, too large or damaged.
    """
    try:
        return parse_json(read_text_bounded(path, MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: not JSON ({error})") from error


def _omni3d(data: dict[str, Any], path: Path) -> dict[int, str]:
    names, order = data["thing_classes"], data.get("thing_dataset_id_to_contiguous_id")
    try:
        if not isinstance(order, dict) or not all(isinstance(name, str) for name in names):
            raise ValueError("names or their numbers are missing")
        found = {int(number): names[place] for number, place in order.items()}
    except (ValueError, TypeError, IndexError) as error:
        raise FileFormatError(f"{path}: damaged categories ({error}); {_ACCEPTED}") from error
    return found


def _images(data: dict[str, Any], path: Path) -> dict[str, str]:
    images: dict[str, str] = {}
    listed = data.get("images", [])
    for index, entry in enumerate(listed if isinstance(listed, list) else [listed]):
        found = entry if isinstance(entry, dict) else {}
        file = found.get("file_name", found.get("file_path"))
        if type(found.get("id")) not in (int, str) or not isinstance(file, str):
            raise FileFormatError(f"{path}: image {index} needs an 'id' and a 'file_name'")
        images[str(found["id"])] = stem_of(file)
    return images


def stem_of(file: str) -> str:
    """Return an image's name without folder and ending, so that it is the name of a frame."""
    return PurePosixPath(file.replace("\\", "/")).name.partition(".")[0]


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
    if not np.isfinite([left, top, width, height]).all() or min(width, height) < 0:
        raise FileFormatError(f"{where}: bbox must be finite and not negative")
    if not 0 <= score <= 1:
        raise FileFormatError(f"{where}: score must be from 0 to 1, not {score:g}")
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


def read_frontal(path: Path, frames: Sequence[Frame]) -> dict[str, float]:
    """Read the scores of a frontal classifier.

    Args:
        path: JSON: an object of scores by image, or a list of objects with `image_id` and `score`;
            images are named as in `read_coco`.
        frames: The images of the scan.

    Returns:
        The score of each frame that has one, from 0 to 1.

    Raises:
        FileFormatError: The file is damaged, a score is not from 0 to 1, or the scan has none of
            its images.
    """
    data = read_json(path)
    if isinstance(data, list):
        entries = [item if isinstance(item, dict) else {} for item in data]
        rows = [(item.get("image_id"), item.get("score")) for item in entries]
    elif isinstance(data, dict):
        rows = list(data.items())
    else:
        raise FileFormatError(f"{path}: must be an object of scores by image, or a list")
    scores: dict[str, float] = {}
    for index, (image, score) in enumerate(rows):
        if type(image) not in (str, int):
            raise FileFormatError(
                f"{path}: entry {index}: needs image_id, a string or an integer, and score"
            )
        if isinstance(score, bool) or not isinstance(score, int | float) or not 0 <= score <= 1:
            where = f"{path}: score of {image!r:.40}"
            raise FileFormatError(f"{where}: must be from 0 to 1, not {score!r:.40}")
        scores[str(image)] = float(score)
    names, _ = frame_names(set(scores), frames, {})
    found = {names[image]: score for image, score in scores.items() if image in names}
    if not found:
        raise FileFormatError(f"{path}: none of its images is one of the scan")
    return found
