"""Checked access to the values of a robot file."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import RobotError, is_name

if TYPE_CHECKING:
    from jaxtyping import Float


class TomlTable:
    """A TOML table whose values are checked on access."""

    def __init__(self, data: Mapping[str, Any], path: Path, prefix: str = "") -> None:
        self.data, self.path, self.prefix = data, path, prefix

    def _take(self, key: str) -> Any:
        if key not in self.data:
            near = difflib.get_close_matches(key, self.data, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise RobotError(f"{self.path}: {self.prefix}{key} is missing{hint}")
        return self.data[key]

    def table(self, key: str) -> TomlTable:
        value = self._take(key)
        if not isinstance(value, dict):
            raise RobotError(f"{self.path}: [{self.prefix}{key}] must be a table")
        return TomlTable(value, self.path, f"{self.prefix}{key}.")

    def tables(self, key: str, most: int = 100) -> dict[str, TomlTable]:
        """Return the tables within a table by name; empty if the table is missing."""
        if key not in self.data:
            return {}
        outer = self.table(key)
        if len(outer.data) > most:
            raise RobotError(f"{self.path}: [{self.prefix}{key}] has more than {most} tables")
        return {name: outer.table(name) for name in outer.data}

    def text(self, key: str) -> str:
        value = self._take(key)
        if not is_name(value):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a printable text, not empty")
        return value

    def texts(self, key: str) -> Sequence[str]:
        value = self._take(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a list of names")
        return value

    def choice(self, key: str, options: Sequence[str], default: str | None = None) -> str:
        value = default if default is not None and key not in self.data else self.text(key)
        if value not in options:
            raise RobotError(
                f"{self.path}: {self.prefix}{key} is {value!r}; it must be {' or '.join(options)}"
            )
        return value

    def flag(self, key: str) -> bool:
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be true or false")
        return value

    def positive(self, key: str, default: float) -> float:
        value = self.data.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e6:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a number > 0 and < 1e6")
        return float(value)

    def number(self, key: str, default: float = 0.0) -> float:
        value = self.data.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a number of magnitude < 1e6")
        return float(value)

    def _numbers(self, key: str) -> Float[np.ndarray, "..."]:
        given = self._take(key)
        try:
            if not _only_numbers(given):
                raise ValueError(key)
            value = np.array(given, float)
        except (TypeError, ValueError, OverflowError) as error:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be numbers") from error
        if not np.isfinite(value).all():
            raise RobotError(f"{self.path}: {self.prefix}{key} must not contain NaN or infinity")
        return value

    def vector(self, key: str) -> Float[np.ndarray, " n"]:
        value = self._numbers(key)
        if value.ndim != 1:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a list of numbers")
        return value

    def matrix(self, key: str, columns: int) -> Float[np.ndarray, "n columns"]:
        value = self._numbers(key)
        if value.ndim != 2 or value.shape[1] != columns:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be rows of {columns} numbers")
        return value

    def unit(self, key: str) -> Float[np.ndarray, "3"]:
        value = self.vector(key)
        if value.shape != (3,) or not 1e-9 < (length := math.hypot(*value)) < 1e9:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be 3 numbers, not all 0")
        return value / length


def _only_numbers(value: object) -> bool:
    """Return whether a value is a number, or rows of numbers; texts and bools are none."""
    if isinstance(value, list):
        return all(map(_only_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)
