"""The scene record: objects with poses and joints, a floor, a start."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, unknown_name
from momapos.core.geometry import apply, pose, pose_planar, upright_frame
from momapos.model.records import Confidence, Hypothesis, Outline
from momapos.model.urdf import Articulated, Boxes, box_urdf, read_urdf

if TYPE_CHECKING:
    from jaxtyping import Float

    from momapos.model.urdf import Joint

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
    hypotheses: Mapping[str, tuple[Hypothesis, ...]] = field(default_factory=dict)
    """Ways in which parts may move, by joint, where that was guessed from how they look."""
    confidence: Confidence | None = None
    """How sure a scan is of it; None of what was not scanned."""

    @classmethod
    def box(
        cls,
        name: str,
        size: Sequence[float],
        xyz: Sequence[float],
        *,
        yaw: float = 0.0,
        category: str = "",
    ) -> SceneObject:
        """A rigid box.

        Args:
            name: Unique in its scene.
            size: Edges along its own x, y and z [m].
            xyz: Its center in the world [m].
            yaw: Turn about the world's z [rad].
            category: What it is, such as "table".

        Raises:
            SceneError: An edge is not positive and finite.
        """
        x, y, z = (float(edge) for edge in size)
        if not (np.isfinite([x, y, z]).all() and min(x, y, z) >= SMALLEST):
            raise SceneError(f"box {name!r}: edges must be at least {SMALLEST:g} m, not {size}")
        T = pose_planar(np.array([xyz[0], xyz[1], yaw], float))
        T[2, 3] = xyz[2]
        return cls(name, category, T, Articulated(box_urdf(name, (x, y, z))))

    @classmethod
    def from_urdf(
        cls,
        name: str,
        path: str | Path,
        xyz: Sequence[float],
        *,
        yaw: float = 0.0,
        scale: float = 1.0,
        joints: Mapping[str, float] | None = None,
        category: str = "",
    ) -> SceneObject:
        """Furniture, an appliance or any other thing from a URDF.

        Args:
            name: Unique in its scene.
            path: The URDF; its meshes lie in its folder or below.
            xyz: Origin of its root link in the world [m].
            yaw: Turn about the world's z [rad].
            scale: Factor on all lengths [-].
            joints: Values that are not at rest [rad] or [m].
            category: What it is, such as "fridge".

        Raises:
            UrdfError: The file is not a usable URDF.
            UnknownNameError: It has no such joint.
        """
        model = Articulated(read_urdf(Path(path), scale=scale))
        for joint in joints or {}:
            model.joint(joint)
        T = pose_planar(np.array([xyz[0], xyz[1], yaw], float))
        T[2, 3] = xyz[2]
        return cls(name, category, T, model, dict(joints or {}))

    def __repr__(self) -> str:
        joints = ", ".join(f"{name} {value:.4g}" for name, value in self.joints.items())
        x, y, z = self.T_world_object[:3, 3]
        at = f"at ({x:.3f}, {y:.3f}, {z:.3f})"
        return f"<SceneObject {self.name!r} ({self.category}) {at}{joints and f', {joints}'}>"

    def joint(self, name: str) -> Joint:
        """Look a movable joint up by name.

        Raises:
            UnknownNameError: There is none; the message names the object, not its model's file.
        """
        return self.model.joint(name, self.name)

    def values(self, change: Mapping[str, float] | None = None) -> dict[str, float]:
        """All joint values, with some of them changed."""
        return self.model.settled({**self.joints, **(change or {})})

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
    def link_boxes(self) -> dict[str, Boxes]:
        """Boxes of the links that have any, in the world."""
        found = {}
        for link, T in self.link_poses().items():
            boxes = self.model.boxes[link]
            if boxes:
                found[link] = Boxes(
                    np.concatenate([b.center @ T[:3, :3].T + T[:3, 3] for b in boxes]),
                    np.concatenate([T[:3, :3] @ b.rotation for b in boxes]),
                    np.concatenate([b.half for b in boxes]),
                )
        return found

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
    def box_proxy(self) -> SceneObject:
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
    boxed = [item.box_proxy for item in items]
    T = np.array([item.T_world_object for item in boxed]).reshape(-1, 4, 4)
    size = [item.model.urdf.links["box"].collisions[0].size for item in boxed]
    half = np.array(size, float).reshape(-1, 3) / 2
    return Boxes(T[:, :3, 3].copy(), T[:, :3, :3].copy(), half)


@dataclass(frozen=True, eq=False)
class Scene:
    """A room; one is equal to itself alone."""

    name: str
    objects: tuple[SceneObject, ...]
    path: Path | None = None
    """The file it came from; plans name it. `save_scene` gives a scene made in code its own."""
    floor_polygon: Float[np.ndarray, "k 2"] | None = None
    """Outline of the floor [m]; None where the room has no known end."""
    start: Float[np.ndarray, "3"] | None = None
    """Where the robot stands at first: x [m], y [m], yaw [rad]."""
    warnings: tuple[str, ...] = ()
    """What the reader had to assume."""
    areas: Mapping[str, Outline] = field(default_factory=dict)
    """Parts of the floor that have names."""
    joints_set: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Values that differ from the file's, by object and joint [rad] or [m]."""
    hypotheses_set: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Which of the file's hypotheses is taken, by object and joint; the first by default."""

    def __repr__(self) -> str:
        floor = (
            "no floor"
            if self.floor_polygon is None
            else f"a floor of {len(self.floor_polygon)} corners"
        )
        return f"<Scene {self.name!r}: {len(self.objects)} objects, {floor}, {self.path}>"

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        # By name: what draws records is downstream of them.
        png: bytes = import_module("momapos.apps.plots.notebook_images").scene_png(self)
        return png

    def object(self, name: str) -> SceneObject:
        """Look an object up by name.

        Raises:
            UnknownNameError: There is none; the message offers the nearest.
        """
        for item in self.objects:
            if item.name == name:
                return item
        raise unknown_name("object", name, [o.name for o in self.objects], f"scene {self.name}")

    def with_box_proxies(self, keep: Collection[str]) -> Scene:
        """The same room in which only the objects named keep their joints and their shape.

        All others are boxes, so what is free in it is free in the room.
        """
        objects = (item if item.name in keep else item.box_proxy for item in self.objects)
        return replace(self, objects=tuple(objects))

    def with_joint(self, name: str, joint: str, value: float) -> Scene:
        """The same scene with one joint of one object at another value."""
        target = self.object(name)
        target.joint(joint)
        changed = replace(target, joints={**target.joints, joint: value})
        return replace(
            self,
            objects=tuple(changed if o is target else o for o in self.objects),
            joints_set={**self.joints_set, name: {**self.joints_set.get(name, {}), joint: value}},
        )

    def with_joints(self, values: Mapping[str, Mapping[str, float]]) -> Scene:
        """The same scene with joints at other values, by object and joint.

        Raises:
            UnknownNameError: There is no such object or joint.
            SceneError: A value is outside its joint's limits.
        """
        scene = self
        for name, joints in values.items():
            for joint, value in joints.items():
                record = scene.object(name).joint(joint)
                if not record.lower - 1e-6 <= value <= record.upper + 1e-6:
                    raise SceneError(
                        f"{name}/{joint}: {value:g} is outside its limits {record.lower:g} to "
                        f"{record.upper:g}"
                    )
                scene = scene.with_joint(name, joint, value)
        return scene
