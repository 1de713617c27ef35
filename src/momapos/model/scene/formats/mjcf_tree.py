"""Convert the bodies of a compiled MJCF model to the links and joints of an object."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core.geometry import invert, pose, pose_wxyz
from momapos.model.urdf import Geometry, Joint, JointKind, Link, Mimic, Urdf, joint_motion

from .imported_room import Names, RoomObject
from .mjcf_shapes import GeomShapes

if TYPE_CHECKING:
    from jaxtyping import Float

_NUMBER = re.compile(r"#\d+$")
"""Suffix of geom names that would otherwise be equal."""


@dataclass
class Tree:
    """Collects the links and joints of one object."""

    model: Any
    shapes: GeomShapes
    children: Mapping[int, Sequence[int]]
    """Child bodies by body."""
    name: str
    prefix: str
    """Prefix of the part names, which is removed."""
    approximated: Counter[str]
    links: dict[str, Link] = field(default_factory=dict)
    joints: dict[int, Joint] = field(default_factory=dict)
    """Movable joints by MuJoCo's index."""
    values: dict[str, float] = field(default_factory=dict)
    solid: list[int] = field(default_factory=list)
    """Geoms with collisions, by MuJoCo's index."""
    _order: list[Joint] = field(default_factory=list)
    _link_names: Names = field(default_factory=Names)
    _joint_names: Names = field(default_factory=Names)

    def object(
        self, T: Float[np.ndarray, "4 4"], follows: Mapping[int, Mimic], extras: Mapping[str, Any]
    ) -> RoomObject:
        """Return the object.

        Args:
            T: Pose in the world.
            follows: Mimic relations by MuJoCo's joint index.
            extras: See `RoomObject`.
        """
        numbers = {joint.name: number for number, joint in self.joints.items()}
        joints = tuple(
            replace(joint, mimic=follows.get(numbers.get(joint.name, -1))) for joint in self._order
        )
        urdf = Urdf(self.name, None, next(iter(self.links)), self.links, joints)
        return RoomObject(self.name, T, urdf, self.values, extras)

    def add_geom(self, geom: int, link: str) -> None:
        """Add a geom of the world as the whole object, in the geom's frame."""
        self._add_link(self._link_names(link, "body"), [geom], invert(self.shapes.pose(geom)))

    def add_body(self, body: int, link: str) -> None:
        """Add a body of the world, and all bodies below it."""
        waiting: list[tuple[int, str | None, Float[np.ndarray, "4 4"]]] = [(body, None, np.eye(4))]
        while waiting:
            number, parent, T_parent_body = waiting.pop()
            wanted = link if parent is None else self._bare(self.model.body(number).name)
            name = self._link_names(wanted, f"body_{number}")
            T_link_body = self._add_joints(number, parent, T_parent_body, name)
            first, count = self.model.body_geomadr[number], self.model.body_geomnum[number]
            self._add_link(name, range(first, first + count), T_link_body)
            waiting += [
                (child, name, T_link_body @ self._offset(child))
                for child in reversed(self.children[number])
            ]

    def _offset(self, body: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a body in its parent, with joints as in the file."""
        return pose_wxyz(
            tuple(self.model.body_pos[body].tolist()), tuple(self.model.body_quat[body].tolist())
        )

    def _bare(self, name: str) -> str:
        return name.removeprefix(f"{self.prefix}/")

    def _add_joints(
        self, body: int, parent: str | None, T_parent_body: Float[np.ndarray, "4 4"], link: str
    ) -> Float[np.ndarray, "4 4"]:
        """Add the joints of a body; several joints become a chain of links without shapes.

        Args:
            body: Index of the body.
            parent: Link of its parent; None for the object's first body.
            T_parent_body: Its pose in the parent.
            link: Name of its link.

        Returns:
            The body's pose in its link, whose origin is the anchor of its last joint.
        """
        first, count = self.model.body_jntadr[body], self.model.body_jntnum[body]
        moving = [j for j in range(first, first + count) if self._kind(j) is not None]
        if parent is None and moving:
            parent = self._link_names("base", "base")
            self.links[parent] = Link(parent, (), ())
        if parent is None:
            return np.eye(4)
        if not moving:
            name = self._joint_names(f"{link}_fixed", "fixed")
            none = np.array([1.0, 0.0, 0.0])
            joint = Joint(name, "fixed", parent, link, T_parent_body, none, 0.0, 0.0, math.inf)
            self._order.append(joint)
            return np.eye(4)
        T, offset = T_parent_body, np.zeros(3)
        for joint_id in moving:
            turns = self._kind(joint_id) != "prismatic"
            anchor = np.array(self.model.jnt_pos[joint_id]) if turns else offset
            T, offset = T @ pose(anchor - offset), anchor
            last = joint_id == moving[-1]
            child = link if last else self._link_names(f"{link}_{joint_id}", "between")
            if not last:
                self.links[child] = Link(child, (), ())
            self._add_joint(joint_id, parent, child, T, link)
            parent, T = child, np.eye(4)
        return pose(-offset)

    def _kind(self, joint: int) -> JointKind | None:
        """Return the kind of a joint; None if URDF has no counterpart."""
        import mujoco

        kind, kinds = int(self.model.jnt_type[joint]), mujoco.mjtJoint
        if kind == kinds.mjJNT_SLIDE:
            return "prismatic"
        if kind == kinds.mjJNT_HINGE:
            return "revolute" if self.model.jnt_limited[joint] else "continuous"
        return None

    def _add_joint(
        self, number: int, parent: str, child: str, T: Float[np.ndarray, "4 4"], link: str
    ) -> None:
        m, kind = self.model, self._kind(number)
        assert kind is not None
        word = "slide" if kind == "prismatic" else "hinge"
        wanted = self._bare(m.joint(number).name) or f"{link}_{word}"
        name = self._joint_names(wanted, word)
        lower, upper = -math.inf, math.inf
        if m.jnt_limited[number]:
            lower, upper = m.jnt_range[number].tolist()
        axis, start = np.array(m.jnt_axis[number]), float(m.qpos0[m.jnt_qposadr[number]])
        joint = Joint(name, kind, parent, child, T, axis, lower, upper, math.inf)
        back = joint_motion(joint, -start)  # the file defines the body at joint value `start`
        dof = int(m.jnt_dofadr[number])
        joint = replace(
            joint, T_parent_joint=T @ back,
            friction=float(m.dof_frictionloss[dof].item()),
            damping=float(m.dof_damping[dof].item()),
        )  # fmt: skip
        self._order.append(joint)
        self.joints[number] = joint
        value = min(max(start, joint.lower), joint.upper)
        if value != start:
            self.approximated["joint values outside their limits, clipped"] += 1
        if value != min(max(0.0, joint.lower), joint.upper):
            self.values[name] = value

    def _add_link(
        self, link: str, geoms: Sequence[int], T_link_body: Float[np.ndarray, "4 4"]
    ) -> None:
        solid: list[Geometry] = []
        drawn: list[Geometry] = []
        for geom in geoms:
            touched = self.shapes.solid(geom)
            if touched or self.model.geom_rgba[geom][3] > 0:
                name = self._shape_name(geom, link)
                shapes = self.shapes.shapes(geom, T_link_body, name, solid=touched)
                (solid if touched else drawn).extend(shapes)
                self.solid += [geom] if touched and shapes else []
        self.links[link] = Link(link, tuple(solid), tuple(drawn))

    def _shape_name(self, geom: int, link: str) -> str:
        name = self._bare(self.model.geom(geom).name).removeprefix(f"{link}/")
        return "".join(c if c.isprintable() else "_" for c in _NUMBER.sub("", name))[:200]
