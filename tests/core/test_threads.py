"""Laws of work on threads: results in order, and after an error nothing more begins."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from momapos.core.errors import OutOfTimeError
from momapos.core.stopwatch import look, time_limit
from momapos.core.threads import AHEAD, blocks_in_threads, in_threads

THREADS = 2
MAX_BEGUN = (AHEAD + 1) * THREADS + 1
"""Items that may have begun when the first result is used."""


@pytest.mark.parametrize("count", [0, 1, 3, 100])
def test_results_come_in_the_order_of_the_items(count: int) -> None:
    assert list(in_threads(lambda k: k * k, range(count), THREADS)) == [k * k for k in range(count)]


def failing(begun: list[int]) -> Iterator[int]:
    """Fail in a thread at the first item."""

    def work(k: int) -> int:
        begun.append(k)
        if k == 0:
            raise ValueError("first item")
        return k

    return in_threads(work, range(1000), THREADS)


def left_by_its_user(begun: list[int]) -> Iterator[int]:
    """Fail where the results are used."""

    def work(k: int) -> int:
        begun.append(k)
        return k

    for _ in in_threads(work, range(1000), THREADS):
        raise ValueError("user of the first result")
    yield 0


@pytest.mark.parametrize("run", [failing, left_by_its_user])
def test_after_an_error_no_more_items_begin(run: Callable[[list[int]], Iterator[int]]) -> None:
    begun: list[int] = []
    with pytest.raises(ValueError, match="first"):
        list(run(begun))
    assert len(begun) <= MAX_BEGUN


def test_a_time_limit_holds_in_the_threads() -> None:
    times = iter(range(10))
    with pytest.raises(OutOfTimeError), time_limit(0.5, clock=lambda: float(next(times))):
        list(in_threads(lambda _: look(), range(3), THREADS))


@pytest.mark.parametrize(("count", "block"), [(0, 3), (2, 3), (7, 3), (9, 3)])
def test_blocks_cover_each_row_once_and_report_their_share(count: int, block: int) -> None:
    rows, shares = np.zeros(count, int), [0.0]

    def work(low: int, high: int) -> None:
        assert 0 < high - low <= block
        rows[low:high] += 1

    blocks_in_threads(work, count, block, shares.append)
    assert (rows == 1).all()
    assert shares == sorted(shares)
    assert shares[-1] == (1.0 if count else 0.0)
