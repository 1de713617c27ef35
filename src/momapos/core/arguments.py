"""Checks of what callers pass; each raises an `InputError` that names the argument."""

from __future__ import annotations

import math
import os
import types
from collections.abc import Hashable, Sequence
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec

from .errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


UNIONS = (Union, types.UnionType)
_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
_SEVERAL = {int: "whole numbers", float: "numbers", str: "words"}


def expect(name: str, value: object, kind: type, hint: str = "") -> None:
    """Refuse an argument of another type.

    Args:
        name: The argument.
        value: What the caller passed.
        kind: The type that it must have.
        hint: How a right value is made, such as "load_scene reads one".

    Raises:
        InputError: It has another type.
    """
    if not isinstance(value, kind):
        more = f"; {hint}" if hint else ""
        raise InputError(f"{name} must be a {kind.__name__}, not {shown(value)}{more}")


def expect_callable(name: str, value: object) -> None:
    """Refuse an argument that cannot be called.

    Raises:
        InputError: It cannot.
    """
    if not callable(value):
        raise InputError(f"{name} must be a function, not {shown(value)}")


def finite_array(
    name: str, value: object, shape: tuple[int | None, ...]
) -> Float[np.ndarray, "*s"]:
    """Return numbers as an array of floats.

    Args:
        name: The argument.
        value: An array or nested sequences of numbers.
        shape: The shape that it must have; None where any length does.

    Raises:
        InputError: It holds anything but finite numbers, or has another shape.
    """
    import numpy as np

    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        array = np.full((), math.nan)
    fits = array.ndim == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
    )
    if not fits or not np.isfinite(array).all():
        sizes = " x ".join("n" if length is None else str(length) for length in shape)
        raise InputError(f"{name} must be {sizes} finite numbers, not {shown(value)}")
    return array


def finite_number(
    name: str, value: object, low: float = -math.inf, high: float = math.inf
) -> float:
    """Return a finite number within bounds, which themselves are allowed.

    Raises:
        InputError: It is no number, not finite, or out of bounds.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, str | bytes) or not (math.isfinite(number) and low <= number <= high):
        raise InputError(f"{name} must be {_range(low, high)}, not {shown(value)}")
    return number


def whole_number(name: str, value: object, low: int, high: int | None = None) -> int:
    """Return a whole number within bounds, which themselves are allowed.

    Raises:
        InputError: It is no whole number or out of bounds.
    """
    whole = isinstance(value, int) or type(value).__module__ == "numpy"
    try:
        number = int(value) if whole and int(value) == value else None  # type: ignore[call-overload]
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or number < low or (high is not None and number > high):
        bounds = _range(low, math.inf if high is None else high).replace("number", "whole number")
        raise InputError(f"{name} must be {bounds}, not {shown(value)}")
    return number


def as_path(name: str, value: object) -> Path:
    """Return a path that may be given as text.

    Raises:
        InputError: It is neither.
    """
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"{name} must be a path, not {shown(value)}")
    path = os.fspath(value)
    if not isinstance(path, str) or not path or "\0" in path:
        raise InputError(f"{name} must be a path, not {shown(value)}")
    return Path(path)


def one_of(name: str, value: object, known: Sequence[str]) -> None:
    """Refuse a word that is none of some.

    Raises:
        InputError: It is none of them; names those that are.
    """
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{name} must be one of {', '.join(known)}, not {shown(value)}")


def check_fields(config: Any) -> None:
    """Refuse values of a configuration that its annotations do not allow, and NaN.

    Raises:
        InputError: It names the field, its type and the value.
    """
    kind = type(config)
    hints = _hints(kind)  # type: ignore[arg-type]
    for item in fields(config):
        value = getattr(config, item.name)
        if isinstance(value, float):
            value = float(value)  # numpy's floats are floats
        try:
            msgspec.convert(value, hints[item.name], strict=True, from_attributes=False)
        except (msgspec.ValidationError, UnicodeEncodeError):  # a half of a character
            raise InputError(
                f"{kind.__name__}.{item.name} must be {type_words(hints[item.name])}, not "
                f"{shown(value)}"
            ) from None
        if any(isinstance(one, float) and math.isnan(one) for one in _parts(value)):
            raise InputError(f"{kind.__name__}.{item.name} must be a number, not {shown(value)}")


def refuse_below(config: object, least: float, *names: str) -> None:
    """Check the types of all fields of a configuration, and lower bounds of some.

    Raises:
        InputError: A field is not.
    """
    check_fields(config)
    refuse_values_below(config, least, *names)


def refuse_values_below(config: object, least: float, *names: str) -> None:
    """Check lower bounds of some fields of a configuration whose types were checked.

    Raises:
        InputError: A field is below, or infinite.
    """
    for name in names:
        value = getattr(config, name)
        if not least <= value < math.inf:
            field = f"{type(config).__name__}.{name}"
            raise InputError(f"{field} must be at least {least:g}, not {value:g}")


def refuse_above(config: object, most: float, *names: str) -> None:
    """Check upper bounds of a configuration; None is allowed.

    Raises:
        InputError: A field is larger.
    """
    for name in names:
        value = getattr(config, name)
        if value is not None and value > most:
            field = f"{type(config).__name__}.{name}"
            raise InputError(f"{field} must be at most {most}, not {value}")


def type_words(kind: Any, bounds: str = "") -> str:
    """Return the values that an annotation allows, in words, which bounds follow."""
    origin, args = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return type_words(args[0], _bounds_words(args[1]))
    if origin is Literal:
        return f"one of {', '.join(map(str, args))}" if len(args) > 1 else repr(args[0])
    if origin in UNIONS:
        left_out = (type(None), msgspec.UnsetType)
        inner = [type_words(one) for one in args if one not in left_out]
        return " or ".join([*inner, *(["none"] if type(None) in args else [])])
    if origin in (tuple, list):
        item = args[0]
        if get_origin(item) is Annotated and item.__origin__ in _SEVERAL:
            item, bounds = item.__origin__, bounds + _bounds_words(item.__metadata__[0])
        count = "" if origin is list or args[-1] is ... else f"{len(args)} "
        if item in _SEVERAL:
            return f"{count}{_SEVERAL[item]}{bounds}"
        return f"{count or 'a list of '}values{bounds}, each {type_words(item)}"
    if args:
        return f"{{name: {type_words(args[1])}}}{bounds}"
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        members = msgspec.structs.fields(kind)
        names = [f"{one.encode_name}: ..." for one in members if one.required]
        return f"{{{', '.join(names) or '...'}}}"
    return (_WORDS.get(kind) or ("{...}" if is_dataclass(kind) else f"a {kind.__name__}")) + bounds


def _bounds_words(meta: msgspec.Meta) -> str:
    if meta.ge is not None and meta.le is not None:
        return f" from {meta.ge:g} to {meta.le:g}"
    bounds = ((">", meta.gt), (">=", meta.ge), ("<", meta.lt), ("<=", meta.le))
    words = [f"{sign} {bound:g}" for sign, bound in bounds if bound is not None]
    if meta.max_length is not None:
        words = [f"of length {meta.min_length or 0} to {meta.max_length}"]
    elif meta.min_length is not None:
        words = [f"of length >= {meta.min_length}"]
    return f" {' and '.join(words)}" if words else ""


def shown(value: object) -> str:
    """Return a value as messages show it: its type, and short values themselves."""
    if isinstance(value, str | bytes | bool | int | float | None | list | tuple | dict):
        text = repr(value)
        return text if len(text) <= 60 else f"{text[:57]}..."
    return f"a {type(value).__name__}"


@lru_cache(maxsize=64)
def _hints(kind: Hashable) -> dict[str, Any]:
    return get_type_hints(kind)


def _parts(value: object) -> Sequence[object]:
    return value if isinstance(value, tuple) else (value,)


def _range(low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return "a finite number"
    if math.isinf(high):
        return f"a number of at least {low:g}"
    if math.isinf(low):
        return f"a number of at most {high:g}"
    return f"a number from {low:g} to {high:g}"
