"""Read and write the confidences of a scan in scene files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from momapos.core import SceneError, unknown_name
from momapos.model.records import Confidence


def confidence_to_json(sure: Confidence) -> dict[str, Any]:
    """Convert the confidence of an object to the content of a scene file."""
    entry: dict[str, Any] = {"object": round(sure.object, 3), "label": round(sure.label, 3)}
    for key, found in (("joints", sure.joints), ("handles", sure.handles)):
        if found:
            entry[key] = {name: round(value, 3) for name, value in found.items()}
    return entry


def read_confidence(value: object, joints: Sequence[str], where: str) -> Confidence | None:
    """Read the confidence of an object; None if the file has none.

    Args:
        value: Content of the file.
        joints: The object's movable joints.
        where: File and object, for messages.

    Raises:
        SceneError: A value is not a number from 0 to 1.
        UnknownNameError: The object has no such joint.
    """
    if value is None:
        return None
    where = f"{where}: confidence"
    if not isinstance(value, dict):
        raise SceneError(f'{where} must be {{"object": ..., "label": ...}}')
    both = _shares({key: value.get(key) for key in ("object", "label")}, where)
    parts = []
    for key in ("joints", "handles"):
        found = value.get(key, {})
        if not isinstance(found, dict):
            raise SceneError(f"{where}: {key} must be {{joint: number}}")
        for name in found:
            if name not in joints:
                raise unknown_name("movable joint", name, joints, f"{where}: {key}")
        parts.append(_shares(found, f"{where}: {key}"))
    return Confidence(both["object"], both["label"], *parts)


def _shares(values: Mapping[str, Any], where: str) -> dict[str, float]:
    for name, value in values.items():
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not 0 <= value <= 1:
            raise SceneError(f"{where}: {name!r:.60} must be a number from 0 to 1")
    return {name: float(value) for name, value in values.items()}
