"""What is drawn, and how often."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .appliances import dishwasher, fridge, microwave, oven
from .cabinets import Habit, cabinet, columns_first, desk, niche, sink
from .plans import Cell, Plan


def range_with_cabinets(rng: np.random.Generator) -> Plan:
    """An oven or a dishwasher within a row of cabinets."""
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
    for cell in inner.cells:
        a, b, c, d = cell.rect
        cells.append(
            Cell(
                (a + left, b, c + left, d), cell.kind, cell.fill, cell.free, cell.along, cell.handle
            )
        )
    return Plan("row", left + inner.width + right, high, cells)


def nothing(rng: np.random.Generator) -> Plan:
    """A face without parts: a side, a back, a table, a wall, shelves, clutter."""
    width, height = rng.uniform(0.3, 2.0), rng.uniform(0.3, 2.2)
    fill = str(
        rng.choice(["side", "back", "table", "wall", "shelves", "clutter", "grille", "framed"])
    )
    return Plan("nothing", width, height, [Cell((0, 0, width, height), None, fill)])


Maker = Callable[[np.random.Generator], Plan]
FAMILIES: dict[Maker, float] = {
    cabinet: 0.4,
    fridge: 0.14,
    microwave: 0.08,
    oven: 0.08,
    dishwasher: 0.07,
    sink: 0.06,
    range_with_cabinets: 0.04,
    desk: 0.03,
    nothing: 0.13,
}
"""What is drawn, and how often."""


HARD_FAMILIES: dict[Maker, float] = {
    cabinet: 0.22,
    fridge: 0.2,
    microwave: 0.1,
    oven: 0.09,
    dishwasher: 0.08,
    sink: 0.04,
    range_with_cabinets: 0.03,
    desk: 0.04,
    niche: 0.08,
    nothing: 0.12,
}
"""What is drawn in the second round: more of what the first makes too little of."""


def random_plan(rng: np.random.Generator, families: dict[Maker, float]) -> Plan:
    """Any face of these families."""
    makers = list(families)
    odds = np.array(list(families.values()))
    return makers[rng.choice(len(makers), p=odds / odds.sum())](rng)
