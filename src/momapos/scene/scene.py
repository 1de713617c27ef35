"""The scene record: objects with poses and joints, a floor, a start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from momapos.errors import unknown_name
from momapos.kinematics.articulated import Articulated


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
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Axis-aligned box in the world: lower and upper corner [m]."""
        points = [
            hull.vertices @ T[:3, :3].T + T[:3, 3]
            for name, T in self.link_poses().items()
            for hull in self.model.hulls[name]
        ]
        if not points:
            return np.repeat(self.T_world_object[None, :3, 3], 2, axis=0)
        stacked = np.concatenate(points)
        return np.stack([stacked.min(0), stacked.max(0)])


@dataclass(frozen=True)
class Scene:
    """A room."""

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

    def with_joint(self, name: str, joint: str, value: float) -> Scene:
        """The same scene with one joint of one object at another value."""
        target = self.object(name)
        target.model.joint(joint)
        changed = replace(target, joints={**target.joints, joint: value})
        return replace(self, objects=tuple(changed if o is target else o for o in self.objects))
