"""Cache what a function computes for an object in this object, so that both live equally long.

A module's cache, such as `functools.lru_cache`, would keep the last robots and scenes of a program
alive, with everything that is computed for them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import suppress
from functools import partial, wraps
from typing import Any, ParamSpec, TypeVar
from weakref import ref

P = ParamSpec("P")
T = TypeVar("T")

MAX_RESULTS = 512
"""Number of results of a function in one object, by default; a robot has some for each part that it
moves [-]."""
_ATTRIBUTE = "_results"
_by_identity = object.__hash__
_Known = dict[tuple[Hashable, ...], tuple[Any, tuple["ref[Any]", ...]]]
"""Results by key, each with references to the other objects that it belongs to."""


class _Results:
    """The results that an object owns. They stay behind when it is copied or pickled."""

    __slots__ = ("__weakref__", "of_function", "owner")

    def __init__(self, owner: int = 0) -> None:
        self.owner = owner
        """The `id` of the object. A copy of the object has the same attributes, but another id."""
        self.of_function: dict[Callable[..., Any], _Known] = {}

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
        size: Number of results in one object; the oldest is dropped first.
        owner: Returns the object that owns the result of a first argument that is compared by
            value; by default that is the argument itself.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def wrapper(*args: P.args, **named: P.kwargs) -> T:
            first: Any = args[0]
            key: list[Any] = []
            others: list[Any] = []
            if owner is not None:
                key.append(first)
                first = owner(first)
            for arg in (*args[1:], *named.items()) if named else args[1:]:
                kind = type(arg)
                if kind.__hash__ is _by_identity and kind.__weakrefoffset__:
                    others.append(arg)
                    arg = id(arg)
                key.append(arg)
            results = first.__dict__.get(_ATTRIBUTE)
            if results is None or results.owner != id(first):
                results = _begin(first)
            known = results.of_function.get(function)
            if known is None:
                known = results.of_function.setdefault(function, {})
            at = tuple(key)
            found = known.get(at)
            if found is not None and (not others or _belongs(found[1], others)):
                return found[0]
            value = function(*args, **named)
            forget = partial(_forget, ref(results), function, at)
            new = value, tuple(ref(one, forget) for one in others)
            found = known.setdefault(at, new)  # another thread may have been faster
            if not _belongs(found[1], others):
                found = known[at] = new
            while len(known) > size:
                with suppress(KeyError, StopIteration, RuntimeError):  # another thread changes it
                    del known[next(iter(known))]
            return found[0]

        return wrapper

    return decorate


def _begin(owner: object) -> _Results:
    """Return the results of an object that has none of its own yet."""
    attributes, new = vars(owner), _Results(id(owner))
    found: _Results = attributes.setdefault(_ATTRIBUTE, new)
    if found.owner != id(owner):  # of the object that this one is a copy of
        found = attributes[_ATTRIBUTE] = new
    return found


def _belongs(references: tuple[ref[Any], ...], others: list[Any]) -> bool:
    """Check whether a result belongs to these objects, not to earlier ones with the same `id`."""
    return [one() for one in references] == others


def _forget(
    owned: ref[_Results], function: Callable[..., Any], key: tuple[Hashable, ...], _dead: object
) -> None:
    """Drop a result, because one of the objects that it belongs to no longer exists."""
    results = owned()
    if results is not None:
        results.of_function[function].pop(key, None)
