"""Work on files from strangers ends in one line."""

from __future__ import annotations

import contextlib
import resource
import signal
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from momapos.cli.bounds import within_bounds
from momapos.errors import InputError


def endless() -> None:
    while True:
        with contextlib.suppress(Exception):
            sum(range(1000))


def test_work_without_end_is_stopped_even_where_its_errors_are_caught() -> None:
    with pytest.raises(InputError, match=r"robot\.urdf takes more than 0\.05 s") as caught:
        run(endless, seconds=0.05)
    assert "\n" not in str(caught.value)


def test_work_on_much_memory_is_stopped() -> None:
    with pytest.raises(InputError, match="more than 1 GB of memory"):
        run(lambda: np.ones(400_000_000), memory=1_000_000_000)


def run(work: Callable[[], object], **bounds: Any) -> None:
    with within_bounds("robot.urdf", **bounds):
        work()


def test_what_ends_in_time_changes_nothing() -> None:
    handler, limits = signal.getsignal(signal.SIGPROF), resource.getrlimit(resource.RLIMIT_DATA)
    with within_bounds("robot.urdf"):
        done = np.ones(1000).sum()
    assert done == 1000
    assert signal.getsignal(signal.SIGPROF) == handler
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    assert resource.getrlimit(resource.RLIMIT_DATA) == limits


def test_other_errors_pass_through() -> None:
    with pytest.raises(KeyError), within_bounds("robot.urdf"):
        raise KeyError("name")
