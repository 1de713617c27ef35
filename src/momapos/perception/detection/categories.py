"""Read the meaning of a detector's category numbers and image numbers.

Accepted are COCO's dataset files ("categories", "images"), Omni3D's category_meta.json
("thing_classes", "thing_dataset_id_to_contiguous_id"), and a list of names counted from 0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from momapos.core import FileFormatError, read_bytes_bounded

MAX_BYTES = 200_000_000
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
        return json.loads(read_bytes_bounded(path, MAX_BYTES))
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
