"""The two decorators, and what a kernel depends on."""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

from . import arrays

Options = dict[str, Any]
ENTRIES: dict[str, Kernel] = {}
"""Every entry of the modules imported so far, by its name."""


class Kernel:
    """A compiled function.

    Kernels that call it take its compiled form. Python calls its stored machine code where it is an
    entry and the arguments are of the annotated types, and numba's dispatcher otherwise.
    """

    def __init__(self, function: Callable[..., Any], is_entry: bool, options: Options) -> None:
        self.py_func = function
        self.options = options
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        self.__wrapped__ = function
        self.is_entry = is_entry
        self._native: Callable[..., Any] | None = None
        if is_entry:
            ENTRIES[self.name] = self

    def __call__(self, *args: Any) -> Any:
        """Run it."""
        if self.is_entry:
            checks = self._checks
            if len(args) == len(checks):
                for fits, arg in zip(checks, args, strict=True):
                    if not fits(arg):
                        break
                else:
                    return (self._native or self.load())(*args)
        return self.dispatcher(*args)

    def load(self) -> Callable[..., Any]:
        """The machine code, from where it is stored, or compiled now."""
        if self._native is None:
            from .code_store import store

            self._native = store.native(self)
        return self._native

    @cached_property
    def types(self) -> list[Any]:
        """Types of the arguments."""
        return arrays.argument_types(self.py_func)

    @cached_property
    def _checks(self) -> list[arrays.Fits]:
        return [arrays.checker(hint) for hint in self.types]

    @cached_property
    def dispatcher(self) -> Any:
        """numba's dispatcher, for arguments of any type."""
        from .compiler import dispatcher

        return dispatcher(self)

    @cached_property
    def _inner(self) -> Any:
        from .compiler import inner

        return inner(self)

    @property
    def _numba_type_(self) -> Any:
        """What numba takes a kernel for inside another: this is numba's own protocol."""
        return self._inner._numba_type_

    @cached_property
    def stamp(self) -> str:
        """Hash of all that the machine code is made from: this function and all that it calls.

        Functions count, not files: an edited kernel has itself and its callers compiled anew, and
        an edited comment nothing.
        """
        digest = hashlib.sha256()
        seen: set[str] = set()
        waiting: list[Kernel] = [self]
        while waiting:
            one = waiting.pop()
            if one.name in seen:
                continue
            seen.add(one.name)
            digest.update(repr([(k, _ordered(v)) for k, v in sorted(one.options.items())]).encode())
            for part in _parts(one.py_func.__code__):
                digest.update(repr(part).encode() + b"\n")
            for name, value in sorted(_globals(one.py_func)):
                if isinstance(value, Kernel):
                    waiting.append(value)
                    value = value.name
                elif isinstance(value, types.ModuleType | types.BuiltinFunctionType | type):
                    value = value.__name__
                digest.update(f"{name} {value!r}\n".encode())
            waiting.sort(key=lambda k: k.name)
        if self.is_entry:
            digest.update(repr([_spelled(hint) for hint in self.types]).encode())
        return digest.hexdigest()[:32]


def _parts(code: types.CodeType) -> Iterator[object]:
    """What a function's code says, without where it stands."""
    yield code.co_code
    yield code.co_names, code.co_varnames, code.co_argcount
    for const in code.co_consts[1:] if code.co_consts[:1] != (None,) else code.co_consts:
        if isinstance(const, types.CodeType):
            yield from _parts(const)
        else:
            yield const


def _globals(function: Any) -> Iterator[tuple[str, object]]:
    """The globals that a function names, with their values."""
    waiting = [function.__code__]
    while waiting:
        code = waiting.pop()
        waiting += [const for const in code.co_consts if isinstance(const, types.CodeType)]
        for name in code.co_names:
            if name in function.__globals__:
                yield name, function.__globals__[name]


def _spelled(hint: Any) -> object:
    """An annotation by content."""
    array = arrays.array_of(hint)
    if array is not None:
        return array.dtype.str, array.ndim, array.readonly
    members = arrays.fields(hint)
    if members is not None:
        names = getattr(hint, "_fields", ())
        return getattr(hint, "__name__", "tuple"), names, [_spelled(member) for member in members]
    return hint.__name__


def _ordered(option: object) -> object:
    """A set in an order that is the same in every process."""
    return sorted(option) if isinstance(option, set) else option


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Make a kernel of a function that other kernels call; options are those of `numba.njit`."""
    if function is None:
        return lambda given: Kernel(given, False, options)
    return Kernel(function, False, options)


def entry(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Make a kernel of a function that Python calls, with arguments of the annotated types."""
    if function is None:
        return lambda given: Kernel(given, True, options)
    return Kernel(function, True, options)
