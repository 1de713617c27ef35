"""momapos bench: run suites of tasks, and report what came of them."""

from __future__ import annotations

import json as json_format
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from tyro.conf import Positional

from momapos.apps.bench import SUITES, Outcome, Settings, refuse_unknown
from momapos.core import InputError, MomaposError, check_outputs

from .console import busy, progress
from .options import OptionalPath, OptionalText, check_seed

MOST = 1000
"""Images of a scan, and base poses off the planned one [-]."""

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from momapos.apps.bench import Contents, Picture, Row


def bench_run(
    suite: Positional[str],
    /,
    *,
    out: Path,
    methods: tuple[str, ...] = (),
    robots: tuple[str, ...] = (),
    workers: int = 2,
    scheduler: OptionalText = None,
    seed: int = 0,
    limit: int = 0,
    timeout: float = Settings.timeout,
    task_limit: float = Settings.limit,
    execute: bool = False,
    scan: int = Settings.scan,
    disturbances: int = 3,
    json: bool = False,
) -> int:
    """Ask every task of a suite of every method; what has an answer already is not asked again.

    Exit status: 0 all have an answer, whatever it is; 2 something cannot be used.

    Args:
        suite: smoke, openings, paper-sim, paper-real or ablations; see docs/benchmark.md.
        out: The results folder; a run that was stopped goes on in it.
        methods: Methods of `momapos place`, or variants such as paper:paper.group=1; those of the
            suite by default.
        robots: Robots of the library; those of the suite by default.
        workers: Processes that answer at once on this machine.
        scheduler: Address of a Dask scheduler whose workers answer instead, as
            tcp://192.168.0.1:8786; they must see the results folder under the same path.
        seed: What the suite is drawn from.
        limit: Ask so many of the suite's tasks, drawn from all; 0 for all.
        timeout: Processor time to search for one answer [s].
        task_limit: Wall time after which a task counts as hung [s].
        execute: Carry solved plans out in physics, held by contact, with noise.
        scan: The robot knows a room by a synthetic scan of so many images (60, say), which is made
            once a room; 0: as it is.
        disturbances: Plan the arm's motion anew at so many base poses 2 cm and 2 degrees, and as
            many 5 cm and 5 degrees off the planned one; 0: at none.
        json: Print one JSON object and nothing else.
    """
    # Told before anything heavy is imported.
    check_seed(seed)
    refuse_unknown(suite, robots)
    _at_least("--workers", workers, 1)
    _at_least("--limit", limit, 0)
    for name, value in (("--timeout", timeout), ("--task-limit", task_limit)):
        if not 0 < value < math.inf:
            raise InputError(f"{name} must be a time above 0 s, not {value:g}")
    for name, count in (("--scan", scan), ("--disturbances", disturbances)):
        if not 0 <= count <= MOST:
            raise InputError(f"{name} must be between 0 and {MOST}, not {count}")
    if scan:
        _check_scannable(suite)
    check_outputs(folders=[out])
    from momapos.apps.bench import method_config

    chosen = tuple(dict.fromkeys(methods)) or SUITES[suite].methods
    for method in chosen:
        method_config(method, timeout)
    from momapos.apps.bench import Store, all_rows, held, jobs_of, open_folder, rows_file, run_jobs

    from .compile import ANSWER, RANK, WALKS, compile_once

    compile_once((*ANSWER, *RANK, *WALKS))
    settings = Settings(timeout, task_limit, execute, scan, disturbances)
    with held(out), _executor(workers, scheduler) as (executor, width, do):
        with busy(f"{suite}: looking at the tasks"):
            made = open_folder(out, suite, seed, robots, settings)
        jobs = jobs_of(made.suite, chosen, out, settings, made.versions, limit or None)
        before = {row.key for row in all_rows(out)}
        left = sum(job.key not in before for job in jobs)
        store = Store(rows_file(out))
        try:
            with _left(suite, left) as tell:
                run_jobs(jobs, store, executor, do, width=width, tell=tell, finished=before)
        finally:
            store.close()
    asked = {job.key for job in jobs}
    rows = [row for row in all_rows(out) if row.key in asked]
    facts = {"suite": suite, "out": str(out), "jobs": len(jobs), "new": left, **_counts(rows)}
    if json:
        print(json_format.dumps(facts))
    else:
        print(f"{suite}: {len(jobs)} answers, {left} of them new, in {out}")
        for method, counts in facts["outcomes"].items():
            print(f"  {method}: " + ", ".join(f"{n} {what}" for what, n in counts.items()))
        print(f"'momapos bench report {out}' says more.")
    return 0


def bench_report(
    folder: Positional[Path],
    /,
    *,
    compare: OptionalPath = None,
    html: OptionalPath = None,
    maps: int = 3,
    parquet: OptionalPath = None,
    json: bool = False,
) -> int:
    """Print tables of a results folder as Markdown.

    Args:
        folder: The results folder.
        compare: Another one of the same tasks, with which it is compared task by task.
        html: Write one page here, with figures and all rows; it needs no network.
        maps: Draw the potential and the candidates of so many tasks in that page; they are asked
            again, by momapos as it is installed.
        parquet: Write the rows here as a Parquet file.
        json: Print one JSON object with all rows instead of tables.
    """
    check_outputs([html, parquet])
    _at_least("--maps", maps, 0)
    from momapos.apps.bench import all_rows, in_order, read_folder

    found = read_folder(folder)
    rows = in_order(found.suite, all_rows(folder))
    if not rows:
        raise InputError(f"{folder}: holds no rows yet; 'momapos bench run' writes them")
    from momapos.apps.bench import all_tables, compared_tables

    tables = all_tables(found.suite, rows)
    if compare is not None:
        other = read_folder(compare)
        compared = compared_tables(rows, all_rows(compare))
        if not compared[0].lines:
            raise InputError(
                f"{compare}: has no task and method in common with {folder} (suites "
                f"{other.suite.name} and {found.suite.name}); nothing can be compared"
            )
        tables += compared
    heading = _heading(found, rows)
    if html is not None:
        from momapos.apps.bench import page
        from momapos.model.scene import write_whole

        write_whole(html, page(heading, tables, rows, _maps(folder, found, rows, maps)))
    if parquet is not None:
        from momapos.apps.bench import write_parquet

        write_parquet(rows, parquet)
    if json:
        from momapos.apps.bench import to_plain

        print(json_format.dumps({**to_plain(found), "rows": to_plain(rows)}))
    else:
        from momapos.apps.bench import markdown

        print(markdown(heading, tables))
    return 0


def _maps(folder: Path, found: Contents, rows: list[Row], count: int) -> list[Picture]:
    """Pictures of some answers; none is made of what the folder does not hold any more."""
    if not count:
        return []
    from momapos.apps.bench import pictures

    try:
        with busy("drawing"):
            return pictures(folder, found, rows, count)
    except MomaposError as error:
        print(f"note: no potential maps: {error}", file=sys.stderr)
        return []


def _check_scannable(suite: str) -> None:
    """Refuse suites that no scan can start, and scans where nothing reads them.

    Raises:
        InputError: The suite takes things out of what is shut.
        MissingExtraError: What reads scans is not installed.
    """
    if not SUITES[suite].scannable:
        others = ", ".join(name for name, kind in SUITES.items() if kind.scannable)
        raise InputError(
            f"--scan: no scan shows what is in the drawers of {suite}; it starts {others}"
        )
    from momapos.perception import default_tools

    default_tools()


def _at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise InputError(f"{name} must be at least {least}, not {value}")


@contextmanager
def _executor(
    workers: int, scheduler: str | None
) -> Iterator[tuple[Executor, int, Callable[[dict[str, Any]], dict[str, Any]]]]:
    """Who answers, how many at once, and by what."""
    from momapos.apps.bench import local_workers, run_job

    if scheduler is None:
        with local_workers(workers) as executor:
            yield executor, workers, run_job
        return
    from momapos.apps.bench import cluster

    with cluster(scheduler) as (executor, width):
        yield executor, width, run_job


@contextmanager
def _left(suite: str, count: int) -> Iterator[Callable[[Row], None]]:
    """Show how many answers came, and for how long the others will take."""
    done, began = 0, time.monotonic()
    with progress(suite) as report:

        def tell(_: Row) -> None:
            nonlocal done
            done += 1
            seconds = (time.monotonic() - began) / done * (count - done)
            report(done / count, f"{done}/{count}, {_duration(seconds)} left")

        yield tell


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _counts(rows: list[Row]) -> dict[str, Any]:
    """Outcomes by method, and how many were done in physics where any were executed."""
    found = Counter((row.method, row.outcome) for row in rows)
    outcomes = {
        method: {what: found[method, what] for what in get_args(Outcome) if found[method, what]}
        for method in sorted({row.method for row in rows})
    }
    executed = [row.done for row in rows if row.done is not None]
    physics = {"executed": len(executed), "done": sum(executed)} if executed else {}
    return {"outcomes": outcomes, **physics}


def _heading(found: Contents, rows: list[Row]) -> list[str]:
    suite, settings = found.suite, found.settings
    hosts = sorted({row.host for row in rows})
    return [
        f"momapos bench: {suite.name}",
        f"{len({row.task for row in rows})} of {len(suite.tasks)} tasks, {len(rows)} answers; "
        f"suite revision {suite.revision}, seed {suite.seed}; robots {', '.join(suite.robots)}.",
        f"{settings.timeout:g} s of processor time for an answer, {settings.limit:g} s for a task"
        + ("; carried out in physics" if settings.execute else "; not carried out")
        + (f"; rooms known by a scan of {settings.scan} images." if settings.scan else "."),
        "Made by " + ", ".join(f"{name} {version}" for name, version in found.versions.items())
        + f", on {', '.join(hosts)}.",
    ]  # fmt: skip
