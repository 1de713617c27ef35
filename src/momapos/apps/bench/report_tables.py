"""Build the tables of a report.

Only solved tasks count, as in the paper: an infeasible answer models every object.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise

import numpy as np

from .bench_records import Row, Suite
from .metrics import (
    CONFIDENCE,
    GRID,
    KITCHEN,
    LABORATORY,
    MARK,
    PrintedTable,
    Table,
    grouped,
    labeled,
    paired_p_value,
    percentile,
    printed_table,
    reasons,
    share,
    shortest_drives,
    simulation_table,
    solved_by_any,
    stage_shares,
    succeeded,
)

FIGURES = {"success": ("%", -1.0), "driving": ("m", 1.0), "time": ("s", 1.0)}
"""Figures of the table: unit, and the sign that makes less better."""


@dataclass(frozen=True)
class _Entry:
    """A method's figure of one task, in print and here."""

    name: str
    printed: float
    mean: float
    by_task: dict[str, float]
    """Value of each task that counts."""


def ordering_table(rows: Sequence[Row], protocol: str, published: PrintedTable) -> Table:
    """Build the table with a sentence for each order of the methods that differs from print.

    Two methods differ here if a sign test over the same tasks says so (for success McNemar's test),
    at 95 %. An order differs if it lacks or reverses a difference that is in print.
    """
    lines = tuple(
        (text,)
        for task in published.tasks
        for figure in FIGURES
        if (text := _sentence(task, figure, [r for r in rows if r.group == task], published))
    )
    note = "=: no significant difference between neighbors (sign test over the tasks, 95 %)."
    title = f"Orders of the methods that differ from the published table ({protocol})"
    return Table(title, ("order",), lines, note)


def _sentence(task: str, figure: str, rows: Sequence[Row], published: PrintedTable) -> str:
    """Return the sentence for one figure of one task; "" if the order is as in print."""
    entries = [
        _Entry(one.name, getattr(one, figure), float(np.mean(list(values.values()))), values)
        for one in published.lines
        if one.task == task
        and (values := _values(figure, _of_method(rows, published.methods[one.name])))
    ]
    unit, sign = FIGURES[figure]
    printed = sorted(entries, key=lambda one: sign * one.printed)
    differ = [(a, b) for a, b in combinations(printed, 2) if a.printed != b.printed]
    if all(_is_better(better, worse, sign) for better, worse in differ):
        return ""
    here = sorted(entries, key=lambda one: sign * one.mean)
    mark, in_table, digits = (">", 0, 0) if sign < 0 else ("<", 1, 2)
    in_print = _chain(
        [f"{one.name} {one.printed:.{in_table}f}" for one in printed],
        [mark if one.printed != other.printed else "=" for one, other in pairwise(printed)],
    )
    measured = _chain(
        [f"{one.name} {one.mean:.{digits}f}" for one in here],
        [mark if _is_better(one, other, sign) else "=" for one, other in pairwise(here)],
    )
    return f"{task.capitalize()}, {figure} [{unit}]: in print {in_print}; here {measured}."


def _of_method(rows: Sequence[Row], method: str) -> list[Row]:
    return [row for row in rows if row.method == method]


def _values(figure: str, rows: Sequence[Row]) -> dict[str, float]:
    """Return the figure of each task: success of all in percent, else of the solved ones."""
    if figure == "success":
        return {row.task: 100.0 * succeeded(row) for row in rows}
    field = "driving" if figure == "driving" else "seconds"
    known = {row.task: getattr(row, field) for row in rows if succeeded(row)}
    return {task: value for task, value in known.items() if value is not None}


def _is_better(one: _Entry, other: _Entry, sign: float) -> bool:
    """Return whether one method is significantly better than another over the same tasks."""
    shared = one.by_task.keys() & other.by_task.keys()
    gain = [sign * (other.by_task[task] - one.by_task[task]) for task in shared]
    better, worse = sum(value > 0 for value in gain), sum(value < 0 for value in gain)
    ahead = sign * (other.mean - one.mean) > 0 and better > worse
    return ahead and paired_p_value(better, worse) < 1 - CONFIDENCE


def _chain(names: Sequence[str], marks: Sequence[str]) -> str:
    return " ".join(word for pair in zip(names, [*marks, ""], strict=True) for word in pair if word)


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


PUBLISHED: dict[str, PrintedTable] = {
    "paper-real": LABORATORY, "paper-table": LABORATORY, "authors-sim": KITCHEN,
}  # fmt: skip
"""The published table of the tasks of a suite."""
MAX_REASONS = 25
"""Lines in the table of failures [-]."""


def all_tables(suite: Suite, rows: Sequence[Row]) -> list[Table]:
    """Build the tables of one results folder."""
    by_protocol = grouped(rows, lambda row: row.protocol)
    rows = labeled(rows)
    tables = [summary_table(rows), class_table(rows, "class", "group"), time_table(rows)]
    tables.append(effort_table(suite, rows))
    if len({row.robot for row in rows}) > 1:
        tables.append(class_table(rows, "robot", "robot"))
    tables += [reason_table(rows), stage_table(rows)]
    if suite.name in PUBLISHED:
        table = PUBLISHED[suite.name]
        for protocol, mine in by_protocol.items():
            tables += [printed_table(mine, protocol, table), ordering_table(mine, protocol, table)]
    if suite.name == "paper-sim":
        tables.append(simulation_table(rows))
    if suite.name == "articulated":
        tables.append(rate_table(rows))
    if from_scan(rows):
        tables += [printed_stages(rows), modeling_table(rows)]
    return tables


Column = tuple[str, Callable[[Sequence[Row]], str]]
"""Heading, and the cell for the rows of one method."""


def summary_table(rows: Sequence[Row]) -> Table:
    """Build the table with one line per method."""
    by_method = grouped(rows, lambda row: row.method)
    columns: list[Column] = [
        ("tasks", lambda mine: str(len(mine))),
        ("solved", lambda mine: _count(_solved(mine), mine)),
        ("95 % interval", lambda mine: _interval(_solved(mine), mine)),
    ]
    if any(row.done is not None for row in rows):
        columns.append(
            ("success in physics", lambda mine: _count([row for row in mine if row.done], mine))
        )
    if GRID in by_method:
        columns.append(("of grid-solvable", partial(_of_grid_solvable, by_method[GRID])))
    if any(row.at_2cm is not None for row in rows):
        columns.append(("base off by 2 cm, 2 deg", partial(_mean_share, "at_2cm")))
        columns.append(("by 5 cm, 5 deg", partial(_mean_share, "at_5cm")))
    columns += [
        ("time, median", partial(_percentile_of, "seconds", "s", 50)),
        ("95th percentile", partial(_percentile_of, "seconds", "s", 95)),
        ("driving, median", lambda mine: _percentile_of("driving", "m", 50, _solved(mine))),
        ("above shortest known", partial(_above_shortest, shortest_drives(rows))),
        ("full checks, mean", _mean_checks),
        ("false infeasible", partial(_false_infeasible, solved_by_any(rows))),
    ]
    if any(row.clearance is not None for row in rows):
        columns.append(("clearance, median", partial(_percentile_of, "clearance", "m", 50)))
    lines = tuple(
        (method, *(cell(mine) for _, cell in columns)) for method, mine in by_method.items()
    )
    return Table("Methods", ("method", *(name for name, _ in columns)), lines, NOTE)


NOTE = (
    "Time: processor time of an answer. Above shortest known: driving beyond the shortest drive "
    "that any method of this run found for the task (median, and total in percent). False "
    "infeasible: infeasible, but another method solves the task. Of grid-solvable: of the tasks "
    "that exhaustive solves. Base off by 2 cm, 2 deg or by 5 cm, 5 deg: success rate with the base "
    "so far off; a task counts by the share of such poses at which replanning the arm succeeds."
)


def _of_grid_solvable(grid: Sequence[Row], mine: Sequence[Row]) -> str:
    """Count the successes, physics included, in the tasks that the grid solves."""
    solvable = {row.task for row in _solved(grid)}
    counted = [row for row in mine if row.task in solvable]
    good = [row for row in counted if succeeded(row)]
    percent = f", {100 * len(good) / len(counted):.1f} %" if counted else ""
    return f"{len(good)} of {len(counted)}{percent}"


def _mean_share(field: str, mine: Sequence[Row]) -> str:
    """Average the shares in a field; an unsolved row counts as zero."""
    shares = [(row, getattr(row, field)) for row in mine]
    counted = [one for one in shares if one[1] is not None or one[0].outcome != "solved"]
    if not counted:
        return "-"
    total = sum(value or 0.0 for _, value in counted)
    return f"{100 * total / len(counted):.0f} %"


def _percentile_of(field: str, unit: str, q: float, mine: Sequence[Row]) -> str:
    known = [value for row in mine if (value := getattr(row, field)) is not None]
    return _number(percentile(known, q), unit)


def _above_shortest(shortest: Mapping[str, float], mine: Sequence[Row]) -> str:
    drives = [(row.driving, shortest[row.task]) for row in _solved(mine) if row.driving is not None]
    above = [length - least for length, least in drives]
    total = sum(least for _, least in drives)
    percent = f", {100 * sum(above) / total:+.0f} %" if total > 0 else ""
    median = _number(percentile(above, 50), "m", sign=True)
    return f"{median}{percent}"


def _mean_checks(mine: Sequence[Row]) -> str:
    checked = [row.checked for row in mine if row.checked is not None]
    return f"{np.mean(checked):.1f}" if checked else "-"


def _false_infeasible(solvable: Collection[str], mine: Sequence[Row]) -> str:
    false = [row for row in mine if row.outcome == "infeasible" and row.task in solvable]
    return str(len(false))


def class_table(rows: Sequence[Row], title: str, field: str) -> Table:
    """Count the successes of every method by a field of the row."""

    def cell(mine: Sequence[Row]) -> str:
        good = [row for row in mine if succeeded(row)]
        return f"{len(good)} of {len(mine)} ({_interval(good, mine)})" if mine else "-"

    return _table_by(f"Success by {title}", rows, field, cell)


def time_table(rows: Sequence[Row]) -> Table:
    """Build the table of each method's median time for the solved tasks of each class."""

    def cell(mine: Sequence[Row]) -> str:
        solved = _solved(mine)
        median = percentile([row.seconds for row in solved if row.seconds is not None], 50)
        return "-" if median is None else f"{1000 * median:.0f} ms"

    return _table_by("Time by class, solved tasks", rows, "group", cell)


def _table_by(
    title: str, rows: Sequence[Row], field: str, cell: Callable[[Sequence[Row]], str]
) -> Table:
    """Build a table with a line per method and a column per value of a field."""
    classes = list(dict.fromkeys(getattr(row, field) for row in rows))
    lines = []
    for method, members in grouped(rows, lambda row: row.method).items():
        mine = grouped(members, lambda row: getattr(row, field))
        lines.append((method, *(cell(mine.get(name, [])) for name in classes)))
    return Table(title, ("method", *classes), tuple(lines))


def effort_table(suite: Suite, rows: Sequence[Row]) -> Table:
    """Build the table of each method's time for the tasks that all solve, and per solved task."""
    moved = {t.name for t in suite.tasks if t.verb in ("open", "close") or t.inside is not None}
    kinds = {"all tasks": rows, "doors and drawers": [r for r in rows if r.task in moved]}
    methods = dict.fromkeys(row.method for row in rows)
    cells = {method: [method] for method in methods}
    columns = ["method"]
    for kind, some in kinds.items():
        columns += [f"{kind}: solved", "median, solved by all", "per solved task"]
        compared = [row for row in some if row.method != GRID]
        failed = {row.task for row in compared if not succeeded(row)}
        shared = {row.task for row in compared} - failed
        for method, line in cells.items():
            mine = [row for row in some if row.method == method]
            good = [row for row in mine if succeeded(row)]
            same = [row for row in good if row.task in shared and row.seconds is not None]
            median = percentile([row.seconds or 0.0 for row in same], 50)
            spent = sum(row.seconds or 0.0 for row in mine)
            line += [
                _count(good, mine),
                _number(median, "s"),
                _number(spent / len(good) if good else None, "s"),
            ]
    note = (
        "Processor time. Solved by all: by every method except exhaustive. Per solved task: total "
        "time of all answers, failures included, divided by the number of solved tasks. A plan "
        "that fails in physics is not solved."
    )
    lines = tuple(tuple(line) for line in cells.values())
    return Table("Time per solved task", tuple(columns), lines, note)


def rate_table(rows: Sequence[Row]) -> Table:
    """Build the table of each method's plans an hour on one core, by robot."""

    def cell(mine: Sequence[Row]) -> str:
        hours = sum(row.seconds or 0.0 for row in mine) / 3600
        solved = _solved(mine)
        return f"{len(solved) / hours:.0f}" if hours > 0 else "-"

    return _table_by("Plans an hour on one core, failures included", rows, "robot", cell)


def reason_table(rows: Sequence[Row]) -> Table:
    """Count the failures of each method by reason, the most frequent first."""
    methods = list(dict.fromkeys(row.method for row in rows))
    found = list(reasons(rows).items())
    lines = []
    for (outcome, reason), members in found[:MAX_REASONS]:
        counted = [[row for row in members if row.method == method] for method in methods]
        cells = [str(len(mine)) if mine else "" for mine in counted]
        lines.append((outcome, reason, *cells))
    left = sum(len(members) for _, members in found[MAX_REASONS:])
    note = f"{left} more failed for {len(found) - MAX_REASONS} other reasons." if left else ""
    return Table("Failures by reason", ("outcome", "reason", *methods), tuple(lines), note)


def stage_table(rows: Sequence[Row]) -> Table:
    """Build the table of each stage's share of the time, its median and its 95th percentile."""
    by_method = grouped(rows, lambda row: row.method)
    shares = {method: stage_shares(mine) for method, mine in by_method.items()}
    stages = list(dict.fromkeys(stage for parts in shares.values() for stage in parts))

    def cell(method: str, stage: str) -> str:
        if stage not in shares[method]:
            return "-"
        seconds = [row.stages.get(stage, 0.0) for row in by_method[method] if row.stages]
        median, high = (1000 * (percentile(seconds, q) or 0.0) for q in (50, 95))
        return f"{100 * shares[method][stage]:.1f} %; {median:.0f}, {high:.0f} ms"

    lines = tuple((method, *(cell(method, stage) for stage in stages)) for method in shares)
    note = "Share of the total time; then the median and the 95th percentile over the answers."
    return Table("Time by stage", ("method", *stages), lines, note)


def compared_tables(first: Sequence[Row], second: Sequence[Row]) -> list[Table]:
    """Compare two results of the same tasks by method."""
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
        drives = [
            a.driving - b.driving
            for a, b in both
            if a.driving is not None and b.driving is not None
        ]
        lines.append((
            method, str(len(mine)),
            f"{sum(succeeded(a) for a, _ in mine)} of {len(mine)}",
            f"{sum(succeeded(b) for _, b in mine)} of {len(mine)}",
            f"+{len(gained)}", f"-{len(lost)}",
            f"{paired_p_value(len(gained), len(lost)):.2g}",
            _number(percentile(times, 50), "times"),
            _number(percentile(drives, 50), "m", sign=True),
        ))  # fmt: skip
    columns = (
        "method", "common tasks", "success, this", "the other", "gained", "lost", "p (McNemar)",
        "time, median ratio", "driving, median change",
    )  # fmt: skip
    changed = tuple(
        (a.task, a.method, _words(a), _words(b)) for a, b in pairs if succeeded(a) != succeeded(b)
    )
    return [
        Table("Comparison with the other results", columns, tuple(lines)),
        Table("Tasks with a different outcome", ("task", "method", "this", "the other"), changed),
    ]


def _words(row: Row) -> str:
    return f"{row.outcome}: {row.reason}" if row.reason else row.outcome


def _solved(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row.outcome == "solved"]


def _count(good: Sequence[Row], rows: Sequence[Row]) -> str:
    return f"{len(good)} of {len(rows)}"


def _interval(good: Sequence[Row], rows: Sequence[Row]) -> str:
    part = share(len(good), len(rows))
    return f"{100 * part.low:.0f} to {100 * part.high:.0f} %"


def _number(value: float | None, unit: str, *, sign: bool = False) -> str:
    if value is None:
        return "-"
    return f"{value:+.2f} {unit}" if sign else f"{value:.2f} {unit}"
