"""Commands are limited in time, and work on untrusted files in time and memory."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from momapos.apps.cli import bounds
from momapos.apps.cli.bounds import ended_after, within_bounds, within_time
from momapos.apps.cli.main import COMMANDS, main
from momapos.core.errors import OutOfTimeError

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
    code = "a = np.ones(40_000_000); report(lambda: np.ones(20_000_000), memory=300_000_000)"
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


NAMES = [
    [name, *sub]
    for name, (_, functions) in COMMANDS.items()
    for sub in ([[]] if isinstance(functions, str) else [[one] for one in functions])
]


@pytest.mark.parametrize("name", NAMES, ids=" ".join)
def test_every_command_has_a_time_limit(
    name: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*name, "--help"]) == 0
    assert "--timeout " in capsys.readouterr().out


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on which a second passes each time that something reads it."""
    ticks = itertools.count()
    monkeypatch.setattr(bounds, "processor_time", lambda: float(next(ticks)))
    monkeypatch.setattr(bounds, "_PERIOD", 0.001)


def endless() -> NoReturn:
    while True:
        with contextlib.suppress(Exception):
            sum(range(100))


@pytest.mark.usefixtures("ticking")
def test_a_command_that_looks_at_no_clock_ends_in_one_line_with_status_4(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> int:
        """Do what has no end."""
        endless()

    monkeypatch.setattr("momapos.apps.cli.schema.schema", command)
    assert main(["schema", "--timeout", "3"]) == 4
    shown = capsys.readouterr()
    assert shown.err == "momapos: the time limit of 3 s is over; give more --timeout\n"
    assert shown.out == ""


@pytest.mark.usefixtures("ticking")
def test_a_search_that_looks_at_no_clock_ends_as_well() -> None:
    with pytest.raises(OutOfTimeError, match="limit of 3 s is over before"), within_time(3.0):
        endless()


@pytest.mark.usefixtures("ticking")
@pytest.mark.parametrize("limit", [within_time, ended_after])
def test_a_library_that_hides_the_end_of_the_time_and_fails_later_fails_for_lack_of_time(
    limit: Callable[[float], AbstractContextManager[None]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "hides_interrupts.py").write_text(
        "while True:\n"
        "    try:\n"
        "        import is_not_installed\n"
        "    except ImportError:\n"
        "        continue\n"
        "    except BaseException:\n"
        "        raise TypeError('a placeholder is no type')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(OutOfTimeError, match="limit of 50 s"), limit(50.0):
        importlib.import_module("hides_interrupts")


def test_a_process_whose_command_is_in_one_long_call_ends_itself_with_status_4() -> None:
    code = (
        "import hashlib\n"
        "from momapos.apps.cli.bounds import counting_from, ended_after\n"
        "with counting_from(0.0), ended_after(0.01):\n"
        "    hashlib.pbkdf2_hmac('sha256', b'', b'', 1_000_000_000)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 4
    assert done.stderr == "momapos: the time limit of 0.01 s is over; give more --timeout\n"


@pytest.mark.usefixtures("ticking")
def test_the_first_of_nested_limits_ends_the_work() -> None:
    handler = signal.getsignal(signal.SIGPROF)
    for outer, inner in ((3.0, 1e6), (1e6, 3.0)):
        with (
            pytest.raises(OutOfTimeError, match="limit of 3 s"), ended_after(outer),
            ended_after(inner),
        ):  # fmt: skip
            endless()
        with pytest.raises(OutOfTimeError), ended_after(3.0), within_bounds("robot.urdf"):
            endless()
    assert signal.getsignal(signal.SIGPROF) == handler
