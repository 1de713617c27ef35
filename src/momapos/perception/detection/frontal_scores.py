"""Read how frontally images show an object, from a classifier of the user."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from momapos.core import FileFormatError
from momapos.model.records import Frame

from .categories import read_json
from .coco_results import frame_names


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
        where = f"{path}: score {index}"
        if type(image) not in (str, int):
            raise FileFormatError(f"{where}: needs image_id, a string or an integer, and score")
        if isinstance(score, bool) or not isinstance(score, int | float) or not 0 <= score <= 1:
            raise FileFormatError(f"{where}: must be from 0 to 1, not {score!r:.40}")
        scores[str(image)] = float(score)
    names, _ = frame_names(set(scores), frames, {})
    found = {names[image]: score for image, score in scores.items() if image in names}
    if not found:
        raise FileFormatError(f"{path}: none of its images is one of the scan")
    return found
