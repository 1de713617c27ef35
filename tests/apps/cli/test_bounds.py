"""Work on untrusted files is limited in time and memory."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from momapos.apps.cli.bounds import within_bounds

_BEGIN = """
import contextlib, signal, sys, time
import numpy as np
from momapos.apps.cli.bounds import within_bounds
from momapos.core.errors import InputError

def report(work, **bounds):
    try:
        with within_bounds("robot.urdf", **bounds):
            work()
    except InputError as error:
        print(error)

def endless():
    while True:
        with contextlib.suppress(Exception):
            sum(range(1000))

class Deaf:
    def __del__(self):
        until = time.process_time() + 0.3
        while time.process_time() < until:
            sum(range(1000))

def in_destructors():
    Deaf()
    endless()
"""
"""Runs in its own process: limits apply to processes, and endless work must not hang the tests."""


@pytest.mark.parametrize("work", ["endless", "in_destructors"])
def test_endless_work_is_stopped_even_if_it_suppresses_errors(work: str) -> None:
    assert said(f"report({work}, seconds=0.05)") == (
        "robot.urdf takes more than 0.05 s of processor time; use simpler shapes\n"
    )


def test_endless_work_is_stopped_even_if_signals_are_blocked() -> None:
    blocked = "signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())"
    assert "more than 0.05 s" in said(f"{blocked}; report(endless, seconds=0.05)")


def test_work_that_needs_too_much_memory_is_stopped() -> None:
    assert said("report(lambda: np.ones(400_000_000), memory=1_000_000_000)") == (
        "robot.urdf takes more than 1 GB of memory; use simpler shapes\n"
    )


def test_memory_that_the_process_already_has_does_not_count() -> None:
    code = "a = np.ones(200_000_000); report(lambda: np.ones(50_000_000), memory=1_000_000_000)"
    assert said(code) == ""


def said(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", _BEGIN + code], capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_work_that_ends_in_time_leaves_no_trace() -> None:
    handler, limits = signal.getsignal(signal.SIGPROF), resource.getrlimit(resource.RLIMIT_DATA)
    threads = threading.active_count()
    with within_bounds("robot.urdf"):
        done = np.ones(1000).sum()
    assert done == 1000
    assert signal.getsignal(signal.SIGPROF) == handler
    assert threading.active_count() == threads
    assert resource.getrlimit(resource.RLIMIT_DATA) == limits


def test_other_errors_pass_through() -> None:
    with pytest.raises(KeyError), within_bounds("robot.urdf"):
        raise KeyError("name")
