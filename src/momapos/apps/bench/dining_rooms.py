"""Build the rooms of the suite `paper-sim`: generated kitchens with a dining area and objects."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import (
    content_key,
    default_cache_dir,
    read_bytes_bounded,
    require,
    temporary_folder,
    version_of,
    write_atomic,
)
from momapos.model.scene import LAYOUTS, empty_kitchen, free_start, with_joint_limits
from momapos.model.scene.library import (
    Box,
    FurniturePart,
    JointMotion,
    Obstacles,
    Piece,
    Vec,
    bar_handle,
    hits,
    joint_name,
    obstacles,
    solid,
    vec,
    write_kitchen,
)

from .bench_records import Container, from_plain, scene_digest, to_plain

MICROWAVE = "microwave"
MIN_SIZE, MAX_SIZE = (0.46, 0.36, 0.27), (0.54, 0.42, 0.32)
"""Width, depth and height of household microwaves [m]."""
WALL, DOOR, PANEL, GAP = 0.02, 0.03, 0.1, 0.0015
"""Thickness of the walls and of the door, width of the control panel on the right, and the gap
around the door [m]."""
HANDLE_EDGE = 0.04
"""Distance of the handle's middle from the free edge of the door [m]."""
BACK_DISTANCE = 0.03
"""Distance from the back of the countertop [m]."""
OPENING = 1.9
"""Upper joint limit [rad]; the tasks open doors by 90 degrees."""
MAX_DRAWS = 60


def microwave_on(
    tops: Sequence[tuple[Piece, Box]], pieces: Sequence[Piece], rng: np.random.Generator
) -> tuple[Piece, Piece] | None:
    """Draw a microwave at the back of a countertop, with clearance for its door.

    Args:
        tops: Countertops, each with its upper box.
        pieces: The furniture of the room.
        rng: Source of randomness.

    Returns:
        The microwave, and the box in front of it that the door needs; None if no draw fits.
    """
    others = obstacles(pieces)
    for _ in range(MAX_DRAWS if tops else 0):
        holder, top = tops[int(rng.integers(len(tops)))]
        size = vec(rng.uniform(MIN_SIZE, MAX_SIZE).round(2))
        (x0, y0, _), (x1, y1, z) = top.low, top.high
        room = (x1 - x0 - size[0]) / 2
        if room < 0.0 or y1 - y0 < size[1] + BACK_DISTANCE:
            continue
        x = (x0 + x1) / 2 + rng.uniform(-room, room)
        y = y1 - BACK_DISTANCE - size[1] / 2
        c, s = np.cos(holder.yaw), np.sin(holder.yaw)
        at = np.add(holder.xyz, [c * x - s * y, s * x + c * y, z + 0.001])
        oven = microwave(size, vec(at), holder.yaw)
        values = np.linspace(0.0, OPENING, 61)
        if not any(hits(oven, part, values, others).any() for part in oven.parts):
            return oven, _swing(size, vec(at), holder.yaw)
    return None


def microwave(size: Vec, xyz: Vec, yaw: float) -> Piece:
    """Build a microwave: an open shell, a control panel on the right, a door hinged on the left.

    Args:
        size: Width, depth with the door, height [m].
        xyz: Middle of its bottom [m].
        yaw: Rotation about z; it faces its own -y [rad].
    """
    half, front, height = size[0] / 2, -size[1] / 2, size[2]
    back, face, right = -front, front + DOOR, half - PANEL
    body = (
        Box("bottom", vec((-half, face, 0.0)), vec((half, back, WALL))),
        Box("top", vec((-half, face, height - WALL)), vec((half, back, height))),
        Box("left", vec((-half, face, WALL)), vec((-half + WALL, back, height - WALL))),
        Box("panel", vec((right, front, WALL)), vec((half, back, height - WALL))),
        Box("back", vec((-half, back - WALL, WALL)), vec((half, back, height - WALL))),
    )
    edge = right - GAP
    door = Box("front", vec((-half, front, WALL)), vec((edge, face - GAP, height - WALL)))
    handle = bar_handle(
        "door", edge - HANDLE_EDGE, height / 2, height - 6 * WALL, upright=True, front=front
    )
    swing = JointMotion("revolute", vec((-half, front, 0.0)), (0.0, 0.0, -1.0), OPENING)
    parts = (FurniturePart("body", body), FurniturePart("door", (door,), swing, handle))
    return Piece(MICROWAVE, MICROWAVE, xyz, yaw, parts)


def _swing(size: Vec, xyz: Vec, yaw: float) -> Piece:
    """Return the box in front of a microwave that its door passes."""
    reach = size[0] - PANEL
    c, s = np.cos(yaw), np.sin(yaw)
    y = -(size[1] + reach) / 2
    center = np.add(xyz, [-s * y, c * y, size[2] / 2])
    return solid("", "", vec((size[0] + 2 * WALL, reach, size[2])), vec(center), yaw)


OBJECT_SIZES: Mapping[str, Vec] = {
    "cup": (0.075, 0.075, 0.095), "mug": (0.07, 0.07, 0.1), "glass": (0.065, 0.065, 0.12),
    "egg_cup": (0.045, 0.045, 0.065), "apple": (0.07, 0.07, 0.07), "lemon": (0.055, 0.07, 0.055),
    "pear": (0.065, 0.065, 0.095), "egg": (0.045, 0.045, 0.058), "bottle": (0.065, 0.065, 0.22),
    "small_bottle": (0.06, 0.06, 0.16), "can": (0.066, 0.066, 0.115),
    "jar": (0.07, 0.07, 0.11), "milk": (0.07, 0.07, 0.2),
    "yogurt": (0.065, 0.065, 0.08), "butter": (0.055, 0.1, 0.045), "cheese": (0.06, 0.12, 0.06),
    "cereal_box": (0.06, 0.16, 0.24), "tea_box": (0.065, 0.13, 0.08), "salt": (0.05, 0.05, 0.1),
    "sugar_box": (0.045, 0.09, 0.17), "mustard": (0.055, 0.06, 0.17), "sponge": (0.06, 0.1, 0.05),
    "candle": (0.06, 0.06, 0.12),
}  # fmt: skip
"""Movable objects and their sizes [m]; each fits a hand with an opening of 8.5 cm. Table, dinner
table, countertop, fridge, drawer, dishwasher and microwave make the paper's thirty kinds
complete."""
PLACES = (
    "on dinner table", "on table", "on countertop", "in fridge", "in drawer", "in dishwasher",
)  # fmt: skip
OBJECTS_PER_PLACE = 8
"""Maximum number of objects in each kind of place of a room [-]."""
DINING_LENGTH = 4.0
"""Length by which the dining area extends the floor [m]."""
AISLE, EDGE_DISTANCE = 0.9, 0.4
"""Free floor between the tables and other furniture, and between them and the floor's edge [m]."""
SIDE_CLEARANCE, LIFT_CLEARANCE = 0.03, 0.08
"""Free space around an object, and above it for lifting [m]."""
DRAWER_CLEARANCE = 0.015
"""Free space around and above an object in a drawer, which is pulled out first [m]."""
FRONT_SHARE = 0.6
"""Share of the depth of a surface, from its front, that holds objects; tables hold them anywhere
[-]."""
REVISION = 2
"""Increased when the same seed draws another room."""
DEFAULT_SEED = 0
ACCEPTED: Mapping[int, tuple[int, int | None]] = {
    1: (0xE43EA276B67869A5297102488A358050, 1089445267),
    2: (0x1FB9FF31FD23603939B5C53D141BF61E, 2621088956),
    3: (0x854ECC3A8B380D21E7164E1AF86BB843, 330264596),
    4: (0x6C31FE0A5944713DA21488F8A15346E5, None),
    5: (0xCB68E41F9EDE955525484336CF143C66, None),
    7: (0x444A7FA335C20B9A07E09533E02CC509, 2364669470),
    9: (0xBF4CE2538120F0128531013770D9ECC5, None),
}
"""Where the random streams of rooms of the default seed draw the first kitchen that is accepted:
the state of PCG64, and the half of its last word if that is still unused. 22 of 32 kitchens are
rejected, each after 2 to 7 s. `make_room` draws on if another version of scene-synthesizer makes a
kitchen that is rejected, too."""
CONTENTS, MAX_BYTES = "contents.json", 1_000_000
STORED = Path(__file__).with_name("dining_rooms.json")
"""Contents of the rooms of the default seed, so that their tasks are known before they are drawn.
`benchmarks/stored_rooms.py` writes it."""
OPEN_SIDES = (("wall_front", 1, 0), ("wall_right", 0, 1), ("wall_left", 0, 0), ("wall_back", 1, 1))
"""Walls, and the edge of the floor at which they stand: axis, and 0 for its lower end."""


@dataclass(frozen=True)
class SupportSurface:
    """A surface that can support objects."""

    place: str
    piece: Piece
    top: Box
    """The supporting box, in the frame of the piece."""
    inside: Container | None = None


@dataclass(frozen=True)
class MovableObject:
    """A movable object of a room."""

    name: str
    place: str
    inside: Container | None


@dataclass(frozen=True)
class RoomPart:
    """A door of a fridge, dishwasher or microwave, or a drawer of a cabinet."""

    kind: str
    """Task class, such as "open fridge"."""
    container: Container
    wide: float
    """Upper limit of its joint [rad] or [m]."""


@dataclass(frozen=True)
class DiningRoom:
    """A room with its movable objects and its parts to open."""

    digest: str
    """Content hash of the scene file with its models."""
    objects: tuple[MovableObject, ...]
    parts: tuple[RoomPart, ...]

    def carried(self, box: Container | None) -> tuple[str, ...]:
        """Return the names of the objects in a drawer; none for other containers."""
        return tuple(o.name for o in self.objects if o.place == "in drawer" and o.inside == box)


def room_name(number: int) -> str:
    """Return the name of a room's scene file."""
    return f"room_{number:02d}.json"


def drawn_room(seed: int, number: int) -> Path:
    """Return the cache's folder with a room; draw it if there is none, which may take a minute.

    Raises:
        MissingExtraError: scene-synthesizer is not installed.
    """
    with require("kitchens"):
        versions = [version_of(name) for name in ("momapos", "numpy", "scene-synthesizer")]
    key = content_key(REVISION, seed, number, *versions)
    home = default_cache_dir() / "rooms" / key
    if not home.exists():
        home.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(home.parent, key) as temporary:
            rng, new = room_stream(seed, number), temporary / "new"
            room = make_room(LAYOUTS[number % len(LAYOUTS)], rng, new / room_name(number))
            (new / CONTENTS).write_text(json.dumps(to_plain(room)))
            if not home.exists():  # else another process was faster, with an equal result
                os.rename(new, home)
    return home


def room_stream(seed: int, number: int) -> np.random.Generator:
    """Return the random stream of a room, after the kitchens that are known to be rejected."""
    rng = np.random.default_rng([seed, number])
    if seed == DEFAULT_SEED and number in ACCEPTED:
        word, half = ACCEPTED[number]
        start = dict(rng.bit_generator.state)
        start["state"] |= {"state": word}
        rng.bit_generator.state = start | {"has_uint32": half is not None, "uinteger": half or 0}
    return rng


@cache
def stored_rooms(seed: int) -> tuple[DiningRoom, ...]:
    """Return the rooms whose contents the package stores; none for what draws others.

    Raises:
        MissingExtraError: scene-synthesizer is not installed.
    """
    with require("kitchens"):
        versions = drawn_by()
    stored = json.loads(read_bytes_bounded(STORED, MAX_BYTES))
    same = seed == DEFAULT_SEED and stored["versions"] == versions
    return tuple(from_plain(one, DiningRoom, str(STORED)) for one in stored["rooms"] if same)


def drawn_by() -> dict[str, Any]:
    """Return what determines the rooms of a seed."""
    return {"revision": REVISION, "scene-synthesizer": version_of("scene-synthesizer")}


def known_room(seed: int, number: int) -> DiningRoom:
    """Return the contents of a room: the stored ones, or those of the drawn room."""
    stored = stored_rooms(seed)
    if number < len(stored):
        return stored[number]
    file = drawn_room(seed, number) / CONTENTS
    return from_plain(json.loads(read_bytes_bounded(file, MAX_BYTES)), DiningRoom, str(file))


def copy_room(seed: int, number: int, folder: Path) -> None:
    """Copy a room of the cache to a folder; its scene file comes last."""
    home, name = drawn_room(seed, number), room_name(number)
    shutil.copytree(home, folder, ignore=shutil.ignore_patterns(CONTENTS, name), dirs_exist_ok=True)
    write_atomic(folder / name, (home / name).read_bytes())


def make_room(layout: str, rng: np.random.Generator, out: Path) -> DiningRoom:
    """Draw a room and write its scene file.

    Args:
        layout: Layout of the kitchen.
        rng: Source of randomness.
        out: The scene file.

    Raises:
        MissingExtraError: scene-synthesizer is not installed.
    """
    while True:
        kitchen, floor = empty_kitchen(layout, int(rng.integers(2**31)))
        dining = dining_area(kitchen, floor)
        tables = None if dining is None else _tables(kitchen, dining[1], rng)
        oven = microwave_on(_countertops(kitchen), kitchen, rng)
        if dining is not None and tables is not None and oven and _has_containers(kitchen):
            break
    pieces = with_joint_limits([*kitchen, *tables, oven[0]])
    objects = _place_objects(pieces, oven[1], rng)
    every = [*pieces, *(item for item, _ in objects)]
    write_kitchen(out, out.stem, every, dining[0], free_start(dining[0], every))
    inside = tuple(placed for _, placed in objects)
    return DiningRoom(scene_digest(out), inside, tuple(_openable(pieces)))


# ------------------------------------------------------------------------- dining area

Corners = list[tuple[float, float]]


def dining_area(
    kitchen: Sequence[Piece], floor: Corners
) -> tuple[Corners, tuple[np.ndarray, np.ndarray]] | None:
    """Extend the floor at a side without a wall.

    Returns:
        The new floor, and the low and high corner of the extension [m]; None if all sides have
        walls.
    """
    names = {piece.name for piece in kitchen}
    edges = np.array([np.min(floor, axis=0), np.max(floor, axis=0)])
    for wall, axis, side in OPEN_SIDES:
        if wall in names:
            continue
        area = edges.copy()
        area[1 - side, axis] = edges[side, axis]
        area[side, axis] += DINING_LENGTH * (2 * side - 1)
        edges[side, axis] = area[side, axis]
        (x0, y0), (x1, y1) = edges.tolist()
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)], (area[0], area[1])
    return None


def _tables(
    kitchen: Sequence[Piece], area: tuple[np.ndarray, np.ndarray], rng: np.random.Generator
) -> list[Piece] | None:
    """Draw a dinner table and a table with aisles around them; None if they don't fit."""
    tables: list[Piece] = []
    for name, low, high in (
        ("dinner_table", (1.4, 0.8, 0.72), (1.8, 0.95, 0.76)),
        ("table", (0.7, 0.55, 0.55), (1.0, 0.7, 0.74)),
    ):
        length, width, height = rng.uniform(low, high).round(2)
        for _ in range(MAX_DRAWS):
            yaw = float(rng.integers(2)) * np.pi / 2
            half = np.array([length, width] if yaw == 0.0 else [width, length]) / 2 + EDGE_DISTANCE
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
    """Build a top on four legs; the frame is on the floor below the middle."""
    x, y, leg, thick = length / 2, width / 2, 0.06, 0.04
    boxes = [Box("top", vec((-x, -y, height - thick)), vec((x, y, height)))]
    for i, j in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        middle = np.array([i * (x - leg), j * (y - leg)])
        low, high = middle - leg / 2, middle + leg / 2
        boxes.append(Box("leg", vec([*low, 0.0]), vec([*high, height - thick])))
    part = FurniturePart("body", tuple(boxes))
    return Piece(name, name.replace("_", " "), vec((*xy, 0.0)), yaw, (part,))


# ------------------------------------------------------------------------- movable objects


def _has_containers(kitchen: Sequence[Piece]) -> bool:
    kinds = {part.kind for part in _openable(kitchen)}
    return kinds == {"open fridge", "open drawer", "open dishwasher"}


def _countertops(pieces: Sequence[Piece]) -> list[tuple[Piece, Box]]:
    return [(one.piece, one.top) for one in supports(pieces) if one.place == "on countertop"]


def _openable(pieces: Sequence[Piece]) -> Iterator[RoomPart]:
    for piece in pieces:
        for part in piece.parts:
            if part.motion is None or not part.handle:
                continue
            box = Container(piece.name, joint_name(part))
            if piece.category in ("fridge", "dishwasher", MICROWAVE):
                yield RoomPart(f"open {piece.category}", box, part.motion.upper)
            elif part.motion.kind == "prismatic" and piece.category == "cabinet":
                yield RoomPart("open drawer", box, part.motion.upper)


def supports(pieces: Sequence[Piece]) -> list[SupportSurface]:
    """Return all surfaces that can support objects."""
    found = []
    for piece in pieces:
        body, doors = piece.parts[0], [part for part in piece.parts if part.motion is not None]
        if piece.category in ("dinner table", "table"):
            found.append(SupportSurface(f"on {piece.category}", piece, body.boxes[0]))
        elif piece.name.startswith("countertop"):
            found.append(SupportSurface("on countertop", piece, body.boxes[-1]))
        elif piece.category in ("fridge", "dishwasher"):
            for door in doors:
                box = Container(piece.name, joint_name(door))
                found += [
                    SupportSurface(f"in {piece.category}", piece, shelf, box)
                    for shelf in _shelves(body, door)
                ]
        elif piece.category == "cabinet":
            for part in doors:
                assert part.motion is not None
                if part.motion.kind == "prismatic":
                    bottom = max(part.boxes, key=_area)
                    box = Container(piece.name, joint_name(part))
                    found.append(SupportSurface("in drawer", piece, bottom, box))
    return found


def _shelves(body: FurniturePart, door: FurniturePart) -> list[Box]:
    """Return the wide, flat boxes of a body behind its door."""
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


def _place_objects(
    pieces: Sequence[Piece], swing: Piece, rng: np.random.Generator
) -> list[tuple[Piece, MovableObject]]:
    """Draw objects for every kind of place, up to `OBJECTS_PER_PLACE`, none in a door's swing."""
    every, kinds = supports(pieces), list(OBJECT_SIZES)
    objects: list[tuple[Piece, MovableObject]] = []
    for place in PLACES:
        there = [support for support in every if support.place == place]
        for _ in range(OBJECTS_PER_PLACE if there else 0):
            kind = str(rng.choice(kinds))
            for _ in range(MAX_DRAWS):
                support = there[int(rng.integers(len(there)))]
                name = f"{kind}_{len(objects)}"
                item = _draw_object(name, kind, support, rng)
                others = [*pieces, swing, *(other for other, _ in objects)]
                if item is not None and _has_clearance(item, support, others):
                    objects.append((item, MovableObject(name, place, support.inside)))
                    break
                kind = str(rng.choice(kinds))
    return objects


def _draw_object(
    name: str, kind: str, support: SupportSurface, rng: np.random.Generator
) -> Piece | None:
    """Draw an object on a surface; None if it is larger than the surface."""
    size, top = np.array(OBJECT_SIZES[kind]), support.top
    low, high = np.array(top.low), np.array(top.high)
    turned = support.inside is not None
    yaw = float(rng.integers(4)) * np.pi / 2 if turned else float(rng.uniform(-np.pi, np.pi))
    c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
    half = np.array([c * size[0] + s * size[1], s * size[0] + c * size[1]]) / 2 + DRAWER_CLEARANCE
    first, last = low[:2] + half, high[:2] - half
    on_table = support.place in ("on dinner table", "on table")
    last[1] = last[1] if on_table else min(last[1], first[1] + FRONT_SHARE * (high[1] - low[1]))
    if (first > last).any():
        return None
    x, y = rng.uniform(first, last)
    piece = support.piece
    c, s = np.cos(piece.yaw), np.sin(piece.yaw)
    xyz = (
        piece.xyz[0] + c * x - s * y,
        piece.xyz[1] + s * x + c * y,
        piece.xyz[2] + high[2] + size[2] / 2 + 0.001,
    )
    return solid(name, kind.replace("_", " "), vec(size), vec(xyz), round(piece.yaw + yaw, 5))


def _has_clearance(item: Piece, support: SupportSurface, pieces: Sequence[Piece]) -> bool:
    """Check that the space around and above an object is free."""
    side, above = SIDE_CLEARANCE, LIFT_CLEARANCE
    if support.place == "in drawer":
        side = above = DRAWER_CLEARANCE
    box = item.parts[0].boxes[0]
    x, y, z = np.subtract(box.high, box.low)
    center = np.add(item.xyz, [0.0, 0.0, above / 2])
    needed = solid("", "", vec((x + 2 * side, y + 2 * side, z + above)), vec(center), item.yaw)
    return not _overlaps(needed, obstacles(pieces))


def _overlaps(piece: Piece, others: Obstacles) -> bool:
    return bool(hits(piece, piece.parts[0], np.zeros(1), others)[0])
