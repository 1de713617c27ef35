"""Time is measured by stage, even if a stage raises."""

from __future__ import annotations

import itertools

import pytest

from momapos.core.stopwatch import Stopwatch


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
