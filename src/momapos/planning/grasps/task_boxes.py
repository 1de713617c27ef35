"""Collect the boxes of a task: moving ones at every joint value, and static ones."""

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
    """Return the boxes of the moving links at each value, their labels, and which may be touched.

    Args:
        target: The object.
        Ts_world_part: Pose of the part at each value.
        T_part_link: Poses of the moving links in the part.
        held: Indices of the grasped collision elements by link; None for all.
    """
    found, labels, touched = [], [], [np.zeros(0, bool)]
    for link, T in T_part_link.items():
        for index, boxes in enumerate(target.model.boxes[link]):
            found.append(boxes.moved(T))
            labels += [f"{target.name}/{link}"] * len(boxes)
            touched.append(np.full(len(boxes), held is None or index in held.get(link, ())))
    part, R, p = Boxes.join(found), Ts_world_part[:, :3, :3], Ts_world_part[:, None, :3, 3]
    world = MovingBoxes(
        np.einsum("vij,mj->vmi", R, part.center) + p,
        np.einsum("vij,mjk->vmik", R, part.rotation),
        np.broadcast_to(part.half, (len(R), *part.half.shape)).copy(),
    )
    return world, labels, np.concatenate(touched)


def held_elements(handles: Iterable[Handle]) -> dict[str, set[int]]:
    """Return the indices of the handles' collision elements by link."""
    held: dict[str, set[int]] = {}
    for element in (e for handle in handles for e in handle.elements):
        if element.index is not None:
            held.setdefault(element.link, set()).add(element.index)
    return held


def scene_boxes(scene: Scene) -> Boxes:
    """Return all boxes of a scene."""
    return static_boxes(scene, None, set())[0]


def static_boxes(
    scene: Scene, target: SceneObject | None, moved: set[str]
) -> tuple[Boxes, list[str]]:
    """Return the boxes of all static links, and their labels.

    Args:
        scene: The scene.
        target: The object with moving links, if any.
        moved: Names of these links.
    """
    found, labels = [], []
    for item in scene.objects:
        for link, boxes in item.link_boxes.items():
            if item is not target or link not in moved:
                found.append(boxes)
                labels += [f"{item.name}/{link}"] * len(boxes)
    return Boxes.join(found), labels
