"""Cache what a function computes for an object in this object, so that both live equally long.

A module's cache, such as `functools.lru_cache`, would keep the last robots and scenes of a program
alive, with everything that is computed for them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import wraps
from typing import Any, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

P = ParamSpec("P")
T = TypeVar("T")

MAX_RESULTS = 512
"""Number of results of a function in one object, and number of other objects with results in it;
an object has fewer parts and links [-]."""
_ATTRIBUTE = "_results"
_OBJECT = object()
"""Stands in a key for an argument that is compared by identity."""
_ABSENT = object()


class _Results:
    """The results that an object owns. They stay behind when it is copied or pickled."""

    __slots__ = ("of_function", "owner")

    def __init__(self, owner: int = 0) -> None:
        self.owner = owner
        """The `id` of the object. A copy of the object has the same attributes, but another id."""
        self.of_function: dict[Hashable, Any] = {}

    def __reduce__(self) -> tuple[type[_Results], tuple[()]]:
        return _Results, ()


def owner_cache(
    size: int = MAX_RESULTS, *, owner: Callable[[Any], Any] | None = None
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Cache a function's results in the object that is its first argument.

    Other arguments that are compared by identity, such as a scene, are held weakly: a result is
    dropped with the first of these objects that no longer exists. So a result may refer to its
    owner, but not to other such arguments. Arguments that are compared by value, such as names,
    numbers and configurations, are part of the key. Copies and pickles of an object begin without
    results, and so do objects made by `dataclasses.replace`.

    Args:
        size: Number of results in one object, and number of other objects with results in it; the
            oldest is dropped first.
        owner: Returns the object that owns the result of a first argument that is compared by
            value; by default that is the argument itself.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def wrapper(*args: P.args, **named: P.kwargs) -> T:
            first, key = args[0], args[1:]
            if owner is not None:
                first, key = owner(first), args
            attributes = vars(first)
            results = attributes.get(_ATTRIBUTE)
            if results is None:
                results = attributes.setdefault(_ATTRIBUTE, _Results(id(first)))
            if results.owner != id(first):
                results = attributes[_ATTRIBUTE] = _Results(id(first))
            if named:
                key = (*key, *named.items())
            others = [arg for arg in key if _is_object(type(arg))]
            if others:
                key = tuple(_OBJECT if _is_object(type(arg)) else arg for arg in key)
            level = _next(results.of_function, (function, len(others)), others)
            for k, other in enumerate(others, 1):
                level = _next(level, other, others[k:], size)
            found = level.get(key, _ABSENT)
            if found is _ABSENT:
                found = level.setdefault(key, function(*args, **named))
                _limit(level, size)
            return found

        return wrapper

    return decorate


def _is_object(kind: type) -> bool:
    """Check whether values of a type are compared by identity, and can be held weakly."""
    return kind.__hash__ is object.__hash__ and kind.__weakrefoffset__ != 0


def _next(level: Any, key: Any, others: list[Any], size: int | None = None) -> Any:
    """Return the results for a key, or for the objects that follow it; made on first use."""
    found = level.get(key)
    if found is None:
        found = level.setdefault(key, WeakKeyDictionary() if others else {})
        if size is not None:
            _limit(level, size)
    return found


def _limit(level: Any, size: int) -> None:
    """Drop the oldest entries beyond a number."""
    while len(level) > size:
        with suppress(KeyError, StopIteration, RuntimeError):  # another thread has changed it
            del level[next(iter(level))]
