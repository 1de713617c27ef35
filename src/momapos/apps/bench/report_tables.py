"""Tables of a report; each number knows the rows that it was counted from."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .bench_records import Row, Suite
from .cells import Cell, Table
from .metrics import (
    Share,
    grouped,
    least_driving,
    paired_p_value,
    percentile,
    reasons,
    share,
    solved_by_any,
    stage_shares,
    succeeded,
)
from .printed import MODELING, printed_stages, printed_table

MOST_REASONS = 25
LOOSE = ("pick", "place")
"""What is done with loose things; all else moves a part."""
GRID = "exhaustive"
"""The method that looks at every base pose."""


def all_tables(suite: Suite, rows: Sequence[Row]) -> list[Table]:
    """The tables of one results folder."""
    tables = [summary_table(rows), class_table(rows, "class", "group"), time_table(rows)]
    tables.append(effort_table(suite, rows))
    if len({row.robot for row in rows}) > 1:
        tables.append(class_table(rows, "robot", "robot"))
    tables += [reason_table(rows), stage_table(rows)]
    if suite.name == "paper-real":
        tables.append(printed_table(rows))
    if any(MODELING in row.stages for row in rows):
        tables.append(printed_stages(rows))
    return tables


def summary_table(rows: Sequence[Row]) -> Table:
    """One line a method."""
    by_method = grouped(rows, lambda row: row.method)
    parts = [_success(by_method), _times(by_method), _driving(by_method, least_driving(rows))]
    parts.append(_search(by_method, solved_by_any(rows)))
    if any(row.at_2cm is not None for row in rows):
        parts.insert(1, _base_errors(by_method))
    if GRID in by_method:
        parts.insert(1, _of_the_grid(by_method))
    if any(row.clearance is not None for row in rows):
        parts.append(_clearance(by_method))
    columns = tuple(name for part in parts for name in part.columns)
    lines = tuple(
        (Cell(method, _keys(mine)), *(cell for part in parts for cell in part.cells[method]))
        for method, mine in by_method.items()
    )
    return Table("Methods", ("method", *columns), lines, NOTE)


NOTE = (
    "Time is processor time of an answer. Over the least known: driving beyond the shortest that "
    "any method of this run found for the task, at the median, and of all meters together. Wrong "
    "no: infeasible, and another method solves it. Of what the grid solves: of the tasks that "
    "exhaustive solves. Base off by 2 cm and 2 degrees, or 5 of both: success, counting a task by "
    "the share of such base poses from which the arm, planned anew, still does it."
)


@dataclass(frozen=True)
class _Part:
    """Some columns of the table of methods."""

    columns: tuple[str, ...]
    cells: Mapping[str, tuple[Cell, ...]]
    """By method."""


def _success(by_method: Mapping[str, Sequence[Row]]) -> _Part:
    physics = any(row.done is not None for mine in by_method.values() for row in mine)
    columns = ("tasks", "solved", "95 % interval", *(("done in physics",) if physics else ()))
    cells = {}
    for method, mine in by_method.items():
        solved = [row for row in mine if row.outcome == "solved"]
        done, part = [row for row in mine if row.done], share(len(solved), len(mine))
        line = [
            Cell(str(len(mine)), _keys(mine)), Cell(_of(part), _keys(solved)),
            Cell(_interval(part), _keys(solved)),
        ]  # fmt: skip
        if physics:
            line.append(Cell(_of(share(len(done), len(mine))), _keys(done)))
        cells[method] = tuple(line)
    return _Part(columns, cells)


def _of_the_grid(by_method: Mapping[str, Sequence[Row]]) -> _Part:
    """How much of what an exhaustive search solves a method does, physics included."""
    possible = {row.task for row in by_method[GRID] if row.outcome == "solved"}
    cells = {}
    for method, mine in by_method.items():
        asked = [row for row in mine if row.task in possible]
        good = [row for row in asked if succeeded(row)]
        part = share(len(good), len(asked))
        percent = f", {100 * part.count / part.of:.1f} %" if asked else ""
        cells[method] = (Cell(f"{_of(part)}{percent}", _keys(good)),)
    return _Part(("of what the grid solves",), cells)


def _base_errors(by_method: Mapping[str, Sequence[Row]]) -> _Part:
    cells = {
        method: (
            _mean_success(mine, [row.at_2cm for row in mine]),
            _mean_success(mine, [row.at_5cm for row in mine]),
        )
        for method, mine in by_method.items()
    }
    return _Part(("base off by 2 cm, 2 deg", "by 5 cm, 5 deg"), cells)


def _mean_success(rows: Sequence[Row], shares: Sequence[float | None]) -> Cell:
    """Success where a row counts by a share; what is not solved counts nothing."""
    asked = [k for k, row in enumerate(rows) if shares[k] is not None or row.outcome != "solved"]
    if not asked:
        return Cell("-")
    whole = sum(shares[k] or 0.0 for k in asked)
    good = [rows[k] for k in asked if shares[k]]
    return Cell(f"{100 * whole / len(asked):.0f} %", _keys(good))


def _times(by_method: Mapping[str, Sequence[Row]]) -> _Part:
    cells = {}
    for method, mine in by_method.items():
        seconds = {row.key: row.seconds for row in mine if row.seconds is not None}
        keys, values = tuple(seconds), list(seconds.values())
        cells[method] = tuple(Cell(_number(percentile(values, q), "s"), keys) for q in (50, 95))
    return _Part(("time, median", "95th percentile"), cells)


def _driving(by_method: Mapping[str, Sequence[Row]], least: Mapping[str, float]) -> _Part:
    cells = {}
    for method, mine in by_method.items():
        ways = {
            row.key: (row.driving, least[row.task])
            for row in mine
            if row.outcome == "solved" and row.driving is not None
        }
        driving = [way for way, _ in ways.values()]
        over = [way - short for way, short in ways.values()]
        whole = sum(short for _, short in ways.values())
        beyond = _number(percentile(over, 50), "m", sign=True)
        percent = f", {100 * sum(over) / whole:+.0f} %" if whole > 0 else ""
        cells[method] = (
            Cell(_number(percentile(driving, 50), "m"), tuple(ways)),
            Cell(f"{beyond}{percent}", tuple(ways)),
        )
    return _Part(("driving, median", "over the least known"), cells)


def _search(by_method: Mapping[str, Sequence[Row]], solvable: Collection[str]) -> _Part:
    cells = {}
    for method, mine in by_method.items():
        checked = [row.checked for row in mine if row.checked is not None]
        wrong = [r for r in mine if r.outcome == "infeasible" and r.task in solvable]
        cells[method] = (
            Cell(f"{np.mean(checked):.1f}" if checked else "-", _keys(mine)),
            Cell(str(len(wrong)), _keys(wrong)),
        )
    return _Part(("full checks, mean", "wrong no"), cells)


def _clearance(by_method: Mapping[str, Sequence[Row]]) -> _Part:
    cells = {}
    for method, mine in by_method.items():
        known = {row.key: row.clearance for row in mine if row.clearance is not None}
        cells[method] = (Cell(_number(percentile(list(known.values()), 50), "m"), tuple(known)),)
    return _Part(("clearance, median",), cells)


def class_table(rows: Sequence[Row], title: str, field: str) -> Table:
    """Successes of every method by a field of the row."""
    classes = list(dict.fromkeys(str(getattr(row, field)) for row in rows))
    lines = []
    for method, members in grouped(rows, lambda row: row.method).items():
        line = [Cell(method, _keys(members))]
        for name in classes:
            mine = [row for row in members if getattr(row, field) == name]
            good = [row for row in mine if succeeded(row)]
            part = share(len(good), len(mine))
            line.append(Cell(f"{_of(part)} ({_interval(part)})" if mine else "-", _keys(good)))
        lines.append(tuple(line))
    return Table(f"Success by {title}", ("method", *classes), tuple(lines))


def time_table(rows: Sequence[Row]) -> Table:
    """Median time that every method takes for the tasks of a class that it solves."""
    classes = list(dict.fromkeys(row.group for row in rows))
    lines = []
    for method, members in grouped(rows, lambda row: row.method).items():
        line = [Cell(method, _keys(members))]
        for name in classes:
            mine = [row for row in members if row.group == name and row.outcome == "solved"]
            seconds = [row.seconds for row in mine if row.seconds is not None]
            half = percentile(seconds, 50)
            line.append(Cell("-" if half is None else f"{1000 * half:.0f} ms", _keys(mine)))
        lines.append(tuple(line))
    return Table("Time by class, of what is solved", ("method", *classes), tuple(lines))


def effort_table(suite: Suite, rows: Sequence[Row]) -> Table:
    """Time of each method for tasks that all methods do, and for one that is done."""
    moved = {t.name for t in suite.tasks if t.verb not in LOOSE or t.inside is not None}
    kinds = {"all tasks": rows, "doors and drawers": [r for r in rows if r.task in moved]}
    methods = grouped(rows, lambda row: row.method)
    cells = {method: [Cell(method, _keys(mine))] for method, mine in methods.items()}
    columns = ["method"]
    for kind, some in kinds.items():
        columns += [f"{kind}: done", "median where all do it", "for one that is done"]
        compared = [row for row in some if row.method != GRID]
        failed = {row.task for row in compared if not succeeded(row)}
        shared = {row.task for row in compared} - failed
        for method, line in cells.items():
            mine = [row for row in some if row.method == method]
            good = [row for row in mine if succeeded(row)]
            same = [row for row in good if row.task in shared and row.seconds is not None]
            half = percentile([row.seconds or 0.0 for row in same], 50)
            spent = sum(row.seconds or 0.0 for row in mine)
            line += [
                Cell(_of(share(len(good), len(mine))), _keys(good)),
                Cell(_number(half, "s"), _keys(same)),
                Cell(_number(spent / len(good) if good else None, "s"), _keys(mine)),
            ]
    note = (
        "Processor time. Where all do it: tasks that every method but exhaustive succeeds in. For "
        "one that is done: the time of all answers, failures too, over the tasks that succeed."
    )
    lines = tuple(tuple(line) for line in cells.values())
    return Table("Time for what is done", tuple(columns), lines, note)


def reason_table(rows: Sequence[Row]) -> Table:
    """Why tasks were not solved, the most frequent reason first."""
    methods = list(dict.fromkeys(row.method for row in rows))
    found = list(reasons(rows).items())
    lines = []
    for (outcome, reason), members in found[:MOST_REASONS]:
        counted = [[row for row in members if row.method == method] for method in methods]
        cells = [Cell(str(len(mine)) if mine else "", _keys(mine)) for mine in counted]
        lines.append((Cell(outcome), Cell(reason, _keys(members)), *cells))
    left = sum(len(members) for _, members in found[MOST_REASONS:])
    note = f"{left} more failed for {len(found) - MOST_REASONS} other reasons." if left else ""
    return Table("Failures by reason", ("outcome", "reason", *methods), tuple(lines), note)


def stage_table(rows: Sequence[Row]) -> Table:
    """Each stage of each method: its share in the time of all answers, median, 95th percentile."""
    by_method = grouped(rows, lambda row: row.method)
    shares = {method: stage_shares(mine) for method, mine in by_method.items()}
    stages = list(dict.fromkeys(stage for parts in shares.values() for stage in parts))

    def cell(method: str, stage: str) -> Cell:
        if stage not in shares[method]:
            return Cell("-")
        seconds = [row.stages.get(stage, 0.0) for row in by_method[method] if row.stages]
        half, most = (1000 * (percentile(seconds, q) or 0.0) for q in (50, 95))
        text = f"{100 * shares[method][stage]:.1f} %; {half:.0f}, {most:.0f} ms"
        return Cell(text, _keys(by_method[method]))

    lines = tuple(
        (Cell(method, _keys(by_method[method])), *(cell(method, stage) for stage in stages))
        for method in shares
    )
    note = "Share of the time of all answers; then the median and the 95th percentile of answers."
    return Table("Time by stage", ("method", *stages), lines, note)


def compared_tables(first: Sequence[Row], second: Sequence[Row]) -> list[Table]:
    """Two results of the same tasks, method by method; keys are those of the first."""
    before = {(row.task, row.method): row for row in second}
    pairs = [
        (row, before[row.task, row.method]) for row in first if (row.task, row.method) in before
    ]
    methods = dict.fromkeys(row.method for row, _ in pairs)
    lines = []
    for method in methods:
        mine = [pair for pair in pairs if pair[0].method == method]
        gained = [a for a, b in mine if succeeded(a) and not succeeded(b)]
        lost = [a for a, b in mine if succeeded(b) and not succeeded(a)]
        both = [(a, b) for a, b in mine if succeeded(a) and succeeded(b)]
        times = [
            a.seconds / b.seconds
            for a, b in mine
            if a.seconds is not None and b.seconds is not None and b.seconds > 0
        ]
        ways = [
            a.driving - b.driving
            for a, b in both
            if a.driving is not None and b.driving is not None
        ]
        keys = _keys([a for a, _ in mine])
        lines.append((
            Cell(method, keys), Cell(str(len(mine)), keys),
            Cell(_of(share(sum(succeeded(a) for a, _ in mine), len(mine))), keys),
            Cell(_of(share(sum(succeeded(b) for _, b in mine), len(mine))), keys),
            Cell(f"+{len(gained)}", _keys(gained)), Cell(f"-{len(lost)}", _keys(lost)),
            Cell(f"{paired_p_value(len(gained), len(lost)):.2g}"),
            Cell(_number(percentile(times, 50), "times"), keys),
            Cell(_number(percentile(ways, 50), "m", sign=True), _keys([a for a, _ in both])),
        ))  # fmt: skip
    columns = (
        "method", "tasks of both", "success, this", "the other", "gained", "lost", "p (McNemar)",
        "time, median ratio", "driving, median change",
    )  # fmt: skip
    changed = tuple(
        (Cell(a.task, (a.key,)), Cell(a.method), Cell(_words(a)), Cell(_words(b)))
        for a, b in pairs
        if succeeded(a) != succeeded(b)
    )
    return [
        Table("Compared with the other results", columns, tuple(lines)),
        Table("Tasks that changed", ("task", "method", "this", "the other"), changed),
    ]


def _words(row: Row) -> str:
    return f"{row.outcome}: {row.reason}" if row.reason else row.outcome


def _keys(rows: Sequence[Row]) -> tuple[str, ...]:
    return tuple(row.key for row in rows)


def _of(part: Share) -> str:
    return f"{part.count} of {part.of}"


def _interval(part: Share) -> str:
    return f"{100 * part.low:.0f} to {100 * part.high:.0f} %"


def _number(value: float | None, unit: str, *, sign: bool = False) -> str:
    if value is None:
        return "-"
    return f"{value:+.2f} {unit}" if sign else f"{value:.2f} {unit}"
