"""What stands on a face: pieces of furniture and appliances as rectangles, by recursive splitting.

A plan is drawn up in metres with the origin at the face's top left corner, y down.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from momapos.types import PartKind

from .canvas import Rect


@dataclass(frozen=True)
class Cell:
    """One field of a face."""

    rect: Rect
    kind: PartKind | None
    """None for what does not move."""
    fill: str = "panel"
    """How it is painted: panel, glass, window, open, knees, blank, controls, knobs,
    basin, vent."""
    free: str = ""
    """Side at which the handle is; "" for the one opposite of the hinge."""
    along: float = 0.5
    """Where along that side the handle sits."""
    handle: bool = True
    """Whether it may have one."""


@dataclass(frozen=True)
class Plan:
    """A face and what is on it."""

    family: str
    width: float
    height: float
    cells: list[Cell] = field(default_factory=list)
    appliance: bool = False


def hinged(rng: np.random.Generator) -> PartKind:
    """A door with its hinge on either side."""
    return "door_left" if rng.random() < 0.5 else "door_right"


def pair(
    rng: np.random.Generator, rect: Rect, gap: float, along: float, fill: str = "panel"
) -> list[Cell]:
    """Two doors that open from their common edge."""
    left, top, right, bottom = rect
    share = 0.5 if rng.random() < 0.8 else rng.uniform(0.35, 0.65)
    at = left + share * (right - left)
    return [
        Cell((left, top, at - gap / 2, bottom), "door_left", fill, along=along),
        Cell((at + gap / 2, top, right, bottom), "door_right", fill, along=along),
    ]


def shares(rng: np.random.Generator, count: int, uneven: float) -> np.ndarray:
    """Relative sizes of neighbours."""
    raw = np.ones(count) if rng.random() > uneven else rng.uniform(0.6, 1.7, count)
    return raw / raw.sum()


def split(
    rng: np.random.Generator, rect: Rect, count: int, gap: float, *, rows: bool, uneven: float
) -> list[Rect]:
    """Divide a rectangle into rows or columns with gaps between."""
    left, top, right, bottom = rect
    low, high = (top, bottom) if rows else (left, right)
    edges = low + (high - low + gap) * np.concatenate(([0], np.cumsum(shares(rng, count, uneven))))
    spans = [(edges[i], edges[i + 1] - gap) for i in range(count)]
    if rows:
        return [(left, a, right, b) for a, b in spans]
    return [(a, top, b, bottom) for a, b in spans]


def cabinet(rng: np.random.Generator) -> Plan:
    """Base, wall and tall cabinets, dressers, sideboards, vanities, chests."""
    form = rng.choice(["base", "wall", "tall", "dresser", "sideboard", "chest", "small"])
    width, height = {
        "base": (rng.uniform(0.3, 2.6), rng.uniform(0.65, 1.0)),
        "wall": (rng.uniform(0.3, 1.8), rng.uniform(0.3, 1.0)),
        "tall": (rng.uniform(0.4, 1.4), rng.uniform(1.4, 2.4)),
        "dresser": (rng.uniform(0.5, 1.6), rng.uniform(0.6, 1.4)),
        "sideboard": (rng.uniform(0.7, 1.8), rng.uniform(0.6, 1.0)),
        "chest": (rng.uniform(0.4, 1.2), rng.uniform(0.5, 1.3)),
        "small": (rng.uniform(0.35, 0.7), rng.uniform(0.4, 0.9)),
    }[form]
    gap = rng.uniform(0.001, 0.008) if rng.random() < 0.5 else rng.uniform(0.012, 0.06)
    side = rng.uniform(0.0, 0.02) if rng.random() < 0.5 else rng.uniform(0.015, 0.08)
    top = side if rng.random() < 0.5 else rng.uniform(0, 0.1)
    foot = rng.uniform(0, 0.12) if form != "wall" else rng.uniform(0, 0.03)
    if rng.random() < 0.15:
        foot += rng.uniform(0.05, 0.2)
    rect = (side, top, width - side, max(height - foot, top + 0.2))
    habit = _Habit.draw(rng, str(form), gap)
    cells = (
        _rows_first(rng, rect, habit) if rng.random() < 0.5 else _columns_first(rng, rect, habit)
    )
    return Plan("cabinet", width, height, cells)


@dataclass(frozen=True)
class _Habit:
    """How one cabinet maker divides a front."""

    form: str
    gap: float
    drawers: float
    along: float
    """Where the handle of a door sits, 0 top, 1 bottom."""
    drawer_free: str
    open: float
    lift: float
    glass: float
    blank: float

    @staticmethod
    def draw(rng: np.random.Generator, form: str, gap: float) -> _Habit:
        along = {"wall": rng.uniform(0.6, 0.95), "tall": rng.uniform(0.3, 0.7)}.get(
            form, rng.uniform(0.05, 0.4)
        )
        if rng.random() < 0.3:
            along = rng.uniform(0.4, 0.6)
        drawers = {"dresser": 0.85, "chest": 1.0, "wall": 0.1}.get(form, rng.uniform(0.1, 0.8))
        return _Habit(
            form,
            gap,
            drawers,
            along,
            "middle" if rng.random() < 0.6 else "top",
            rng.choice([0.0, 0.0, 0.15, 0.4]),
            (0.35 if form == "wall" else 0.04) * (rng.random() < 0.6),
            rng.choice([0.0, 0.0, 0.2, 0.8]),
            rng.choice([0.0, 0.0, 0.1]),
        )


def _columns_first(rng: np.random.Generator, rect: Rect, habit: _Habit) -> list[Cell]:
    wide = rect[2] - rect[0]
    most = int(np.clip(wide / 0.3, 1, 6))
    columns = split(rng, rect, int(rng.integers(1, most + 1)), habit.gap, rows=False, uneven=0.5)
    return [cell for column in columns for cell in _stack(rng, column, habit)]


def _rows_first(rng: np.random.Generator, rect: Rect, habit: _Habit) -> list[Cell]:
    high, wide = rect[3] - rect[1], rect[2] - rect[0]
    chest = habit.form in ("dresser", "chest")
    if not chest and rng.random() < 0.6:
        first = min(rng.uniform(0.1, 0.22), 0.5 * high)
        upper = (rect[0], rect[1], rect[2], rect[1] + first)
        lower = (rect[0], rect[1] + first + habit.gap, rect[2], rect[3])
        bands = [(upper, True), (lower, False)]
    else:
        least = 0.12 if chest else 0.25
        count = int(rng.integers(1, int(np.clip(high / least, 1, 6)) + 1))
        bands = [(r, chest) for r in split(rng, rect, count, habit.gap, rows=True, uneven=0.4)]
    cells = []
    for band, drawers in bands:
        least = 0.15 if habit.form == "chest" else 0.28
        count = int(rng.integers(1, int(np.clip(wide / least, 1, 5)) + 1))
        for field_ in split(rng, band, count, habit.gap, rows=False, uneven=0.4):
            if drawers and rng.random() < max(habit.drawers, 0.7):
                cells.append(_drawer(habit, field_))
            else:
                cells.extend(_leaf(rng, field_, habit))
    return cells


def _stack(rng: np.random.Generator, rect: Rect, habit: _Habit) -> list[Cell]:
    """One column: drawers, a door with or without a drawer above, two doors."""
    high = rect[3] - rect[1]
    draw = rng.random()
    if draw < habit.drawers * 0.6:
        count = int(rng.integers(2, int(np.clip(high / 0.12, 2, 6)) + 1))
        fields = split(rng, rect, count, habit.gap, rows=True, uneven=0.5)
        return [_drawer(habit, f) for f in fields]
    if draw < habit.drawers and high > 0.4:
        first = rng.uniform(0.1, 0.2)
        at = rect[1] + first if rng.random() < 0.8 else rect[3] - first
        upper = (rect[0], rect[1], rect[2], at - habit.gap / 2)
        lower = (rect[0], at + habit.gap / 2, rect[2], rect[3])
        cells = []
        for field_ in (upper, lower):
            if field_[3] - field_[1] < 0.25:
                cells.append(_drawer(habit, field_))
            else:
                cells.extend(_leaf(rng, field_, habit))
        return cells
    count = 1 if high < 0.5 else int(rng.integers(1, 3 + (high > 1.2)))
    fields = split(rng, rect, count, habit.gap, rows=True, uneven=0.6)
    return [cell for f in fields for cell in _leaf(rng, f, habit)]


def _drawer(habit: _Habit, rect: Rect) -> Cell:
    return Cell(rect, "drawer", free=habit.drawer_free)


def _leaf(rng: np.random.Generator, rect: Rect, habit: _Habit) -> list[Cell]:
    """A field that is not cut further."""
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    fill = "glass" if rng.random() < habit.glass else "panel"
    draw = rng.random()
    if draw < habit.open:
        return [Cell(rect, None, "open")]
    if draw > 1 - habit.blank:
        return [Cell(rect, None, "blank")]
    if rng.random() < habit.lift and wide > 0.8 * high:
        lift = rng.random() < 0.7
        free = "bottom" if lift else "top"
        return [Cell(rect, "door_up" if lift else "door_down", fill, free=free)]
    if high < 0.28 and wide > 1.2 * high and rng.random() < 0.85:
        return [_drawer(habit, rect)]
    if wide > 0.62 and wide > 0.7 * high and rng.random() < 0.9:
        return pair(rng, rect, min(habit.gap, 0.01), habit.along, fill)
    if wide > 1.6 * high and rng.random() < 0.5:
        return [_drawer(habit, rect)]
    if wide > 0.45 and rng.random() < 0.35:
        return pair(rng, rect, min(habit.gap, 0.01), habit.along, fill)
    return [Cell(rect, hinged(rng), fill, along=habit.along)]


def fridge(rng: np.random.Generator) -> Plan:
    """One door, freezer above or below, side by side, French doors."""
    small = rng.random() < 0.35
    width = rng.uniform(0.4, 0.65) if small else rng.uniform(0.5, 1.0)
    height = rng.uniform(0.45, 1.2) if small else rng.uniform(1.3, 2.1)
    gap = rng.uniform(0.003, 0.03)
    foot = rng.uniform(0, 0.1) * (rng.random() < 0.7)
    top = rng.uniform(0, 0.06) * (rng.random() < 0.5)
    side = rng.uniform(0, 0.02) * (rng.random() < 0.4)
    rect = (side, top, width - side, height - foot)
    draw = rng.random() * (0.7 if small else 1.0)
    if draw < 0.35:
        along = rng.uniform(0.1, 0.9)
        cells = [Cell(rect, hinged(rng), along=along)]
    elif draw < 0.7:
        at = rect[1] + (rect[3] - rect[1]) * (
            rng.uniform(0.22, 0.42) if rng.random() < 0.65 else rng.uniform(0.5, 0.75)
        )
        kind = hinged(rng)
        near = rng.random() < 0.7
        cells = [
            Cell((rect[0], rect[1], rect[2], at - gap / 2), kind, along=0.85 if near else 0.5),
            Cell((rect[0], at + gap / 2, rect[2], rect[3]), kind, along=0.2 if near else 0.4),
        ]
        if at > 0.55 * height and rng.random() < 0.3:
            cells[1] = Cell(cells[1].rect, "drawer", free="top")
    elif draw < 0.85:
        cells = pair(rng, rect, gap, rng.uniform(0.35, 0.6))
    else:
        at = rect[1] + (rect[3] - rect[1]) * rng.uniform(0.5, 0.7)
        cells = pair(rng, (rect[0], rect[1], rect[2], at), gap, rng.uniform(0.6, 0.85))
        lower = (rect[0], at + gap, rect[2], rect[3])
        if rng.random() < 0.3:
            cells += pair(rng, lower, gap, 0.2)
        else:
            count = int(rng.integers(1, 3))
            rows = split(rng, lower, count, gap, rows=True, uneven=0.3)
            cells += [Cell(r, "drawer", free="top") for r in rows]
    return Plan("fridge", width, height, cells, appliance=True)


def microwave(rng: np.random.Generator) -> Plan:
    """A door with a window, controls beside it, seldom below."""
    width, height = rng.uniform(0.4, 0.75), rng.uniform(0.22, 0.45)
    rim = rng.uniform(0, 0.03)
    panel = width * rng.uniform(0.16, 0.34)
    rect = (rim, rim, width - rim, height - rim)
    gap = rng.uniform(0.001, 0.01)
    draw = rng.random()
    handle = rng.random() < 0.7
    if draw < 0.72:
        at = rect[2] - panel
        kind: PartKind = "door_left" if rng.random() < 0.93 else "door_down"
        door = Cell((rect[0], rect[1], at, rect[3]), kind, "window", handle=handle)
        side = Cell((at + gap, rect[1], rect[2], rect[3]), None, "controls")
    elif draw < 0.82:
        at = rect[0] + panel
        door = Cell((at, rect[1], rect[2], rect[3]), "door_right", "window", handle=handle)
        side = Cell((rect[0], rect[1], at - gap, rect[3]), None, "controls")
    else:
        at = rect[3] - height * rng.uniform(0.12, 0.25)
        kind = "door_down" if rng.random() < 0.6 else hinged(rng)
        free = "top" if kind == "door_down" else ""
        door = Cell((rect[0], rect[1], rect[2], at), kind, "window", free=free, handle=handle)
        side = Cell((rect[0], at + gap, rect[2], rect[3]), None, "controls")
    return Plan("microwave", width, height, [door, side], appliance=True)


def oven(rng: np.random.Generator) -> Plan:
    """Wall ovens, double ovens and ranges with a drawer below."""
    width = rng.uniform(0.5, 0.95)
    form = rng.choice(["single", "range", "double", "bare"])
    height = {"single": rng.uniform(0.45, 0.75), "range": rng.uniform(0.75, 1.15)}.get(
        str(form), rng.uniform(0.9, 1.5) if form == "double" else rng.uniform(0.4, 0.8)
    )
    gap = rng.uniform(0.002, 0.02)
    rim = rng.uniform(0, 0.02)
    y, bottom = rng.uniform(0, 0.03), height - rng.uniform(0, 0.06)
    cells = []
    if form != "bare":
        strip = rng.uniform(0.06, 0.16) if rng.random() < 0.75 else rng.uniform(0.16, 0.3)
        fill = "knobs" if rng.random() < 0.6 else "controls"
        cells.append(Cell((rim, y, width - rim, y + strip), None, fill))
        y += strip + gap
    if form == "range" and rng.random() < 0.7:
        drawer = rng.uniform(0.1, 0.24)
        fill = "panel" if rng.random() < 0.8 else "blank"
        kind: PartKind | None = "drawer" if fill == "panel" else None
        lower = (rim, bottom - drawer, width - rim, bottom)
        cells.append(Cell(lower, kind, fill, free="top", handle=rng.random() < 0.6))
        bottom -= drawer + gap
    count = 2 if form == "double" else 1
    down: PartKind = "door_down" if rng.random() < 0.93 else hinged(rng)
    free = "top" if down == "door_down" else ""
    rows = split(rng, (rim, y, width - rim, bottom), count, gap, rows=True, uneven=0.5)
    cells += [Cell(r, down, "window" if rng.random() < 0.88 else "panel", free=free) for r in rows]
    return Plan("oven", width, height, cells, appliance=True)


def dishwasher(rng: np.random.Generator) -> Plan:
    """Drop-down door with a control strip, or two drawers."""
    width, height = rng.uniform(0.42, 0.65), rng.uniform(0.45, 0.92)
    rim, gap = rng.uniform(0, 0.02), rng.uniform(0.002, 0.012)
    top, bottom = rim, height - rng.uniform(0, 0.14)
    if rng.random() < 0.15:
        bottom = height * rng.uniform(0.5, 0.8)
    cells = []
    if rng.random() < 0.6:
        strip = rng.uniform(0.05, 0.15)
        cells.append(Cell((rim, top, width - rim, top + strip), None, "controls"))
        top += strip + gap
    rect = (rim, top, width - rim, bottom)
    draw = rng.random()
    handle = rng.random() < 0.75
    if draw < 0.8:
        cells.append(Cell(rect, "door_down", "panel", free="top", handle=handle))
    elif draw < 0.9:
        rows = split(rng, rect, 2, gap, rows=True, uneven=0.2)
        cells += [Cell(r, "drawer", "panel", free="top") for r in rows]
    else:
        cells.append(Cell(rect, "drawer", "panel", free="top", handle=handle))
    if rng.random() < 0.6:
        fill = "vent" if rng.random() < 0.6 else "blank"
        cells.append(Cell((rim, bottom + gap, width - rim, height), None, fill))
    return Plan("dishwasher", width, height, cells, appliance=True)


def sink(rng: np.random.Generator) -> Plan:
    """A base with false fronts over its doors, and drawers beside them."""
    width, height = rng.uniform(0.5, 1.8), rng.uniform(0.65, 0.95)
    gap = rng.uniform(0.002, 0.04)
    side = rng.uniform(0, 0.06)
    foot = rng.uniform(0, 0.14)
    rect = (side, rng.uniform(0, 0.06), width - side, height - foot)
    columns = [rect]
    if width > 0.9:
        columns = split(rng, rect, int(rng.integers(1, 4)), gap, rows=False, uneven=0.6)
    habit = _Habit.draw(rng, "base", gap)
    basin = int(rng.integers(len(columns)))
    cells = []
    for i, column in enumerate(columns):
        if i != basin:
            cells += _stack(rng, column, habit)
            continue
        at = column[1] + rng.uniform(0.1, 0.22)
        count = 1 if rng.random() < 0.6 else 2
        upper = (column[0], column[1], column[2], at)
        false = split(rng, upper, count, gap, rows=False, uneven=0)
        style = "blank" if rng.random() < 0.8 else "basin"
        cells += [Cell(r, None, style) for r in false]
        lower = (column[0], at + gap, column[2], column[3])
        cells += (
            pair(rng, lower, gap, habit.along) if rng.random() < 0.8 else _leaf(rng, lower, habit)
        )
    return Plan("sink", width, height, cells)


def range_with_cabinets(rng: np.random.Generator) -> Plan:
    """An oven or a dishwasher within a row of cabinets."""
    inner = oven(rng) if rng.random() < 0.6 else dishwasher(rng)
    habit = _Habit.draw(rng, "base", rng.uniform(0.002, 0.03))
    left = rng.uniform(0.25, 0.9) * (rng.random() < 0.8)
    right = rng.uniform(0.25, 0.9) * (rng.random() < 0.8 or left == 0)
    high = inner.height
    cells = []
    for low, end in ((0.0, left), (left + inner.width, left + inner.width + right)):
        if end - low > 0.2:
            rect = (low + 0.01, 0.02, end - 0.01, high - rng.uniform(0.0, 0.1))
            cells += _columns_first(rng, rect, habit)
    for cell in inner.cells:
        a, b, c, d = cell.rect
        cells.append(
            Cell(
                (a + left, b, c + left, d), cell.kind, cell.fill, cell.free, cell.along, cell.handle
            )
        )
    return Plan("row", left + inner.width + right, high, cells)


def desk(rng: np.random.Generator) -> Plan:
    """Columns of drawers or doors beside room for the knees."""
    width, height = rng.uniform(0.9, 1.9), rng.uniform(0.65, 0.95)
    habit = _Habit.draw(rng, "dresser", rng.uniform(0.001, 0.02))
    board, side, column = rng.uniform(0.02, 0.08), rng.uniform(0, 0.05), rng.uniform(0.22, 0.45)
    foot = rng.uniform(0, 0.15)
    cells = []
    low, high = side, side + column
    if rng.random() < 0.75:
        cells += _stack(rng, (low, board + 0.01, high, height - foot), habit)
    if rng.random() < 0.75 or not cells:
        cells += _stack(rng, (width - high, board + 0.01, width - low, height - foot), habit)
    middle = (high + 0.01, board + 0.01, width - high - 0.01, height)
    if rng.random() < 0.5:
        at = board + rng.uniform(0.06, 0.16)
        cells.append(_drawer(habit, (middle[0], middle[1], middle[2], at)))
        middle = (middle[0], at + 0.01, middle[2], height)
    cells.append(Cell(middle, None, "knees"))
    return Plan("desk", width, height, cells)


def niche(rng: np.random.Generator) -> Plan:
    """Few parts in a broad body: bands of bare wood, openings or slots around them."""
    width, height = rng.uniform(0.4, 2.0), rng.uniform(0.5, 2.1)
    habit = _Habit.draw(rng, "base", rng.uniform(0.001, 0.02))
    rim = rng.uniform(0.0, 0.03)
    rect = [rim, rim, width - rim, height - rim]
    cells = []
    for side in rng.permutation(4)[: int(rng.integers(1, 4))]:
        wide, high = rect[2] - rect[0], rect[3] - rect[1]
        band = rng.uniform(0.1, 0.4) * (wide if side % 2 == 0 else high)
        rest, strip = list(rect), list(rect)
        rest[side] += band if side < 2 else -band
        strip[(side + 2) % 4] = rest[side]
        rect = rest
        fill = str(rng.choice(["bare", "open", "blank", "vent", "controls", "row"]))
        field_ = (strip[0] + 0.005, strip[1] + 0.005, strip[2] - 0.005, strip[3] - 0.005)
        if fill == "row":
            rows = split(rng, field_, int(rng.integers(2, 6)), 0.02, rows=side % 2 == 0, uneven=0.2)
            cells += [Cell(r, None, "open") for r in rows]
        elif fill != "bare":
            cells.append(Cell(field_, None, fill))
    inner = (rect[0], rect[1], rect[2], rect[3])
    cells += _stack(rng, inner, habit) if rng.random() < 0.3 else _leaf(rng, inner, habit)
    return Plan("niche", width, height, cells)


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
