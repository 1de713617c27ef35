"""The boxes of a task: what moves, at every value of its joint, and what stands still."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Boxes, MovingBoxes

from .handles import Handle

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


def moving_boxes(
    target: SceneObject,
    Ts_world_part: Float[np.ndarray, "v 4 4"],
    T_part_link: dict[str, Float[np.ndarray, "4 4"]],
    held: Mapping[str, Collection[int]] | None,
) -> tuple[MovingBoxes, list[str], Bool[np.ndarray, " m"]]:
    """Boxes of the moving links at each value, and which of them the palm may touch.

    Args:
        target: The object.
        Ts_world_part: Where the part is at each value.
        T_part_link: Where the moving links are in it.
        held: Collision elements that are held, by link; None for all.
    """
    center, rotation, half, labels, near = [], [], [], [], []
    for link, T in T_part_link.items():
        for index, boxes in enumerate(target.model.boxes[link]):
            center.append(boxes.center @ T[:3, :3].T + T[:3, 3])
            rotation.append(T[:3, :3] @ boxes.rotation)
            half.append(boxes.half)
            labels += [f"{target.name}/{link}"] * len(boxes)
            near.append(np.full(len(boxes), held is None or index in held.get(link, ())))
    c, R, h = _stack(center, rotation, half)
    world = MovingBoxes(
        np.einsum("vij,mj->vmi", Ts_world_part[:, :3, :3], c) + Ts_world_part[:, None, :3, 3],
        np.einsum("vij,mjk->vmik", Ts_world_part[:, :3, :3], R),
        np.broadcast_to(h, (len(Ts_world_part), *h.shape)).copy(),
    )
    return world, labels, np.concatenate(near) if near else np.zeros(0, bool)


def held_elements(handles: Iterable[Handle]) -> dict[str, set[int]]:
    """The collision elements of handles, by link."""
    held: dict[str, set[int]] = {}
    for element in (e for handle in handles for e in handle.elements):
        if element.index is not None:
            held.setdefault(element.link, set()).add(element.index)
    return held


def room_boxes(scene: Scene) -> Boxes:
    """All boxes of a room."""
    return static_boxes(scene, None, set())[0]


def static_boxes(
    scene: Scene, target: SceneObject | None, moved: set[str]
) -> tuple[Boxes, list[str]]:
    """Boxes of all that stands still, and their names.

    Args:
        scene: The room.
        target: The object of which some links move, if any does.
        moved: These links.
    """
    center, rotation, half, labels = [], [], [], []
    for item in scene.objects:
        for link, boxes in item.link_boxes.items():
            if item is target and link in moved:
                continue
            center.append(boxes.center)
            rotation.append(boxes.rotation)
            half.append(boxes.half)
            labels += [f"{item.name}/{link}"] * len(boxes)
    return Boxes(*_stack(center, rotation, half)), labels


def _stack(
    center: list[np.ndarray], rotation: list[np.ndarray], half: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if not center:
        return np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))
    return np.concatenate(center), np.concatenate(rotation), np.concatenate(half)
