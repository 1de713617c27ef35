"""A worker runs the newest request, and cancels outdated ones."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from momapos.apps.web.work import LatestWorker, Stopped
from momapos.core.errors import TaskError
from momapos.core.stopwatch import Clock

LONG = 20.0
"""Timeout that no passing test reaches [s]."""


@pytest.fixture
def messages() -> list[str]:
    return []


@pytest.fixture
def worker(messages: list[str]) -> Iterator[LatestWorker]:
    worker = LatestWorker("test", messages.append)
    yield worker
    worker.close()


def test_only_the_newest_waiting_request_runs(worker: LatestWorker) -> None:
    begun, go, done = threading.Event(), threading.Event(), []

    def first(_: Clock) -> None:
        begun.set()
        go.wait(LONG)
        done.append(0)

    worker.put(first)
    assert begun.wait(LONG)
    for k in range(1, 50):
        worker.put(lambda _, k=k: done.append(k))
    assert worker.waiting
    go.set()
    assert worker.wait(LONG)
    assert done == [0, 49]


def test_running_work_is_canceled_by_its_clock(worker: LatestWorker) -> None:
    begun, ended = threading.Event(), threading.Event()

    def work(clock: Clock) -> None:
        begun.set()
        try:
            while True:
                clock()
        except Stopped:
            ended.set()
            raise

    worker.put(work)
    assert begun.wait(LONG)
    worker.stop()
    assert ended.wait(LONG)
    assert worker.wait(LONG)
    assert not worker.busy


def test_a_newer_request_can_cancel_the_running_one(worker: LatestWorker) -> None:
    begun, done = threading.Event(), []

    def work(clock: Clock) -> None:
        begun.set()
        while True:
            clock()

    worker.put(work)
    assert begun.wait(LONG)
    worker.put(lambda _: done.append("newer"), stop_running=True)
    assert worker.wait(LONG)
    assert done == ["newer"]


def test_a_failure_is_reported_and_the_thread_continues(
    worker: LatestWorker, messages: list[str]
) -> None:
    def wrong(_: Clock) -> None:
        raise TaskError("no such door")

    def broken(_: Clock) -> None:
        raise KeyError("secret")

    done: list[int] = []
    for work in (wrong, broken, lambda _: done.append(1)):
        worker.put(work)
        assert worker.wait(LONG)
    assert messages[0] == "no such door"
    assert "KeyError" in messages[1]
    assert "bug in momapos" in messages[1]
    assert done == [1]


def test_nothing_runs_after_close(messages: list[str]) -> None:
    worker, done = LatestWorker("test", messages.append), []
    worker.close()
    worker.put(lambda _: done.append(1))
    assert not any(thread.name == "test" for thread in threading.enumerate())
    assert done == []
