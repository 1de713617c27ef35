"""Run jobs in worker processes, one per thread; one that hangs or dies harms no other job."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from momapos.core import one_line

WORKER = (sys.executable, "-m", "momapos.apps.bench.worker")
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
