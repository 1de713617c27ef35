"""A worker whose jobs say what shall go wrong with them."""

from __future__ import annotations

import os
import signal
import sys
import threading

from momapos.apps.bench.bench_records import Job, Row
from momapos.apps.bench.runner import failed
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
    print("what a library says on the standard output")
    # Which process answered, where a real row says why it failed.
    return failed(job, f"pid {os.getpid()}")


if __name__ == "__main__":
    serve(answer)
