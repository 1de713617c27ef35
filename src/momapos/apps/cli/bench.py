"""momapos bench: run suites of tasks, and print their results."""

from __future__ import annotations

import json as json_format
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional, get_args

from tyro.conf import Positional, arg

from momapos.apps.bench import (
    ARM_SUITE,
    SUITES,
    Commit,
    GraspSet,
    Outcome,
    Settings,
    protocols_of,
    refuse_unknown,
)
from momapos.core import InputError, check_outputs, resolved, say

from .console import busy, progress
from .options import Flag, OptionalFolder, Text, check_count, check_seed, optional

if TYPE_CHECKING:
    from momapos.apps.bench import Contents, Row


MAX_COUNT, MAX_TASKS = 1_000, 1_000_000
"""Maximum number of images in a scan, and of disturbed base poses [-]."""

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from momapos.apps.bench import Row


def bench_run(
    suite: Annotated[Positional[str], arg(metavar="SUITE")],
    /,
    *,
    out: Annotated[Path, arg(metavar="DIR")],
    methods: Annotated[tuple[str, ...], arg(metavar="[METHOD ...]")] = (),
    robots: Annotated[tuple[str, ...], arg(metavar="[ROBOT ...]")] = (),
    workers: int = 2,
    scheduler: Annotated[Text, optional("ADDRESS")] = None,
    seed: int = 0,
    limit: int = 0,
    timeout: float = Settings.timeout,
    task_limit: float = Settings.limit,
    commit: Annotated[Optional[Commit], optional("first|retry", "retry")] = None,  # noqa: UP045
    grasps: Annotated[Optional[GraspSet], optional("one|pinch|all", "all")] = None,  # noqa: UP045
    execute: Flag = False,
    scan: int = Settings.scan,
    disturbances: int = 3,
    record: OptionalFolder = None,
    problems: OptionalFolder = None,
    json: Flag = False,
) -> int:
    """Run all tasks of a suite with all methods; skip tasks that already have a result.

    Exit status: 0 all tasks have a result; 2 unusable input.

    Args:
        suite: smoke, openings, paper-sim, paper-real, paper-table, authors-sim, ablations,
            articulated or motionbenchmaker; see docs/benchmark.md.
        out: The results folder; a stopped run continues in it.
        methods: Methods of `momapos place`, or variants such as paper:paper.group=1 (default: those
            of the suite); for motionbenchmaker ours or RRTConnect, which is OMPL's.
        robots: Library robots (default: those of the suite); for motionbenchmaker also robot files
            and URDFs of arms.
        workers: Number of parallel processes on this machine.
        scheduler: Run on the workers of this Dask scheduler, such as tcp://192.168.0.1:8786. They
            must see the results folder under the same path.
        seed: Seed of the suite's tasks.
        limit: Run this many tasks, drawn from the whole suite; 0: all.
        timeout: Processor time to search for one plan [s].
        task_limit: Wall time after which a task counts as hung [s].
        commit: first: the first base pose that a method proposes counts, and is checked in the true
            scene; retry: a method tries its base poses in turn.
        grasps: one: a straight pinch of the middle of the handle or object; pinch: all pinches;
            all: every grasp of momapos.
        execute: Execute solved plans in simulation, with contact grasps and noise.
        scan: Number of images of a synthetic scan from which the robot knows each room, such as 60;
            0: it knows the true scene.
        disturbances: Number of base poses that are 2 cm and 2 deg from the planned one, and as many
            5 cm and 5 deg from it, at which the arm motion is replanned; 0: none.
        record: With --execute, write the record of each new run to this folder, in a folder for
            each robot; 'momapos export' makes a set of episodes of these.
        problems: For motionbenchmaker, the folder that contains the folders KIND_ROBOT; for
            articulated, the one that contains the objects of PartNet-Mobility, KIND/NUMBER.
        json: Print one JSON object, and nothing else.
    """
    # Mistakes are reported before anything heavy is imported.
    check_seed(seed)
    if suite == ARM_SUITE:
        check_count("--limit", limit, 0, MAX_TASKS)
        unused = {
            "--workers": workers != 2, "--scheduler": scheduler, "--commit": commit,
            "--grasps": grasps, "--execute": execute, "--scan": scan,
            "--timeout": timeout != Settings.timeout, "--disturbances": disturbances != 3,
            "--task-limit": task_limit != Settings.limit, "--record": record,
        }  # fmt: skip
        wrong = [name for name, given in unused.items() if given]
        if wrong:
            raise InputError(f"{suite} plans arm motions, one by one; leave out {', '.join(wrong)}")
        return _run_arms(problems, robots, methods, out, limit, seed, json=json)
    refuse_unknown(suite, robots)
    _check_problems(suite, problems)
    check_count("--workers", workers, 1, MAX_COUNT)
    check_count("--limit", limit, 0, MAX_TASKS)
    for name, value in (("--timeout", timeout), ("--task-limit", task_limit)):
        if not 0 < value < math.inf:
            raise InputError(f"{name} must be a time above 0 s, not {value:g}")
    for name, count in (("--scan", scan), ("--disturbances", disturbances)):
        check_count(name, count, 0, MAX_COUNT)
    protocols = protocols_of(suite, commit, grasps)
    if scan:
        _check_scannable(suite)
    if scan and commit == "first":
        raise InputError("--commit first checks the base pose in the true scene; leave out --scan")
    if record is not None and (scan or not execute):
        raise InputError("--record needs --execute, and runs in the true scene without --scan")
    check_outputs(folders=[out, record])
    from momapos.apps.bench import method_config

    chosen = tuple(dict.fromkeys(methods)) or SUITES[suite].methods
    for method in chosen:
        for protocol in protocols:
            method_config(method, timeout, protocol)
    from momapos.apps.bench import (
        RowStore,
        all_rows,
        jobs_of,
        locked,
        open_folder,
        rows_file,
        run_jobs,
    )

    from .compile import ANSWER, RANK, WALKS, compile_once

    compile_once((*ANSWER, *RANK, *WALKS))
    folder = "" if problems is None else str(resolved(problems))
    settings = Settings(timeout, task_limit, execute, scan, disturbances, protocols, folder)
    with locked(out), _executor(workers, scheduler) as (executor, width, do):
        with (
            progress(f"{suite}: drawing the rooms") as report,
            nullcontext() if SUITES[suite].rooms else busy(f"{suite}: preparing the tasks"),
        ):
            made = open_folder(out, suite, seed, robots, settings, limit or None, report)
        jobs = jobs_of(
            made.suite, chosen, out, settings, made.versions, limit or None,
            "" if record is None else str(record.absolute()),
        )  # fmt: skip
        before = {row.key for row in all_rows(out)}
        left = sum(job.key not in before for job in jobs)
        store = RowStore(rows_file(out))
        try:
            with _progress_of(suite, left) as on_row:
                run_jobs(jobs, store, executor, do, width=width, on_row=on_row, finished=before)
        finally:
            store.close()
    keys = {job.key for job in jobs}
    rows = [row for row in all_rows(out) if row.key in keys]
    facts = {"suite": suite, "out": str(out), "jobs": len(jobs), "new": left, **_counts(rows)}
    if json:
        say(json_format.dumps(facts))
    else:
        say(f"{suite}: {len(jobs)} results, {left} of them new, in {out}")
        for method, counts in facts["outcomes"].items():
            say(f"  {method}: " + ", ".join(f"{n} {what}" for what, n in counts.items()))
        say(f"Show tables with 'momapos bench report {out}'.")
    return 0


def _run_arms(
    problems: Path | None, robots: tuple[str, ...], planners: tuple[str, ...], out: Path,
    limit: int, seed: int, *, json: bool,
) -> int:  # fmt: skip
    """Plan the arm problems of a folder, and print the number of results."""
    if problems is None:
        raise InputError(f"{ARM_SUITE} needs --problems, the folder that contains KIND_ROBOT")
    from momapos.apps.bench import (
        arm_outcomes,
        check_arm_suite,
        run_arm_suite,
        write_arm_results,
    )

    robots = tuple(dict.fromkeys(robots)) or ("fetch",)
    planners = tuple(dict.fromkeys(planners)) or ("ours",)
    check_arm_suite(robots, planners)
    check_outputs(folders=[out])
    with progress(ARM_SUITE) as report:
        found = run_arm_suite(
            problems, robots, planners, limit=limit, seed=seed,
            on_row=lambda done, count: report(done / count, f"{done}/{count}"),
        )  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    write_arm_results(found, out)
    outcomes = dict(arm_outcomes(found))
    if json:
        facts = {"suite": ARM_SUITE, "out": str(out), "problems": len(found.rows)}
        say(json_format.dumps({**facts, "results": outcomes}))
    else:
        say(f"{ARM_SUITE}: {len(found.rows)} results, in {out}")
        for run, counts in outcomes.items():
            say(f"  {run}: " + ", ".join(f"{n} {what}" for what, n in counts.items()))
        say(f"Show tables with 'momapos bench report {out}'.")
    return 0


def _check_problems(suite: str, problems: Path | None) -> None:
    """Refuse a missing or superfluous folder of problems.

    Raises:
        InputError: The suite needs one, or makes its own tasks.
    """
    if SUITES[suite].needs_objects:
        if problems is None:
            raise InputError(
                f"{suite} needs --problems, the folder that contains the objects of "
                "PartNet-Mobility as KIND/NUMBER/mobility.urdf"
            )
    elif problems is not None:
        others = [name for name, kind in SUITES.items() if kind.needs_objects]
        raise InputError(
            f"--problems is for {', '.join((*others, ARM_SUITE))}; {suite} makes its own tasks"
        )


def _check_scannable(suite: str) -> None:
    """Refuse --scan for suites that need objects which no scan shows.

    Raises:
        InputError: The suite takes objects out of closed furniture.
        MissingExtraError: Packages for scans are missing.
    """
    if not SUITES[suite].scannable:
        others = ", ".join(name for name, kind in SUITES.items() if kind.scannable)
        raise InputError(
            f"--scan: a scan can't show the objects in the drawers of {suite}; use {others}"
        )
    from momapos.perception import default_tools

    default_tools()


@contextmanager
def _executor(
    workers: int, scheduler: str | None
) -> Iterator[tuple[Executor, int, Callable[[dict[str, Any]], dict[str, Any]]]]:
    """Start the workers; yield them, their number and the job function."""
    from momapos.apps.bench import local_workers, run_job

    if scheduler is None:
        with local_workers(workers) as executor:
            yield executor, workers, run_job
        return
    from momapos.apps.bench import cluster

    with cluster(scheduler) as (executor, width):
        yield executor, width, run_job


@contextmanager
def _progress_of(suite: str, count: int) -> Iterator[Callable[[Row], None]]:
    """Show the number of results, and the time left."""
    done, began = 0, time.monotonic()
    with progress(suite) as report:

        def on_row(_: Row) -> None:
            nonlocal done
            done += 1
            seconds = (time.monotonic() - began) / done * (count - done)
            report(done / count, f"{done}/{count}, {_duration(seconds)} left")

        yield on_row


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _counts(rows: list[Row]) -> dict[str, Any]:
    """Count outcomes by method, and successes in simulation."""
    from momapos.apps.bench import labeled

    rows = labeled(rows)
    found = Counter((row.method, row.outcome) for row in rows)
    outcomes = {
        method: {what: found[method, what] for what in get_args(Outcome) if found[method, what]}
        for method in sorted({row.method for row in rows})
    }
    executed = [row.done for row in rows if row.done is not None]
    physics = {"executed": len(executed), "done": sum(executed)} if executed else {}
    return {"outcomes": outcomes, **physics}


def bench_data(suite: Annotated[Positional[str], arg(metavar="SUITE")], /) -> int:
    """Print what a suite needs that momapos does not contain, and where it must lie.

    Exit status: 0 all is there; 2 something is missing.

    Args:
        suite: paper for all suites of the paper, or one of paper-real, paper-table, authors-sim.
    """
    from momapos.apps.bench import data_lines

    lines, complete = data_lines(suite)
    for line in lines:
        say(line)
    return 0 if complete else 2


def bench_report(
    folder: Annotated[Positional[Path], arg(metavar="DIR")],
    /,
    *,
    compare: OptionalFolder = None,
    json: Flag = False,
) -> int:
    """Print the tables of a results folder as Markdown.

    Args:
        folder: The results folder.
        compare: Another results folder of the same tasks, to compare task by task.
        json: Print one JSON object with all rows instead of tables.
    """
    from momapos.apps.bench import ARM_FILE, all_rows, in_order, read_folder

    if (folder / ARM_FILE).is_file():
        if compare is not None:
            raise InputError(f"{folder}: results of {ARM_SUITE} are reported as Markdown or --json")
        return _report_arms(folder, json=json)
    found = read_folder(folder)
    rows = in_order(found.suite, all_rows(folder))
    if not rows:
        raise InputError(f"{folder}: contains no results yet; 'momapos bench run' writes them")
    from momapos.apps.bench import all_tables, compared_tables, labeled

    tables = all_tables(found.suite, rows)
    if compare is not None:
        other = read_folder(compare)
        compared = compared_tables(labeled(rows), labeled(all_rows(compare)))
        if not compared[0].lines:
            raise InputError(
                f"{compare}: shares no task and method with {folder} (suites "
                f"{other.suite.name} and {found.suite.name})"
            )
        tables += compared
    heading = _heading(found, rows)
    if json:
        from momapos.apps.bench import to_plain

        say(json_format.dumps({**to_plain(found), "rows": to_plain(rows)}))
    else:
        from momapos.apps.bench import markdown

        say(markdown(heading, tables))
    return 0


def _report_arms(folder: Path, *, json: bool) -> int:
    """Print the results of arm problems."""
    from momapos.apps.bench import arm_heading, arm_tables, markdown, read_arm_results, to_plain

    found = read_arm_results(folder)
    if json:
        say(json_format.dumps(to_plain(found)))
    else:
        say(markdown(arm_heading(found), arm_tables(found)))
    return 0


def _heading(found: Contents, rows: list[Row]) -> list[str]:
    suite, settings = found.suite, found.settings
    hosts = sorted({row.host for row in rows})
    return [
        f"momapos bench: {suite.name}",
        f"{len({row.task for row in rows})} of {len(suite.tasks)} tasks, {len(rows)} results; "
        f"suite revision {suite.revision}, seed {suite.seed}; robots {', '.join(suite.robots)}.",
        f"{settings.timeout:g} s of processor time per plan, {settings.limit:g} s per task"
        + ("; executed in simulation" if settings.execute else "; not executed")
        + (f"; rooms known from a scan of {settings.scan} images" if settings.scan else "")
        + f"; protocols (base pose, grasps): {'; '.join(map(str, settings.protocols))}.",
        "Created with " + ", ".join(f"{name} {version}" for name, version in found.versions.items())
        + f", on {', '.join(hosts)}.",
    ]  # fmt: skip
