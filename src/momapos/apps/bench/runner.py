"""Run the jobs without a row in worker processes, and store every row at once."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from momapos.core import InputError, content_key, one_line, require

from .bench_records import Job, Row, Settings, Suite, from_plain, to_plain
from .folder import RowStore

WORKER = (sys.executable, "-P", "-m", "momapos.apps.bench.worker")
START_LIMIT = 300.0
"""Time for a process to start [s]; imports are slow on a busy machine."""
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: one thread each, because several workers run in parallel."""
EXIT_TIMEOUT = 10.0
"""Time for a process to exit after it closed its output [s]."""
_CHUNK = 1 << 16


class JobFailed(Exception):
    """A job raised, hung, or ended its process; the message states which."""


class Process:
    """A worker process and its line protocol."""

    def __init__(self, command: tuple[str, ...]) -> None:
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `kill`
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,  # a keyboard interrupt reaches only the runner
        )  # fmt: skip
        self._unread = b""
        self._errors_begin = 0
        """Offset of the current job's error output."""

    def run(self, job: dict[str, Any], limit: float) -> dict[str, Any]:
        """Run a job and return its row.

        Args:
            job: A `Job` as a dictionary.
            limit: Wall time limit [s].

        Raises:
            JobFailed: The job raised, the time is up, or the process ended.
        """
        assert self.process.stdin is not None
        self._errors_begin = os.fstat(self.errors.fileno()).st_size
        try:
            self.process.stdin.write(json.dumps(job).encode() + b"\n")
            self.process.stdin.flush()
        except OSError as error:
            raise JobFailed(self._exit_text()) from error
        answer = self._line(limit)
        if "error" in answer:
            raise JobFailed(answer["error"])
        row: dict[str, Any] = answer["row"]
        return row

    def wait_ready(self) -> None:
        """Wait until the process accepts jobs.

        Raises:
            JobFailed: The process ended, or the wait exceeds `START_LIMIT`.
        """
        self._line(START_LIMIT)

    def kill(self) -> None:
        """End the process and close its files."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            if pipe is not None:
                with contextlib.suppress(OSError):  # unflushed input has no reader any more
                    pipe.close()

    def _line(self, limit: float) -> dict[str, Any]:
        assert self.process.stdout is not None
        source, end = self.process.stdout.fileno(), time.monotonic() + limit
        while b"\n" not in self._unread:
            ready, _, _ = select.select([source], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise JobFailed(f"hung: no answer in {limit:g} s")
            chunk = os.read(source, _CHUNK)
            if not chunk:
                raise JobFailed(self._exit_text())
            self._unread += chunk
        line, _, self._unread = self._unread.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _exit_text(self) -> str:
        """Describe how the process ended, with the last line of its error output."""
        try:
            code = self.process.wait(EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        how = f"was killed by signal {-code}" if code < 0 else f"ended with status {code}"
        self.errors.seek(self._errors_begin)
        last = self.errors.read().decode(errors="replace").strip().rpartition("\n")[2]
        return one_line(f"its process {how}" + (f": {last}" if last else ""))


class _Processes:
    """The worker process of every thread."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.by_thread: dict[tuple[int, tuple[str, ...]], Process] = {}
        self.open = True
        """Whether new processes may start."""

    def mine(self, command: tuple[str, ...]) -> Process:
        """Return the process of this thread; start one if there is none.

        Raises:
            JobFailed: The process does not start, or the run is being stopped.
        """
        key = (threading.get_ident(), command)
        with self.lock:
            found = self.by_thread.get(key)
            if found is not None:
                return found
            if not self.open:
                raise JobFailed("the run is being stopped")
            found = self.by_thread[key] = Process(command)
        found.wait_ready()
        return found

    def drop_mine(self, command: tuple[str, ...]) -> None:
        with self.lock:
            found = self.by_thread.pop((threading.get_ident(), command), None)
        if found is not None:
            found.kill()

    def close(self) -> None:
        """Kill the processes of all threads, and let no new one start."""
        with self.lock:
            self.open = False
            for process in self.by_thread.values():
                process.process.kill()

    def reopen(self) -> None:
        """Forget all processes, and let new ones start."""
        with self.lock:
            for process in self.by_thread.values():
                process.kill()
            self.by_thread.clear()
            self.open = True


_PROCESSES = _Processes()


def run_job(job: dict[str, Any], command: tuple[str, ...] = WORKER) -> dict[str, Any]:
    """Run a job in the worker process of this thread; any executor can call this.

    Args:
        job: A `Job` as a dictionary; its settings hold the time limit.
        command: Command that starts a worker.

    Returns:
        A `Row` as a dictionary.

    Raises:
        JobFailed: The job raised, hung or ended its process. The next job gets a new process.
    """
    try:
        return _PROCESSES.mine(command).run(job, job["settings"]["limit"])
    except JobFailed:
        _PROCESSES.drop_mine(command)
        raise


@contextmanager
def local_workers(count: int) -> Iterator[Executor]:
    """Yield threads with a worker process each; none of them outlives the context."""
    threads = ThreadPoolExecutor(count)
    try:
        yield threads
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        _PROCESSES.close()  # ends the jobs that threads wait for, so that they can be joined
        threads.shutdown(wait=True)
        _PROCESSES.reopen()


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
        limit: Number of tasks, drawn from the suite; None for all.
        record: Folder for the records of executed tasks; "" for none.
    """
    same = (sorted(versions.items()), settings)
    return [
        Job(
            content_key(task, suite.scenes[task.scene], method, protocol, *same),
            str(folder.absolute()), task, method, settings, protocol, record,
        )
        for task in suite.limited(limit)
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


CONNECT_TIMEOUT = 10.0
"""Time to wait for a scheduler [s]."""


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, int]]:
    """Connect to a Dask scheduler.

    Args:
        address: Address of the scheduler, such as tcp://192.168.0.1:8786.

    Yields:
        The executor, and the number of jobs that it runs in parallel.

    Raises:
        MissingExtraError: dask.distributed is not installed.
        InputError: No scheduler answers, or it has no workers.
    """
    with require("bench"):
        from distributed import Client
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is an OSError
        raise InputError(
            f"scheduler {address}: no Dask scheduler answers there ({type(error).__name__}); "
            "start one with 'dask scheduler'"
        ) from error
    with client:
        width = sum(client.nthreads().values())
        if not width:
            raise InputError(
                f"scheduler {address}: it has no workers; start some with 'dask worker {address}'"
            )
        executor = client.get_executor(pure=False)
        try:
            yield executor, width
        finally:
            executor.shutdown(wait=False)
