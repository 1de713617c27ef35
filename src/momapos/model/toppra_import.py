"""Import toppra without matplotlib.

toppra imports matplotlib for its own plots, which takes longer than the rest of its import and a
third of a short command. A stand-in imports matplotlib when a plot needs it.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

_FOR_PLOTS = ("matplotlib", "matplotlib.pyplot")


class _Later(ModuleType):
    """Imports a module when it is used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        _forget(self)
        return getattr(import_module(self.__name__), name)


def _forget(module: _Later) -> None:
    """Let the next import find the real module."""
    if sys.modules.get(module.__name__) is module:
        del sys.modules[module.__name__]


@cache
def import_toppra() -> Any:
    """Return the module toppra."""
    waiting = [_Later(name) for name in _FOR_PLOTS if name not in sys.modules]
    sys.modules.update({module.__name__: module for module in waiting})
    try:
        return import_module("toppra")
    finally:
        for module in waiting:
            _forget(module)
