"""Laws of jobs on a Dask cluster, with two workers on this machine."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import pytest
from tests import optional
from tests.apps.bench.fakes import WORKER, job
from tests.commands import error_of

from momapos.apps.bench.bench_records import Row
from momapos.apps.bench.folder import RowStore, read_rows
from momapos.apps.bench.runner import cluster, run_job, run_jobs
from momapos.core.errors import InputError


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_a_cluster_answers_every_job_even_if_jobs_and_a_worker_die(tmp_path: Path) -> None:
    distributed = optional.module("distributed")
    whats = ("answers", "dies", "hangs", "raises")
    jobs = [job(f"{what} {k}", what, 2.0) for k in range(4) for what in whats]
    reported: list[Row] = []
    store = RowStore(tmp_path / "rows-x.sqlite")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as made:
        victim = made.workers[0]

        def on_row(row: Row) -> None:
            reported.append(row)
            if len(reported) == 5:
                victim.process.process._process.kill()

        with cluster(made.scheduler_address) as (executor, width):
            assert width == 2
            run_jobs(
                jobs, store, executor, partial(run_job, command=WORKER), width=width, on_row=on_row
            )
    assert {row.key for row in read_rows(store.path)} == {one.key for one in jobs}
    assert len(reported) == len(jobs)
    reasons = {"answers": "pid ", "dies": "its process was killed", "hangs": "hung: no answer",
               "raises": "ValueError: of two lines"}  # fmt: skip
    assert all(row.reason.startswith(reasons[row.key.split()[0]]) for row in reported)


@pytest.mark.timeout(60)
def test_a_missing_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    optional.module("distributed")
    monkeypatch.setattr("momapos.apps.bench.runner.CONNECT_TIMEOUT", 0.5)
    for address in ("tcp://127.0.0.1:1", "no address"):
        with pytest.raises(InputError, match="no Dask scheduler answers there"), cluster(address):
            raise AssertionError(f"there is a scheduler at {address}")


def test_without_dask_the_message_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    command = ["bench", "run", "smoke", "--scheduler", "tcp://127.0.0.1:1", "--limit", "1"]
    assert "pip install distributed" in error_of(*command, "--out", str(tmp_path / "out"))
