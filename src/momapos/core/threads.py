"""Process items or rows on threads; files, images and kernels release the GIL."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from .stopwatch import within_limits

T = TypeVar("T")
R = TypeVar("R")
AHEAD = 4
"""Items per thread that begin before the result of the first is used, because results can be large
[-]."""


def in_threads(work: Callable[[T], R], items: Iterable[T], threads: int = 2) -> Iterator[R]:
    """Yield the results of all items in order.

    After an error or an interrupt, the items that have not begun are left.

    Args:
        work: Called by several threads, within the time limits that hold here.
        items: Its arguments.
        threads: Maximum number of threads; there are no more than processors [-].
    """
    limited, pending = within_limits(work), deque[Future[R]]()
    threads = max(1, min(threads, os.cpu_count() or 1))
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                pending.append(pool.submit(limited, item))
                if len(pending) > AHEAD * threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def blocks_in_threads(
    work: Callable[[int, int], None],
    count: int,
    block: int,
    done: Callable[[float], None] = lambda _: None,
) -> None:
    """Run work(lo, hi) over blocks of rows; report the completed share, in [0, 1]."""
    ranges = [(lo, min(lo + block, count)) for lo in range(0, count, block)]
    for i, _ in enumerate(in_threads(lambda r: work(*r), ranges)):
        done((i + 1) / len(ranges))
