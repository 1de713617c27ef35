"""A worker that fails in the way that the job's object names."""

from __future__ import annotations

import os
import signal
import sys
import threading

from momapos.apps.bench.bench_records import Job, Row
from momapos.apps.bench.runner import failed_row
from momapos.apps.bench.worker import serve


def answer(job: Job) -> Row:
    what = job.task.object
    if what == "hangs":
        threading.Event().wait()
    if what == "raises":
        raise ValueError("of two\nlines")
    if what == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "leaves":
        print("the last words", file=sys.stderr, flush=True)
        os._exit(7)
    print("output of a library")
    return failed_row(job, f"pid {os.getpid()}")


if __name__ == "__main__":
    serve(answer)
