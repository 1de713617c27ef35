"""The process that answers jobs: one JSON object a line in, one a line out.

It ends when nobody listens any more, whatever it is doing: its runner may have been killed.
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
    """Answer the jobs that come on the standard input, until it ends.

    What libraries print goes to the standard error, so that answers stand alone.
    """
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, lines), daemon=True).start()
    _say(out, {"ready": True})
    while True:
        job = from_plain(json.loads(lines.get()), Job, "worker")
        try:
            _say(out, {"row": to_plain(answer(job))})
        except Exception as error:  # whatever it is, it is the job's end and not the run's
            text = one_line(str(error))
            _say(out, {"error": f"{type(error).__name__}: {text}" if text else str(type(error))})


def _read(source: BinaryIO, lines: queue.SimpleQueue[bytes]) -> None:
    """Hand lines on, and end the process where there are no more."""
    for line in source:
        lines.put(line)
    os._exit(0)


def _say(out: BinaryIO, what: object) -> None:
    out.write(json.dumps(what).encode() + b"\n")
    out.flush()


if __name__ == "__main__":
    from .job import answer_job

    serve(answer_job)
