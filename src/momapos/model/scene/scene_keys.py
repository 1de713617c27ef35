"""Find keys of scene files that the reader does not know, at every depth."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeAlias

MAX_IGNORED_KEYS = 100
"""Maximum number of unknown keys of a file that are reported one by one [-]."""
MAX_LISTED_KEYS = 5
"""The known keys are listed if no similar one exists and if they are at most this many [-]."""


@dataclass(frozen=True)
class Named:
    """A mapping whose keys are names that the user chooses, such as joints."""

    value: Keys


Keys: TypeAlias = "Mapping[str, Keys] | Named | None"
"""Known keys of a value, or of each item of a list; None for values without keys."""

_HYPOTHESIS: Keys = dict.fromkeys(("kind", "probability", "point", "axis", "upper"))
_OBJECT: Keys = {
    "name": None,
    "category": None,
    "pose": {"xyz": None, "wxyz": None},
    "urdf": None,
    "scale": None,
    "box": None,
    "joints": Named(None),
    "closed": Named(None),
    "mass": None,
    "resistance": Named(None),
    "latch": dict.fromkeys(("joint", "to", "holds")),
    "hypotheses": Named(_HYPOTHESIS),
    "confidence": {"object": None, "label": None, "joints": Named(None), "handles": Named(None)},
}
SCENE_KEYS: Keys = {
    "format": None,
    "version": None,
    "name": None,
    "floor": None,
    "walls": dict.fromkeys(("from", "to", "height", "thickness")),
    "map": None,
    "start": {"x": None, "y": None, "yaw": None},
    "areas": Named(None),
    "objects": _OBJECT,
}
"""Keys of a momapos scene."""
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
    found = tuple(islice(_unknown(data, keys, where, ""), MAX_IGNORED_KEYS + 1))
    if len(found) > MAX_IGNORED_KEYS:
        rest = IgnoredKey(where, "", "...", f"more than {MAX_IGNORED_KEYS} unknown keys")
        return (*found[:MAX_IGNORED_KEYS], rest)
    return found


def _unknown(data: Any, keys: Keys, where: str, owner: str) -> Iterator[IgnoredKey]:
    if keys is None:
        return
    if isinstance(data, list):
        for index, item in enumerate(data):
            named = _name_of(item) if not owner else ""
            what = "wall" if where.endswith(": walls") else "object"
            at = f"{where} {index}" if owner else f"{where}: {what} {index}"
            yield from _unknown(item, keys, f"{at} ({named!r})" if named else at, owner or named)
        return
    if not isinstance(data, dict):
        return
    if isinstance(keys, Named):
        for name, value in data.items():
            yield from _unknown(value, keys.value, f"{where}: {name!r:.80}", owner)
        return
    for key in sorted(set(data) - set(keys)):
        yield IgnoredKey(where, owner, key, _advice(key, sorted(keys)))
    for key in (known for known in keys if known in data):
        at = where if key == "objects" and not owner else f"{where}: {key}"
        yield from _unknown(data[key], keys[key], at, owner)


def _name_of(item: Any) -> str:
    name = item.get("name", item.get("obj_name")) if isinstance(item, dict) else ""
    return name[:80] if isinstance(name, str) else ""


def _advice(key: str, known: list[str]) -> str:
    meant = _MEANT.get(key.lower(), "")
    near = [meant] if meant in known else difflib.get_close_matches(key.lower(), known, n=1)
    if near:
        what = f", {_WHAT[near[0]]}" if near[0] in _WHAT and near[0] == meant else ""
        return f"did you mean {near[0]!r}{what}?"
    return f"known are {', '.join(known)}" if len(known) <= MAX_LISTED_KEYS else ""
