"""Read and write the motion hypotheses of parts in scene files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, get_args

import numpy as np

from momapos.core import SceneError, unknown_name
from momapos.model.records import Hypothesis, PartKind

KINDS: tuple[PartKind, ...] = get_args(PartKind)
MAX_HYPOTHESES = 16
"""Maximum number of hypotheses of a joint [-]."""
ROUNDING_TOLERANCE = 1e-3
"""Tolerance of rounded probabilities and of unit vectors [-]."""
MAX_COORDINATE = 1e3
"""Maximum coordinate of a point on an axis, in the object's frame [m]."""


def hypotheses_to_json(found: Sequence[Hypothesis]) -> list[dict[str, Any]]:
    """Convert the hypotheses of a joint to the content of a scene file."""
    return [
        {
            "kind": one.kind,
            "probability": round(one.probability, 4),
            "point": list(one.point),
            "axis": list(one.axis),
            "upper": round(one.upper, 5),
        }
        for one in found
    ]


def read_hypotheses(
    value: object, joints: Mapping[str, bool], where: str
) -> dict[str, tuple[Hypothesis, ...]]:
    """Read the hypotheses of an object's joints.

    Args:
        value: Content of the file.
        joints: The object's movable joints, and whether each slides.
        where: File and object, for messages.

    Raises:
        SceneError: A value is invalid, the probabilities of a joint do not sum to 1 or increase, or
            the first hypothesis is not the joint of the URDF.
        UnknownNameError: The object has no such joint.
    """
    if not isinstance(value, dict):
        raise SceneError(f"{where}: hypotheses must be {{joint: [...]}}")
    found = {}
    for name, rows in value.items():
        if name not in joints:
            raise unknown_name("movable joint", name, list(joints), f"{where}: hypotheses")
        at = f"{where}: hypotheses of {name!r}"
        if not isinstance(rows, list) or not 1 <= len(rows) <= MAX_HYPOTHESES:
            raise SceneError(f"{at} must be a list of 1 to {MAX_HYPOTHESES} hypotheses")
        found[name] = tuple(_hypothesis(row, f"{at}: {k}") for k, row in enumerate(rows))
        total = sum(one.probability for one in found[name])
        if abs(total - 1.0) > ROUNDING_TOLERANCE * len(rows):
            raise SceneError(f"{at}: the probabilities sum to {total:.4g}; they must sum to 1")
        _check_first(found[name], joints[name], at)
    return found


def _check_first(found: Sequence[Hypothesis], slides: bool, at: str) -> None:
    """Check that the most probable hypothesis stands first and fits the joint of the URDF.

    Planners take the joint of the URDF for the most probable one.
    """
    for before, after in pairwise(found):
        if after.probability > before.probability:
            raise SceneError(
                f"{at}: {after.kind} ({after.probability:g}) stands after the less probable "
                f"{before.kind} ({before.probability:g}); list the most probable first, which is "
                "the joint of the URDF"
            )
    if (found[0].kind == "drawer") != slides:
        joint = "prismatic" if slides else "a hinge"
        raise SceneError(
            f"{at}: the first is a {found[0].kind}, but the joint of the URDF is {joint}; the "
            "first must be the joint of the URDF"
        )


def _hypothesis(row: object, where: str) -> Hypothesis:
    if not isinstance(row, dict):
        raise SceneError(f"{where} must be a JSON object")
    kind = next((known for known in KINDS if known == row.get("kind")), None)
    if kind is None:
        given = f"{row.get('kind')!r:.40}"
        raise SceneError(f"{where}: kind {given} must be one of {', '.join(KINDS)}")
    point, axis = (_triple(row, key, where) for key in ("point", "axis"))
    if abs(float(np.linalg.norm(axis)) - 1.0) > ROUNDING_TOLERANCE:
        raise SceneError(f"{where}: axis must have length 1")
    probability, upper = (_number(row, key, where) for key in ("probability", "upper"))
    if not 0.0 <= probability <= 1.0:
        raise SceneError(f"{where}: probability {probability:g} must be from 0 to 1")
    if not 0.0 <= upper <= MAX_COORDINATE:
        raise SceneError(f"{where}: upper must be 0 or more, not {upper:g}")
    return Hypothesis(kind, probability, point, axis, upper)


def _triple(row: Mapping[str, Any], key: str, where: str) -> tuple[float, float, float]:
    values = row.get(key)
    if not isinstance(values, list) or len(values) != 3:
        raise SceneError(f"{where}: {key} must be 3 numbers")
    x, y, z = (_number({key: value}, key, where) for value in values)
    return x, y, z


def _number(row: Mapping[str, Any], key: str, where: str) -> float:
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SceneError(f"{where}: {key} must be a number")
    # Compare integers of any length before converting to float, which may overflow.
    if not -MAX_COORDINATE <= value <= MAX_COORDINATE:
        raise SceneError(f"{where}: {key} must be a finite number within {MAX_COORDINATE:g}")
    return float(value)
