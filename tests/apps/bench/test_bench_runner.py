"""Laws of the runner for jobs that hang, raise or end their process, and for later jobs."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.apps.bench.fakes import WORKER, job, row, suite, task

from momapos.apps.bench import runner
from momapos.apps.bench.bench_records import Job, Row, Settings, to_plain
from momapos.apps.bench.folder import RowStore, read_rows
from momapos.apps.bench.runner import JobFailed, jobs_of, local_workers, run_job, run_jobs
from momapos.apps.cli.bench import _progress_of
from momapos.core.errors import InputError

FAKE: Callable[[dict[str, Any]], dict[str, Any]] = partial(run_job, command=WORKER)
VERSIONS = {"momapos": "1"}


def run(jobs: list[Job], folder: Path, workers: int = 1, **more: Any) -> dict[str, Row]:
    store, reported = RowStore(folder / "rows-x.sqlite"), []
    with local_workers(workers) as executor:
        run_jobs(jobs, store, executor, FAKE, width=workers, on_row=reported.append, **more)
    store.close()
    assert read_rows(store.path) == reported
    return {one.key: one for one in reported}


def gone(pid: int) -> bool:
    """Check that a process ends within 30 s."""
    try:
        watched = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    with os.fdopen(watched) as ended:
        return bool(select.select([ended], [], [], 30.0)[0])


def test_a_failing_job_gets_a_failed_row_and_the_others_are_answered(tmp_path: Path) -> None:
    wrong = {
        "hangs": "hung: no answer in 1 s",
        "raises": "ValueError: of two lines",
        "dies": "its process was killed by signal 9",
        "leaves": "its process ended with status 7: the last words",
    }
    limits = dict.fromkeys(wrong, 60.0) | {"hangs": 1.0}
    jobs = [one for what in wrong for one in (job(what, what, limits[what]), job(f"after {what}"))]
    rows = run(jobs, tmp_path)
    assert {key: one.outcome for key, one in rows.items()} == dict.fromkeys(rows, "failed")
    for what, reason in wrong.items():
        assert rows[what].reason == reason
        assert rows[f"after {what}"].reason.startswith("pid ")
    assert list(rows) == [one.key for one in jobs]


def test_a_failing_job_harms_no_parallel_job(tmp_path: Path) -> None:
    jobs = [job(f"{what} {k}", what, 60.0) for k in range(4) for what in ("dies", "answers")]
    rows = run(jobs, tmp_path, workers=2)
    assert len(rows) == len(jobs)
    assert all(rows[one.key].reason.startswith("pid ") for one in jobs[1::2])


def test_no_worker_outlives_the_run(tmp_path: Path) -> None:
    rows = run([job("one"), job("two")], tmp_path)
    assert all(gone(int(one.reason.split()[1])) for one in rows.values())


def test_an_interrupted_run_ends_hanging_workers() -> None:
    started: list[int] = []

    def interrupted() -> None:
        with local_workers(1) as executor:
            executor.submit(FAKE, to_plain(job("long", "hangs", 600.0)))
            while not started:
                with runner._PROCESSES.lock:
                    started.extend(p.process.pid for p in runner._PROCESSES.by_thread.values())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert gone(started[0])


def test_a_worker_ends_when_its_runner_is_gone() -> None:
    code = (
        "import json, os, subprocess\n"
        f"worker = subprocess.Popen({list(WORKER)!r}, stdin=-1, stdout=-1)\n"
        "worker.stdout.readline()\n"
        f"worker.stdin.write({json_line(job('long', 'hangs'))!r})\n"
        "worker.stdin.flush()\n"
        "print(worker.pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60).stdout
    assert gone(int(said))


def json_line(one: Job) -> bytes:
    return json.dumps(to_plain(one)).encode() + b"\n"


def test_finished_jobs_are_not_run_again(tmp_path: Path) -> None:
    jobs = [job(f"key {k}") for k in range(4)]
    assert set(run(jobs, tmp_path, finished={"key 1", "key 3"})) == {"key 0", "key 2"}


def test_a_row_that_cannot_be_stored_ends_the_run(tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows-x.sqlite")
    store.connection.execute("PRAGMA query_only = 1")
    do = lambda plain: to_plain(row(plain["key"]))  # noqa: E731
    with ThreadPoolExecutor(1) as executor, pytest.raises(InputError, match="cannot be written"):
        run_jobs([job("one")], store, executor, do, width=1, on_row=lambda _: None)


class _Gone(Executor):
    """Cancels every job, or accepts none."""

    def __init__(self, accepts: bool) -> None:
        self.accepts = accepts

    def submit(self, *_: Any, **__: Any) -> Future[Any]:
        if not self.accepts:
            raise RuntimeError("cannot schedule new futures after shutdown")
        future: Future[Any] = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


@pytest.mark.parametrize("accepts", [True, False])
def test_an_executor_that_is_gone_ends_the_run(accepts: bool, tmp_path: Path) -> None:
    store = RowStore(tmp_path / "rows-x.sqlite")
    store.add(row("finished before"))
    with pytest.raises(InputError, match="the same command resumes the run"):
        run_jobs([job("one")], store, _Gone(accepts), FAKE, width=1, on_row=lambda _: None)
    assert [one.key for one in read_rows(store.path)] == ["finished before"]


def test_an_error_of_the_executor_becomes_the_row_of_the_job(tmp_path: Path) -> None:
    def die(_: dict[str, Any]) -> dict[str, Any]:
        raise RuntimeError("three workers died of it")

    store, reported = RowStore(tmp_path / "rows-x.sqlite"), []
    with ThreadPoolExecutor(1) as executor:
        run_jobs([job("one")], store, executor, die, width=1, on_row=reported.append)
    assert [one.reason for one in reported] == ["RuntimeError: three workers died of it"]


def test_a_worker_that_cannot_start_is_reported() -> None:
    code = "import sys; sys.stderr.write('no way'); sys.exit(3)"
    with pytest.raises(JobFailed, match="ended with status 3: no way"):
        run_job(to_plain(job("one")), (sys.executable, "-c", code))


def test_a_larger_limit_includes_the_tasks_of_a_smaller_one() -> None:
    whole = suite(*(task(f"task {k}") for k in range(50)))
    keys = [
        {one.key for one in jobs_of(whole, ["ours", "m3"], Path("x"), Settings(), VERSIONS, n)}
        for n in (5, 20, None)
    ]
    assert [len(part) for part in keys] == [10, 40, 100]
    assert keys[0] < keys[1] < keys[2]


def test_a_key_differs_for_everything_that_determines_a_row() -> None:
    base = suite(task("task"))
    changed = [
        (base, "ours", Settings(), VERSIONS),
        (base, "m3", Settings(), VERSIONS),
        (base, "ours", Settings(timeout=1.0), VERSIONS),
        (base, "ours", Settings(execute=True), VERSIONS),
        (base, "ours", Settings(), {"momapos": "2"}),
        (replace(base, scenes={"kitchen_small": "another"}), "ours", Settings(), VERSIONS),
        (suite(replace(task("task"), seed=1)), "ours", Settings(), VERSIONS),
        (suite(task("task", "other object")), "ours", Settings(), VERSIONS),
    ]
    keys = [
        jobs_of(made, [method], Path("x"), settings, versions)[0].key
        for made, method, settings, versions in changed
    ]
    assert len(set(keys)) == len(keys)
    again = jobs_of(base, ["ours"], Path("another/folder"), Settings(), VERSIONS)[0].key
    assert again == keys[0]


def test_progress_shows_the_number_of_rows_and_the_time_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown: list[tuple[float, str]] = []

    @contextmanager
    def progress(_: str) -> Iterator[Callable[[float, str], None]]:
        yield lambda share, what: shown.append((share, what))

    clock = iter([0.0, 10.0, 40.0, 30_000.0])
    monkeypatch.setattr("momapos.apps.cli.bench.progress", progress)
    monkeypatch.setattr("momapos.apps.cli.bench.time.monotonic", lambda: next(clock))
    with _progress_of("made", 4) as tell:
        for key in ("one", "two", "three"):
            tell(row(key))
    assert shown == [
        (0.25, "1/4, 30 s left"), (0.5, "2/4, 40 s left"), (0.75, "3/4, 2.8 h left")
    ]  # fmt: skip
