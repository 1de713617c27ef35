"""Draw layouts of cabinets, sinks and desks by recursive splitting."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from momapos.model.records.scans import PartKind

from .canvas import Rect
from .plans import Cell, Plan, hinged, pair, split


def cabinet(rng: np.random.Generator) -> Plan:
    """Draw a base, wall or tall cabinet, dresser, sideboard, vanity or chest."""
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
    habit = Habit.draw(rng, str(form), gap)
    cells = rows_first(rng, rect, habit) if rng.random() < 0.5 else columns_first(rng, rect, habit)
    return Plan("cabinet", width, height, cells)


@dataclass(frozen=True)
class Habit:
    """Style parameters of how a cabinet's front is divided."""

    form: str
    gap: float
    drawers: float
    along: float
    """Position of a door's handle, 0 top, 1 bottom [-]."""
    drawer_free: str
    open: float
    lift: float
    glass: float
    blank: float
    level: bool = False
    """Whether hinged doors have level handles, at their top, or at the bottom of wall cabinets."""

    @staticmethod
    def draw(rng: np.random.Generator, form: str, gap: float) -> Habit:
        along = {"wall": rng.uniform(0.6, 0.95), "tall": rng.uniform(0.3, 0.7)}.get(
            form, rng.uniform(0.05, 0.4)
        )
        if rng.random() < 0.3:
            along = rng.uniform(0.4, 0.6)
        drawers = {"dresser": 0.85, "chest": 1.0, "wall": 0.1}.get(form, rng.uniform(0.1, 0.8))
        return Habit(
            form,
            gap,
            drawers,
            along,
            "middle" if rng.random() < 0.6 else "top",
            rng.choice([0.0, 0.0, 0.15, 0.4]),
            (0.35 if form == "wall" else 0.04) * (rng.random() < 0.6),
            rng.choice([0.0, 0.0, 0.2, 0.8]),
            rng.choice([0.0, 0.0, 0.1]),
            bool(rng.random() < 0.35),
        )


def columns_first(rng: np.random.Generator, rect: Rect, habit: Habit) -> list[Cell]:
    wide = rect[2] - rect[0]
    most = int(np.clip(wide / 0.3, 1, 6))
    columns = split(rng, rect, int(rng.integers(1, most + 1)), habit.gap, rows=False, uneven=0.5)
    return [cell for column in columns for cell in stack(rng, column, habit)]


def rows_first(rng: np.random.Generator, rect: Rect, habit: Habit) -> list[Cell]:
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
                cells.append(drawer_cell(habit, field_))
            else:
                cells.extend(leaf(rng, field_, habit))
    return cells


def stack(rng: np.random.Generator, rect: Rect, habit: Habit) -> list[Cell]:
    """Draw one column: drawers, a door with or without a drawer above, or two doors."""
    high = rect[3] - rect[1]
    draw = rng.random()
    if draw < habit.drawers * 0.6:
        count = int(rng.integers(2, int(np.clip(high / 0.12, 2, 6)) + 1))
        fields = split(rng, rect, count, habit.gap, rows=True, uneven=0.5)
        return [drawer_cell(habit, f) for f in fields]
    if draw < habit.drawers and high > 0.4:
        first = rng.uniform(0.1, 0.2)
        at = rect[1] + first if rng.random() < 0.8 else rect[3] - first
        upper = (rect[0], rect[1], rect[2], at - habit.gap / 2)
        lower = (rect[0], at + habit.gap / 2, rect[2], rect[3])
        cells = []
        for field_ in (upper, lower):
            if field_[3] - field_[1] < 0.25:
                cells.append(drawer_cell(habit, field_))
            else:
                cells.extend(leaf(rng, field_, habit))
        return cells
    count = 1 if high < 0.5 else int(rng.integers(1, 3 + (high > 1.2)))
    fields = split(rng, rect, count, habit.gap, rows=True, uneven=0.6)
    return [cell for f in fields for cell in leaf(rng, f, habit)]


def drawer_cell(habit: Habit, rect: Rect) -> Cell:
    return Cell(rect, "drawer", free=habit.drawer_free)


def leaf(rng: np.random.Generator, rect: Rect, habit: Habit) -> list[Cell]:
    """Draw a field that is not split further."""
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
        return [drawer_cell(habit, rect)]
    if wide > 0.62 and wide > 0.7 * high and rng.random() < 0.9:
        return level(rng, pair(rng, rect, min(habit.gap, 0.01), habit.along, fill), habit)
    if wide > 1.6 * high and rng.random() < 0.5:
        return [drawer_cell(habit, rect)]
    if wide > 0.45 and rng.random() < 0.35:
        return level(rng, pair(rng, rect, min(habit.gap, 0.01), habit.along, fill), habit)
    return level(rng, [Cell(rect, hinged(rng), fill, along=habit.along)], habit)


def level(rng: np.random.Generator, doors: list[Cell], habit: Habit) -> list[Cell]:
    """Give hinged doors level handles if that is the habit: in the free corner, or centered."""
    if not habit.level:
        return doors
    end = 0.5 if rng.random() < 0.4 else rng.uniform(0.0, 0.3)
    free = "bottom" if habit.form == "wall" else "top"
    return [
        replace(door, free=free, along=1 - end if door.kind == "door_left" else end)
        for door in doors
    ]


def sink(rng: np.random.Generator) -> Plan:
    """Draw a sink base with false fronts over its doors, and drawers next to them."""
    width, height = rng.uniform(0.5, 1.8), rng.uniform(0.65, 0.95)
    gap = rng.uniform(0.002, 0.04)
    side = rng.uniform(0, 0.06)
    foot = rng.uniform(0, 0.14)
    rect = (side, rng.uniform(0, 0.06), width - side, height - foot)
    columns = [rect]
    if width > 0.9:
        columns = split(rng, rect, int(rng.integers(1, 4)), gap, rows=False, uneven=0.6)
    habit = Habit.draw(rng, "base", gap)
    basin = int(rng.integers(len(columns)))
    cells = []
    for i, column in enumerate(columns):
        if i != basin:
            cells += stack(rng, column, habit)
            continue
        at = column[1] + rng.uniform(0.1, 0.22)
        count = 1 if rng.random() < 0.6 else 2
        upper = (column[0], column[1], column[2], at)
        false = split(rng, upper, count, gap, rows=False, uneven=0)
        style = "blank" if rng.random() < 0.8 else "basin"
        cells += [Cell(r, None, style) for r in false]
        lower = (column[0], at + gap, column[2], column[3])
        cells += (
            pair(rng, lower, gap, habit.along) if rng.random() < 0.8 else leaf(rng, lower, habit)
        )
    return Plan("sink", width, height, cells)


def desk(rng: np.random.Generator) -> Plan:
    """Draw a desk: columns of drawers or doors next to knee space."""
    width, height = rng.uniform(0.9, 1.9), rng.uniform(0.65, 0.95)
    habit = Habit.draw(rng, "dresser", rng.uniform(0.001, 0.02))
    board, side, column = rng.uniform(0.02, 0.08), rng.uniform(0, 0.05), rng.uniform(0.22, 0.45)
    foot = rng.uniform(0, 0.15)
    cells = []
    low, high = side, side + column
    if rng.random() < 0.75:
        cells += stack(rng, (low, board + 0.01, high, height - foot), habit)
    if rng.random() < 0.75 or not cells:
        cells += stack(rng, (width - high, board + 0.01, width - low, height - foot), habit)
    middle = (high + 0.01, board + 0.01, width - high - 0.01, height)
    if rng.random() < 0.5:
        at = board + rng.uniform(0.06, 0.16)
        cells.append(drawer_cell(habit, (middle[0], middle[1], middle[2], at)))
        middle = (middle[0], at + 0.01, middle[2], height)
    cells.append(Cell(middle, None, "knees"))
    return Plan("desk", width, height, cells)


def niche(rng: np.random.Generator) -> Plan:
    """Draw few parts in a wide body, surrounded by bare wood, openings or slots."""
    width, height = rng.uniform(0.4, 2.0), rng.uniform(0.5, 2.1)
    habit = Habit.draw(rng, "base", rng.uniform(0.001, 0.02))
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
    cells += stack(rng, inner, habit) if rng.random() < 0.3 else leaf(rng, inner, habit)
    return Plan("niche", width, height, cells)


def hung(rng: np.random.Generator) -> Plan:
    """Draw wall cabinets in one or two rows: doors with low handles, and lifted doors."""
    width, height = rng.uniform(0.35, 2.2), rng.uniform(0.25, 1.1)
    gap = rng.uniform(0.001, 0.008) if rng.random() < 0.7 else rng.uniform(0.01, 0.05)
    rim = rng.uniform(0.0, 0.03)
    habit = replace(Habit.draw(rng, "wall", gap), lift=float(rng.choice([0.1, 0.5, 0.9])))
    habit = replace(habit, level=bool(rng.random() < 0.3))
    rows = 1 if height < 0.5 or rng.random() < 0.5 else 2
    inner = (rim, rim, width - rim, height - rim)
    cells = []
    for band in split(rng, inner, rows, gap, rows=True, uneven=0.7):
        most = max(int((band[2] - band[0]) / 0.35), 1)
        columns = int(rng.integers(1, min(most, 4) + 1))
        for field_ in split(rng, band, columns, gap, rows=False, uneven=0.5):
            cells += _hung_field(rng, field_, habit)
    return Plan("hung", width, height, cells)


def _hung_field(rng: np.random.Generator, rect: Rect, habit: Habit) -> list[Cell]:
    """Draw one field of a wall cabinet; level handles of hinged doors are in the free corner."""
    wide, high = rect[2] - rect[0], rect[3] - rect[1]
    fill = "glass" if rng.random() < habit.glass else "panel"
    if rng.random() < habit.open:
        return [Cell(rect, None, "open")]
    if wide > max(0.9 * high, 0.4) and rng.random() < habit.lift:
        kind: PartKind = "door_up" if rng.random() < 0.93 else "door_down"
        free = "bottom" if kind == "door_up" else "top"
        return [Cell(rect, kind, fill, free=free)]
    if wide > 0.6 or (wide > 0.45 and rng.random() < 0.3):
        doors = pair(rng, rect, min(habit.gap, 0.01), habit.along, fill)
    else:
        doors = [Cell(rect, hinged(rng), fill, along=habit.along)]
    return level(rng, doors, habit)
