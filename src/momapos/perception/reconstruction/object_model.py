"""A hollow body with doors and drawers, made to fit a box and the parts seen on one side of it.

Frame of a piece: origin in the center of the box, x right, y to the back, z up, as seen from in
front of the side with the parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import UprightBox, wrap_angle
from momapos.model.records import Detection, FaceImage
from momapos.model.records import Part as SeenPart
from momapos.model.scene.library import (
    Box,
    FurniturePart,
    Piece,
    bar_handle,
    ending_before_hits,
    solid,
    vec,
)

from .alignment import AlignedHandle, AlignedPart, AlignmentConfig, align, front_of
from .height_maps import Area
from .part_motions import Beside, Motions

KNOB = 2.0
"""A handle less elongated than this is a knob, without a gap behind it [-]."""
MISFIT = 0.02
"""A face may differ in size from the side of the box that it shows by this [m]."""
UNMEASURED = 0.5
"""Confidence of a handle that images alone show [-]."""
FINGER_GAP = 0.01
"""Between a bar and the front behind it, where the handle stands out enough [m]."""


@dataclass(frozen=True)
class ModelConfig:
    """What cannot be seen of furniture."""

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    """How the parts are fitted onto the face."""
    panel: float = 0.018
    """Thickness of the body's walls [m]."""
    thickness: tuple[float, float] = (0.02, 0.06)
    """Of a door in the face's plane, and of one that stands proud of it at most [m]."""
    gap: float = 0.002
    """Between a moving part and what is beside and behind it [m]."""
    hinge_depth: float = 0.01
    """How far behind its front a door's hinge lies, about half the thickness of a leaf [m]."""
    tight_hinge_depth: float = 0.005
    """The same where another object is beside it: half of the doors that have neighbors turn about
    their front, half about an axis 1 to 2 cm deep [m]."""
    passed: float = 0.5
    """Where that object stands out of the face by more than this share of the door's width, as a
    wall does, the hinge lies in the front [-]."""
    turn: float = np.pi / 2
    """How far doors open [rad]."""
    travel: float = 0.4
    """How far drawers open at most [m]."""
    tray: float = 0.85
    """Depth of a drawer as a share of the room for it [-]."""


@dataclass(frozen=True)
class _Layers:
    """Where the layers of a piece lie, along y [m]."""

    face: float
    """The plane that height map counts from."""
    opening: float
    """Front of the walls; doors lie before it."""
    back: float
    """Rear of the piece."""
    wall: float
    """Thickness of the walls."""
    shallow: float
    """What heights and doors are scaled by, so that they fit into the front of a thin box [-]."""


def furniture_model(
    detection: Detection,
    facing: float,
    face: FaceImage,
    parts: Sequence[SeenPart],
    config: ModelConfig | None = None,
    *,
    beside: Beside = (np.inf, np.inf),
) -> Piece:
    """Make the model of one object: its box, hollow, with doors and drawers that open.

    A door turns about an axis behind its front (`ModelConfig.hinge_depth`), as real ones do, mostly
    by 1 to 2 cm, in fridges by 2 to 8; less deep where another object is beside its hinge, and in
    its front beside a wall. Where anything is beside it, it stays within its own width as
    it opens. Every joint ends before its part would hit the rest of the piece.

    Args:
        detection: The object with its box.
        facing: Yaw of the outward normal of the box's front [rad]; the nearest side is taken.
        face: That side, seen straight on.
        parts: The doors and drawers on it.
        config: What cannot be seen.
        beside: How far what stands beside the object stands out of the face, left and right as
            seen from the front [m]; None where nothing does, infinite where that is not known.

    Returns:
        The piece; its moving parts are named by what they are, top to bottom and left to right:
        `door` and `drawer` where there is one, else `door_1`, `door_2`. One box without parts.

    Raises:
        InputError: The face does not have the size of that side of the box.
    """
    config = config or ModelConfig()
    yaw, size = seen_from(detection.box, facing)
    width, _, height = size
    if max(abs(face.width - width), abs(face.height - height)) > MISFIT:
        raise InputError(
            f"{detection.name}: the face is {face.width:.2f} x {face.height:.2f} m, but that side "
            f"of its box {width:.2f} x {height:.2f} m; is it another side?"
        )
    aligned = align(face, parts, config.alignment)
    center = vec(detection.box.center)
    if not aligned:
        return solid(detection.name, detection.label, vec(size), center, yaw)
    layers = _layers(size, aligned, config)
    body = FurniturePart("body", tuple(_body(face, aligned, layers, config)))
    moving = [
        _moving(name, part, [p.area for p in aligned], face, layers, config, beside)
        for name, part in zip(_names(aligned), aligned, strict=True)
    ]
    piece = Piece(detection.name, detection.label, center, yaw, (body, *moving))
    return ending_before_hits(piece, [piece], {"revolute": 0.0, "prismatic": 0.0})


def seen_from(box: UprightBox, facing: float) -> tuple[float, tuple[float, float, float]]:
    """Turn a box so that one of its sides is the front.

    Args:
        box: The box.
        facing: Yaw of the outward normal of that side [rad]; the nearest side is taken.

    Returns:
        Yaw of the piece [rad], whose front is toward its -y, and its width, depth, height [m].
    """
    quarter = round((facing - box.yaw) / (np.pi / 2))
    x, y, z = map(float, box.size)
    width, depth = (y, x) if quarter % 2 == 0 else (x, y)
    return float(wrap_angle(box.yaw + (quarter + 1) * np.pi / 2)), (width, depth, z)


def _names(parts: Sequence[AlignedPart]) -> list[str]:
    """Name parts by what they are; they are numbered where there are several of one."""
    kinds = ["drawer" if part.kind == "drawer" else "door" for part in parts]
    count, seen = Counter(kinds), Counter[str]()
    names = []
    for kind in kinds:
        seen[kind] += 1
        names.append(f"{kind}_{seen[kind]}" if count[kind] > 1 else kind)
    return names


# ------------------------------------------------------------------------------ along y: the layers


def _layers(
    size: tuple[float, float, float], parts: Sequence[AlignedPart], config: ModelConfig
) -> _Layers:
    """Lay the walls behind the rearmost door."""
    depth = size[1]
    front = _Layers(-depth / 2, 0.0, depth / 2, min(config.panel, min(size) / 8), 1.0)
    rear = max(sum(_slab(part, front, config)) for part in parts) - front.face
    shallow = min(1.0, depth / 3 / max(rear, 1e-3))
    return replace(front, opening=front.face + shallow * rear + config.gap, shallow=shallow)


def _slab(part: AlignedPart, layers: _Layers, config: ModelConfig) -> tuple[float, float]:
    """Where the front of a part lies along y, and its thickness [m]."""
    thickness = float(np.clip(part.out, *config.thickness))
    return layers.face - part.out * layers.shallow, thickness * layers.shallow


# -------------------------------------------------------------------------------------- what stands


def _body(
    face: FaceImage, parts: Sequence[AlignedPart], layers: _Layers, config: ModelConfig
) -> list[Box]:
    """Walls around an empty room, a board at each seam, and panels where nothing opens."""
    w, h, wall = face.width, face.height, layers.wall
    whole, inside = Area(0.0, 0.0, w, h), _inside(face, layers)
    shell = {
        "left": Area(0.0, 0.0, wall, h),
        "right": Area(w - wall, 0.0, w, h),
        "bottom": Area(wall, 0.0, w - wall, wall),
        "top": Area(wall, h - wall, w - wall, h),
    }
    rear = layers.back - wall
    boxes = [_box(name, area, layers.opening, layers.back, face) for name, area in shell.items()]
    boxes.append(_box("back", inside, rear, layers.back, face))
    areas = [part.area for part in parts]
    for index, board in enumerate(_boards(areas, inside, wall), start=1):
        boxes.append(_box(f"divider_{index}", board, layers.opening, rear, face))
    for index, area in enumerate(_rest(areas, whole), start=1):
        out = front_of(face, area, config.alignment.most_height_map) * layers.shallow
        front = layers.face - out
        boxes.append(_box(f"panel_{index}", area, front, max(layers.opening, front + wall), face))
    return boxes


def _inside(face: FaceImage, layers: _Layers) -> Area:
    """The room between the outer walls, as seen from the front."""
    wall = layers.wall
    return Area(wall, wall, face.width - wall, face.height - wall)


def _boards(areas: Sequence[Area], inside: Area, wall: float) -> list[Area]:
    """A board along each edge of an area, one where edges are in line, none in an outer wall."""
    boards = []
    upright = [(edge, a.bottom, a.top) for a in areas for edge in (a.left, a.right)]
    for x, low, high in _in_line(upright):
        boards.append(Area(x - wall / 2, low, x + wall / 2, high).within(inside))
    level = [(edge, a.left, a.right) for a in areas for edge in (a.bottom, a.top)]
    for z, low, high in _in_line(level):
        boards.append(Area(low, z - wall / 2, high, z + wall / 2).within(inside))
    return [board for board in boards if board is not None]


def _in_line(edges: Sequence[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Join spans (place, start, end) at one place that overlap or touch [m]."""
    joined: list[tuple[float, float, float]] = []
    for place, start, end in sorted(edges):
        if joined and joined[-1][0] == place and start <= joined[-1][2]:
            joined[-1] = (place, joined[-1][1], max(end, joined[-1][2]))
        else:
            joined.append((place, start, end))
    return joined


def _rest(areas: Sequence[Area], whole: Area) -> list[Area]:
    """Rectangles that fill what areas leave of the whole; each is as wide as can be."""
    x = np.unique([whole.left, whole.right, *(v for a in areas for v in (a.left, a.right))])
    z = np.unique([whole.bottom, whole.top, *(v for a in areas for v in (a.bottom, a.top))])
    free = np.ones((len(z) - 1, len(x) - 1), bool)
    for a in areas:
        rows, columns = np.searchsorted(z, (a.bottom, a.top)), np.searchsorted(x, (a.left, a.right))
        free[rows[0] : rows[1], columns[0] : columns[1]] = False
    open_rows: dict[tuple[float, float], Area] = {}
    done: list[Area] = []
    for row, (bottom, top) in zip(free, pairwise(z.tolist()), strict=True):
        ends = np.flatnonzero(np.diff(np.r_[False, row, False].astype(int))).reshape(-1, 2)
        runs = {(float(x[a]), float(x[b])) for a, b in ends}
        done += [area for run, area in open_rows.items() if run not in runs]
        open_rows = {
            run: replace(open_rows[run], top=top)
            if run in open_rows
            else Area(run[0], bottom, run[1], top)
            for run in sorted(runs)
        }
    return [*done, *open_rows.values()]


# --------------------------------------------------------------------------------------- what moves


def _moving(
    name: str,
    part: AlignedPart,
    areas: Sequence[Area],
    face: FaceImage,
    layers: _Layers,
    config: ModelConfig,
    beside: Beside,
) -> FurniturePart:
    """A door, or a drawer with its tray."""
    front, thickness = _slab(part, layers, config)
    tray = config.tray * (layers.back - layers.wall - layers.opening)
    motions = Motions(
        part.area, part.out, front, thickness, face, config, min(config.travel, tray), beside,
        any(part.area.stands_on(other) for other in areas),
    )  # fmt: skip
    strip, leaf = motions.recess(part.kind)
    boxes = [_box(f"{name}_panel", leaf, front, front + thickness, face)]
    if strip is not None:
        inner = front + motions.depth(part.kind)
        boxes.append(_box(f"{name}_hinge_side", strip, inner, front + thickness, face))
    if part.kind == "drawer":
        rear = layers.opening + tray
        boxes += _tray(name, part.area, front + thickness, rear, face, layers, config)
    handle = () if part.handle is None else _handle(name, part.handle, front, face)
    sure, held = _confidence(part)
    return FurniturePart(
        name, tuple(boxes), motions.of(part.kind), handle, motions.hypotheses(part.odds), sure, held
    )


def _confidence(part: AlignedPart) -> tuple[float, float | None]:
    """That a part is there and moves as modeled, and that its handle is there.

    A handle that depth does not show may be a shadow or a print.
    """
    likeliest = part.odds[0][1] if part.odds else 1.0
    if part.handle is None:
        return part.score * likeliest, None
    return part.score * likeliest, part.score * (1.0 if part.handle.measured else UNMEASURED)


def _tray(
    name: str,
    area: Area,
    front: float,
    rear: float,
    face: FaceImage,
    layers: _Layers,
    config: ModelConfig,
) -> list[Box]:
    """The box of a drawer, open above, in the room between the boards around it."""
    inside, room = _inside(face, layers), area.within(area, layers.wall / 2 + config.gap)
    room = None if room is None else room.within(inside, config.gap)
    if room is None:
        return []
    board = min(0.012, room.width / 4, room.height / 4)
    sides = {
        "left": replace(room, right=room.left + board),
        "right": replace(room, left=room.right - board),
        "bottom": replace(room, top=room.bottom + board),
    }
    boxes = [_box(f"{name}_{side}", a, front, rear, face) for side, a in sides.items()]
    return [*boxes, _box(f"{name}_back", room, rear - board, rear, face)]


def _handle(name: str, handle: AlignedHandle, front: float, face: FaceImage) -> tuple[Box, ...]:
    """A bar on posts, or a knob where it is about as long as thick."""
    area = handle.area
    thick, length = sorted((area.width, area.height))
    if length < KNOB * thick:
        return (_box(f"{name}_handle_knob", area, front - handle.out, front, face),)
    bar = min(thick, max(handle.out - FINGER_GAP, handle.out / 2))
    x = (area.left + area.right - face.width) / 2
    z = (area.bottom + area.top - face.height) / 2
    return bar_handle(
        name,
        x,
        z,
        length,
        upright=bool(area.height > area.width),
        front=front,
        bar=bar,
        stand_off=handle.out - bar,
    )


def _box(name: str, area: Area, front: float, rear: float, face: FaceImage) -> Box:
    """A box from an area of the face and a span along y [m], in the frame of the piece."""
    x, z = face.width / 2, face.height / 2
    low, high = (area.left - x, front, area.bottom - z), (area.right - x, rear, area.top - z)
    return Box(name, vec(low), vec(high))
