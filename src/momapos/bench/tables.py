"""Tables of a report; each number knows the rows that it was counted from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from momapos.bench.metrics import (
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
from momapos.bench.records import Row, Suite

MOST_REASONS = 25


@dataclass(frozen=True)
class Cell:
    """What a table shows, and the keys of the rows behind it."""

    text: str
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table with one line of headings."""

    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[Cell, ...], ...]
    note: str = ""


def all_tables(suite: Suite, rows: Sequence[Row]) -> list[Table]:
    """The tables of one results folder."""
    tables = [summary_table(rows), class_table(rows, "class", "group")]
    if len({row.robot for row in rows}) > 1:
        tables.append(class_table(rows, "robot", "robot"))
    tables += [reason_table(rows), stage_table(rows)]
    if suite.name == "paper-real":
        from momapos.bench.printed import printed_table

        tables.append(printed_table())
    return tables


def summary_table(rows: Sequence[Row]) -> Table:
    """One line a method."""
    physics = any(row.done is not None for row in rows)
    columns = (
        "method", "tasks", "solved", "95 % interval", *(("done in physics",) if physics else ()),
        "time, median", "95th percentile", "driving, median", "over the least known",
        "full checks, mean", "wrong no",
    )  # fmt: skip
    least, solvable = least_driving(rows), solved_by_any(rows)
    lines = []
    for method, mine in grouped(rows, lambda row: row.method).items():
        solved = [row for row in mine if row.outcome == "solved"]
        done = [row for row in mine if row.done]
        timed = [row for row in mine if row.seconds is not None]
        seconds = [row.seconds for row in timed if row.seconds is not None]
        driven = [row for row in solved if row.driving is not None]
        driving = [row.driving for row in driven if row.driving is not None]
        over = [way - least[row.task] for way, row in zip(driving, driven, strict=True)]
        checked = [row.checked for row in mine if row.checked is not None]
        wrong = [r for r in mine if r.outcome == "infeasible" and r.task in solvable]
        part = share(len(solved), len(mine))
        line = [
            Cell(method, _keys(mine)), Cell(str(len(mine)), _keys(mine)),
            Cell(_of(part), _keys(solved)), Cell(_interval(part), _keys(solved)),
        ]  # fmt: skip
        if physics:
            line.append(Cell(_of(share(len(done), len(mine))), _keys(done)))
        line += [
            Cell(_number(percentile(seconds, 50), "s"), _keys(timed)),
            Cell(_number(percentile(seconds, 95), "s"), _keys(timed)),
            Cell(_number(percentile(driving, 50), "m"), _keys(driven)),
            Cell(_number(percentile(over, 50), "m", sign=True), _keys(driven)),
            Cell(f"{np.mean(checked):.1f}" if checked else "-", _keys(mine)),
            Cell(str(len(wrong)), _keys(wrong)),
        ]
        lines.append(tuple(line))
    note = (
        "Time is processor time of an answer. Over the least known: driving beyond the shortest "
        "that any method of this run found for the task. Wrong no: infeasible, and another method "
        "solves it."
    )
    return Table("Methods", columns, tuple(lines), note)


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
    """Share of each stage in the time of all answers, by method."""
    by_method = grouped(rows, lambda row: row.method)
    shares = {method: stage_shares(mine) for method, mine in by_method.items()}
    stages = list(dict.fromkeys(stage for parts in shares.values() for stage in parts))
    lines = tuple(
        (
            Cell(method, _keys(by_method[method])),
            *(Cell(f"{100 * parts[s]:.1f} %" if s in parts else "-") for s in stages),
        )
        for method, parts in shares.items()
    )
    return Table("Time by stage", ("method", *stages), lines)


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
