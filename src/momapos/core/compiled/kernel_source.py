"""The Python source of a kernel, and a stamp of everything that its machine code depends on."""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

from . import arrays

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
        return arrays.argument_types(self.py_func)

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
    array = arrays.array_of(hint)
    if array is not None:
        return array.dtype.str, array.ndim, array.readonly
    members = arrays.fields(hint)
    if members is not None:
        names = getattr(hint, "_fields", ())
        contents = [_type_content(member) for member in members]
        return getattr(hint, "__name__", "tuple"), names, contents
    return hint.__name__


def _ordered(option: object) -> object:
    """Return sets in an order that is the same in every process."""
    return sorted(option) if isinstance(option, set) else option
