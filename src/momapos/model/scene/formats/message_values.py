"""Read the values of a ROS message that is written as YAML."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError, shown
from momapos.core.geometry import pose_wxyz

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_NUMBER = 1e6
"""Maximum magnitude of a number [-]."""
MAX_LIST = 1_000_000
"""Maximum length of a list [-]."""


class Message:
    """The fields of a message; each error names the field."""

    def __init__(self, value: Any, where: str) -> None:
        if not isinstance(value, dict):
            raise FileFormatError(f"{where} must be a mapping, not {shown(value)}")
        self.value, self.where = value, where

    def __contains__(self, key: str) -> bool:
        return self.value.get(key) is not None

    def error(self, text: str) -> FileFormatError:
        """Return an error about this message."""
        return FileFormatError(f"{self.where}: {text}")

    def part(self, key: str) -> Message:
        """Return a message in a field; an empty one if the field is missing."""
        value = self.value.get(key)
        return Message({} if value is None else value, f"{self.where}: {key}")

    def values(self, key: str) -> list[Any]:
        """Return the list in a field; an empty one if the field is missing."""
        value = self.value.get(key)
        value = [] if value is None else value
        if not isinstance(value, list) or len(value) > MAX_LIST:
            raise self.error(f"{key} must be a list, not {shown(value)}")
        return value

    def parts(self, key: str) -> Iterator[Message]:
        """Yield the messages in a list."""
        for number, value in enumerate(self.values(key)):
            yield Message(value, f"{self.where}: {key} {number}")

    def text(self, key: str) -> str:
        """Return the text in a field; "" if it is missing."""
        value = self.value.get(key)
        if value is None:
            return ""
        if isinstance(value, list | dict):
            raise self.error(f"{key} must be text, not {shown(value)}")
        return str(value)[:1000]

    def numbers(self, key: str, count: int | None, names: str = "") -> Float[np.ndarray, " n"]:
        """Return numbers in a field.

        Args:
            key: The field, which must exist.
            count: How many there must be; None for any number.
            names: Letters of the fields, if the numbers may also be a message, such as "xyz".
        """
        return as_numbers(self.value.get(key), count, f"{self.where}: {key}", names)

    def pose(self, first: str = "position", then: str = "orientation") -> Float[np.ndarray, "4 4"]:
        """Return the pose that this message is.

        A missing part or a quaternion of zeros means none, as in MoveIt.
        """
        xyz = self.numbers(first, 3, "xyz") if first in self else np.zeros(3)
        x, y, z, w = self.numbers(then, 4, "xyzw") if then in self else np.zeros(4)
        length = math.hypot(x, y, z, w)
        if length == 0:
            w = length = 1.0
        if not 0.9 < length < 1.1:
            raise self.error(f"{then} has length {length:g}; it must be 1")
        return pose_wxyz(tuple(xyz.tolist()), (w, x, y, z))


def as_numbers(value: Any, count: int | None, where: str, names: str = "") -> np.ndarray:
    """Return a list or a message of finite numbers.

    Raises:
        FileFormatError: It has others, or another number of them.
    """
    if isinstance(value, dict) and set(value) <= set(names):
        value = [value.get(name, 0.0) for name in names]
    rows = value if isinstance(value, list) and len(value) <= MAX_LIST else [None]
    numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in rows)
    array = np.array(rows, float) if numeric else np.full(1, np.nan)
    if (count not in (None, len(rows))) or not (np.abs(array) <= MAX_NUMBER).all():
        wanted = "finite numbers" if count is None else f"{count} finite numbers"
        raise FileFormatError(f"{where} must be {wanted}, not {shown(value)}")
    return array
