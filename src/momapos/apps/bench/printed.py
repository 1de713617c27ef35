"""Compare results with the figures that the paper prints for its four tasks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .bench_records import Row
from .cells import Cell, Table
from .metrics import grouped, stage_shares, succeeded

PRINTED = (
    ("grasp apple", "MoMa-Pos", "13.5 +- 2.0", "3.2 +- 1.2", 100),
    ("grasp apple", "Habitat", "17.3 +- 0.2", "3.0 +- 0.0", 100),
    ("grasp apple", "M3*", "17.8 +- 2.3", "3.2 +- 1.1", 100),
    ("grasp apple", "Reuleaux", "19.2 +- 4.3", "3.6 +- 1.6", 100),
    ("grasp cup", "MoMa-Pos", "13.2 +- 2.4", "3.5 +- 1.4", 100),
    ("grasp cup", "Habitat", "16.9 +- 2.7", "3.2 +- 0.0", 100),
    ("grasp cup", "M3*", "17.3 +- 3.2", "3.3 +- 0.1", 100),
    ("grasp cup", "Reuleaux", "18.7 +- 3.9", "3.7 +- 1.1", 100),
    ("open fridge", "MoMa-Pos", "17.4 +- 2.3", "2.3 +- 0.1", 100),
    ("open fridge", "Habitat", "15.7 +- 1.4", "2.2 +- 0.0", 18),
    ("open fridge", "M3*", "18.2 +- 8.4", "2.2 +- 0.1", 26),
    ("open fridge", "Reuleaux", "17.7 +- 2.7", "2.5 +- 0.1", 70),
    ("open microwave", "MoMa-Pos", "17.2 +- 1.0", "3.7 +- 1.6", 100),
    ("open microwave", "Habitat", "14.4 +- 0.4", "3.2 +- 0.0", 22),
    ("open microwave", "M3*", "17.4 +- 1.4", "3.5 +- 0.0", 44),
    ("open microwave", "Reuleaux", "18.0 +- 2.0", "3.6 +- 1.4", 82),
)
"""Task, method, time [s], driving length [m], success rate [%]: the main table of Shao et al."""
STAGES = {"modeling": 58.0, "importance": 0.8, "placing": 40.9}
"""Published shares of the time from scan to motion [%]; placing is the paper's potential and
feasibility together."""
MODELING, IMPORTANCE = "modeling", "importance"
MARK = "as printed"


def printed_table(rows: Sequence[Row]) -> Table:
    """Build the table of the paper's four tasks: our results, then the printed ones."""
    lines = []
    for task in dict.fromkeys(task for task, *_ in PRINTED):
        mine = [row for row in rows if row.group == task]
        for method, some in grouped(mine, lambda row: row.method).items():
            good = [row for row in some if succeeded(row)]
            percent = f"{100 * len(good) / len(some):.0f} % of {len(some)}"
            seconds = [row.seconds for row in good if row.seconds is not None]
            driving = [row.driving for row in good if row.driving is not None]
            keys = tuple(row.key for row in good)
            spread = Cell(_spread(seconds, "s"), keys), Cell(_spread(driving, "m"), keys)
            lines.append((Cell(task), Cell(method), *spread, Cell(percent, keys)))
        lines += [
            (Cell(task), Cell(f"{method}, {MARK}"), Cell(f"{seconds} s"), Cell(f"{length} m"),
             Cell(f"{percent} %"))
            for name, method, seconds, length, percent in PRINTED
            if name == task
        ]  # fmt: skip
    note = (
        "As printed: Shao et al., on the real robot. Their time includes perception and modeling; "
        "ours does with --scan. Their start poses differ: compare driving only within one "
        "source. Mean and standard deviation of the successes."
    )
    columns = ("task", "method", "time", "driving", "success")
    return Table("The paper's table and ours", columns, tuple(lines), note)


def printed_stages(rows: Sequence[Row]) -> Table:
    """Build the table of the stages from scan to motion, with the paper's shares."""
    lines = []
    for method, mine in grouped(rows, lambda row: row.method).items():
        from_scan = [row for row in mine if MODELING in row.stages]
        shares, keys = scan_shares(from_scan), tuple(row.key for row in from_scan)
        if shares:
            cells = (Cell(f"{shares[stage]:.1f} %", keys) for stage in STAGES)
            lines.append((Cell(method), *cells))
    lines.append((Cell(f"MoMa-Pos, {MARK}"), *(Cell(f"{x:.1f} %") for x in STAGES.values())))
    note = (
        "Shares of the processor time from the images of the scan to the planned motion. "
        "Placing: potential and feasibility of the samples."
    )
    return Table("From scan to motion", ("method", *STAGES), tuple(lines), note)


def pies(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """Return the shares of the stages by method; with a scan, the paper's too."""
    by_method = grouped(rows, lambda row: row.method)
    from_scan = {
        method: scan_shares([row for row in mine if MODELING in row.stages])
        for method, mine in by_method.items()
    }
    known = {method: shares for method, shares in from_scan.items() if shares}
    if known:
        return {**known, f"MoMa-Pos, {MARK}": STAGES}
    return {method: dict(stage_shares(mine)) for method, mine in by_method.items()}


def scan_shares(rows: Sequence[Row]) -> dict[str, float]:
    """Return the share of each of the paper's stages in the total time [%]; empty for no time."""
    total = sum(sum(row.stages.values()) for row in rows)
    if not total:
        return {}
    first = {
        stage: 100 * sum(row.stages.get(stage, 0.0) for row in rows) / total
        for stage in (MODELING, IMPORTANCE)
    }
    return {**first, "placing": 100 - sum(first.values())}


def _spread(values: Sequence[float], unit: str) -> str:
    return f"{np.mean(values):.2f} +- {np.std(values):.2f} {unit}" if values else "-"
