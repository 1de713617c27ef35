"""A URDF with its kinematics and collision geometry, for scenes and robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from momapos.core import Cache, unknown_name

from .convex_pieces import pieces_of
from .hulls import Boxes, Hull, cover_shape, fit_box, hull_of
from .meshes import mesh_digest
from .model_cache import freeze, once
from .static_shapes import StaticElement, static_element
from .urdf_records import Geometry, Joint, Urdf, joint_motion

if TYPE_CHECKING:
    from jaxtyping import Float

T = TypeVar("T")
_GEOMETRY = ("hulls", "boxes", "static_elements", "_pieces")
"""Computed properties that do not depend on joint values."""
JointValues: TypeAlias = "Mapping[str, float | Float[np.ndarray, ' v']]"
"""Values of joints by name [rad] or [m], one or one per state."""


@dataclass(frozen=True, eq=False)
class Articulated:
    """A tree of links with named joints; geometry is computed on first use."""

    urdf: Urdf
    held: Mapping[str, float] = field(default_factory=dict)
    """Rest values of joints that do not rest at zero [rad] or [m]."""

    cache: Cache | None = field(default=None, repr=False)
    """Cache for its geometry, which is expensive to compute."""
    closed: Mapping[str, float] = field(default_factory=dict)
    """Values at which joints are closed, where a scene says so [rad] or [m]; see `opening_of`."""

    def changed(
        self, *, held: Mapping[str, float] | None = None, closed: Mapping[str, float] | None = None
    ) -> Articulated:
        """Return the model with other rest or closed values; it shares the computed geometry."""
        held, closed = self.held if held is None else held, closed or self.closed
        other = Articulated(self.urdf, held, self.cache, closed)
        other.__dict__.update({k: v for k, v in self.__dict__.items() if k in _GEOMETRY})
        return other

    def __repr__(self) -> str:
        counts = f"{len(self.urdf.links)} links, {len(self.joints)} movable joints"
        return f"<Articulated {self.urdf.name!r}: {counts}, {self.urdf.path}>"

    @cached_property
    def links(self) -> tuple[str, ...]:
        """Return the link names, parents before children."""
        return (self.urdf.root, *(joint.child for joint in self.urdf.joints))

    @cached_property
    def joints(self) -> dict[str, Joint]:
        """Return the movable joints by name, parents before children."""
        return {joint.name: joint for joint in self.urdf.joints if joint.movable}

    def joint(self, name: str, of: str | None = None) -> Joint:
        """Return a movable joint by name.

        Args:
            name: The joint.
            of: The model's name in messages; by default that of its file.

        Raises:
            UnknownNameError: There is no such joint.
        """
        if name not in self.joints:
            raise unknown_name("movable joint", name, self.joints, of or self.urdf.name)
        return self.joints[name]

    @cached_property
    def rest(self) -> dict[str, float]:
        """Return the rest value of each movable joint: as in `held` or zero, within its limits.

        Mimic joints follow their leaders.
        """
        rest = {
            name: float(np.clip(self.held.get(name, 0.0), joint.lower, joint.upper))
            for name, joint in self.joints.items()
        }
        return rest | {
            name: joint.mimic.at(rest[joint.mimic.joint])
            for name, joint in self.joints.items()
            if joint.mimic is not None
        }

    def followers(self, joint: str) -> tuple[Joint, ...]:
        """Return the mimic joints of a leader."""
        return tuple(j for j in self.joints.values() if j.mimic and j.mimic.joint == joint)

    def all_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values of all movable joints, given some; see `value_of`."""
        return {name: self.value_of(joint, values) for name, joint in self.joints.items()}

    def value_of(self, joint: Joint, values: JointValues) -> Any:
        """Return a joint's value or values: from its leader, as given, or at rest."""
        if joint.mimic is not None:
            leader = joint.mimic.joint
            return joint.mimic.at(values.get(leader, self.rest[leader]))
        return values.get(joint.name, self.rest[joint.name])

    def link_poses(self, values: Mapping[str, float]) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return poses of all links in the root's frame; other joints are at rest."""
        poses = {self.urdf.root: np.eye(4)}
        for joint in self.urdf.joints:
            poses[joint.child] = self._child_pose(joint, poses[joint.parent], values)
        return poses

    def _child_pose(
        self, joint: Joint, T_parent: Float[np.ndarray, "*parents 4 4"], values: JointValues
    ) -> Float[np.ndarray, "*batch 4 4"]:
        T = T_parent @ joint.T_parent_joint
        if not joint.movable:
            return T
        return np.asarray(T @ joint_motion(joint, self.value_of(joint, values)))

    def moving_poses(
        self,
        joint: str,
        values: Float[np.ndarray, " v"],
        others: JointValues,
        poses: Mapping[str, Float[np.ndarray, "4 4"]],
    ) -> dict[str, Float[np.ndarray, "v 4 4"]]:
        """Return the poses of the links that a joint and its mimic joints move.

        Args:
            joint: The joint, which is no mimic joint.
            values: Its values [rad] or [m].
            others: Values of the other joints, one or one per value of the joint; joints without a
                value are at rest.
            poses: Poses of all links, in any frame, at one value of the joint.

        Returns:
            The poses in that frame, by link, at each value.
        """
        given: JointValues = {**others, joint: values}
        moved, found = set(self.moved_by(joint)), dict[str, np.ndarray]()
        for one in self.urdf.joints:
            if one.child in moved:
                T = self._child_pose(one, found.get(one.parent, poses[one.parent]), given)
                found[one.child] = np.broadcast_to(T, (len(values), 4, 4))
        return found

    def rigid_groups(self, joint: str, *inner: str) -> dict[str, str]:
        """Return the links that a joint moves, each with the link that carries it.

        A carrier is the child of the joint or of one of its mimic joints. The links that it carries
        keep their pose in it, as long as no other joint moves.

        Args:
            joint: The joint.
            inner: Joints of the part that move, too; their children are carriers as well.
        """
        leaders = (joint, *inner)
        carriers = {
            one.child for name in leaders for one in (self.joint(name), *self.followers(name))
        }
        moved, groups = set(self.moved_by(joint)), dict[str, str]()
        for one in self.urdf.joints:
            if one.child in moved:
                groups[one.child] = one.child if one.child in carriers else groups[one.parent]
        return groups

    @cached_property
    def rest_poses(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return poses of all links in the root's frame, with all joints at rest."""
        return self.link_poses({})

    @cached_property
    def _children(self) -> dict[str, list[Joint]]:
        children: dict[str, list[Joint]] = {}
        for joint in self.urdf.joints:
            children.setdefault(joint.parent, []).append(joint)
        return children

    def links_below(self, link: str) -> tuple[str, ...]:
        """Return a link and all links below it."""
        below, queue = {link}, [link]
        while queue:
            children = [joint.child for joint in self._children.get(queue.pop(), [])]
            below.update(children)
            queue += children
        return tuple(name for name in self.links if name in below)

    def moved_by(self, joint: str) -> tuple[str, ...]:
        """Return the links that move with a joint and with its mimic joints."""
        if joint not in self._moved:
            moving = (self.joint(joint), *self.followers(joint))
            below = {link for one in moving for link in self.links_below(one.child)}
            self._moved[joint] = tuple(name for name in self.links if name in below)
        return self._moved[joint]

    @cached_property
    def _moved(self) -> dict[str, tuple[str, ...]]:
        """The results of `moved_by` so far."""
        return {}

    @cached_property
    def hulls(self) -> dict[str, tuple[Hull, ...]]:
        """Return convex hulls of the collision elements by link, in the link's frame."""

        def compute() -> dict[str, tuple[Hull, ...]]:
            return {
                name: tuple(hull_of(shape, name) for shape in link.collisions)
                for name, link in self.urdf.links.items()
            }

        return self.cached("hulls", compute)

    @cached_property
    def boxes(self) -> dict[str, tuple[Boxes, ...]]:
        """Return boxes that cover each hull, by link, in the link's frame."""

        def compute() -> dict[str, tuple[Boxes, ...]]:
            return {
                name: tuple(
                    cover_shape(shape, hull)
                    for shape, hull in zip(link.collisions, self.hulls[name], strict=True)
                )
                for name, link in self.urdf.links.items()
            }

        return self.cached("boxes", compute)

    @cached_property
    def static_elements(self) -> dict[str, tuple[StaticElement, ...]]:
        """Return the collision elements by link as they are checked where they stand still."""

        def compute() -> dict[str, tuple[StaticElement, ...]]:
            return {
                name: tuple(map(static_element, link.collisions, self.hulls[name]))
                for name, link in self.urdf.links.items()
            }

        return self.cached("static", compute, records=(StaticElement,))

    def pieces(self, link: str, element: int) -> tuple[Hull, ...]:
        """Return the convex pieces of a collision element, cached; see `convex_pieces`.

        Raises:
            UrdfError: The faces of its mesh are unreadable.
        """
        key = link, element
        if key not in self._pieces:
            shape, hull = self.urdf.links[link].collisions[element], self.hulls[link][element]
            self._pieces[key] = self.cached("pieces", lambda: pieces_of(shape, hull), link, element)
        return self._pieces[key]

    @cached_property
    def _pieces(self) -> dict[tuple[str, int], tuple[Hull, ...]]:
        return {}

    def hull(self, link: str, shape: Geometry) -> Hull:
        """Return the hull of a link's shape, visual or collision."""
        hulls = zip(self.urdf.links[link].collisions, self.hulls[link], strict=True)
        return next((hull for known, hull in hulls if known is shape), None) or hull_of(shape, link)

    def box_around(
        self, points: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
        """Fit a box around points of the model, see `fit_box`."""
        return once(self.cache, "fit", (points,), lambda: fit_box(points))

    def cached(
        self, what: str, compute: Callable[[], T], *parts: object, records: tuple[type, ...] = ()
    ) -> T:
        """Compute a value from joints and shapes, or return the cached one.

        Args:
            what: Prefix of the key.
            compute: Returns the value; see `once`.
            parts: What the value depends on besides joints and shapes.
            records: Record types in the value besides hulls and boxes.
        """
        if self.cache is None:
            return compute()
        return once(self.cache, what, (self._content, *parts), compute, (Hull, Boxes, *records))

    @cached_property
    def _content(self) -> bytes:
        """Serialize all inputs of the geometry; meshes by their content."""
        shapes = {name: link.collisions for name, link in self.urdf.links.items()}
        meshes = [shape.mesh for group in shapes.values() for shape in group if shape.mesh]
        digests = {mesh: mesh_digest(mesh) for mesh in dict.fromkeys(meshes)}
        bare = {name: [replace(s, mesh=None) for s in group] for name, group in shapes.items()}
        held = sorted(self.held.items())
        return freeze((self.urdf.root, self.urdf.joints, held, bare, [digests[m] for m in meshes]))

    def shapes_named(self, word: str, links: tuple[str, ...]) -> list[tuple[str, Geometry]]:
        """Return shapes with a word in the name of their link or element, ignoring case."""
        found = []
        for name in links:
            link = self.urdf.links[name]
            named = word in name.lower()
            exact = [s for s in (*link.collisions, *link.visuals) if word in s.name.lower()]
            shapes = list(link.collisions or link.visuals) if named else exact
            found += [(name, shape) for shape in shapes]
        return found
