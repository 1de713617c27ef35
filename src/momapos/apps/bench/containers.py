"""Change a scene as opening a container changes the room."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from momapos.model.scene import Scene

from .bench_records import Container


def without(scene: Scene, names: Collection[str]) -> Scene:
    """Return the scene without some objects."""
    return replace(scene, objects=tuple(o for o in scene.objects if o.name not in names))


def opened(scene: Scene, box: Container, value: float, carried: Collection[str]) -> Scene:
    """Return the scene with an opened container.

    Args:
        scene: The scene before.
        box: The container.
        value: New value of its joint [rad] or [m].
        carried: Objects that move with it.
    """
    holder, after = scene.object(box.object), scene.with_joint(box.object, box.joint, value)
    link = holder.model.joint(box.joint).child
    T = after.object(box.object).link_poses()[link] @ np.linalg.inv(holder.link_poses()[link])
    objects = (
        replace(item, T_world_object=T @ item.T_world_object) if item.name in carried else item
        for item in after.objects
    )
    return replace(after, objects=tuple(objects))
