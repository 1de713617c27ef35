"""momapos bench: run suites of tasks, and report what came of them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from momapos.bench.records import Settings
from momapos.bench.suites import SUITES
from momapos.cli.console import progress
from momapos.cli.options import check_seed
from momapos.errors import InputError, unknown_name

if TYPE_CHECKING:
    from momapos.bench.records import Row


def bench_run(
    suite: Positional[str],
    /,
    *,
    out: Path,
    methods: tuple[str, ...] = (),
    robots: tuple[str, ...] = (),
    workers: int = 2,
    seed: int = 0,
    limit: int = 0,
    timeout: float = 20.0,
    task_limit: float = 300.0,
    execute: bool = False,
) -> int:
    """Run a suite: every task by every method; what has a row already is not run again.

    Args:
        suite: smoke, openings, paper-sim, paper-real or ablations.
        out: The results folder; a run that was stopped goes on in it.
        methods: Methods of `momapos place`, or variants such as paper:paper.group=1; those of the
            suite by default.
        robots: Robots of the library; those of the suite by default.
        workers: Processes that answer at once.
        seed: What the suite is drawn from.
        limit: So many of the suite's tasks, drawn from it; all where 0.
        timeout: Processor time to search for one answer [s].
        task_limit: Wall time after which a task counts as hung [s].
        execute: Carry solved plans out in physics.
    """
    check_seed(seed)
    if suite not in SUITES:
        raise unknown_name("suite", suite, SUITES, "momapos bench")
    for name, least in (("workers", 1), ("limit", 0)):
        if locals()[name] < least:
            raise InputError(f"--{name} must be at least {least}")
    for name, value in (("timeout", timeout), ("task-limit", task_limit)):
        if not 0 < value < float("inf"):
            raise InputError(f"--{name} must be above 0 s, not {value:g}")
    from momapos.bench.folder import all_rows, held, open_folder, rows_file
    from momapos.bench.guard import local_workers, run_job
    from momapos.bench.methods import method_config
    from momapos.bench.runner import jobs_of, run_jobs
    from momapos.bench.store import Store
    from momapos.cli.compile import ANSWER, RANK, WALKS, compile_once

    chosen = tuple(dict.fromkeys(methods)) or SUITES[suite].methods
    for method in chosen:
        method_config(method, timeout)
    compile_once((*ANSWER, *RANK, *WALKS))
    out.mkdir(parents=True, exist_ok=True)
    with held(out):
        made, versions = open_folder(out, suite, seed, robots)
        settings = Settings(timeout, task_limit, execute)
        jobs = jobs_of(made, chosen, out, settings, versions, limit or None)
        done = {row.key for row in all_rows(out)}
        store = Store(rows_file(out))
        with local_workers(workers) as executor, progress(f"{suite}") as report:
            run_jobs(
                jobs, store, executor, run_job, width=workers,
                tell=lambda row: print(row.task, row.method, row.outcome, row.reason, row.seconds, file=sys.stderr), finished=done,
            )
        store.close()
    return 0
