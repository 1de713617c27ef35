"""Draw whole layouts, and list the families with their frequencies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from . import blanks
from .appliances import dishwasher, fridge, microwave, oven
from .cabinets import Habit, cabinet, columns_first, desk, hung, level, niche, rows_first, sink
from .canvas import Rect
from .plans import Cell, Plan, hinged, split


def range_with_cabinets(rng: np.random.Generator) -> Plan:
    """Draw an oven or a dishwasher within a row of cabinets."""
    inner = oven(rng) if rng.random() < 0.6 else dishwasher(rng)
    habit = Habit.draw(rng, "base", rng.uniform(0.002, 0.03))
    left = rng.uniform(0.25, 0.9) * (rng.random() < 0.8)
    right = rng.uniform(0.25, 0.9) * (rng.random() < 0.8 or left == 0)
    high = inner.height
    cells = []
    for low, end in ((0.0, left), (left + inner.width, left + inner.width + right)):
        if end - low > 0.2:
            rect = (low + 0.01, 0.02, end - 0.01, high - rng.uniform(0.0, 0.1))
            cells += columns_first(rng, rect, habit)
    cells += [_moved(cell, left, 1.0) for cell in inner.cells]
    return Plan("row", left + inner.width + right, high, cells)


def row(rng: np.random.Generator) -> Plan:
    """Draw a section of a long row, cut at any position, as in `perception.rows`."""
    wall = rng.random() < 0.5
    high = rng.uniform(0.45, 1.0) if wall else rng.uniform(0.65, 0.95)
    habit = Habit.draw(rng, "wall" if wall else "base", rng.uniform(0.001, 0.006))
    if rng.random() < 0.7:
        habit = replace(habit, open=0.0, lift=0.0, glass=0.0, blank=0.0)
    foot = 0.0 if wall else rng.uniform(0.0, 0.14)
    top = rng.uniform(0.0, 0.05)
    cells, at, wide = [], 0.0, rng.uniform(1.2, 4.0)
    while at < wide:
        if not wall and rng.random() < 0.2:
            inner = oven(rng) if rng.random() < 0.5 else dishwasher(rng)
            cells += [_moved(cell, at, high / inner.height) for cell in inner.cells]
            at += inner.width
            continue
        unit = rng.uniform(0.3, 1.3)
        rect = (at + 0.002, top, at + unit - 0.002, high - foot)
        cells += rows_first(rng, rect, habit) if rng.random() < 0.3 else _unit(rng, rect, habit)
        at += unit
    length = min(at, max(0.95, rng.uniform(1.0, 1.6) * high))
    left = rng.uniform(0.0, at - length)
    right = left + length
    seen = [c for c in cells if c.rect[0] < right - 0.02 and c.rect[2] > left + 0.02]
    return Plan("row", at, high, seen, stretch=(left, right))


def _unit(rng: np.random.Generator, rect: Rect, habit: Habit) -> list[Cell]:
    """Draw one cabinet of a row; doors side by side are as frequent as all other fronts."""
    if rng.random() < 0.5:
        return columns_first(rng, rect, habit)
    count = max(1, round((rect[2] - rect[0]) / rng.uniform(0.3, 0.6)))
    columns = split(rng, rect, count, habit.gap, rows=False, uneven=0.2)
    return level(rng, [Cell(c, hinged(rng), along=habit.along) for c in columns], habit)


def _moved(cell: Cell, by: float, scale: float) -> Cell:
    """Move a cell of another layout into a row and scale it to the row's height."""
    left, top, right, bottom = cell.rect
    return replace(cell, rect=(left + by, top * scale, right + by, bottom * scale))


def nothing(rng: np.random.Generator) -> Plan:
    """Draw a face without parts: a side, a back, a table, a wall, shelves, clutter."""
    width, height = rng.uniform(0.3, 2.0), rng.uniform(0.3, 2.2)
    fill = str(rng.choice(blanks.FILLS, p=blanks.SHARES))
    return Plan("nothing", width, height, [Cell((0, 0, width, height), None, fill)])


Maker = Callable[[np.random.Generator], Plan]
FAMILIES: dict[Maker, float] = {
    cabinet: 0.3,
    row: 0.16,
    fridge: 0.13,
    microwave: 0.08,
    oven: 0.08,
    dishwasher: 0.07,
    sink: 0.05,
    range_with_cabinets: 0.03,
    desk: 0.03,
    nothing: 0.12,
}
"""Frequencies of the families in the first round."""


HARD_FAMILIES: dict[Maker, float] = {
    cabinet: 0.16,
    row: 0.16,
    fridge: 0.18,
    microwave: 0.08,
    oven: 0.08,
    dishwasher: 0.07,
    sink: 0.04,
    range_with_cabinets: 0.03,
    desk: 0.04,
    niche: 0.08,
    nothing: 0.12,
}
"""Frequencies in the second round: more of the rare families."""
LAST_FAMILIES: dict[Maker, float] = {**HARD_FAMILIES, hung: 0.3, nothing: 0.4}
"""Frequencies in the third round: wall cabinets, since lifted doors are rare in the others, and
faces without parts."""


def random_plan(rng: np.random.Generator, families: dict[Maker, float]) -> Plan:
    """Draw a plan from these families."""
    makers = list(families)
    odds = np.array(list(families.values()))
    return makers[rng.choice(len(makers), p=odds / odds.sum())](rng)
