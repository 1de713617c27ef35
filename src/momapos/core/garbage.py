"""Pause the search for garbage, which passes over all objects again and again as they grow."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Disable garbage collection while many objects are made that stay.

    It would take 10 % of the time of compiling, whose objects for the kernels of one answer then
    take 600 MB, and half of the time of reading JSON.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
