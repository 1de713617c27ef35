"""Worker process: reads one JSON job per line, writes one JSON answer per line.

It exits when its standard input closes, even during a job, because its runner may be killed.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from collections.abc import Callable
from typing import BinaryIO

from momapos.core import one_line

from .bench_records import Job, Row, from_plain, to_plain


def serve(answer: Callable[[Job], Row]) -> None:
    """Answer jobs from standard input until it closes.

    Output that libraries print goes to standard error, so that standard output has only answers.
    """
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, lines), daemon=True).start()
    _write(out, {"ready": True})
    while True:
        job = from_plain(json.loads(lines.get()), Job, "worker")
        try:
            _write(out, {"row": to_plain(answer(job))})
        except Exception as error:  # an error ends the job, not the run
            text = one_line(str(error))
            _write(out, {"error": f"{type(error).__name__}: {text}" if text else str(type(error))})


def _read(source: BinaryIO, lines: queue.SimpleQueue[bytes]) -> None:
    """Queue the lines, and exit the process after the last one."""
    for line in source:
        lines.put(line)
    os._exit(0)


def _write(out: BinaryIO, message: object) -> None:
    out.write(json.dumps(message).encode() + b"\n")
    out.flush()


if __name__ == "__main__":
    from .job import answer_job

    serve(answer_job)
