"""Rooms before and after a container was opened."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from momapos.model.scene import Scene

from .bench_records import Container


def without(scene: Scene, names: Collection[str]) -> Scene:
    """The same room without some things."""
    return replace(scene, objects=tuple(o for o in scene.objects if o.name not in names))


def opened(scene: Scene, box: Container, value: float, carried: Collection[str]) -> Scene:
    """The room after a container was opened.

    Args:
        scene: The room before.
        box: The container.
        value: Where its joint is then [rad] or [m].
        carried: Things that move with it.
    """
    holder, after = scene.object(box.object), scene.with_joint(box.object, box.joint, value)
    link = holder.model.joint(box.joint).child
    T = after.object(box.object).link_poses()[link] @ np.linalg.inv(holder.link_poses()[link])
    objects = (
        replace(item, T_world_object=T @ item.T_world_object) if item.name in carried else item
        for item in after.objects
    )
    return replace(after, objects=tuple(objects))
