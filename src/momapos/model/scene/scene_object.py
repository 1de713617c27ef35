"""The record of an object in a room (pose, model, joint values), and of walls."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, as_path, finite_array, finite_number, owner_cache
from momapos.core.geometry import any_overlap, apply, pose, pose_planar, signed_area, upright_frame
from momapos.model.records import Confidence, Hypothesis, JointResistance, Latch
from momapos.model.urdf import (
    Articulated,
    Boxes,
    Link,
    Urdf,
    box_urdf,
    mesh_model,
    read_furniture,
    trimesh_parts,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from momapos.model.urdf import Joint


WALL_HEIGHT, WALL_THICKNESS = 2.5, 0.1
"""Default height and thickness of a wall; also the height of what a map shows as occupied [m]."""
MIN_LENGTH = 1e-3
"""Minimum length, height and thickness of a wall [m]."""
MAX_LENGTH, MAX_HEIGHT, MAX_THICKNESS = 1e3, 100.0, 10.0
"""Maximum sizes of a wall [m]."""
MAX_DISTANCE = 1e4
"""Maximum distance of an end from the world's origin [m]."""
_THINNER = (WALL_THICKNESS, 0.05, 0.02, 0.01)
"""Thicknesses of a wall along the floor, the first that leaves the floor free [m]."""
_INSET = 2e-3
"""A wall that reaches less into the floor counts as outside [m]."""


@dataclass(frozen=True)
class Wall:
    """A solid wall on the floor; its center line is the segment between two points.

    Raises:
        SceneError: A number is not finite or out of range, or both ends are at one point.
    """

    start: tuple[float, float]
    """One end of the center line: x, y [m]."""
    end: tuple[float, float]
    """The other end: x, y [m]."""
    height: float = WALL_HEIGHT
    """Height above the floor [m]."""
    thickness: float = WALL_THICKNESS
    """Thickness, half of it on either side of the center line [m]."""

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            x, y = finite_array(f"Wall.{name}", getattr(self, name), (2,)).tolist()
            if max(abs(x), abs(y)) > MAX_DISTANCE:
                raise SceneError(
                    f"Wall.{name} must be within 10 km of the origin, not {x:g}, {y:g}"
                )
            object.__setattr__(self, name, (x, y))
        for name, most in (("height", MAX_HEIGHT), ("thickness", MAX_THICKNESS)):
            value = finite_number(f"Wall.{name}", getattr(self, name), MIN_LENGTH, most)
            object.__setattr__(self, name, value)
        if not MIN_LENGTH <= self.length <= MAX_LENGTH:
            raise SceneError(
                f"Wall from {self.start} to {self.end} is {self.length:g} m long; it must be "
                f"{MIN_LENGTH:g} to {MAX_LENGTH:g} m"
            )

    @property
    def length(self) -> float:
        """Return the length of the center line [m]."""
        return math.dist(self.start, self.end)

    @property
    def size(self) -> tuple[float, float, float]:
        """Return length, thickness and height [m]."""
        return self.length, self.thickness, self.height

    @property
    def center(self) -> tuple[float, float, float]:
        """Return the middle of the box in the world [m]."""
        (x, y), (u, v) = self.start, self.end
        return (x + u) / 2, (y + v) / 2, self.height / 2

    @property
    def yaw(self) -> float:
        """Return the direction of the center line [rad]."""
        return math.atan2(self.end[1] - self.start[1], self.end[0] - self.start[0])


def wall_name(index: int) -> str:
    """Return the name of a wall's object by its index from 0."""
    return f"wall_{index + 1}"


def walls_around(floor: Float[np.ndarray, "k 2"]) -> tuple[Wall, ...]:
    """Return walls along all edges of a floor, just outside of it, so that it stays free.

    A wall is thinner where the floor continues behind it, and longer at an outer corner, which it
    fills.

    Args:
        floor: Corners of a simple polygon [m].
    """
    polygon = floor if signed_area(floor) > 0 else floor[::-1]
    polygon = polygon[np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1) > MIN_LENGTH]
    corner = np.roll(polygon, -1, axis=0)
    edge = corner - polygon
    along = edge / np.linalg.norm(edge, axis=1)[:, None]
    after = np.roll(along, -1, axis=0)
    outer = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0] > 0.0
    away = np.stack([along[:, 1], -along[:, 0]], axis=1)
    thickness, extension = np.full(len(polygon), _THINNER[-1]), np.zeros(len(polygon))
    left = np.ones(len(polygon), bool)
    for t in _THINNER:
        for longer in (t * outer, np.zeros(len(polygon))):
            end = corner + longer[:, None] * along
            free = left & ~_reach_into(floor, polygon, end, along, away, t)
            thickness[free], extension[free] = t, longer[free]
            left &= ~free
    shift = thickness[:, None] / 2 * away
    first, last = polygon + shift, corner + extension[:, None] * along + shift
    return tuple(
        Wall(tuple(a), tuple(b), WALL_HEIGHT, t)
        for a, b, t in zip(first.tolist(), last.tolist(), thickness.tolist(), strict=True)
    )


def _reach_into(
    floor: Float[np.ndarray, "k 2"],
    start: Float[np.ndarray, "n 2"],
    end: Float[np.ndarray, "n 2"],
    along: Float[np.ndarray, "n 2"],
    away: Float[np.ndarray, "n 2"],
    thickness: float,
) -> Bool[np.ndarray, " n"]:
    """Return which walls outside of the edges from start to end would reach into the floor."""
    near, far = _INSET * away, (thickness - _INSET) * away
    start, end = start + _INSET * along, end - _INSET * along
    return any_overlap(floor, np.stack([start + near, end + near, end + far, start + far], axis=1))


def check_crossing(walls: Sequence[Wall], where: str) -> None:
    """Check that no two walls cross away from their ends.

    Raises:
        SceneError: Two walls cross; the message starts with `where`.
    """
    if not walls:
        return
    a, b = np.array([w.start for w in walls]), np.array([w.end for w in walls])
    d, length = b - a, np.array([w.length for w in walls])
    cross = d[:, None, 0] * d[None, :, 1] - d[:, None, 1] * d[None, :, 0]
    offset = a[None] - a[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        # The lines meet at the shares s and t of their segments.
        s = (offset[..., 0] * d[None, :, 1] - offset[..., 1] * d[None, :, 0]) / cross
        t = (offset[..., 0] * d[:, None, 1] - offset[..., 1] * d[:, None, 0]) / cross
    thick = np.array([w.thickness for w in walls])
    # Walls that meet at an end may overlap by their thickness there.
    reach = np.maximum(thick[:, None], thick[None])
    inside = (np.minimum(s, 1 - s) * length[:, None] > reach) & (
        np.minimum(t, 1 - t) * length[None] > reach
    )
    rows = np.argwhere(np.triu(inside & np.isfinite(s) & np.isfinite(t), 1))
    if len(rows):
        i, j = rows[0].tolist()
        x, y = a[i] + s[i, j] * d[i]
        raise SceneError(
            f"{where}: {wall_name(i)} and {wall_name(j)} cross at ({x:.3g}, {y:.3g}); a wall may "
            f"end at another one, so split {wall_name(i)} there"
        )


MAX_STEP_HEIGHT = 5e-3
"""Robots drive over what is at most this high on the floor: rugs, sills, cables [m]."""
MIN_BOX_EDGE = 1e-4
"""Minimum edge of a box [m]."""
MIN_SCALE = 1e-6
"""Minimum scale of a model, for models in micrometers [-]."""
MAX_MASS = 1e5
"""Maximum mass of an object [kg]; excludes mistaken units."""
SAME_VALUE = 1e-6
"""Joint values that differ by less count as the same [rad] or [m]."""
MAX_POSED_MODELS = 16
"""Number of other rest values at which a model is cached [-]."""
MAX_VARIANTS = 8
"""Number of other resistances, or masses, with which an object is cached [-]."""


@dataclass(frozen=True, eq=False)
class SceneObject:
    """An object in the room; a rigid box is a model with one link."""

    name: str
    category: str
    T_world_object: Float[np.ndarray, "4 4"]
    model: Articulated
    joints: Mapping[str, float] = field(default_factory=dict)
    """Joint values [rad] or [m] in this scene; other joints are at rest."""
    hypotheses: Mapping[str, tuple[Hypothesis, ...]] = field(default_factory=dict)
    """Possible motions of parts by joint, if inferred from appearance."""
    confidence: Confidence | None = None
    """Confidence of a scan in the object; None if it was not scanned."""
    resistance: Mapping[str, JointResistance] = field(default_factory=dict)
    """Known resistance of joints; the rest is assumed."""
    mass: float | None = None
    """Known mass of the whole object [kg]; None for that of its model, or an assumed one."""
    wall: Wall | None = None
    """The wall of the room that this box stands for; None for other objects."""
    latch: Latch | None = None
    """What must be turned before one of its parts opens; None for nothing."""
    on: str | None = None
    """What it rests on, as OBJECT or OBJECT/PART; "" for nothing that moves; None for what carries
    its base."""

    @classmethod
    def box(
        cls,
        name: str,
        size: Sequence[float] | Float[np.ndarray, "3"],
        xyz: Sequence[float] | Float[np.ndarray, "3"],
        *,
        yaw: float = 0.0,
        category: str = "",
    ) -> SceneObject:
        """Return a rigid box.

        Args:
            name: Unique name in its scene.
            size: Edge lengths along its own x, y and z [m].
            xyz: Center in the world [m].
            yaw: Rotation about the world's z [rad].
            category: For example "table".

        Raises:
            InputError: A number is not finite, or an edge is shorter than 0.1 mm.
        """
        x, y, z = finite_array(f"size of box {name!r}", size, (3,)).tolist()
        if min(x, y, z) < MIN_BOX_EDGE:
            raise SceneError(
                f"size of box {name!r} must be at least {MIN_BOX_EDGE:g} m, not {size}"
            )
        T = _planar_pose(xyz, yaw)
        return cls(name, category, T, Articulated(box_urdf(name, (x, y, z))))

    @classmethod
    def nothing(cls) -> SceneObject:
        """Return an object without a name and without shapes."""
        urdf = Urdf("", None, "nothing", {"nothing": Link("nothing", (), ())}, ())
        return cls("", "", np.eye(4), Articulated(urdf))

    @classmethod
    def of_wall(cls, name: str, wall: Wall) -> SceneObject:
        """Return the solid box of a wall."""
        box = cls.box(name, wall.size, wall.center, yaw=wall.yaw, category="wall")
        return replace(box, wall=wall)

    @classmethod
    def from_mesh(
        cls,
        name: str,
        vertices: object,
        faces: object,
        xyz: Sequence[float] | Float[np.ndarray, "3"],
        *,
        yaw: float = 0.0,
        category: str = "",
    ) -> SceneObject:
        """Return a rigid object from the triangles of its surface.

        Its collision shape is the convex hull of the mesh. An object of several hulls is made by
        `from_trimesh` from a scene, or as several objects.

        Args:
            name: Unique name in its scene.
            vertices: Corners (v, 3) in the object's frame, z up [m].
            faces: Triangles (f, 3) as indices of vertices, from 0.
            xyz: Origin of its frame in the world [m].
            yaw: Rotation about the world's z [rad].
            category: For example "table".

        Raises:
            InputError: The vertices or faces are no mesh.
            UrdfError: The mesh has no volume and no area.
        """
        model = Articulated(mesh_model(name, [(vertices, faces)]))
        return cls(name, category, _planar_pose(xyz, yaw), model)

    @classmethod
    def from_trimesh(
        cls,
        name: str,
        mesh: object,
        xyz: Sequence[float] | Float[np.ndarray, "3"],
        *,
        yaw: float = 0.0,
        category: str = "",
    ) -> SceneObject:
        """Return a rigid object from a `trimesh.Trimesh` or a `trimesh.Scene`.

        Each placed mesh of a scene gets a convex hull of its own.

        Args:
            name: Unique name in its scene.
            mesh: The mesh or scene in the object's frame, z up. If it declares units, it is
                converted to meters.
            xyz: Origin of its frame in the world [m].
            yaw: Rotation about the world's z [rad].
            category: For example "table".

        Raises:
            InputError: The mesh is none, or its vertices, faces or units are invalid.
            UrdfError: A mesh has no volume and no area.
        """
        model = Articulated(mesh_model(name, trimesh_parts(name, mesh)))
        return cls(name, category, _planar_pose(xyz, yaw), model)

    @classmethod
    def from_urdf(
        cls,
        name: str,
        path: str | Path,
        xyz: Sequence[float] | Float[np.ndarray, "3"],
        *,
        yaw: float = 0.0,
        scale: float = 1.0,
        joints: Mapping[str, float] | None = None,
        category: str = "",
        visual_collisions: bool = True,
    ) -> SceneObject:
        """Return an object from a URDF, such as furniture or an appliance.

        Args:
            name: Unique name in its scene.
            path: The URDF; its meshes are in its folder or below.
            xyz: Origin of its root link in the world [m].
            yaw: Rotation about the world's z [rad].
            scale: Factor on all lengths [-].
            joints: Values of joints that are not at rest [rad] or [m].
            category: For example "fridge".
            visual_collisions: Whether visual shapes stand in where collision shapes are missing;
                `model.urdf.notes` names the links. If not, such a file is an error.

        Raises:
            UrdfError: The URDF is invalid.
            UnknownNameError: A joint does not exist.
        """
        scale = finite_number("scale", scale, MIN_SCALE)
        file = as_path("path", path)
        model = Articulated(read_furniture(file, scale=scale, visual_collisions=visual_collisions))
        for joint in joints or {}:
            model.joint(joint)
        T = _planar_pose(xyz, yaw)
        return cls(name, category, T, model, dict(joints or {}))

    def __repr__(self) -> str:
        joints = ", ".join(f"{name} {value:.4g}" for name, value in self.joints.items())
        x, y, z = self.T_world_object[:3, 3]
        at = f"at ({x:.3f}, {y:.3f}, {z:.3f})"
        return f"<SceneObject {self.name!r} ({self.category}) {at}{joints and f', {joints}'}>"

    def joint(self, name: str) -> Joint:
        """Return a movable joint by name.

        Raises:
            UnknownNameError: The joint does not exist; the message names the object.
        """
        return self.model.joint(name, self.name)

    def values(self, change: Mapping[str, float] | None = None) -> dict[str, float]:
        """Return all joint values, some of them changed."""
        return self.model.all_values({**self.joints, **(change or {})})

    @owner_cache(MAX_VARIANTS)
    def with_resistance(self, known: tuple[tuple[str, JointResistance], ...]) -> SceneObject:
        """Return the object with other known resistances of some joints.

        The same ones give the same object, and with it all that is computed for it.
        """
        return replace(self, resistance={**self.resistance, **dict(known)})

    @owner_cache(MAX_VARIANTS)
    def with_mass(self, mass: float) -> SceneObject:
        """Return the object with another known mass [kg]; see `with_resistance`."""
        return replace(self, mass=mass)

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

    def posed_model(self, joint: str) -> Articulated:
        """Return the model with what a joint moves at rest as it is in this scene.

        Other joints of the part, such as that of its lever, may have values of their own.
        """
        model = self.model
        inside = {one.name for one in model.joints.values() if one.child in model.moved_by(joint)}
        values = {
            name: value
            for name, value in self.joints.items()
            if name in inside and name != joint and abs(value - model.rest[name]) > SAME_VALUE
        }
        return _posed(model, tuple(sorted(values.items()))) if values else model

    def moving_poses(
        self,
        joint: str,
        values: Float[np.ndarray, " v"],
        latch: Float[np.ndarray, " v"] | None = None,
    ) -> dict[str, Float[np.ndarray, "v 4 4"]]:
        """World poses of the links that a joint moves, at values of the joint [rad] or [m].

        Args:
            joint: The joint.
            values: Its values.
            latch: Values of the object's latch, where it turns, too.
        """
        turned = {} if self.latch is None or latch is None else {self.latch.joint: latch}
        return self.model.moving_poses(joint, values, {**self.joints, **turned}, self._poses)

    @cached_property
    def static_boxes(self) -> dict[str, Boxes]:
        """Boxes of the links that have any, in the world, where they stand still."""
        found = {}
        for link, T in self.link_poses().items():
            boxes = [element.boxes for element in self.model.static_elements[link]]
            if boxes:
                found[link] = Boxes(
                    np.concatenate([b.center @ T[:3, :3].T + T[:3, 3] for b in boxes]),
                    np.concatenate([T[:3, :3] @ b.rotation for b in boxes]),
                    np.concatenate([b.half for b in boxes]),
                )
        return found

    def static_labels(self, link: str) -> list[str]:
        """Return the names of a link's boxes in `static_boxes`, with the object."""
        labels = []
        for element in self.model.static_elements[link]:
            labels += [f"{self.name}/{element.label(link, static=True)}"] * len(element.boxes)
        return labels

    @cached_property
    def vertices(self) -> Float[np.ndarray, "v 3"]:
        """Vertices of all hulls in the world [m]; the origin if there is no geometry."""
        points = [
            apply(T, hull.vertices)
            for name, T in self.link_poses().items()
            for hull in self.model.hulls[name]
        ]
        return np.concatenate(points) if points else self.T_world_object[None, :3, 3]

    @cached_property
    def box_proxy(self) -> SceneObject:
        """The object as one rigid upright box, with the object's yaw."""
        if self.wall is not None:
            return self
        R = upright_frame(self.T_world_object[:3, :3])
        local = self.vertices @ R
        low, high = local.min(0), local.max(0)
        x, y, z = np.maximum(high - low, MIN_BOX_EDGE).tolist()
        model = Articulated(box_urdf(self.name, (x, y, z)))
        return SceneObject(self.name, self.category, pose(R @ ((low + high) / 2), R), model)

    @cached_property
    def is_flat(self) -> bool:
        """Return whether it lies so flat on the floor that it is in nobody's way."""
        return bool(self.bounds[1, 2] <= MAX_STEP_HEIGHT)

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lower and upper corner of the world-aligned bounding box [m]."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


@owner_cache(MAX_POSED_MODELS)
def _posed(model: Articulated, values: tuple[tuple[str, float], ...]) -> Articulated:
    return model.changed(held={**model.held, **dict(values)})


def _planar_pose(
    xyz: Sequence[float] | Float[np.ndarray, "3"], yaw: float
) -> Float[np.ndarray, "4 4"]:
    """Return the pose of an upright frame at a point."""
    x, y, z = finite_array("xyz", xyz, (3,)).tolist()
    T = pose_planar(np.array([x, y, finite_number("yaw", yaw)]))
    T[2, 3] = z
    return T


def upright_boxes(items: Sequence[SceneObject]) -> Boxes:
    """Return the upright box around each object, aligned with the object's frame."""
    boxed = [item.box_proxy for item in items]
    T = np.array([item.T_world_object for item in boxed]).reshape(-1, 4, 4)
    size = [item.model.urdf.links["box"].collisions[0].size for item in boxed]
    half = np.array(size, float).reshape(-1, 3) / 2
    return Boxes(T[:, :3, 3].copy(), T[:, :3, :3].copy(), half)
