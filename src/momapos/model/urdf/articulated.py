"""A URDF with its kinematics and collision geometry, for scenes and robots.

A mesh whose hull is mostly free space, such as a carcass, a table with legs or a tray, is cut into
convex pieces. Hulls that a box covers loosely, such as those of round tables, get strips.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from momapos.core import Cache, UrdfError, owner_cache, unknown_name
from momapos.core.geometry import apply, invert

from .convex_pieces import (
    MAX_TRIANGLES,
    CutConfig,
    containing,
    convex_pieces,
    decimated,
    free_share,
    free_volume,
    pieces_of,
    triangles_of,
)
from .hulls import STRIPS, Boxes, Hull, cover_shape, fit_box, hull_around, hull_of, slab
from .meshes import mesh_digest, mesh_triangles
from .model_cache import freeze, once
from .urdf_records import Geometry, Joint, Mesh, Urdf, joint_motion

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_MEASURED = 60_000
"""Number of triangles up to which the free space of a mesh is measured [-]: 40,000 take 3 to 9 s to
measure and cut, 400,000 two minutes and 5 GB."""
CUT = CutConfig(
    max_void=2e-3, max_pieces=16, max_slabs=4, min_slab=0.003, min_even_slab=0.05,
    min_free_share=1 / 3, min_free_volume=5e-3, max_remaining=1 / 1.5,
)  # fmt: skip
"""How furniture that stands still is cut, coarser than for handles. 172 of 912 meshes of real
furniture have a hull with 1.5 times the volume of the rest, and 60 of these have free space for a
hand with a wrist in it. These 60 take 17 s instead of 276 s to cut, once; the pieces have 59 % of
the hull's volume instead of 42 % (medians)."""
LINK_CUT = CutConfig(
    max_void=3e-5, max_pieces=16, max_slabs=6, min_slab=0.003, min_even_slab=0.02,
    max_triangles=MAX_MEASURED, min_free_share=0.05, min_free_volume=2e-5, max_remaining=0.95,
    max_added=0.01, max_detail=8_000,
)  # fmt: skip
"""How links of robots are cut: finer, since forearms and hands pass obstacles and each other within
centimeters. Fingers, whose hulls have less free space, stay whole. Merging takes a UR5's upper arm
from 7 pieces to 3 and a Fetch's torso from 8 to 3, which adds 1 to 2 % of their hulls' volume.
As 8,000 triangles, four sensors and fingers of 19,000 to 26,000 take 16 s instead of 37 s to cut,
and their pieces have up to 2 % more of the hulls' volume."""
MAX_LOOSENESS = 0.05
"""Boxes whose corners are farther outside of their hull are replaced by strips; the base keeps a
similar distance [m]."""
MIN_STRIP_SAVING = 0.1
"""Smallest share of the boxes' volume that strips must save [-]."""


@dataclass(frozen=True, eq=False)
class StaticElement:
    """A collision element where it stands still."""

    hulls: tuple[Hull, ...]
    """Its convex hull, or its convex pieces."""
    boxes: Boxes
    """Boxes that cover the hulls."""
    hollow_mesh: str
    """Name of its mesh file if much of the mesh's hull is free space; else ""."""

    def label(self, link: str, *, static: bool) -> str:
        """Return a link's name, with what stands for its mesh if that is not the mesh.

        Args:
            link: The link.
            static: Whether the element stands still; moving elements are hulls.
        """
        if not self.hollow_mesh:
            return link
        part = "piece" if static and len(self.hulls) > 1 else "hull"
        return f"{link} ({part} of {self.hollow_mesh})"


def static_element(geometry: Geometry, hull: Hull) -> StaticElement:
    """Return a collision element as it is checked where it stands still."""
    found = _hollow_pieces(geometry, hull, CUT)
    pieces, hollow_mesh = found or (hull,), _mesh_name(geometry) if found else ""
    if len(pieces) == 1:
        return StaticElement(pieces, _cover(geometry, hull), hollow_mesh)
    boxes = Boxes.join(_cover(geometry, piece) for piece in pieces)
    return StaticElement(pieces, boxes, hollow_mesh)


def in_convex_pieces(urdf: Urdf, cache: Cache | None = None) -> Urdf:
    """Return a robot whose hollow meshes are convex pieces, each a collision element.

    Masts, columns, forearms and cages so leave the space around them free. Meshes with very many
    faces are cut as coarser ones; those with unreadable faces stay whole.

    Args:
        urdf: The robot.
        cache: Stores the pieces.
    """

    def pieces(shape: Geometry) -> tuple[Geometry, ...]:
        if shape.mesh is None:
            return (shape,)
        key = mesh_digest(shape.mesh), shape.size, shape.T_link_geometry
        cut = lambda: _hollow_pieces(shape, hull_of(shape), LINK_CUT)  # noqa: E731
        found = once(cache, "link-pieces", key, cut, (Hull,))
        if len(found) < 2:
            return (shape,)
        return tuple(
            Geometry(
                "mesh", (1.0, 1.0, 1.0), np.eye(4), shape.name, Mesh(piece.vertices, piece.faces),
                f"piece {k} of {_mesh_name(shape)}", shape,
            )
            for k, piece in enumerate(found, 1)
        )  # fmt: skip

    links = {
        name: replace(link, collisions=tuple(p for s in link.collisions for p in pieces(s)))
        for name, link in urdf.links.items()
    }
    return replace(urdf, links=links)


def _mesh_name(geometry: Geometry) -> str:
    return geometry.mesh.name if isinstance(geometry.mesh, Path) else "its mesh"


def _hollow_pieces(geometry: Geometry, hull: Hull, config: CutConfig) -> tuple[Hull, ...]:
    """Return the convex pieces of a hollow mesh, its hull if they are hardly smaller.

    Empty for other shapes, for very large meshes, and for meshes with damaged faces, which a hull
    does not need.
    """
    volume = volume_of(hull)
    if geometry.mesh is None or volume < config.min_free_volume:
        return ()
    try:
        triangles = triangles_of(geometry)
    except UrdfError:
        return ()
    least = max(config.min_free_volume, config.min_free_share * volume)
    coarse = triangles
    if 0 < config.max_detail < len(triangles):
        coarse = decimated(triangles, config.max_detail)
    if len(coarse) > MAX_MEASURED or free_volume(coarse) <= least:
        return ()
    parts = convex_pieces(coarse, config)
    if len(parts) == 1:
        return (hull,)
    pieces = tuple(hull_around(points, hull.name) for points in parts)
    if coarse is not triangles:
        pieces = containing(pieces, triangles)
    pieces = _merged(pieces, config.max_added * volume)
    return pieces if sum(map(volume_of, pieces)) <= config.max_remaining * volume else (hull,)


def _merged(pieces: tuple[Hull, ...], limit: float) -> tuple[Hull, ...]:
    """Merge the pairs of pieces whose common hull adds little volume, the least first [m^3]."""
    while limit > 0.0 and len(pieces) > 1:
        pairs = [
            (hull_around(np.concatenate([a.vertices, b.vertices]), a.name), a, b)
            for a, b in combinations(pieces, 2)
        ]
        added = [volume_of(both) - volume_of(a) - volume_of(b) for both, a, b in pairs]
        least = int(np.argmin(added))
        if added[least] > limit:
            break
        both, *old = pairs[least]
        pieces = (*(piece for piece in pieces if piece not in old), both)
    return pieces


def surface_of(geometry: Geometry) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles of a shape in the link frame; those of the hull if they are damaged."""
    if geometry.kind == "mesh":
        with contextlib.suppress(UrdfError):
            return triangles_of(geometry)
    hull = hull_of(geometry)
    return hull.vertices[hull.faces]


def volume_of(hull: Hull) -> float:
    """Return the volume of a convex body [m^3]."""
    a, b, c = (hull.vertices - hull.vertices.mean(0))[hull.faces].transpose(1, 0, 2)
    return float(np.abs(np.einsum("ij,ij->i", a, np.cross(b, c))).sum()) / 6


def _cover(geometry: Geometry, hull: Hull) -> Boxes:
    """Cover a hull by boxes, or by strips if these are tighter."""
    boxes = cover_shape(geometry, hull)
    if geometry.kind == "box" or _looseness(boxes, hull) <= MAX_LOOSENESS:
        return boxes
    strips = min((_strips(hull, axis) for axis in range(3)), key=_volume)
    return strips if _volume(strips) < (1 - MIN_STRIP_SAVING) * _volume(boxes) else boxes


def _looseness(boxes: Boxes, hull: Hull) -> float:
    """Return how far corners of boxes are outside of the planes of a hull's faces [m]."""
    a, b, c = hull.vertices[hull.faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    kept = length > 1e-12
    normals = normals[kept] / length[kept, None]
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    local = signs[None] * boxes.half[:, None]
    corners = (boxes.center[:, None] + np.einsum("bij,bkj->bki", boxes.rotation, local)).reshape(
        -1, 3
    )
    return float((corners @ normals.T - (a[kept] * normals).sum(1)).max())


def _strips(hull: Hull, axis: int) -> Boxes:
    """Cover a hull by strips across an axis of the box around it, narrow at its ends."""
    center, R, half = fit_box(hull.vertices)
    edges = half[axis] * np.cos(np.linspace(np.pi, 0, STRIPS + 1))
    at = float(center @ R[:, axis])
    bounds = []
    for low, high in zip(edges[:-1] + at, edges[1:] + at, strict=True):
        points = slab(hull.vertices, hull.faces, R[:, axis], low - 1e-9, high + 1e-9) @ R
        bounds.append((points.min(0), points.max(0)))
    low, high = np.array(bounds).transpose(1, 0, 2)
    return Boxes((low + high) / 2 @ R.T, np.repeat(R[None], STRIPS, axis=0), (high - low) / 2)


def _volume(boxes: Boxes) -> float:
    return float(np.prod(2 * boxes.half, axis=1).sum())


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
    contents: frozenset[str] = frozenset()
    """Links that stand for objects that rest on it, by which nobody holds it."""

    def changed(
        self, *, held: Mapping[str, float] | None = None, closed: Mapping[str, float] | None = None
    ) -> Articulated:
        """Return the model with other rest or closed values; it shares the computed geometry."""
        held, closed = self.held if held is None else held, closed or self.closed
        other = Articulated(self.urdf, held, self.cache, closed, self.contents)
        other.__dict__.update({k: v for k, v in self.__dict__.items() if k in _GEOMETRY})
        return other

    def with_geometry_of(
        self, base: Articulated, parts: Sequence[tuple[Articulated, Mapping[str, str]]]
    ) -> Articulated:
        """Take the geometry from the models that this one is made of, and return it.

        Args:
            base: The model whose links keep their names.
            parts: The others, each with the names of its links in this model.
        """
        for name in ("hulls", "boxes", "static_elements"):
            found = dict(getattr(base, name))
            for model, renamed in parts:
                found |= {renamed[link]: one for link, one in getattr(model, name).items()}
            self.__dict__[name] = found
        return self

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
        if (joint.name if joint.mimic is None else joint.mimic.joint) not in values:
            return np.asarray(T @ self._rest_motions[joint.name])
        return np.asarray(T @ joint_motion(joint, self.value_of(joint, values)))

    @cached_property
    def _rest_motions(self) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return the motion of each movable joint at rest: most joints are, in most questions."""
        joints = self.joints.items()
        return {name: joint_motion(joint, self.value_of(joint, {})) for name, joint in joints}

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

    def surface(self, link: str) -> Float[np.ndarray, "t 3 3"]:
        """Return the triangles of a link's collision elements before cutting, in its frame.

        Meshes with unreadable faces have the triangles of their hulls.
        """
        shapes = [shape.whole or shape for shape in self.urdf.links[link].collisions]
        found = [surface_of(shape) for shape in {id(shape): shape for shape in shapes}.values()]
        return np.concatenate([np.empty((0, 3, 3)), *found])

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
        bare = {
            name: [replace(s, mesh=None, whole=None) for s in group]
            for name, group in shapes.items()
        }
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


MIN_SIDE_SHARE = 0.05
"""Zero is well within a joint's range if each side has at least this share of the range [-]."""
MIN_PROTRUSION_DROP = 0.1
"""A part is closed at a limit, not at zero, if it protrudes less there by more than this [m]."""
MIN_BREADTH = 0.1
"""A part whose second extent is smaller is a lever or a tap, which nothing closes [m]."""
MIN_FREE_SIDE = 0.05
"""A part without limits opens to the side on which it protrudes more by at least this [m]."""
TRIAL_ANGLE, TRIAL_TRAVEL = np.pi / 4, 0.2
"""Motion to either side for that comparison: a door is in front or inside [rad], [m]."""


@dataclass(frozen=True)
class JointOpening:
    """Joint values of the closed and the wide-open part [rad] or [m]."""

    closed: float
    wide: float
    """The limit toward which the joint opens; infinite for a continuous joint."""

    @property
    def sign(self) -> float:
        """Return the direction in which the joint opens, 1 or -1."""
        return 1.0 if self.wide >= self.closed else -1.0


@owner_cache()
def opening_of(model: Articulated, joint: str) -> JointOpening:
    """Return at which value a part is closed, and toward which limit it opens.

    A part is closed where its model's `closed` says so. Otherwise it is closed at zero or at the
    limit nearest to zero, unless it protrudes from the rest of its object there and protrudes much
    less at a limit: then it is closed at that limit. It opens toward the farther limit. Without
    limits it opens to the side on which it comes out of its object.
    """
    record = model.joint(joint)
    lower, upper = record.lower, record.upper
    if joint in model.closed:
        closed = model.closed[joint]
    else:
        closed = min(max(0.0, lower), upper)
        if np.isfinite([lower, upper]).all():
            closed = _flush(model, record, (closed, lower, upper))
    if not np.isfinite([lower, upper]).any():
        return JointOpening(closed, np.inf if _comes_out(model, record, closed) else -np.inf)
    return JointOpening(closed, upper if upper - closed >= closed - lower else lower)


def opens_both_ways(model: Articulated, joint: str) -> bool:
    """Check whether a part is closed well within its range, as a swing door is."""
    record, closed = model.joint(joint), opening_of(model, joint).closed
    least = MIN_SIDE_SHARE * (record.upper - record.lower)
    return bool(
        np.isfinite(least) and record.lower < closed - least < closed + least < record.upper
    )


def _flush(model: Articulated, joint: Joint, values: tuple[float, ...]) -> float:
    """Return the first value, or the one at which the part protrudes much less."""
    if _breadth(model, joint) < MIN_BREADTH:
        return values[0]
    out = [_protrusion(model, joint.name, value) for value in values]
    best = int(np.argmin(out))
    return values[best] if out[0] - out[best] > MIN_PROTRUSION_DROP else values[0]


def _comes_out(model: Articulated, joint: Joint, closed: float) -> bool:
    """Return whether a part comes out toward larger values rather than toward smaller ones."""
    trial = TRIAL_TRAVEL if joint.kind == "prismatic" else TRIAL_ANGLE
    up, down = (_protrusion(model, joint.name, closed + s * trial) for s in (1.0, -1.0))
    return down - up < MIN_FREE_SIDE


def _breadth(model: Articulated, joint: Joint) -> float:
    """Return the second extent of what a joint moves, in its child's frame [m]."""
    T_child_root = invert(model.rest_poses[joint.child])
    points = [
        apply(T_child_root @ model.rest_poses[link], hull.vertices)
        for link in model.moved_by(joint.name)
        for hull in model.hulls[link]
    ]
    return float(np.sort(np.ptp(np.concatenate(points), axis=0))[1]) if points else 0.0


def _protrusion(model: Articulated, joint: str, value: float) -> float:
    """Return how far a part protrudes from the bounding box of the rest of its object [m]."""
    poses = model.link_poses({joint: value})
    moved = set(model.moved_by(joint))

    def corners(names: list[str]) -> np.ndarray:
        points = [apply(poses[n], hull.vertices) for n in names for hull in model.hulls[n]]
        return np.concatenate(points) if points else np.zeros((0, 3))

    part = corners([name for name in model.links if name in moved])
    rest = corners([name for name in model.links if name not in moved])
    if not len(part) or not len(rest):
        return 0.0
    outside = np.maximum(rest.min(0) - part, part - rest.max(0)).max(0)
    return float(np.maximum(outside, 0.0).sum())


def hull_space(model: Articulated, link: str, element: int) -> tuple[float, float]:
    """Return the volume of a collision element's hull, and of the free space in it [m^3].

    Primitives have no free space. That of meshes with more than `MAX_TRIANGLES` is not measured and
    counts as zero.

    Raises:
        UrdfError: The faces of its mesh are unreadable.
    """
    shape = model.urdf.links[link].collisions[element]

    def measure() -> tuple[float, float]:
        assert shape.mesh is not None
        triangles = mesh_triangles(shape.mesh) * shape.size
        return free_share(triangles) if 0 < len(triangles) <= MAX_TRIANGLES else (0.0, 0.0)

    if shape.kind != "mesh":
        return 0.0, 0.0
    return model.cached("hull-space", measure, link, element)
