"""Threads of the page: the newest request wins, and what nobody waits for ends."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from momapos.apps.web.work import Latest, Stopped
from momapos.core.errors import TaskError
from momapos.core.stopwatch import Clock

LONG = 20.0
"""No test waits so long where the law holds [s]."""


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def latest(told: list[str]) -> Iterator[Latest]:
    worker = Latest("test", told.append)
    yield worker
    worker.close()


def test_of_requests_that_wait_only_the_newest_runs(latest: Latest) -> None:
    begun, go, done = threading.Event(), threading.Event(), []

    def first(_: Clock) -> None:
        begun.set()
        go.wait(LONG)
        done.append(0)

    latest.put(first)
    assert begun.wait(LONG)
    for k in range(1, 50):
        latest.put(lambda _, k=k: done.append(k))
    assert latest.waiting
    go.set()
    assert latest.wait(LONG)
    assert done == [0, 49]


def test_what_runs_is_ended_by_its_clock(latest: Latest) -> None:
    begun, ended = threading.Event(), threading.Event()

    def work(clock: Clock) -> None:
        begun.set()
        try:
            while True:
                clock()
        except Stopped:
            ended.set()
            raise

    latest.put(work)
    assert begun.wait(LONG)
    latest.stop()
    assert ended.wait(LONG)
    assert latest.wait(LONG)
    assert not latest.busy


def test_a_newer_request_ends_the_one_that_runs_where_it_is_for_nothing(latest: Latest) -> None:
    begun, done = threading.Event(), []

    def work(clock: Clock) -> None:
        begun.set()
        while True:
            clock()

    latest.put(work)
    assert begun.wait(LONG)
    latest.put(lambda _: done.append("newer"), stop_running=True)
    assert latest.wait(LONG)
    assert done == ["newer"]


def test_a_failure_is_told_and_the_thread_goes_on(latest: Latest, told: list[str]) -> None:
    def wrong(_: Clock) -> None:
        raise TaskError("no such door")

    def broken(_: Clock) -> None:
        raise KeyError("secret")

    done: list[int] = []
    for work in (wrong, broken, lambda _: done.append(1)):
        latest.put(work)
        assert latest.wait(LONG)
    assert told[0] == "no such door"
    assert "KeyError" in told[1]
    assert "defect" in told[1]
    assert done == [1]


def test_nothing_runs_after_the_end(told: list[str]) -> None:
    latest, done = Latest("test", told.append), []
    latest.close()
    latest.put(lambda _: done.append(1))
    assert not any(thread.name == "test" for thread in threading.enumerate())
    assert done == []
