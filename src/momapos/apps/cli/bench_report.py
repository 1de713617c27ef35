"""momapos bench report: print the results of a suite."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from momapos.apps.bench import ARM_SUITE
from momapos.core import InputError, say

from .options import Flag, OptionalFolder

if TYPE_CHECKING:
    from momapos.apps.bench import Contents, Row


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
