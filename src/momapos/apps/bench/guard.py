"""Jobs run in processes of their own, one a thread: one that hangs or dies takes nothing along."""

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
"""Time for a process to start [s]; a busy machine reads its packages for long."""
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Workers answer side by side, each by one thread."""
ENDING = 10.0
"""Time for a process to end that answers no more [s]."""
_CHUNK = 1 << 16


class JobFailed(Exception):
    """A job raised, hung, or ended its process; the message says which."""


class Process:
    """A worker process and the lines that are exchanged with it."""

    def __init__(self, command: tuple[str, ...]) -> None:
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `kill`
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors,
            env={**os.environ, **ONE_THREAD},
            # An interrupt from the keyboard is the runner's; no job fails by it.
            start_new_session=True,
        )  # fmt: skip
        self._left = b""
        self._said = 0
        """Where in the errors what the present job says begins."""

    def ask(self, job: dict[str, Any], limit: float) -> dict[str, Any]:
        """The answer to a job.

        Args:
            job: A `Job` as a dictionary.
            limit: Wall time for it [s].

        Raises:
            JobFailed: It raised, the time is up, or the process ended.
        """
        assert self.process.stdin is not None
        self._said = os.fstat(self.errors.fileno()).st_size
        try:
            self.process.stdin.write(json.dumps(job).encode() + b"\n")
            self.process.stdin.flush()
        except OSError as error:
            raise JobFailed(self._death()) from error
        answer = self._line(limit)
        if "error" in answer:
            raise JobFailed(answer["error"])
        row: dict[str, Any] = answer["row"]
        return row

    def wait_ready(self) -> None:
        """Wait until the process takes jobs.

        Raises:
            JobFailed: It ended, or takes too long.
        """
        self._line(START_LIMIT)

    def kill(self) -> None:
        """End the process and close its files."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self.errors):
            if pipe is not None:
                with contextlib.suppress(OSError):  # what was written last found no reader
                    pipe.close()

    def _line(self, limit: float) -> dict[str, Any]:
        assert self.process.stdout is not None
        source, end = self.process.stdout.fileno(), time.monotonic() + limit
        while b"\n" not in self._left:
            ready, _, _ = select.select([source], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise JobFailed(f"hung: no answer in {limit:g} s")
            chunk = os.read(source, _CHUNK)
            if not chunk:
                raise JobFailed(self._death())
            self._left += chunk
        line, _, self._left = self._left.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _death(self) -> str:
        """How the process ended, with the last line that it said."""
        try:
            code = self.process.wait(ENDING)
        except subprocess.TimeoutExpired:  # it said that it ends, and does not
            self.process.kill()
            code = self.process.wait()
        how = f"was killed by signal {-code}" if code < 0 else f"ended with status {code}"
        self.errors.seek(self._said)
        said = self.errors.read().decode(errors="replace").strip().rpartition("\n")[2]
        return one_line(f"its process {how}" + (f": {said}" if said else ""))


class _Processes:
    """The worker process of every thread."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.by_thread: dict[tuple[int, tuple[str, ...]], Process] = {}
        self.open = True
        """Whether new ones may start."""

    def mine(self, command: tuple[str, ...]) -> Process:
        """The process of this thread, started where there is none.

        Raises:
            JobFailed: It does not start, or none may.
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
        """End the process of this thread."""
        with self.lock:
            found = self.by_thread.pop((threading.get_ident(), command), None)
        if found is not None:
            found.kill()

    def close(self) -> None:
        """End the processes of all threads, and let none start."""
        with self.lock:
            self.open = False
            for process in self.by_thread.values():
                process.process.kill()

    def reopen(self) -> None:
        """Forget what was ended, and let new ones start."""
        with self.lock:
            for process in self.by_thread.values():
                process.kill()
            self.by_thread.clear()
            self.open = True


_PROCESSES = _Processes()


def run_job(job: dict[str, Any], command: tuple[str, ...] = WORKER) -> dict[str, Any]:
    """Answer a job in the worker process of this thread; any executor can call this.

    Args:
        job: A `Job` as a dictionary; its settings say how long it may take.
        command: What starts a worker.

    Returns:
        A `Row` as a dictionary.

    Raises:
        JobFailed: The job raised, hung or ended its process. The next one finds a new process.
    """
    try:
        return _PROCESSES.mine(command).ask(job, job["settings"]["limit"])
    except JobFailed:
        _PROCESSES.drop_mine(command)
        raise


@contextmanager
def local_workers(count: int) -> Iterator[Executor]:
    """Threads of this process, each with a worker process; none is left at the end."""
    threads = ThreadPoolExecutor(count)
    try:
        yield threads
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        _PROCESSES.close()  # what a thread waits for ends, and so does the thread
        threads.shutdown(wait=True)
        _PROCESSES.reopen()
