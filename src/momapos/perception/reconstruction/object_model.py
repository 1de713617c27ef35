"""Build a hollow body with doors and drawers that fits a box and the parts seen on one side.

Frame of a piece: origin in the center of the box, x right, y to the back, z up, as seen from the
front, the side with the parts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import UprightBox, wrap_angle
from momapos.model.records import Detection, FaceImage, Hypothesis, PartKind
from momapos.model.records import Part as SeenPart
from momapos.model.scene.library import (
    Box,
    FurniturePart,
    JointMotion,
    Piece,
    Vec,
    bar_handle,
    limit_joints_before_hits,
    solid,
    vec,
)

from .alignment import MAX_HEIGHT_MAP, AlignedHandle, AlignedPart, align, front_of
from .height_maps import Area
from .model_config import DOOR_THICKNESS, MAX_PASSED, PART_GAP, TRAY_SHARE, ModelConfig

STRIP = 0.03
"""Width of the strip next to a hinge in which the height map is read [m]."""
MIN_PROBABILITY = 0.005
"""Less probable kinds are not hypotheses [-]."""
Neighbors = tuple[float | None, float | None]
"""Protrusion of an object's neighbors beyond its face, left and right [m]; None: no neighbor."""


@dataclass(frozen=True, eq=False)
class Motions:
    """The motions that one part would have as any kind of part."""

    area: Area
    """Area on the face, up to the middle of its gaps."""
    out: float
    """Protrusion of its front beyond the face [m]."""
    front: float
    """y coordinate of its front, in the frame of the piece [m]."""
    thickness: float
    """Thickness of its leaf [m]."""
    face: FaceImage
    config: ModelConfig
    travel: float
    """Range of its slide [m]."""
    neighbors: Neighbors
    """Protrusion of the object's neighbors beyond the face, left and right as seen from the front
    [m]; None without a neighbor."""
    below: bool = False
    """Whether another part adjoins from below."""

    def is_free(self, kind: PartKind) -> bool:
        """Check whether the hinge of a kind of part has no neighbor."""
        if kind == "door_down":
            return not self.below  # a plinth lies farther back
        return self._at_rim(kind) and not self._is_tight(kind)

    def _at_rim(self, kind: PartKind) -> bool:
        at_rim = {
            "door_left": self.area.left <= 0.0,
            "door_right": self.area.right >= self.face.width,
            "door_up": self.area.top >= self.face.height,
        }
        return bool(at_rim.get(kind, False))

    def _is_tight(self, kind: PartKind) -> bool:
        """Check whether another object is next to the hinge of a kind of part."""
        return self._at_rim(kind) and self._neighbor(kind) is not None

    def _neighbor(self, kind: PartKind) -> float | None:
        return {"door_left": self.neighbors[0], "door_right": self.neighbors[1]}.get(kind)

    def depth(self, kind: PartKind) -> float:
        """Return how far behind the front the hinge of a kind of part lies [m]."""
        config, depth = self.config, self.config.hinge_depth
        if self._is_tight(kind):
            past = (self._neighbor(kind) or 0.0) - self.out
            depth = config.tight_hinge_depth if past < MAX_PASSED * self.area.width else 0.0
        return min(depth, self.thickness)

    def of(self, kind: PartKind) -> JointMotion:
        """Return the joint of a kind of part; all open with a positive value."""
        if kind == "drawer":
            return JointMotion("prismatic", (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), self.travel)
        gap = PART_GAP
        x, z = self.face.width / 2, self.face.height / 2
        left, right = self.area.left + gap - x, self.area.right - gap - x
        bottom, top = self.area.bottom + gap - z, self.area.top - gap - z
        y = self.front + self.depth(kind)
        pivots: dict[str, tuple[Vec, Vec]] = {
            "door_left": ((left, y, 0.0), (0.0, 0.0, -1.0)),
            "door_right": ((right, y, 0.0), (0.0, 0.0, 1.0)),
            "door_down": ((0.0, y, bottom), (1.0, 0.0, 0.0)),
            "door_up": ((0.0, y, top), (-1.0, 0.0, 0.0)),
        }
        pivot, axis = pivots[kind]
        return JointMotion("revolute", vec(pivot), axis, self.config.turn)

    def leaf(self, kind: PartKind) -> Area:
        """Return the front of a kind of part, with gaps around it.

        The rear edge of a door swings out beyond its width, so the gap opposite the hinge is wider.
        The leaf starts at its axis, so that it does not swing into what is behind. With a neighbor
        it starts as far from the axis as the axis lies behind the neighbor's front, so that it
        stays within its width until it has passed the neighbor.
        """
        area = self.area.within(self.area, PART_GAP)
        assert area is not None
        if kind == "drawer":
            return area
        width = area.width if kind in ("door_left", "door_right") else area.height
        swing = (self.thickness - self.depth(kind)) ** 2 / (2 * width)
        clear = self.is_free(kind) and kind != "door_down"  # a plinth or the floor is below
        behind = 0.0 if clear else self.depth(kind) + self._surroundings(kind)
        cut = min(behind, width / 4)
        return {
            "door_left": replace(area, left=area.left + cut, right=area.right - swing),
            "door_right": replace(area, left=area.left + swing, right=area.right - cut),
            "door_down": replace(area, bottom=area.bottom + cut, top=area.top - swing),
            "door_up": replace(area, bottom=area.bottom + swing, top=area.top - cut),
        }[kind]

    def recess(self, kind: PartKind) -> tuple[Area | None, Area]:
        """Split a leaf into the recessed strip at its hinge, if there is one, and the rest.

        At 90 degrees, the front of a leaf is as far to the side of its axis as it is in front of
        it when closed. So the strip that passes a protruding neighbor is set back by the depth of
        the axis.
        """
        leaf, depth = self.leaf(kind), self.depth(kind)
        out = (self._neighbor(kind) or 0.0) - self.out if self._is_tight(kind) else 0.0
        if out <= 0.0 or depth <= 0.0:
            return None, leaf
        past = depth + out + PART_GAP
        if kind == "door_left":
            edge = self.area.left + past
            return replace(leaf, right=edge), replace(leaf, left=edge)
        edge = self.area.right - past
        return replace(leaf, left=edge), replace(leaf, right=edge)

    def _surroundings(self, kind: PartKind) -> float:
        """Return how far the area next to a hinge protrudes beyond the part's front [m]."""
        area, face = self.area, self.face
        strip = {
            "door_left": replace(area, left=area.left - STRIP, right=area.left),
            "door_right": replace(area, left=area.right, right=area.right + STRIP),
            "door_down": replace(area, bottom=area.bottom - STRIP, top=area.bottom),
            "door_up": replace(area, bottom=area.top, top=area.top + STRIP),
        }[kind].within(Area(0.0, 0.0, face.width, face.height))
        if strip is None:
            return 0.0
        out = front_of(face, strip, MAX_HEIGHT_MAP)
        return max(0.0, out - self.out) + (PART_GAP if out > self.out else 0.0)

    def hypotheses(self, odds: Sequence[tuple[PartKind, float]]) -> tuple[Hypothesis, ...]:
        """Return all probable motions of the part, the most probable first.

        Args:
            odds: Kinds with their probabilities, the most probable first.
        """
        kept = [(kind, share) for kind, share in odds if share >= MIN_PROBABILITY]
        total = sum(share for _, share in kept)
        found = []
        for kind, share in kept:
            motion = self.of(kind)
            found.append(Hypothesis(kind, share / total, motion.pivot, motion.axis, motion.upper))
        return tuple(found)


MIN_BAR_ASPECT = 2.0
"""A less elongated handle is a knob, without a gap behind it [-]."""
MAX_SIZE_DIFFERENCE = 0.02
"""Between a face and the side of the box that it shows [m]."""
UNMEASURED = 0.5
"""Confidence of a handle without depth [-]."""
FINGER_GAP = 0.01
"""Between a bar and the front behind it, where the handle protrudes enough [m]."""


@dataclass(frozen=True)
class _Layers:
    """Positions of the layers of a piece along y [m]."""

    face: float
    """Plane that the height map refers to."""
    opening: float
    """Front of the walls; doors lie in front of it."""
    back: float
    """Rear of the piece."""
    wall: float
    """Thickness of the walls."""
    shallow: float
    """Scale of heights and doors, so that they fit into the front of a thin box [-]."""


def furniture_model(
    detection: Detection,
    facing: float,
    face: FaceImage,
    parts: Sequence[SeenPart],
    config: ModelConfig | None = None,
    *,
    neighbors: Neighbors = (np.inf, np.inf),
) -> Piece:
    """Build the model of one object: its box, hollow, with doors and drawers that open.

    A door turns about an axis behind its front (`ModelConfig.hinge_depth`), as real doors do: most
    by 1 to 2 cm, fridges by 2 to 8 cm. The axis is less deep if another object is next to the
    hinge, and in the front next to a wall. With a neighbor, a door stays within its own width as it
    opens. Every joint ends before its part would hit the rest of the piece.

    Args:
        detection: The object with its box.
        facing: Yaw of the outward normal of the box's front [rad]; the nearest side is used.
        face: That side, seen straight on.
        parts: The doors and drawers on it.
        config: Assumptions about invisible dimensions.
        neighbors: Protrusion of the neighbors beyond the face, left and right as seen from the
            front [m]; None without a neighbor, infinite if unknown.

    Returns:
        The piece. Moving parts are named by kind, top to bottom and left to right: `door` and
        `drawer` if unique, else `door_1`, `door_2`. One solid box without parts.

    Raises:
        InputError: The face does not have the size of that side of the box.
    """
    config = config or ModelConfig()
    yaw, size = seen_from(detection.box, facing)
    width, _, height = size
    if max(abs(face.width - width), abs(face.height - height)) > MAX_SIZE_DIFFERENCE:
        raise InputError(
            f"{detection.name}: the face is {face.width:.2f} x {face.height:.2f} m, but this side "
            f"of the box is {width:.2f} x {height:.2f} m; give the image of the side at `facing`"
        )
    aligned = align(face, parts, config.grid)
    center = vec(detection.box.center)
    if not aligned:
        return solid(detection.name, detection.label, vec(size), center, yaw)
    layers = _layers(size, aligned, config)
    body = FurniturePart("body", tuple(_body(face, aligned, layers)))
    moving = [
        _moving(name, part, [p.area for p in aligned], face, layers, config, neighbors)
        for name, part in zip(_names(aligned), aligned, strict=True)
    ]
    piece = Piece(detection.name, detection.label, center, yaw, (body, *moving))
    return limit_joints_before_hits(piece, [piece], {"revolute": 0.0, "prismatic": 0.0})


def seen_from(box: UprightBox, facing: float) -> tuple[float, tuple[float, float, float]]:
    """Return the yaw and size of a box with one of its sides as the front.

    Args:
        box: The box.
        facing: Yaw of the outward normal of that side [rad]; the nearest side is used.

    Returns:
        Yaw of the piece [rad], whose front is toward its -y, and its width, depth, height [m].
    """
    quarter = round((facing - box.yaw) / (np.pi / 2))
    x, y, z = map(float, box.size)
    width, depth = (y, x) if quarter % 2 == 0 else (x, y)
    return float(wrap_angle(box.yaw + (quarter + 1) * np.pi / 2)), (width, depth, z)


def _names(parts: Sequence[AlignedPart]) -> list[str]:
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
    """Place the walls behind the rearmost door."""
    depth = size[1]
    front = _Layers(-depth / 2, 0.0, depth / 2, min(config.panel, min(size) / 8), 1.0)
    rear = max(sum(_slab(part, front)) for part in parts) - front.face
    shallow = min(1.0, depth / 3 / max(rear, 1e-3))
    return replace(front, opening=front.face + shallow * rear + PART_GAP, shallow=shallow)


def _slab(part: AlignedPart, layers: _Layers) -> tuple[float, float]:
    """Return the y coordinate of a part's front, and its thickness [m]."""
    thickness = float(np.clip(part.out, *DOOR_THICKNESS))
    return layers.face - part.out * layers.shallow, thickness * layers.shallow


# ------------------------------------------------------------------------------------- fixed parts


def _body(face: FaceImage, parts: Sequence[AlignedPart], layers: _Layers) -> list[Box]:
    """Return the outer walls, a board at each seam, and panels where nothing opens."""
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
        out = front_of(face, area, MAX_HEIGHT_MAP) * layers.shallow
        front = layers.face - out
        boxes.append(_box(f"panel_{index}", area, front, max(layers.opening, front + wall), face))
    return boxes


def _inside(face: FaceImage, layers: _Layers) -> Area:
    """Return the area between the outer walls, as seen from the front."""
    wall = layers.wall
    return Area(wall, wall, face.width - wall, face.height - wall)


def _boards(areas: Sequence[Area], inside: Area, wall: float) -> list[Area]:
    """Return a board along each edge of the areas, without duplicates and outer walls."""
    boards = []
    upright = [(edge, a.bottom, a.top) for a in areas for edge in (a.left, a.right)]
    for x, low, high in _in_line(upright):
        boards.append(Area(x - wall / 2, low, x + wall / 2, high).within(inside))
    level = [(edge, a.left, a.right) for a in areas for edge in (a.bottom, a.top)]
    for z, low, high in _in_line(level):
        boards.append(Area(low, z - wall / 2, high, z + wall / 2).within(inside))
    return [board for board in boards if board is not None]


def _in_line(edges: Sequence[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Merge spans (place, start, end) at one place that overlap or touch [m]."""
    merged: list[tuple[float, float, float]] = []
    for place, start, end in sorted(edges):
        if merged and merged[-1][0] == place and start <= merged[-1][2]:
            merged[-1] = (place, merged[-1][1], max(end, merged[-1][2]))
        else:
            merged.append((place, start, end))
    return merged


def _rest(areas: Sequence[Area], whole: Area) -> list[Area]:
    """Divide the rest of the whole into rectangles, each as wide as possible."""
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


# ------------------------------------------------------------------------------------ moving parts


def _moving(
    name: str,
    part: AlignedPart,
    areas: Sequence[Area],
    face: FaceImage,
    layers: _Layers,
    config: ModelConfig,
    neighbors: Neighbors,
) -> FurniturePart:
    front, thickness = _slab(part, layers)
    tray = TRAY_SHARE * (layers.back - layers.wall - layers.opening)
    motions = Motions(
        part.area, part.out, front, thickness, face, config, min(config.travel, tray), neighbors,
        any(part.area.stands_on(other) for other in areas),
    )  # fmt: skip
    strip, leaf = motions.recess(part.kind)
    boxes = [_box(f"{name}_panel", leaf, front, front + thickness, face)]
    if strip is not None:
        inner = front + motions.depth(part.kind)
        boxes.append(_box(f"{name}_hinge_side", strip, inner, front + thickness, face))
    if part.kind == "drawer":
        rear = layers.opening + tray
        boxes += _tray(name, part.area, front + thickness, rear, face, layers)
    handle = () if part.handle is None else _handle(name, part.handle, front, face)
    sure, held = _confidence(part)
    return FurniturePart(
        name, tuple(boxes), motions.of(part.kind), handle, motions.hypotheses(part.odds), sure, held
    )


def _confidence(part: AlignedPart) -> tuple[float, float | None]:
    """Return the confidence that a part exists and moves as modeled, and that its handle exists.

    A handle without depth may be a shadow or a print.
    """
    most_probable = part.odds[0][1] if part.odds else 1.0
    if part.handle is None:
        return part.score * most_probable, None
    return part.score * most_probable, part.score * (1.0 if part.handle.measured else UNMEASURED)


def _tray(
    name: str,
    area: Area,
    front: float,
    rear: float,
    face: FaceImage,
    layers: _Layers,
) -> list[Box]:
    """Return the open box of a drawer, in the space between the boards around it."""
    inside, room = _inside(face, layers), area.within(area, layers.wall / 2 + PART_GAP)
    room = None if room is None else room.within(inside, PART_GAP)
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
    """Return a bar on posts, or a knob if the handle is not elongated."""
    area = handle.area
    thick, length = sorted((area.width, area.height))
    if length < MIN_BAR_ASPECT * thick:
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
    """Return a box from an area of the face and a span along y [m], in the frame of the piece."""
    x, z = face.width / 2, face.height / 2
    low, high = (area.left - x, front, area.bottom - z), (area.right - x, rear, area.top - z)
    return Box(name, vec(low), vec(high))
