"""Numbers from rows."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from .bench_records import Row, Suite

Key = TypeVar("Key", bound=Hashable)
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Share:
    """How many of how many, and between what the true share lies (Wilson's score interval)."""

    count: int
    of: int
    low: float
    high: float


def share(count: int, of: int) -> Share:
    """A share with its interval; between 0 and 1 where nothing was counted."""
    if of == 0:
        return Share(0, 0, 0.0, 1.0)
    from scipy.stats import binomtest

    interval = binomtest(count, of).proportion_ci(CONFIDENCE, method="wilson")
    return Share(count, of, float(interval.low), float(interval.high))


def grouped(rows: Iterable[Row], key: Callable[[Row], Key]) -> dict[Key, list[Row]]:
    """Rows by a key, in the order in which the keys come."""
    found: dict[Key, list[Row]] = defaultdict(list)
    for row in rows:
        found[key(row)].append(row)
    return dict(found)


def in_order(suite: Suite, rows: Iterable[Row]) -> list[Row]:
    """Rows as the suite has its methods and tasks, however they came."""
    tasks = {task.name: k for k, task in enumerate(suite.tasks)}
    methods = {method: k for k, method in enumerate(suite.methods)}
    return sorted(
        rows,
        key=lambda row: (
            tasks.get(row.task, len(tasks)), methods.get(row.method, len(methods)), row.method,
        ),
    )  # fmt: skip


def succeeded(row: Row) -> bool:
    """Whether the task was solved, and where it was executed, done."""
    return row.outcome == "solved" and row.done is not False


def percentile(values: Sequence[float], q: float) -> float | None:
    """A percentile; None of nothing."""
    return float(np.percentile(values, q)) if len(values) else None


def least_driving(rows: Iterable[Row]) -> dict[str, float]:
    """The shortest driving length by which any method solved each task [m]."""
    least: dict[str, float] = {}
    for row in rows:
        if row.driving is not None:
            least[row.task] = min(row.driving, least.get(row.task, np.inf))
    return least


def solved_by_any(rows: Iterable[Row]) -> set[str]:
    """Tasks that some method solved."""
    return {row.task for row in rows if row.outcome == "solved"}


def reasons(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """Rows that did not succeed, by outcome and reason, the most frequent first."""
    failed = [row for row in rows if not succeeded(row)]
    by_reason = grouped(failed, lambda row: (how_it_ended(row), row.reason or "-"))
    return dict(sorted(by_reason.items(), key=lambda item: -len(item[1])))


def how_it_ended(row: Row) -> str:
    """The outcome in words, physics included."""
    return "not done in physics" if row.done is False else row.outcome


def stage_shares(rows: Sequence[Row]) -> Mapping[str, float]:
    """Share of each stage in the time of all answers, in [0, 1], the largest first."""
    total: Counter[str] = Counter()
    for row in rows:
        total.update(row.stages)
    whole = sum(total.values())
    return {stage: seconds / whole for stage, seconds in total.most_common() if whole > 0}


def paired_p_value(better: int, worse: int) -> float:
    """How likely two methods that are as good as each other differ this much (McNemar, exact).

    Args:
        better: Tasks that only the first one solves.
        worse: Tasks that only the second one solves.
    """
    if better + worse == 0:
        return 1.0
    from scipy.stats import binomtest

    return float(binomtest(better, better + worse, 0.5).pvalue)
