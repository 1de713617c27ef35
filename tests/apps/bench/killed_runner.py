"""Run many short jobs, and print the key of each reported row; the test kills this process."""

from __future__ import annotations

import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tests.apps.bench.fakes import job, row

from momapos.apps.bench.bench_records import to_plain
from momapos.apps.bench.folder import RowStore, all_rows, rows_file
from momapos.apps.bench.runner import run_jobs

PAUSE = threading.Event()


def run(plain_job: dict[str, Any]) -> dict[str, Any]:
    PAUSE.wait(0.004)
    plain: dict[str, Any] = to_plain(row(plain_job["key"]))
    return plain


if __name__ == "__main__":
    folder, count = Path(sys.argv[1]), int(sys.argv[2])
    finished = {found.key for found in all_rows(folder)}
    store = RowStore(rows_file(folder))
    print("begins", flush=True)
    run_jobs(
        [job(f"key {k}") for k in range(count)], store, ThreadPoolExecutor(2), run, width=2,
        on_row=lambda new: print(new.key, flush=True), finished=finished,
    )  # fmt: skip
    store.close()
