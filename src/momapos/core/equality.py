"""Equality and hashes of records that hold arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T", bound=type)


def compare_by_content(record: T) -> T:
    """Let two records of a dataclass be equal if all their fields are; arrays element by element.

    The dataclass itself is made with `eq=False`. NaN equals NaN.
    """

    def equal(self: object, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        names = [item.name for item in fields(self) if item.compare]  # type: ignore[arg-type]
        return all(_same(getattr(self, name), getattr(other, name)) for name in names)

    def digest(self: object) -> int:
        names = [item.name for item in fields(self) if item.compare]  # type: ignore[arg-type]
        return hash((type(self), *(_key(getattr(self, name)) for name in names)))

    record.__eq__ = equal  # type: ignore[assignment]
    record.__hash__ = digest  # type: ignore[assignment, method-assign]
    return record


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if type(one) is not type(other):
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f")
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[key], other[key]) for key in one)
    return bool(one == other)


def _key(value: Any) -> Any:
    """Return what is equal for values that are equal, and can be hashed."""
    if isinstance(value, np.ndarray):
        return value.shape
    if isinstance(value, tuple):
        return tuple(map(_key, value))
    if isinstance(value, Mapping):
        return frozenset((key, _key(item)) for key, item in value.items())
    return value
