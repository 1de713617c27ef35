"""Build rooms with known furniture: one object alone, or many along the walls of a kitchen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from momapos.core.geometry import invert, pose_planar
from momapos.model.scene import Scene, SceneObject

BETWEEN = 0.08
"""Free width between two objects of a kitchen [m]."""
AISLE = 2.4
"""Distance between the fronts of the two rows [m]."""
WALL = 0.1
"""Thickness of walls [m]."""
CEILING = 2.6
"""Height of walls [m]."""


@dataclass(frozen=True)
class Place:
    """A room with objects whose parts are known."""

    name: str
    scene: Scene
    objects: dict[str, tuple[str, np.ndarray]]
    """By name in the room: the name in the list of objects, and the transform from the room's frame
    to the object's own, in which its front is toward -x."""


def kitchen(name: str, alone: Sequence[tuple[str, Scene]]) -> Place:
    """Place objects and their counters in two rows along opposite walls, in turn.

    Args:
        name: Name of the room.
        alone: Each object's name and its own room from `objects.room`: its front toward -x, a
            wall behind it, for small ones a counter below.
    """
    rows = (alone[0::2], alone[1::2])
    depth = max(-_span(scene)[0][0] for _, scene in alone)
    ends = AISLE / 2 + depth
    items: list[SceneObject] = []
    objects: dict[str, tuple[str, np.ndarray]] = {}
    lengths = [sum(_wide(scene) for _, scene in row) for row in rows]
    for row, length, turn in zip(rows, lengths, (0.0, np.pi), strict=True):
        T_room_row = pose_planar(np.array([0.0, 0.0, turn]))
        at = -length / 2
        for object_name, scene in row:
            low, high = _span(scene)
            wide = _wide(scene)
            shift = np.array([ends, at + wide / 2 - (low[1] + high[1]) / 2, 0.0])
            T = T_room_row @ pose_planar(shift)
            own = f"object_{len(objects) + 1}"
            objects[own] = (object_name, invert(T))
            for item in scene.objects:
                if item.name != "wall":
                    new = own if item.name == "object" else f"{item.name}_{len(objects)}"
                    where = T @ item.T_world_object
                    items.append(replace(item, name=new, T_world_object=where))
            at += wide
    y = max(lengths) / 2 + 0.5
    x = ends + max(_behind(scene) for _, scene in alone)
    for k, (size, middle) in enumerate(
        (
            ((WALL, 2 * y), (x + WALL / 2, 0.0)),
            ((WALL, 2 * y), (-x - WALL / 2, 0.0)),
            ((2 * x, WALL), (0.0, y + WALL / 2)),
            ((2 * x, WALL), (0.0, -y - WALL / 2)),
        ),
        start=1,
    ):
        items.append(SceneObject.box(f"wall_{k}", (*size, CEILING), (*middle, CEILING / 2)))
    floor = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return Place(name, Scene(name, tuple(items), floor_polygon=floor), objects)


def _span(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a room's object with its counter [m]."""
    corners = [item.bounds for item in scene.objects if item.name != "wall"]
    lows, highs = zip(*corners, strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _behind(scene: Scene) -> float:
    """Return the distance of a room's wall behind its object [m]."""
    return float(scene.object("wall").bounds[0][0])


def _wide(scene: Scene) -> float:
    """Return the width along the wall of an object with its counter [m]."""
    low, high = _span(scene)
    return float(high[1] - low[1]) + BETWEEN
