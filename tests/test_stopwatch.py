"""Time is counted by stage, also where a stage ends in an error."""

from __future__ import annotations

import itertools

import pytest

from momapos.stopwatch import Stopwatch


def test_stages_add_up_and_a_stage_that_raises_counts() -> None:
    ticks = itertools.count()
    watch = Stopwatch(lambda: float(next(ticks)), {"drive": 0.0})
    for _ in range(2):
        with watch.stage("plan"):
            pass
    with pytest.raises(ValueError, match="wheel"), watch.stage("drive"):
        raise ValueError("a wheel is off")
    assert watch.seconds == {"drive": 1.0, "plan": 2.0}
    assert watch.total == 7.0
