"""Read texts, numbers and poses of SDF elements."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import FileFormatError
from momapos.core.geometry import pose_rpy

if TYPE_CHECKING:
    from jaxtyping import Float


def text_of(element: Element, key: str) -> str:
    """Return the text of a child element; "" if it is missing."""
    return (element.findtext(key) or "").strip()


def pose_of(element: Element | None, where: str) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a `pose` element: x y z and roll pitch yaw.

    Raises:
        FileFormatError: The pose is invalid.
    """
    if element is None or not (element.text or "").strip():
        return np.eye(4)
    if element.get("rotation_format", "euler_rpy") != "euler_rpy":
        raise FileFormatError(f"{where}: a pose must be x y z and roll, pitch, yaw")
    x, y, z, *turn = numbers(element.text, 6, f"{where}: pose")
    if element.get("degrees", "false") in ("true", "1"):
        turn = [math.radians(angle) for angle in turn]
    return pose_rpy((x, y, z), tuple(turn))


def numbers(text: str | None, count: int | None, where: str) -> list[float]:
    """Return the numbers in a text.

    Args:
        text: The text.
        count: Required number of values; None for any.
        where: Start of messages.

    Raises:
        FileFormatError: The count is wrong, or a value is invalid.
    """
    found = [number(word, where) for word in (text or "").split()]
    if count is not None and len(found) != count:
        raise FileFormatError(f"{where}: {text!r:.80} must be {count} numbers")
    return found


def number(text: str, where: str) -> float:
    """Return a number.

    Raises:
        FileFormatError: The text is not a finite number of supported size.
    """
    try:
        value = float(text)
    except ValueError as error:
        raise FileFormatError(f"{where}: {text!r:.80} is not a number") from error
    if not abs(value) <= 1e17:
        raise FileFormatError(f"{where}: {text!r:.80} must be finite and at most 1e17")
    return value
