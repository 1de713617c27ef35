"""Generate kitchens from a layout and a seed, and write them as momapos scenes.

scene-synthesizer (NVIDIA, Apache-2.0) arranges the furniture. This module converts each piece to a
small URDF of boxes for planning: doors have a gap to their frames, handles are bars that a gripper
can close around, wire baskets become trays, and every joint ends before it hits something.
"""

from __future__ import annotations

import random
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, require, unknown_name
from momapos.model.scene.library import (
    Box,
    FurniturePart,
    JointMotion,
    Piece,
    bar_handle,
    limit_joints_before_hits,
    obstacles,
    solid,
    union,
    vec,
    write_kitchen,
)

from .scene_object import WALL_HEIGHT, WALL_THICKNESS

if TYPE_CHECKING:
    from jaxtyping import Float

LAYOUTS: tuple[str, ...] = (
    "single_wall",
    "galley",
    "l_shaped",
    "u_shaped",
    "island",
    "peninsula",
)
"""Layouts of scene-synthesizer."""

SIZES: Mapping[str, float] = {
    "counter_height": 0.9,
    "counter_depth": 0.63,
    "wall_cabinet_z": 1.42,
    "wall_cabinet_height": 0.72,
    "corner_padding": 0.12,
    "aisle_width": 1.8,
    "exit_width": 1.0,
}
"""Sizes of real kitchens [m]; the defaults of scene-synthesizer are too low and narrow."""

KINDS: Mapping[str, tuple[str, str]] = {
    "refrigerator": ("fridge", "fridge"),
    "range_hood": ("range_hood", "range hood"),
    "range": ("oven", "oven"),
    "dishwasher": ("dishwasher", "dishwasher"),
    "sink_cabinet": ("sink_cabinet", "sink"),
    "wall_cabinet": ("wall_cabinet", "cabinet"),
    "base_cabinet": ("base_cabinet", "cabinet"),
    "kitchen_island": ("kitchen_island", "kitchen island"),
    "corner": ("corner", "counter"),
    "countertop": ("countertop", "counter"),
}
"""Our name and category of each furniture kind of scene-synthesizer."""

ITEMS: Mapping[str, tuple[float, float, float]] = {
    "cup": (0.075, 0.075, 0.095),
    "apple": (0.07, 0.07, 0.07),
    "cereal_box": (0.06, 0.16, 0.24),
    "bottle": (0.065, 0.065, 0.22),
}
"""Small objects on the counters, with their sizes [m]."""

NEEDS_WALL = ("fridge", "oven", "dishwasher", "sink_cabinet", "wall_cabinet", "range_hood")
"""Pieces that need a wall behind them; cabinets and islands can be freestanding."""

MIN_OPENING = {"revolute": 0.6, "prismatic": 0.2}
"""Opening below which a part is fixed instead [rad] or [m]."""

MAX_DOOR_OPENING = 2.0  # maximum opening of doors [rad]
PART_GAP = 0.0015  # reduction of moving parts on each side [m]
HANDLE_LENGTHS = (0.12, 0.4)  # [m]
WALL_GAP = 0.005  # between furniture and wall [m]
FREE_FRONT, FREE_SIDE = 2.5, 1.5  # floor between furniture and edge: opposite a wall, else [m]
CLEARANCE = 0.8  # preferred clearance of the start pose [m]


def generate_kitchen(layout: str, *, seed: int, out: Path) -> Path:
    """Generate a kitchen and write it as a momapos scene.

    The result is reproducible to the byte. On an error nothing is written.

    Args:
        layout: One of `LAYOUTS`.
        seed: Random seed, 0 or more.
        out: The scene file; its URDF files are written to `<stem>_urdf` next to it.

    Returns:
        The path of the scene file.

    Raises:
        UnknownNameError: The layout does not exist.
        InputError: The seed is negative, or the URDF folder contains other files.
        MissingExtraError: scene-synthesizer is not installed.
    """
    if layout not in LAYOUTS:
        raise unknown_name("layout", layout, LAYOUTS, "the built-in kitchens")
    if seed < 0:
        raise InputError(f"seed must be 0 or more, not {seed}")
    pieces, floor = empty_kitchen(layout, seed)
    counters = [piece for piece in pieces if piece.name.startswith("countertop")]
    pieces += _items(counters, seed)
    pieces = with_joint_limits(pieces)
    return write_kitchen(out, f"{layout}_{seed}", pieces, floor, free_start(floor, pieces))


def empty_kitchen(layout: str, seed: int) -> tuple[list[Piece], list[tuple[float, float]]]:
    """Return furniture and walls of a kitchen with empty counters, and the floor's corners [m].

    Raises:
        MissingExtraError: scene-synthesizer is not installed.
    """
    pieces = _without_clashes(_furniture(layout, seed))
    floor, walls = _room(pieces)
    return pieces + walls, floor


def with_joint_limits(pieces: Sequence[Piece]) -> list[Piece]:
    """Return the furniture with every joint ending before its part hits anything."""
    return [limit_joints_before_hits(piece, pieces, MIN_OPENING) for piece in pieces]


def _furniture(layout: str, seed: int) -> list[Piece]:
    """Let scene-synthesizer arrange the furniture, and convert it piece by piece."""
    with require("kitchens"):
        from scene_synthesizer import procedural_assets, procedural_scenes
    with _contained(procedural_assets.utils, seed):
        build = getattr(procedural_scenes, f"kitchen_{layout}")
        scene = build(seed=seed, **procedural_scenes.use_primitives_only(), **SIZES)
        scene.zero_configurations()
        return [_piece(scene, name) for name in scene.get_object_names()]


@contextmanager
def _contained(utils: Any, seed: int) -> Iterator[None]:
    """Contain a generator's side effects: global random state, and mesh files in /tmp."""
    numpy_state, python_state = np.random.get_state(), random.getstate()  # noqa: NPY002
    file_name = utils.get_random_filename
    np.random.seed(seed % 2**32)  # noqa: NPY002 - makes other users of it reproducible
    random.seed(seed)
    with tempfile.TemporaryDirectory() as folder:

        def in_folder(suffix: str, prefix: str = "", **_: Any) -> str:
            name: str = file_name(suffix, prefix, folder)
            return name

        utils.get_random_filename = in_folder
        try:
            yield
        finally:
            utils.get_random_filename = file_name
            np.random.set_state(numpy_state)  # noqa: NPY002
            random.setstate(python_state)


def _piece(scene: Any, name: str) -> Piece:
    kind = next(kind for kind in KINDS if name.startswith(kind))
    new_kind, category = KINDS[kind]
    links, roots, joints = scene.get_links(scene.metadata["object_nodes"][name])
    frame = f"{name}/corpus" if f"{name}/corpus" in roots else name  # its front is at -y
    motions = {
        edge[1]: _motion(scene, frame, edge[1], edge[2]["metadata"]["joint"])
        for edge in joints.values()
    }
    body: list[Box] = []
    parts: list[FurniturePart] = []
    for root, nodes in sorted(zip(roots, links, strict=True)):
        boxes = [_box(scene, frame, node) for node in nodes if node in scene.graph.nodes_geometry]
        motion = motions.get(root)
        if motion is None or not any("handle" in box.name for box in boxes):
            body += _simplified(boxes)  # without a handle it cannot be pulled, such as a basket
        else:
            parts.append(_moving_part(root.rsplit("/", maxsplit=1)[-1], _simplified(boxes), motion))
    T = scene.get_transform(frame)
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    xyz = (float(T[0, 3]), float(T[1, 3]), float(T[2, 3]))
    new_name = name.replace(kind, new_kind, 1)
    return Piece(new_name, category, xyz, yaw, (FurniturePart("body", tuple(body)), *parts))


def _motion(scene: Any, frame: str, node: str, joint: Mapping[str, Any]) -> JointMotion | None:
    """Convert a joint into the frame of its piece; None for a fixed one."""
    if joint["type"] not in ("revolute", "prismatic"):
        return None
    T_piece_link = scene.get_transform(node, frame)
    axis = np.round(T_piece_link[:3, :3] @ np.asarray(joint["axis"], float), 9)
    return JointMotion(joint["type"], vec(T_piece_link[:3, 3]), vec(axis), joint["limit_upper"])


def _box(scene: Any, frame: str, node: str) -> Box:
    """Return the bounding box of a geometry in the frame of its piece."""
    T = scene.get_transform(node, frame)
    low, high = scene.geometry[scene.graph[node][1]].bounds
    center = T[:3, :3] @ (low + high) / 2 + T[:3, 3]
    half = np.abs(T[:3, :3]) @ (high - low) / 2
    return Box(node.rsplit("/", maxsplit=1)[-1], vec(center - half), vec(center + half))


def _simplified(boxes: Sequence[Box]) -> list[Box]:
    """Replace wires, baskets and the sink by a few boxes, and remove racks inside doors.

    The racks of scene-synthesizer touch the frame when the door rotates.
    """
    groups: dict[str, list[Box]] = {}
    for box in boxes:
        wires = re.fullmatch(r"(\w+_basket)_collision_\d+|(shelf_\d+_\d+_\d+)_\d+", box.name)
        groups.setdefault((wires[1] or wires[2]) if wires else box.name, []).append(box)
    hulls = {name: union(name, group) for name, group in groups.items()}
    plain: list[Box] = []
    for name, box in hulls.items():
        if name.startswith(("door_shelf", "door_holder")):
            continue
        if name == "sink" or name.endswith("_basket"):
            bottom = replace(box, high=(box.high[0], box.high[1], box.low[2] + 0.005))
            plain += [*_sides(box, box, 0.005), bottom]
        elif name == "sink_countertop":
            plain += _sides(box, hulls["sink"], 0.0)
        else:
            plain.append(box)
    return plain


def _sides(outer: Box, inner: Box, wall: float) -> list[Box]:
    """Return the four boxes between an outer box and a hole, with walls `wall` [m] thick."""
    (x0, y0, z0), (x1, y1, z1) = outer.low, outer.high
    hx0, hy0 = inner.low[0] + wall, inner.low[1] + wall
    hx1, hy1 = inner.high[0] - wall, inner.high[1] - wall
    return [
        Box(f"{outer.name}_left", (x0, y0, z0), (hx0, y1, z1)),
        Box(f"{outer.name}_right", (hx1, y0, z0), (x1, y1, z1)),
        Box(f"{outer.name}_front", (hx0, y0, z0), (hx1, hy0, z1)),
        Box(f"{outer.name}_back", (hx0, hy1, z0), (hx1, y1, z1)),
    ]


def _moving_part(name: str, boxes: Sequence[Box], motion: JointMotion) -> FurniturePart:
    """Return a door or drawer with a gap to its frame and a bar handle."""
    panels = [box for box in boxes if "handle" not in box.name]
    front = min(box.low[1] for box in panels) + PART_GAP
    margin = np.full(3, PART_GAP)
    if motion.kind == "revolute":
        motion = replace(motion, upper=min(motion.upper, MAX_DOOR_OPENING))
    if motion.kind == "revolute" and motion.axis[2]:
        # A door hinged at its front edge stays within its width, except its inner far edge.
        motion = replace(motion, pivot=(motion.pivot[0], front, motion.pivot[2]))
        width, thickness, _ = _size(union("all", panels))
        margin[0] += thickness**2 / (2 * width)
    panels = [_smaller(box, margin) for box in panels]
    old = union("handle", [box for box in boxes if "handle" in box.name])
    along_x, _, along_z = _size(old)
    center = np.add(old.low, old.high) / 2
    upright = bool(along_z > along_x)
    length = float(np.clip(max(along_x, along_z), *HANDLE_LENGTHS))
    handle = bar_handle(name, center[0], center[2], length, upright=upright, front=front)
    return FurniturePart(name, tuple(panels), motion, handle)


def _size(box: Box) -> Float[np.ndarray, "3"]:
    return np.subtract(box.high, box.low)


def _smaller(box: Box, margin: Float[np.ndarray, "3"]) -> Box:
    """Shrink a box by a margin [m] on each side, but by at most half its size in total."""
    low, high = np.array(box.low), np.array(box.high)
    margin = np.minimum(margin, (high - low) / 4)
    return Box(box.name, vec(low + margin), vec(high - margin))


def _without_clashes(pieces: Sequence[Piece]) -> list[Piece]:
    """Remove wall cabinets that overlap earlier pieces, as in scene-synthesizer's galley."""
    kept: list[Piece] = []
    for piece in pieces:
        low, high = _bounds([piece])
        others = [_bounds([other]) for other in kept]
        clash = any(np.all((low < b - 0.01) & (high > a + 0.01)) for a, b in others)
        if not (clash and piece.name.startswith("wall_cabinet")):
            kept.append(piece)
    return kept


def _bounds(pieces: Sequence[Piece]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the corners of the box around furniture with handles, in the world [m]."""
    low, high = obstacles(pieces).bounds()
    return low.min(axis=0), high.max(axis=0)


def _room(pieces: Sequence[Piece]) -> tuple[list[tuple[float, float]], list[Piece]]:
    """Lay out the floor, with walls behind furniture at its edge.

    Returns:
        The corners of the floor [m], counterclockwise, and the walls.
    """
    low, high = (bound[:2] for bound in _bounds(pieces))
    edges = np.stack([low, high])
    walled = np.zeros((2, 2), bool)  # (low or high edge, x or y)
    for piece in pieces:
        back = np.round([-np.sin(piece.yaw), np.cos(piece.yaw)])
        axis = int(np.argmax(np.abs(back)))
        side = int(back[axis] > 0)
        reach = _bounds([piece])[side][axis]
        if piece.name.startswith(NEEDS_WALL) and abs(reach - edges[side, axis]) < 0.05:
            walled[side, axis] = True
    free = np.where(walled, WALL_GAP, np.where(walled[::-1], FREE_FRONT, FREE_SIDE))
    edges = np.round(edges + [[-1.0], [1.0]] * free, 3)
    (x0, y0), (x1, y1) = edges.tolist()
    walls = []
    names = ("wall_left", "wall_front", "wall_right", "wall_back")
    for (side, axis), name in zip(np.ndindex(2, 2), names, strict=True):
        center, size = edges.mean(axis=0), edges[1] - edges[0]
        center[axis] = edges[side, axis] + (side - 0.5) * WALL_THICKNESS
        size[axis] = WALL_THICKNESS
        if walled[side, axis]:
            wall = solid(name, "wall", vec([*size, WALL_HEIGHT]), vec([*center, WALL_HEIGHT / 2]))
            walls.append(wall)
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)], walls


def _items(counters: Sequence[Piece], seed: int) -> list[Piece]:
    """Place small objects on the front two thirds of counters, apart from each other."""
    rng = np.random.default_rng((seed, 1))
    items: list[Piece] = []
    for name, size in ITEMS.items():
        for _ in range(100):
            counter = counters[int(rng.integers(len(counters)))]
            top = union("top", counter.parts[0].boxes[-1:])
            margin = 0.04 + np.hypot(size[0], size[1]) / 2
            depth = top.high[1] - top.low[1]
            x = rng.uniform(top.low[0] + margin, top.high[0] - margin)
            y = rng.uniform(top.low[1] + margin, max(top.low[1] + margin, top.high[1] - depth / 3))
            yaw = round(float(rng.uniform(-np.pi, np.pi)), 3)
            c, s = np.cos(counter.yaw), np.sin(counter.yaw)
            z = counter.xyz[2] + top.high[2] + size[2] / 2 + 0.001
            xyz = vec((counter.xyz[0] + c * x - s * y, counter.xyz[1] + s * x + c * y, z))
            if all(np.hypot(*np.subtract(xyz, item.xyz)[:2]) > 0.25 for item in items):
                items.append(solid(name, name.replace("_", " "), size, xyz, yaw))
                break
    return items


def free_start(
    floor: Sequence[tuple[float, float]], pieces: Sequence[Piece]
) -> tuple[float, float, float]:
    """Return the free pose closest to the furniture, or the freest one; the robot faces it.

    Returns:
        x [m], y [m], yaw [rad].
    """
    low, high = obstacles(pieces).bounds()
    corner, opposite = np.min(floor, axis=0), np.max(floor, axis=0)
    xs, ys = (np.arange(corner[i], opposite[i], 0.1) for i in range(2))
    points = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    away = np.maximum(np.maximum(low[:, :2] - points[:, None], points[:, None] - high[:, :2]), 0.0)
    to_edge = np.minimum(points - corner, opposite - points).min(axis=1)
    clearance = np.minimum(np.linalg.norm(away, axis=-1).min(axis=1), to_edge)
    middle = (low.min(axis=0) + high.max(axis=0))[:2] / 2
    distance = np.linalg.norm(points - middle, axis=1)
    free = clearance >= CLEARANCE
    best = np.argmin(np.where(free, distance, np.inf)) if free.any() else np.argmax(clearance)
    x, y = points[best]
    return float(x), float(y), float(np.arctan2(middle[1] - y, middle[0] - x))
