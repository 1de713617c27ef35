"""The decorators `kernel` and `entry`, which make compiled functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

from momapos.core.stopwatch import look

from . import kernel_source
from .kernel_source import KernelSource, Options

ENTRIES: dict[str, Kernel] = {}
"""Entries of all modules imported so far, by name."""


class Kernel(KernelSource):
    """A compiled function.

    Other kernels call its compiled form. From Python, an entry whose arguments have the annotated
    types runs the stored machine code; everything else goes through numba's dispatcher.
    """

    def __init__(self, function: Callable[..., Any], is_entry: bool, options: Options) -> None:
        super().__init__(function, is_entry, options)
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        self.__wrapped__ = function
        self._native: Callable[..., Any] | None = None
        if is_entry:
            ENTRIES[self.name] = self

    def __call__(self, *args: Any) -> Any:
        """Run the kernel, unless a time limit is over."""
        look()
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
        """Return the machine code, loaded from the store or compiled now."""
        if self._native is None:
            from .code_store import store

            self._native = store.native(self)
        return self._native

    @cached_property
    def _checks(self) -> list[kernel_source.Fits]:
        return [kernel_source.checker(hint) for hint in self.types]

    @cached_property
    def dispatcher(self) -> Any:
        """Return numba's dispatcher, for arguments of any type."""
        from .compiler import dispatcher

        return dispatcher(self)

    @cached_property
    def _inner(self) -> Any:
        from .compiler import inner

        return inner(self)

    @property
    def _numba_type_(self) -> Any:
        """Return numba's type of a kernel that another kernel calls (numba's own protocol)."""
        return self._inner._numba_type_


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Make a kernel that other kernels call; the options are those of `numba.njit`."""
    if function is None:
        return lambda given: Kernel(given, False, options)
    return Kernel(function, False, options)


def entry(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Make a kernel that Python calls, with arguments of the annotated types."""
    if function is None:
        return lambda given: Kernel(given, True, options)
    return Kernel(function, True, options)
