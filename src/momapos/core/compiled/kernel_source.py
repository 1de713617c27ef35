"""The source and the argument types of a kernel, and a stamp of all that its code depends on.

Annotations give the types of arguments. A record of arrays is a NamedTuple with fields annotated in
the same way; plain tuples are `tuple[...]`, numbers `int`, `float` and `bool`.
"""

from __future__ import annotations

import hashlib
import types
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

_C, _ALIGNED, _WRITEABLE = 0x1, 0x100, 0x400  # numpy's flags
_NUMBERS: dict[type, tuple[type, ...]] = {
    int: (int, np.int64),
    float: (float, np.float64),
    bool: (bool, np.bool_),
    np.uint64: (np.uint64,),
}


@dataclass(frozen=True)
class Array:
    """A C-contiguous array."""

    dtype: np.dtype
    ndim: int
    readonly: bool = False
    """Whether the kernel only reads it, so that read-only arrays are accepted."""


F1 = Annotated[np.ndarray, Array(np.dtype("f8"), 1)]
F2 = Annotated[np.ndarray, Array(np.dtype("f8"), 2)]
F3 = Annotated[np.ndarray, Array(np.dtype("f8"), 3)]
F4 = Annotated[np.ndarray, Array(np.dtype("f8"), 4)]
I1 = Annotated[np.ndarray, Array(np.dtype("i8"), 1)]
I2 = Annotated[np.ndarray, Array(np.dtype("i8"), 2)]
B1 = Annotated[np.ndarray, Array(np.dtype("?"), 1)]
B2 = Annotated[np.ndarray, Array(np.dtype("?"), 2)]
U1 = Annotated[np.ndarray, Array(np.dtype("u8"), 1)]
U2 = Annotated[np.ndarray, Array(np.dtype("u8"), 2)]
U3 = Annotated[np.ndarray, Array(np.dtype("u8"), 3)]
U4 = Annotated[np.ndarray, Array(np.dtype("u8"), 4)]
S2 = Annotated[np.ndarray, Array(np.dtype("f4"), 2)]
S3 = Annotated[np.ndarray, Array(np.dtype("f4"), 3)]
C1 = Annotated[np.ndarray, Array(np.dtype("i1"), 1)]
C2 = Annotated[np.ndarray, Array(np.dtype("i1"), 2)]
ReadI8 = Annotated[np.ndarray, Array(np.dtype("i1"), 1, readonly=True)]

Fits = Callable[[Any], bool]


def argument_types(function: Callable[..., object]) -> list[Any]:
    """Return the annotations of a function's arguments, in order."""
    hints = typing.get_type_hints(function, include_extras=True)
    code = function.__code__
    return [hints[name] for name in code.co_varnames[: code.co_argcount]]


def fields(hint: Any) -> list[Any] | None:
    """Return the types of the members of a record or tuple; None for other types."""
    if typing.get_origin(hint) is tuple:
        return list(typing.get_args(hint))
    if isinstance(hint, type) and issubclass(hint, tuple):
        hints = typing.get_type_hints(hint, include_extras=True)
        return [hints[name] for name in hint._fields]  # type: ignore[attr-defined]
    return None


def array_of(hint: Any) -> Array | None:
    """Return the array type that an annotation holds, if any."""
    for extra in getattr(hint, "__metadata__", ()):
        if isinstance(extra, Array):
            return extra
    return None


def checker(hint: Any) -> Fits:
    """Return a function that checks whether a value has exactly the memory layout of a type.

    Raises:
        TypeError: Entries do not support the annotation.
    """
    array = array_of(hint)
    if array is not None:
        return _array_checker(array)
    members = fields(hint)
    if members is not None:
        return _tuple_checker(hint, [checker(member) for member in members])
    if hint in _NUMBERS:
        kinds = _NUMBERS[hint]
        return lambda value: type(value) in kinds
    raise TypeError(f"entries do not support the argument type {hint!r}")


def _array_checker(array: Array) -> Fits:
    dtype, ndim = array.dtype, array.ndim
    need = _C | _ALIGNED | (0 if array.readonly else _WRITEABLE)

    def fits(value: Any) -> bool:
        return (
            type(value) is np.ndarray
            and value.ndim == ndim
            and (value.dtype is dtype or value.dtype == dtype)
            and value.flags.num & need == need
        )

    return fits


def _tuple_checker(hint: Any, members: list[Fits]) -> Fits:
    kind = typing.get_origin(hint) or hint
    last: Any = None

    def fits(value: Any) -> bool:
        # The same record is often passed again, and its arrays do not change their type.
        nonlocal last
        if value is last:
            return True
        if type(value) not in (kind, tuple) or len(value) != len(members):
            return False
        for member, item in zip(members, value, strict=True):  # faster than all()
            if not member(item):
                return False
        last = value
        return True

    return fits


Options = dict[str, Any]
_NAMED = types.ModuleType | types.BuiltinFunctionType | types.FunctionType | type
"""What a stamp names: modules, functions of libraries or of `lanes`, and types."""


class KernelSource:
    """A Python function to compile, with its options; an entry also has argument types."""

    def __init__(self, function: Callable[..., Any], is_entry: bool, options: Options) -> None:
        self.py_func = function
        self.options = options
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.is_entry = is_entry

    @cached_property
    def types(self) -> list[Any]:
        """Return the annotated types of the arguments."""
        return argument_types(self.py_func)

    @cached_property
    def stamp(self) -> str:
        """Return a hash of this function and of all kernels that it calls.

        The hash covers functions, not files: an edited kernel invalidates itself and its callers,
        an edited comment nothing.
        """
        digest = hashlib.sha256()
        seen: set[str] = set()
        waiting: list[KernelSource] = [self]
        while waiting:
            one = waiting.pop()
            if one.name in seen:
                continue
            seen.add(one.name)
            digest.update(repr([(k, _ordered(v)) for k, v in sorted(one.options.items())]).encode())
            for part in _code_parts(one.py_func.__code__, one.py_func.__doc__):
                digest.update(repr(part).encode() + b"\n")
            for name, value in sorted(_globals(one.py_func)):
                if isinstance(value, KernelSource):
                    waiting.append(value)
                    value = value.name
                elif isinstance(value, _NAMED):
                    value = value.__name__
                digest.update(f"{name} {value!r}\n".encode())
            waiting.sort(key=lambda k: k.name)
        if self.is_entry:
            digest.update(repr([_type_content(hint) for hint in self.types]).encode())
        return digest.hexdigest()[:32]


def _code_parts(code: types.CodeType, doc: str | None = None) -> Iterator[object]:
    """Iterate over the content of a function's code, without its location and docstring."""
    yield code.co_code
    yield code.co_names, code.co_varnames, code.co_argcount
    # Only a docstring comes first: the code of a comprehension begins with its own constants.
    for const in code.co_consts[1:] if doc and code.co_consts[:1] == (doc,) else code.co_consts:
        if isinstance(const, types.CodeType):
            yield from _code_parts(const)
        else:
            yield const


def _globals(function: Any) -> Iterator[tuple[str, object]]:
    """Iterate over the globals that a function uses, with their values."""
    waiting = [function.__code__]
    while waiting:
        code = waiting.pop()
        waiting += [const for const in code.co_consts if isinstance(const, types.CodeType)]
        for name in code.co_names:
            if name in function.__globals__:
                yield name, function.__globals__[name]


def _type_content(hint: Any) -> object:
    """Return what an annotation means, as plain values."""
    array = array_of(hint)
    if array is not None:
        return array.dtype.str, array.ndim, array.readonly
    members = fields(hint)
    if members is not None:
        names = getattr(hint, "_fields", ())
        contents = [_type_content(member) for member in members]
        return getattr(hint, "__name__", "tuple"), names, contents
    return hint.__name__


def _ordered(option: object) -> object:
    """Return sets in an order that is the same in every process."""
    return sorted(option) if isinstance(option, set) else option
