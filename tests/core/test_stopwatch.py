"""Time is measured by stage, even if a stage raises; a limit ends work at its next look."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from momapos.core.errors import OutOfTimeError
from momapos.core.geometry.polygons import convex_hull
from momapos.core.stopwatch import (
    GRACE_PERIOD,
    ProcessorClock,
    Stopwatch,
    look,
    time_left,
    time_limit,
    within_limits,
)


def test_stages_add_up_and_include_stages_that_raise() -> None:
    ticks = itertools.count()
    watch = Stopwatch(lambda: float(next(ticks)), {"drive": 0.0})
    for _ in range(2):
        with watch.stage("plan"):
            pass
    with pytest.raises(ValueError, match="wheel"), watch.stage("drive"):
        raise ValueError("a wheel is off")
    assert watch.seconds == {"drive": 1.0, "plan": 2.0}
    assert watch.total == 7.0


def test_the_time_of_a_nested_stage_counts_once() -> None:
    ticks = itertools.count()
    watch = Stopwatch(lambda: float(next(ticks)))
    with watch.stage("search"):
        for _ in range(2):
            with watch.stage("way"), watch.stage("map"):
                pass
    with watch.stage("way"):
        pass
    assert watch.seconds == {"search": 3.0, "way": 5.0, "map": 2.0}
    assert watch.total == 13.0
    assert sum(watch.seconds.values()) == 10.0


class Hand:
    """A clock that is set by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_limit_ends_work_and_leaves_ever_shorter_times_to_finish() -> None:
    clock, ended = Hand(), []
    look()
    with time_limit(2.0, clock):
        look()
        assert time_left() == 2.0
        for step in range(1, 200):
            clock.now = 1.9 + 0.01 * step
            try:
                look()
            except OutOfTimeError:
                ended.append(clock.now)
    look()
    assert time_left() == float("inf")
    assert len(ended) > 3
    assert ended[0] == pytest.approx(2.0, abs=0.011)
    assert ended[3] < 2.0 + 2 * GRACE_PERIOD + 0.02, "all together twice the first"


def test_the_nearest_of_nested_limits_ends_work_once() -> None:
    near, far = Hand(), Hand()
    with time_limit(5.0, far), time_limit(1.0, near):
        assert time_left() == 1.0
        near.now, far.now = 1.5, 6.0
        with pytest.raises(OutOfTimeError):
            look()
        look()
    with time_limit(1.0, near), time_limit(100.0, far):
        near.now = 3.0
        with pytest.raises(OutOfTimeError, match="1 s"):
            look()


def test_limits_hold_in_other_threads_that_work_for_one() -> None:
    clock = Hand()

    def work(_: int) -> str:
        try:
            look()
        except OutOfTimeError:
            return "ended"
        return "went on"

    with ThreadPoolExecutor(1) as pool, time_limit(1.0, clock):
        clock.now = 2.0
        assert list(pool.map(work, [0])) == ["went on"]
        assert list(pool.map(within_limits(work), [0])) == ["ended"]
        assert list(pool.map(work, [0])) == ["went on"]


def test_every_kernel_looks_at_the_clock() -> None:
    clock = Hand()
    points = np.random.default_rng(0).uniform(size=(9, 2))
    with time_limit(1.0, clock):
        convex_hull(points)
        clock.now = 2.0
        with pytest.raises(OutOfTimeError):
            convex_hull(points)


def test_a_stopped_clock_stands_still_and_goes_on_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hand = Hand()
    monkeypatch.setattr("momapos.core.stopwatch.time.process_time", hand)
    clock = ProcessorClock()
    hand.now = 1.0
    with clock.stopped():
        hand.now = 5.0
        with clock.stopped():
            hand.now = 8.0
        assert clock() == 1.0
    assert clock() == 1.0
    hand.now = 9.0
    assert clock() == 2.0
