"""Draw layouts of fridges, microwaves, ovens and dishwashers."""

from __future__ import annotations

import numpy as np

from momapos.model.records.scans import PartKind

from .plans import Cell, Plan, hinged, pair, split


def fridge(rng: np.random.Generator) -> Plan:
    """Draw a fridge: one door, freezer above or below, side by side, or French doors."""
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
    """Draw a microwave: a door with a window, controls next to it, rarely below."""
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
    """Draw a wall oven, a double oven, or a range with a drawer below."""
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
    """Draw a dishwasher: a drop-down door with a control strip, or two drawers."""
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
