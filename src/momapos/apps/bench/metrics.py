"""Compute the figures of a report from rows."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from .bench_records import Row, Suite

Key = TypeVar("Key", bound=Hashable)
CONFIDENCE = 0.95
GRID = "exhaustive"
"""The method that checks every base pose of a grid."""


@dataclass(frozen=True)
class Share:
    """A count of a total, with the bounds of Wilson's score interval for the true share."""

    count: int
    of: int
    low: float
    high: float


def share(count: int, of: int) -> Share:
    """Return a share with its interval, which is [0, 1] if `of` is zero."""
    if of == 0:
        return Share(0, 0, 0.0, 1.0)
    from scipy.stats import binomtest

    interval = binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    return Share(count, of, float(interval.low), float(interval.high))


def grouped(rows: Iterable[Row], key: Callable[[Row], Key]) -> dict[Key, list[Row]]:
    """Group rows by a key; keys keep the order of their first row."""
    found: dict[Key, list[Row]] = defaultdict(list)
    for row in rows:
        found[key(row)].append(row)
    return dict(found)


def in_order(suite: Suite, rows: Iterable[Row]) -> list[Row]:
    """Sort rows by the suite's order of tasks and methods."""
    tasks = {task.name: k for k, task in enumerate(suite.tasks)}
    methods = {method: k for k, method in enumerate(suite.methods)}
    return sorted(
        rows,
        key=lambda row: (
            tasks.get(row.task, len(tasks)), methods.get(row.method, len(methods)), row.method,
        ),
    )  # fmt: skip


def labeled(rows: Sequence[Row]) -> list[Row]:
    """Append the protocol to the methods if there are several protocols."""
    if len({row.protocol for row in rows}) < 2:
        return list(rows)
    return [replace(row, method=f"{row.method} ({row.protocol})") for row in rows]


def succeeded(row: Row) -> bool:
    """Check that the task is solved and, if executed, that the execution succeeded."""
    return row.outcome == "solved" and row.done is not False


def percentile(values: Sequence[float], q: float) -> float | None:
    """Return a percentile; None for no values."""
    return float(np.percentile(values, q)) if len(values) else None


def shortest_drives(rows: Iterable[Row]) -> dict[str, float]:
    """Return the shortest driving length of any method for each solved task [m]."""
    shortest: dict[str, float] = {}
    for row in rows:
        if row.driving is not None:
            shortest[row.task] = min(row.driving, shortest.get(row.task, np.inf))
    return shortest


def solved_by_any(rows: Iterable[Row]) -> set[str]:
    """Return the tasks that at least one method solves."""
    return {row.task for row in rows if row.outcome == "solved"}


def reasons(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """Group the rows without success by outcome and reason, the most frequent first."""
    failed = [row for row in rows if not succeeded(row)]
    by_reason = grouped(failed, lambda row: (outcome_text(row), row.reason or "-"))
    return dict(sorted(by_reason.items(), key=lambda item: -len(item[1])))


def outcome_text(row: Row) -> str:
    """Return the outcome in words, physics included."""
    return "failed in physics" if row.done is False else row.outcome


def stage_shares(rows: Sequence[Row]) -> Mapping[str, float]:
    """Return each stage's share of the total time, in [0, 1], the largest first."""
    total: Counter[str] = Counter()
    for row in rows:
        total.update(row.stages)
    whole = sum(total.values())
    return {stage: seconds / whole for stage, seconds in total.most_common() if whole > 0}


def paired_p_value(better: int, worse: int) -> float:
    """Return the p-value of the exact McNemar test.

    Args:
        better: Tasks that only the first method solves.
        worse: Tasks that only the second method solves.
    """
    if better + worse == 0:
        return 1.0
    from scipy.stats import binomtest

    return float(binomtest(better, better + worse, 0.5).pvalue)
