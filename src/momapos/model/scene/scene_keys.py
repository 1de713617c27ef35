"""Find keys of scene files that the reader does not know, at every depth."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from momapos.core import ChosenName, Keys, Parents, unknown_keys

MAX_IGNORED_KEYS = 100
"""Maximum number of unknown keys of a file that are reported one by one [-]."""
MAX_LISTED_KEYS = 5
"""The known keys are listed if no similar one exists and if they are at most this many [-]."""


BESTMAN_KEYS: Keys = dict.fromkeys((
    "obj_name", "model_path", "object_position", "object_orientation", "scale", "fixed_base",
    "note",
))  # fmt: skip
"""Keys of an object of a BestMan scene; `note` is a comment."""
_MEANT = {
    "rpy": "wxyz", "euler": "wxyz", "quat": "wxyz", "quaternion": "wxyz", "xyzw": "wxyz",
    "orientation": "wxyz", "rotation": "wxyz", "position": "xyz", "translation": "xyz",
    "size": "box", "dimensions": "box", "extents": "box", "file": "urdf", "model": "urdf",
    "mesh": "urdf", "uri": "urdf", "type": "category", "class": "category", "label": "category",
    "theta": "yaw", "heading": "yaw", "outline": "floor", "room": "floor", "polygon": "floor",
    "robot": "start", "obstacles": "objects", "furniture": "objects",
}  # fmt: skip
"""Words of other formats for our keys."""
_WHAT = {"wxyz": "a unit quaternion", "yaw": "in radians", "box": "edge lengths in meters"}
"""What a suggested key holds, where a word of another format may hold something else."""


@dataclass(frozen=True)
class IgnoredKey:
    """An unknown key of a scene file, which was ignored."""

    where: str
    """File, object and parent keys."""
    object: str
    """Name of the object; "" outside of objects."""
    key: str
    advice: str
    """Which key may be meant."""

    def __str__(self) -> str:
        advice = f"; {self.advice}" if self.advice else ""
        return f"{self.where}: {self.key!r:.80} is not known and was ignored{advice}"


def ignored_keys(data: Any, keys: Keys, where: str) -> tuple[IgnoredKey, ...]:
    """Return the unknown keys of a scene file, at most `MAX_IGNORED_KEYS` and one for the others.

    Args:
        data: Content of the file.
        keys: The keys that it may have.
        where: The file, for messages.
    """
    unknown = tuple(islice(unknown_keys(data, keys), MAX_IGNORED_KEYS + 1))
    found = tuple(
        IgnoredKey(*_at(data, parents, where), key, _advice(key, known))
        for parents, key, known in unknown[:MAX_IGNORED_KEYS]
    )
    if len(unknown) <= MAX_IGNORED_KEYS:
        return found
    rest = IgnoredKey(where, "", "...", f"more than {MAX_IGNORED_KEYS} unknown keys")
    return (*found, rest)


def place_of(data: Any, parents: Parents, where: str) -> str:
    """Return where a value of a scene file stands, in words that begin with the file."""
    return _at(data, parents, where)[0]


def _at(data: Any, parents: Parents, where: str) -> tuple[str, str]:
    """Return where a key stands, in words, and the name of the object that it belongs to."""
    owner, item = "", data
    for part in parents:
        item = item.get(part) if isinstance(item, dict) else item[part]
        if isinstance(part, int) and owner:
            where = f"{where} {part}"
        elif isinstance(part, int):
            owner = _name_of(item)
            what = {"walls": "wall", "objects": "object"}.get(f"{parents[0]}", "point")
            what = "object" if part is parents[0] else what
            where = f"{where}: {what} {part}" + (f" ({owner!r})" if owner else "")
        elif isinstance(part, ChosenName):
            where = f"{where}: {part!r:.80}"
        elif part != "objects" or owner or part is parents[-1]:
            where = f"{where}: {part}"
    return where, owner


def _name_of(item: Any) -> str:
    name = item.get("name", item.get("obj_name")) if isinstance(item, dict) else ""
    return name[:80] if isinstance(name, str) else ""


def _advice(key: str, known: Sequence[str]) -> str:
    meant = _MEANT.get(key.lower(), "")
    near = [meant] if meant in known else difflib.get_close_matches(key.lower(), known, n=1)
    if near:
        what = f", {_WHAT[near[0]]}" if near[0] in _WHAT and near[0] == meant else ""
        return f"did you mean {near[0]!r}{what}?"
    return f"known are {', '.join(known)}" if len(known) <= MAX_LISTED_KEYS else ""
