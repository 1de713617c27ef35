"""Report the stages from a scan to a motion, next to the shares of time that the paper prints.

Only solved tasks count, as in the paper: an infeasible answer models every object.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .bench_records import Row
from .markdown_report import Table
from .metrics import grouped, succeeded
from .printed import MARK

SURVEY, MODELING, CHECKS = "survey", "modeling", "checks"
"""Stages: from the images to the boxes of all objects; the models; all but the named stages."""
STAGES: Mapping[str, float] = {MODELING: 58.0, CHECKS: 40.0, "potential": 0.9, "importance": 0.8}
"""The paper's shares of the time [%]; it names no time for the boxes of the objects."""


def from_scan(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of tasks that were solved from a scan."""
    return [row for row in rows if MODELING in row.stages and succeeded(row)]


def printed_stages(rows: Sequence[Row]) -> Table:
    """Build the table of the shares of time from scan to motion, with the paper's.

    Each method has two lines: of the whole time, and of the time without the survey.
    """
    lines = []
    for method, mine in grouped(from_scan(rows), lambda row: row.method).items():
        for words, without in ((method, ()), (f"{method}, without {SURVEY}", (SURVEY,))):
            shares = scan_shares(mine, without)
            cells = (
                f"{shares[stage]:.1f} %" if stage in shares else "-" for stage in (SURVEY, *STAGES)
            )
            lines.append((words, *cells))
    printed = (f"{share:.1f} %" for share in STAGES.values())
    lines.append((f"MoMa-Pos, {MARK}", "-", *printed))
    note = (
        f"Shares of the processor time of solved tasks. {SURVEY}: from the images to a labeled box "
        f"of each object, which the paper's table does not contain. {CHECKS}: all other stages, "
        "mainly the arm motions at the samples."
    )
    return Table("From scan to motion", ("method", SURVEY, *STAGES), tuple(lines), note)


def modeling_table(rows: Sequence[Row]) -> Table:
    """Build the table of the time to model objects by class: the paper's figure."""
    chosen = from_scan(rows)
    classes = list(dict.fromkeys(row.group for row in chosen))
    lines = []
    for method, times in modeling_times(chosen).items():
        cells = (f"{times[name]:.2f} s" if name in times else "-" for name in classes)
        lines.append((method, *cells))
    note = (
        f"Mean processor time of the models in solved tasks, without the {SURVEY}. The variant "
        "paper:importance.alpha=0 models every object."
    )
    return Table("Modeling time by class", ("method", *classes), tuple(lines), note)


def modeling_times(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Return the mean time to model objects by method and class [s]."""
    return {
        method: {
            name: float(np.mean([row.stages[MODELING] for row in some]))
            for name, some in grouped(mine, lambda row: row.group).items()
        }
        for method, mine in grouped(from_scan(rows), lambda row: row.method).items()
    }


def scan_shares(rows: Sequence[Row], without: Sequence[str] = ()) -> dict[str, float]:
    """Return the share of each stage in the time from scan to motion [%]; empty for no time.

    Args:
        rows: The answers.
        without: Stages that don't count.
    """
    spent: dict[str, float] = dict.fromkeys((SURVEY, *STAGES), 0.0)
    for row in rows:
        for stage, seconds in row.stages.items():
            spent[stage if stage in spent else CHECKS] += seconds
    counted = {stage: seconds for stage, seconds in spent.items() if stage not in without}
    total = sum(counted.values())
    return {stage: 100 * seconds / total for stage, seconds in counted.items()} if total else {}
