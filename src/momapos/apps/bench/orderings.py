"""Compare the order of the methods in the paper's table with their order in our results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from .bench_records import Row
from .markdown_report import Table
from .metrics import CONFIDENCE, paired_p_value, succeeded
from .printed import PrintedTable

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
