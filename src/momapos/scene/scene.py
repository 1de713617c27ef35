"""The scene record: objects with poses and joints, a floor, a start."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.errors import unknown_name
from momapos.geometry.transforms import apply, pose, upright_frame
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.hulls import Boxes
from momapos.kinematics.urdf import box_urdf

if TYPE_CHECKING:
    from jaxtyping import Float

SMALLEST = 1e-4
"""Edges of a box are at least this [m]."""


@dataclass(frozen=True)
class SceneObject:
    """One thing in the room; a rigid box is a model with one link."""

    name: str
    category: str
    T_world_object: Float[np.ndarray, "4 4"]
    model: Articulated
    joints: Mapping[str, float] = field(default_factory=dict)
    """Joint values [rad] or [m] in this scene; joints not named are at rest."""

    def values(self, change: Mapping[str, float] | None = None) -> dict[str, float]:
        """All joint values, with some of them changed."""
        return {**self.model.rest, **self.joints, **(change or {})}

    def link_poses(
        self, change: Mapping[str, float] | None = None
    ) -> dict[str, Float[np.ndarray, "4 4"]]:
        """World poses of the links, with some joints changed."""
        if not change:
            return self._poses
        poses = self.model.link_poses(self.values(change))
        return {name: self.T_world_object @ T for name, T in poses.items()}

    @cached_property
    def _poses(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        poses = self.model.link_poses(self.values())
        return {name: self.T_world_object @ T for name, T in poses.items()}

    @cached_property
    def vertices(self) -> Float[np.ndarray, "v 3"]:
        """Corners of all hulls in the world [m]; the origin where there is no geometry."""
        points = [
            apply(T, hull.vertices)
            for name, T in self.link_poses().items()
            for hull in self.model.hulls[name]
        ]
        return np.concatenate(points) if points else self.T_world_object[None, :3, 3]

    @cached_property
    def boxed(self) -> SceneObject:
        """The same thing as one rigid box, upright and turned as the thing is."""
        R = upright_frame(self.T_world_object[:3, :3])
        local = self.vertices @ R
        low, high = local.min(0), local.max(0)
        x, y, z = np.maximum(high - low, SMALLEST).tolist()
        model = Articulated(box_urdf(self.name, (x, y, z)))
        return SceneObject(self.name, self.category, pose(R @ ((low + high) / 2), R), model)

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Axis-aligned box in the world: lower and upper corner [m]."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


def upright_boxes(items: Sequence[SceneObject]) -> Boxes:
    """The upright box around each object, turned with the object's frame."""
    boxed = [item.boxed for item in items]
    T = np.array([item.T_world_object for item in boxed]).reshape(-1, 4, 4)
    size = [item.model.urdf.links["box"].collisions[0].size for item in boxed]
    half = np.array(size, float).reshape(-1, 3) / 2
    return Boxes(T[:, :3, 3].copy(), T[:, :3, :3].copy(), half)


@dataclass(frozen=True, eq=False)
class Scene:
    """A room; one is equal to itself alone."""

    name: str
    path: Path | None
    """The file it came from; plans name it."""
    objects: tuple[SceneObject, ...]
    floor: Float[np.ndarray, "k 2"] | None = None
    """Outline of the floor [m]; None where the room has no known end."""
    start: Float[np.ndarray, "3"] | None = None
    """Where the robot stands at first: x [m], y [m], yaw [rad]."""
    warnings: tuple[str, ...] = ()
    """What the reader had to assume."""

    def object(self, name: str) -> SceneObject:
        """Look an object up by name.

        Raises:
            UnknownNameError: There is none; the message offers the nearest.
        """
        for item in self.objects:
            if item.name == name:
                return item
        raise unknown_name("object", name, [o.name for o in self.objects], f"scene {self.name}")

    def boxed(self, keep: Collection[str]) -> Scene:
        """The same room in which only the objects named keep their joints and their shape.

        All others are boxes, so what is free in it is free in the room.
        """
        objects = (item if item.name in keep else item.boxed for item in self.objects)
        return replace(self, objects=tuple(objects))

    def with_joint(self, name: str, joint: str, value: float) -> Scene:
        """The same scene with one joint of one object at another value."""
        target = self.object(name)
        target.model.joint(joint)
        changed = replace(target, joints={**target.joints, joint: value})
        return replace(self, objects=tuple(changed if o is target else o for o in self.objects))
