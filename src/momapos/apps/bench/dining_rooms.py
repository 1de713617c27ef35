"""Generated kitchens with a place to eat, in which things stand on tables and counters, in fridge,
drawers and dishwasher: the rooms of the suite `paper-sim`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from momapos.model.scene import LAYOUTS, empty_kitchen, free_start, with_joint_ends
from momapos.model.scene.library import (
    Box,
    FurniturePart,
    Obstacles,
    Piece,
    Vec,
    hits,
    joint_name,
    obstacles,
    solid,
    vec,
    write_kitchen,
)

from .bench_records import Container

THINGS: Mapping[str, Vec] = {
    "cup": (0.075, 0.075, 0.095), "mug": (0.07, 0.07, 0.1), "glass": (0.065, 0.065, 0.12),
    "egg_cup": (0.045, 0.045, 0.065), "apple": (0.07, 0.07, 0.07), "lemon": (0.055, 0.07, 0.055),
    "pear": (0.065, 0.065, 0.095), "egg": (0.045, 0.045, 0.058), "bottle": (0.065, 0.065, 0.22),
    "small_bottle": (0.06, 0.06, 0.16), "can": (0.066, 0.066, 0.115),
    "tuna_can": (0.075, 0.075, 0.045), "jar": (0.07, 0.07, 0.11), "milk": (0.07, 0.07, 0.2),
    "yogurt": (0.065, 0.065, 0.08), "butter": (0.055, 0.1, 0.045), "cheese": (0.06, 0.12, 0.06),
    "cereal_box": (0.06, 0.16, 0.24), "tea_box": (0.065, 0.13, 0.08), "salt": (0.05, 0.05, 0.1),
    "sugar_box": (0.045, 0.09, 0.17), "mustard": (0.055, 0.06, 0.17), "sponge": (0.06, 0.1, 0.05),
    "candle": (0.06, 0.06, 0.12),
}  # fmt: skip
"""Loose things and their sizes [m]; with table, dinner table, countertop, fridge, drawer and
dishwasher thirty objects. Each is narrow enough for a hand that opens 8.5 cm."""
PLACES = (
    "on dinner table", "on table", "on countertop", "in fridge", "in drawer", "in dishwasher",
)  # fmt: skip
EACH = 8
"""Things in each kind of place of a room, where there is room for them [-]."""
DINING = 4.0
"""The floor is longer by so much where people eat [m]."""
AISLE, EDGE = 0.9, 0.4
"""Free floor between the tables and all else, and between them and the floor's edge [m]."""
ASIDE, ABOVE = 0.03, 0.08
"""Free space around a thing in the open, and above it, for it is lifted [m]."""
SNUG = 0.015
"""Likewise in a drawer, which is pulled out first [m]."""
FRONT = 0.6
"""Things stand in the front share of what they stand in or on, as far as it is deep [-]."""
DRAWS = 60
OPEN_SIDES = (("wall_front", 1, 0), ("wall_right", 0, 1), ("wall_left", 0, 0), ("wall_back", 1, 1))
"""Walls, and which edge of the floor they stand at: axis, and 0 for the low one."""


@dataclass(frozen=True)
class Spot:
    """A surface on which things can stand."""

    place: str
    piece: Piece
    top: Box
    """What they stand on, in the frame of the piece."""
    inside: Container | None = None


@dataclass(frozen=True)
class Placed:
    """A thing of a room and where it stands."""

    name: str
    place: str
    inside: Container | None


@dataclass(frozen=True)
class Opening:
    """A door of a fridge or dishwasher, or a drawer of a cabinet."""

    kind: str
    """Such as "open fridge"."""
    part: Container
    wide: float
    """Where its joint ends [rad] or [m]."""


@dataclass(frozen=True)
class Room:
    """A room, its things, and what of it a suite opens."""

    file: Path
    things: tuple[Placed, ...]
    openings: tuple[Opening, ...]

    def carried(self, box: Container | None) -> tuple[str, ...]:
        """Names of the things in a drawer; none in anything else."""
        return tuple(t.name for t in self.things if t.place == "in drawer" and t.inside == box)


def make_room(layout: str, rng: np.random.Generator, out: Path) -> Room:
    """Draw a room and write its scene file.

    Args:
        layout: Of the kitchen.
        rng: Where everything random comes from.
        out: The scene file.

    Raises:
        MissingExtraError: scene-synthesizer is not installed.
    """
    while True:
        kitchen, floor = empty_kitchen(layout, int(rng.integers(2**31)))
        dining = dining_area(kitchen, floor)
        tables = None if dining is None else _tables(kitchen, dining[1], rng)
        if dining is not None and tables is not None and _has_containers(kitchen):
            break
    pieces = with_joint_ends([*kitchen, *tables])
    things = _furnish(pieces, rng)
    every = [*pieces, *(thing for thing, _ in things)]
    write_kitchen(out, out.stem, every, dining[0], free_start(dining[0], every))
    return Room(out, tuple(placed for _, placed in things), tuple(_openings(pieces)))


def room_layouts(count: int) -> list[str]:
    """Layouts of so many rooms, in turn."""
    return [LAYOUTS[k % len(LAYOUTS)] for k in range(count)]


# ------------------------------------------------------------------------- where people eat

Corners = list[tuple[float, float]]


def dining_area(
    kitchen: Sequence[Piece], floor: Corners
) -> tuple[Corners, tuple[np.ndarray, np.ndarray]] | None:
    """The floor made longer at a side without a wall, and low and high corner of what is new [m].

    None where all sides have walls.
    """
    names = {piece.name for piece in kitchen}
    edges = np.array([np.min(floor, axis=0), np.max(floor, axis=0)])
    for wall, axis, side in OPEN_SIDES:
        if wall in names:
            continue
        area = edges.copy()
        area[1 - side, axis] = edges[side, axis]
        area[side, axis] += DINING * (2 * side - 1)
        edges[side, axis] = area[side, axis]
        (x0, y0), (x1, y1) = edges.tolist()
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)], (area[0], area[1])
    return None


def _tables(
    kitchen: Sequence[Piece], area: tuple[np.ndarray, np.ndarray], rng: np.random.Generator
) -> list[Piece] | None:
    """A dinner table and a table with aisles around them; None where they do not fit."""
    tables: list[Piece] = []
    for name, low, high in (
        ("dinner_table", (1.4, 0.8, 0.72), (1.8, 0.95, 0.76)),
        ("table", (0.7, 0.55, 0.55), (1.0, 0.7, 0.74)),
    ):
        length, width, height = rng.uniform(low, high).round(2)
        for _ in range(DRAWS):
            yaw = float(rng.integers(2)) * np.pi / 2
            half = np.array([length, width] if yaw == 0.0 else [width, length]) / 2 + EDGE
            if (area[1] - area[0] < 2 * half).any():
                continue
            x, y = rng.uniform(area[0] + half, area[1] - half)
            table = _table(name, length, width, height, (x, y), yaw)
            around = solid("", "", vec((length + 2 * AISLE, width + 2 * AISLE, height)),
                           vec((x, y, height / 2)), yaw)  # fmt: skip
            if not _overlaps(around, obstacles([*kitchen, *tables])):
                tables.append(table)
                break
        else:
            return None
    return tables


def _table(
    name: str, length: float, width: float, height: float, xy: tuple[float, float], yaw: float
) -> Piece:
    """A top on four legs; its frame is on the floor, under the middle."""
    x, y, leg, thick = length / 2, width / 2, 0.06, 0.04
    boxes = [Box("top", vec((-x, -y, height - thick)), vec((x, y, height)))]
    for i, j in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        middle = np.array([i * (x - leg), j * (y - leg)])
        low, high = middle - leg / 2, middle + leg / 2
        boxes.append(Box("leg", vec([*low, 0.0]), vec([*high, height - thick])))
    part = FurniturePart("body", tuple(boxes))
    return Piece(name, name.replace("_", " "), vec((*xy, 0.0)), yaw, (part,))


# ------------------------------------------------------------------------- where things stand


def _has_containers(kitchen: Sequence[Piece]) -> bool:
    """Whether the furniture has a fridge, a dishwasher and a drawer of a cabinet."""
    kinds = {opening.kind for opening in _openings(kitchen)}
    return kinds == {"open fridge", "open drawer", "open dishwasher"}


def _openings(pieces: Sequence[Piece]) -> Iterator[Opening]:
    for piece in pieces:
        for part in piece.parts:
            if part.motion is None or not part.handle:
                continue
            box = Container(piece.name, joint_name(part))
            if piece.category in ("fridge", "dishwasher"):
                yield Opening(f"open {piece.category}", box, part.motion.upper)
            elif part.motion.kind == "prismatic" and piece.category == "cabinet":
                yield Opening("open drawer", box, part.motion.upper)


def spots(pieces: Sequence[Piece]) -> list[Spot]:
    """All surfaces on which things can stand, by what the furniture is."""
    found = []
    for piece in pieces:
        body, doors = piece.parts[0], [part for part in piece.parts if part.motion is not None]
        if piece.category in ("dinner table", "table"):
            found.append(Spot(f"on {piece.category}", piece, body.boxes[0]))
        elif piece.name.startswith("countertop"):
            found.append(Spot("on countertop", piece, body.boxes[-1]))
        elif piece.category in ("fridge", "dishwasher"):
            for door in doors:
                box = Container(piece.name, joint_name(door))
                found += [
                    Spot(f"in {piece.category}", piece, shelf, box)
                    for shelf in _shelves(body, door)
                ]
        elif piece.category == "cabinet":
            for part in doors:
                assert part.motion is not None
                if part.motion.kind == "prismatic":
                    bottom = max(part.boxes, key=_area)
                    box = Container(piece.name, joint_name(part))
                    found.append(Spot("in drawer", piece, bottom, box))
    return found


def _shelves(body: FurniturePart, door: FurniturePart) -> list[Box]:
    """Flat boxes of a body that its door hides: they lie behind it, and reach far sideways."""
    low = np.min([box.low for box in door.boxes], axis=0)
    high = np.max([box.high for box in door.boxes], axis=0)
    widest = max(_area(box) for box in body.boxes)
    return [
        box
        for box in body.boxes
        if _area(box) > 0.5 * widest
        and box.high[2] - box.low[2] < 0.08
        and low[2] - 0.02 <= box.high[2] <= high[2] - 0.1
        and low[0] < (box.low[0] + box.high[0]) / 2 < high[0]
    ]


def _area(box: Box) -> float:
    return (box.high[0] - box.low[0]) * (box.high[1] - box.low[1])


def _furnish(pieces: Sequence[Piece], rng: np.random.Generator) -> list[tuple[Piece, Placed]]:
    """Stand things in every kind of place, as many as `EACH` where they find room."""
    every, number = spots(pieces), 0
    things: list[tuple[Piece, Placed]] = []
    for place in PLACES:
        there = [spot for spot in every if spot.place == place]
        for _ in range(EACH if there else 0):
            kind = str(rng.choice(list(THINGS)))
            for _ in range(DRAWS):
                spot = there[int(rng.integers(len(there)))]
                name = f"{kind}_{number}"
                thing = _stood(name, kind, spot, rng)
                if thing is not None and _has_room(thing, spot, [*pieces, *(t for t, _ in things)]):
                    things.append((thing, Placed(name, place, spot.inside)))
                    number += 1
                    break
                kind = str(rng.choice(list(THINGS)))
    return things


def _stood(name: str, kind: str, spot: Spot, rng: np.random.Generator) -> Piece | None:
    """A thing drawn on a surface; None where it is larger than the surface."""
    size, low, high = np.array(THINGS[kind]), np.array(spot.top.low), np.array(spot.top.high)
    turned = spot.inside is not None
    yaw = float(rng.integers(4)) * np.pi / 2 if turned else float(rng.uniform(-np.pi, np.pi))
    c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
    half = np.array([c * size[0] + s * size[1], s * size[0] + c * size[1]]) / 2 + SNUG
    first, last = low[:2] + half, high[:2] - half
    on_table = spot.place in ("on dinner table", "on table")
    last[1] = last[1] if on_table else min(last[1], first[1] + FRONT * (high[1] - low[1]))
    if (first > last).any():
        return None
    x, y = rng.uniform(first, last)
    piece = spot.piece
    c, s = np.cos(piece.yaw), np.sin(piece.yaw)
    xyz = (
        piece.xyz[0] + c * x - s * y,
        piece.xyz[1] + s * x + c * y,
        piece.xyz[2] + high[2] + size[2] / 2 + 0.001,
    )
    return solid(name, kind.replace("_", " "), vec(size), vec(xyz), round(piece.yaw + yaw, 5))


def _has_room(thing: Piece, spot: Spot, pieces: Sequence[Piece]) -> bool:
    """Whether nothing is in the space that a thing needs, around it and above."""
    in_drawer = spot.place == "in drawer"
    aside, above = (SNUG, SNUG) if in_drawer else (ASIDE, ABOVE)
    box = thing.parts[0].boxes[0]
    x, y, z = np.subtract(box.high, box.low)
    center = np.add(thing.xyz, [0.0, 0.0, above / 2])
    needed = solid("", "", vec((x + 2 * aside, y + 2 * aside, z + above)), vec(center), thing.yaw)
    return not _overlaps(needed, obstacles(pieces))


def _overlaps(piece: Piece, others: Obstacles) -> bool:
    return bool(hits(piece, piece.parts[0], np.zeros(1), others)[0])
