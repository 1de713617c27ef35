"""Boxes of a scene that stand still, and of what a task moves, at each value of its motion."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import invert
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Boxes, MovingBoxes

from .handles import Handle

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_PARTS = 8
"""Number of parts of a scene for which the static boxes are cached; a question has a few [-]."""
Body: TypeAlias = "tuple[Float[np.ndarray, 'v 4 4'], Mapping[str, Float[np.ndarray, '4 4']]]"
"""A rigid body that moves: its world pose at each value, and the poses of its links in it."""


def moving_boxes(
    target: SceneObject,
    bodies: Sequence[Body],
    held: Mapping[str, Collection[int]] | None,
) -> tuple[MovingBoxes, list[str], Bool[np.ndarray, " m"]]:
    """Return the boxes of the moving links at each value, their labels, and which may be touched.

    Args:
        target: The object.
        bodies: The rigid bodies that move, one or more.
        held: Indices of the grasped collision elements by link; None for all.
    """
    found, labels, touched = [], [], [np.zeros(0, bool)]
    for Ts_world_body, T_body_link in bodies:
        carried = []
        for link, T in T_body_link.items():
            for index, boxes in enumerate(target.model.boxes[link]):
                element = target.model.static_elements[link][index]
                label = element.label(link, static=False)
                carried.append(boxes.moved(T))
                labels += [f"{target.name}/{label}"] * len(boxes)
                touched.append(np.full(len(boxes), held is None or index in held.get(link, ())))
        found.append(_along(Boxes.join(carried), Ts_world_body))
    return MovingBoxes.join(found), labels, np.concatenate(touched)


def bodies_moved_by(
    target: SceneObject,
    joint: str,
    values: Float[np.ndarray, " v"],
    latch: Float[np.ndarray, " v"] | None = None,
) -> dict[str, Body]:
    """Return the bodies that a joint and its mimic joints move, by the link that carries each.

    Args:
        target: The object.
        joint: Its joint.
        values: Values of the joint [rad] or [m].
        latch: Values of the object's latch, if it is turned, too [rad] or [m].
    """
    poses, moving = target.link_poses(), target.moving_poses(joint, values, latch)
    turned = () if target.latch is None or latch is None else (target.latch.joint,)
    groups = target.model.rigid_groups(joint, *turned)
    back = {carrier: invert(poses[carrier]) for carrier in dict.fromkeys(groups.values())}
    return {
        carrier: (
            moving[carrier],
            {link: T @ poses[link] for link, one in groups.items() if one == carrier},
        )
        for carrier, T in back.items()
    }


def _along(boxes: Boxes, Ts: Float[np.ndarray, "v 4 4"]) -> MovingBoxes:
    """Return boxes at each pose of the link that carries them."""
    R, p = Ts[:, :3, :3], Ts[:, None, :3, 3]
    return MovingBoxes(
        np.einsum("vij,mj->vmi", R, boxes.center) + p,
        np.einsum("vij,mjk->vmik", R, boxes.rotation),
        np.broadcast_to(boxes.half, (len(R), *boxes.half.shape)).copy(),
    )


def held_elements(handles: Iterable[Handle]) -> dict[str, set[int]]:
    """Return the indices of the handles' collision elements by link."""
    held: dict[str, set[int]] = {}
    for element in (e for handle in handles for e in handle.elements):
        if element.index is not None:
            held.setdefault(element.link, set()).add(element.index)
    return held


def scene_boxes(scene: Scene) -> Boxes:
    """Return all boxes of a scene."""
    return static_boxes(scene, None, frozenset())[0]


@owner_cache(_PARTS)
def static_boxes(
    scene: Scene, target: SceneObject | None, moved: frozenset[str]
) -> tuple[Boxes, tuple[str, ...]]:
    """Return the boxes of all static links, and their labels, cached for all motions of a part.

    What lies flat on the floor is left out.

    Args:
        scene: The scene.
        target: The object with moving links, if any.
        moved: Names of these links.
    """
    found: list[Boxes] = []
    labels: list[str] = []
    for item in scene.objects:
        if item.is_flat and item is not target:
            continue
        for link, boxes in item.static_boxes.items():
            if item is not target or link not in moved:
                found.append(boxes)
                labels += item.static_labels(link)
    return Boxes.join(found), tuple(labels)
