"""Run the jobs without a row on any executor, and store every row at once."""

from __future__ import annotations

import random
import socket
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from momapos.core import InputError, content_key, one_line

from .bench_records import Job, Row, Settings, Suite, from_plain, to_plain
from .guard import JobFailed
from .row_store import RowStore

RunJob: TypeAlias = Callable[[dict[str, Any]], dict[str, Any]]
"""Turns a job into a row, both as dictionaries; runs where the executor runs."""
EXECUTOR_LOST = (
    "the workers are gone (did the scheduler end?); finished rows are saved, and the same command "
    "resumes the run"
)
JOBS_PER_WORKER = 2
"""Submitted jobs per worker, so that no worker waits for the next job [-]."""


def jobs_of(
    suite: Suite,
    methods: Sequence[str],
    folder: Path,
    settings: Settings,
    versions: Mapping[str, str],
    limit: int | None = None,
    record: str = "",
) -> list[Job]:
    """Return all jobs: every task under every protocol with every method, grouped by task.

    Args:
        suite: The suite.
        methods: Methods or variants.
        folder: Folder with the suite's scene files.
        settings: Settings for every task.
        versions: Versions that rows depend on.
        limit: Number of tasks, drawn from the suite; a larger number includes the same tasks.
        record: Folder for the records of executed tasks; "" for none.
    """
    order = list(range(len(suite.tasks)))
    if limit is not None:
        random.Random(suite.seed).shuffle(order)
        order = sorted(order[:limit])
    tasks = [suite.tasks[k] for k in order]
    same = (sorted(versions.items()), settings)
    return [
        Job(
            content_key(task, suite.scenes[task.scene], method, protocol, *same),
            str(folder.absolute()), task, method, settings, protocol, record,
        )
        for task in tasks
        for protocol in settings.protocols
        for method in methods
    ]  # fmt: skip


def run_jobs(
    jobs: Iterable[Job],
    store: RowStore,
    executor: Executor,
    run_job: RunJob,
    *,
    width: int,
    on_row: Callable[[Row], None],
    finished: Collection[str] = (),
) -> None:
    """Run jobs until each has a row.

    Args:
        jobs: The jobs.
        store: Store for the rows.
        executor: Executor of the jobs.
        run_job: Runs one job.
        width: Jobs that the executor runs in parallel.
        on_row: Called with every new row after it is stored.
        finished: Keys of jobs with a row, which are skipped.

    Raises:
        InputError: A row can't be stored, or the executor is gone.
    """
    waiting = iter([job for job in jobs if job.key not in finished])
    running: dict[Future[dict[str, Any]], Job] = {}
    while True:
        while len(running) < JOBS_PER_WORKER * width and (job := next(waiting, None)) is not None:
            running[_submit(executor, run_job, job)] = job
        if not running:
            return
        done = wait(running, return_when=FIRST_COMPLETED).done
        for future in [one for one in running if one in done]:  # in the order of submission
            row = _row_of(future, running.pop(future))
            if store.add(row):
                on_row(row)


def _submit(executor: Executor, run_job: RunJob, job: Job) -> Future[dict[str, Any]]:
    try:
        return executor.submit(run_job, to_plain(job))
    except RuntimeError as error:  # raised by executors that are shut down or broken
        raise InputError(EXECUTOR_LOST) from error


def _row_of(future: Future[dict[str, Any]], job: Job) -> Row:
    """Return the row of a finished job; an exception becomes a failed row."""
    try:
        row = from_plain(future.result(), Row, f"worker: {job.task.name}")
    except JobFailed as error:
        row = failed_row(job, str(error))
    except (CancelledError, BrokenExecutor) as error:
        raise InputError(EXECUTOR_LOST) from error
    except Exception as error:  # raised by the executor, such as for a worker that dies repeatedly
        row = failed_row(job, one_line(f"{type(error).__name__}: {error}"))
    host = row.host or socket.gethostname()
    return replace(row, host=host, finished=time.time())


def failed_row(job: Job, reason: str) -> Row:
    """Return the row of a failed job."""
    task = job.task
    return Row(
        key=job.key, task=task.name, group=task.group, robot=task.robot, method=job.method,
        seed=task.seed, outcome="failed", reason=reason, protocol=str(job.protocol),
    )  # fmt: skip
