"""Process many rows on two threads; the kernels release the GIL."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from momapos.core import within_limits

Progress = Callable[[float], None]
"""Callback for the completed share, in [0, 1]."""


def silent(_share: float) -> None:
    """Report no progress."""


def in_threads(
    work: Callable[[int, int], None], count: int, block: int, done: Progress = silent
) -> None:
    """Run work(lo, hi) over blocks of rows."""
    ranges = [(lo, min(lo + block, count)) for lo in range(0, count, block)]
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        try:
            for i, _ in enumerate(pool.map(within_limits(lambda r: work(*r)), ranges)):
                done((i + 1) / len(ranges))
        except BaseException:  # an interrupt leaves the blocks that have not begun
            pool.shutdown(wait=False, cancel_futures=True)
            raise
