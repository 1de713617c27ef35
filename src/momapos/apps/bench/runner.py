"""Run the jobs that have no row yet, by any executor, and keep every row as it comes."""

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
from .row_store import Store

Do: TypeAlias = Callable[[dict[str, Any]], dict[str, Any]]
"""Turns a job into a row, both as dictionaries; runs wherever the executor does."""
GONE = (
    "those who answer are gone (a scheduler that ended?); the rows of finished jobs are kept, and "
    "the same command goes on from there"
)
AHEAD = 2
"""Jobs that are handed out for each worker, so that none waits for the next [-]."""


def jobs_of(
    suite: Suite,
    methods: Sequence[str],
    folder: Path,
    settings: Settings,
    versions: Mapping[str, str],
    limit: int | None = None,
) -> list[Job]:
    """All jobs: every task by every method, the methods of a task one after the other.

    Args:
        suite: The suite.
        methods: Methods or variants.
        folder: Where the suite's scene files are.
        settings: How every task is asked.
        versions: Of what answers.
        limit: So many tasks, drawn from the suite; a larger number holds those of a smaller one.
    """
    order = list(range(len(suite.tasks)))
    if limit is not None:
        random.Random(suite.seed).shuffle(order)
        order = sorted(order[:limit])
    tasks = [suite.tasks[k] for k in order]
    same = (sorted(versions.items()), settings)
    return [
        Job(
            content_key(task, suite.scenes[task.scene], method, *same),
            str(folder.absolute()), task, method, settings,
        )
        for task in tasks
        for method in methods
    ]  # fmt: skip


def run_jobs(
    jobs: Iterable[Job],
    store: Store,
    executor: Executor,
    do: Do,
    *,
    width: int,
    tell: Callable[[Row], None],
    finished: Collection[str] = (),
) -> None:
    """Run jobs until each has a row.

    Args:
        jobs: What is to be done.
        store: Where rows go; a row is told after it is there.
        executor: Who does it.
        do: Does one job.
        width: Jobs that the executor does at once.
        tell: Hears of every new row.
        finished: Keys of jobs that have a row.

    Raises:
        InputError: A row cannot be kept, or the executor is gone.
    """
    waiting = iter([job for job in jobs if job.key not in finished])
    running: dict[Future[dict[str, Any]], Job] = {}
    while True:
        while len(running) < AHEAD * width and (job := next(waiting, None)) is not None:
            running[_submitted(executor, do, job)] = job
        if not running:
            return
        done = wait(running, return_when=FIRST_COMPLETED).done
        for future in [one for one in running if one in done]:  # in the order of handing out
            row = _row_of(future, running.pop(future))
            if store.add(row):
                tell(row)


def _submitted(executor: Executor, do: Do, job: Job) -> Future[dict[str, Any]]:
    """A job that is handed out.

    Raises:
        InputError: The executor is gone.
    """
    try:
        return executor.submit(do, to_plain(job))
    except RuntimeError as error:  # what executors raise that were shut down or are broken
        raise InputError(GONE) from error


def _row_of(future: Future[dict[str, Any]], job: Job) -> Row:
    """What came of a job, and when; what it raised is a row.

    Raises:
        InputError: The executor is gone.
    """
    try:
        row = from_plain(future.result(), Row, f"worker: {job.task.name}")
    except JobFailed as error:
        row = failed(job, str(error))
    except (CancelledError, BrokenExecutor) as error:
        raise InputError(GONE) from error
    except Exception as error:  # of the executor's own: a worker that died again and again, say
        row = failed(job, one_line(f"{type(error).__name__}: {error}"))
    host = row.host or socket.gethostname()
    return replace(row, host=host, finished=time.time())


def failed(job: Job, reason: str) -> Row:
    """The row of a job that came to no end."""
    task = job.task
    return Row(
        key=job.key, task=task.name, group=task.group, robot=task.robot, method=job.method,
        seed=task.seed, outcome="failed", reason=reason,
    )  # fmt: skip
