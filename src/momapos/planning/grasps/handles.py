"""Find the handles of a moving part, or its free edges if it has none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import apply
from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated, joint_motion, opening_of

from .front_strips import Strip, strips_of
from .handle_core import MAX_HELD_DEPTH, HandleKind, core_of
from .handle_shapes import (
    Element,
    clusters,
    corners,
    named_elements,
    named_shapes,
    part_elements,
    part_pieces,
    poses_in_part,
    protrusions,
    rigid_links,
    visual_elements,
    widest,
)

if TYPE_CHECKING:
    from jaxtyping import Float

_POINTS = 9
"""Points on the path of a handle [-]."""
_MODELS = 1024
"""Number of parts whose handles are cached [-]."""
KNOB_ELONGATION = 1.5
"""A handle less elongated than this is a knob, which can be approached at any roll [-]."""
PUSH_INSET = 0.05
"""Distance from the free edge at which a door is pushed [m]."""
MAX_STRIPS = 4
"""Maximum number of strips of a part, the longest ones [-]."""
MIN_LEVER_SHARE = 0.5
"""Minimum lever arm of a strip, as a share of the part's largest one: close to the hinge, an error
of the hand moves the free edge by much more [-]."""
EDGE_WIDTH = 0.02
"""Elements of a panel that end this close to its edge form the edge [m]."""


class HandleSource(StrEnum):
    """How a handle was found; plans contain the words."""

    NAME = "name"
    SHAPE = "shape"
    EDGE = "edge"


@dataclass(frozen=True, eq=False)
class Handle:
    """A handle, edge or face to grasp or push, in the frame of the moving link."""

    center: Float[np.ndarray, "3"]
    """Middle of the whole handle [m]."""
    grip: Float[np.ndarray, "3"]
    """Middle of the part that a hand closes on, without fixings [m]."""
    long: Float[np.ndarray, "3"]
    """Unit vector along the handle."""
    out: Float[np.ndarray, "3"]
    """Unit vector from the part toward the hand, perpendicular to `long`."""
    half_length: float
    """Half the length along `long` [m]."""
    thickness: float
    """Size across, which the fingers must span [m]."""
    depth: float
    """Size along `out` of the part that a hand closes on [m]."""
    found: HandleSource
    kind: HandleKind
    name: str
    """Name of its link or shape, or of the panel without a handle."""
    elements: tuple[Element, ...]
    """Elements that the pads may touch."""
    in_pieces: bool = False
    """Whether collision checks use convex pieces of the part's meshes instead of their hulls."""

    @property
    def knob(self) -> bool:
        """Whether this is a knob."""
        return self.kind is HandleKind.KNOB

    @property
    def edge(self) -> bool:
        """Whether this is a free edge."""
        return self.kind is HandleKind.EDGE

    def __str__(self) -> str:
        how = {
            HandleSource.NAME: f"{self.kind} {self.name!r}, by its name",
            HandleSource.SHAPE: f"{self.kind} {self.name!r}, by its shape",
            HandleSource.EDGE: f"the {self.kind} of {self.name!r}, which has no handle",
        }
        return how[self.found]


def has_handle(model: Articulated, joint: str) -> bool:
    """Check whether the part that a joint moves has geometry named "handle"."""
    return bool(named_shapes(model, joint))


def opening_direction(
    item: SceneObject, joint: str
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the middle of a part and the direction in which it opens, in the world."""
    middle, direction = _opening(item.model, joint)
    T_world_part = item.link_poses()[item.joint(joint).child]
    return apply(T_world_part, middle[None])[0], T_world_part[:3, :3] @ direction


@lru_cache(maxsize=_MODELS)
def _opening(
    model: Articulated, joint: str
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the same in the part's frame."""
    links = rigid_links(model, joint)
    T_link = poses_in_part(model, joint, links)
    centers = [apply(T_link[n], h.vertices).mean(0) for n in links for h in model.hulls[n]]
    middle = np.mean(centers, axis=0) if centers else np.zeros(3)
    return middle, motion_direction(model, joint, opening_of(model, joint).sign, middle)


def find_handle(model: Articulated, joint: str, sign: float) -> Handle:
    """Return the first handle of `find_handles`."""
    return find_handles(model, joint, sign)[0]


@lru_cache(maxsize=_MODELS)
def find_handles(model: Articulated, joint: str, sign: float) -> tuple[Handle, ...]:
    """Find the handles of the part that a joint moves, the most probable first.

    The order: the largest group named "handle"; protrusions of the panel, in the collision elements
    or else in the visuals; without these, handles in the convex pieces of the meshes; then the free
    edges of the panel.

    Args:
        model: The object.
        joint: The joint.
        sign: Opening direction of the joint (+1 or -1), which the handle faces.

    Raises:
        TaskError: The part has no geometry.
    """
    own = _own(part_elements(model, joint), model, joint)
    known = handles_by_hulls(model, joint, sign)
    if not own and not known:
        raise TaskError(f"joint {joint!r} moves no geometry; it must move a link with a shape")
    if not own:
        return known
    taken = {id(e) for handle in known for e in handle.elements}
    bare = tuple(e for e in own if id(e) not in taken)
    edges = _free_edges(bare or own, model, joint, sign)
    return (*(known or handles_by_pieces(model, joint, sign)), *edges)


def handles_in_turn(model: Articulated, joint: str, sign: float) -> Iterator[Handle]:
    """Yield the handles, the most probable first; split meshes only when needed."""
    found = find_handles(model, joint, sign)
    yield from (h for h in found if not h.edge)
    yield from (h for h in handles_by_pieces(model, joint, sign) if h not in found)
    yield from (h for h in found if h.edge)


@lru_cache(maxsize=_MODELS)
def handles_by_hulls(model: Articulated, joint: str, sign: float) -> tuple[Handle, ...]:
    """Find the geometry named "handle" and the elements that protrude from the panel."""
    own = _own(part_elements(model, joint), model, joint)
    named = clusters(named_elements(model, joint))[:1]
    handles = [_of(HandleSource.NAME, group, model, joint, sign, own) for group in named]
    if own:
        known = {id(e) for group in named for e in group}
        out = _panel_normal(own, model, joint, sign)
        shaped = protrusions(own, out) or protrusions((*own, *visual_elements(model, joint)), out)
        groups = [group for group in shaped if not known & {id(e) for e in group}]
        handles += _by_shape(groups, model, joint, sign, own)
    return tuple(handles)


@lru_cache(maxsize=_MODELS)
def handles_by_pieces(model: Articulated, joint: str, sign: float) -> tuple[Handle, ...]:
    """Find protrusions and strips among the convex pieces of the meshes."""
    whole = part_elements(model, joint)
    own = _own(part_pieces(model, joint), model, joint)
    cut = [e for e in own if not any(e is other for other in whole)]
    if not cut:
        return ()
    out = _panel_normal(own, model, joint, sign)
    of_cut = {id(e) for e in cut}
    groups = [g for g in protrusions(own, out) if of_cut & {id(e) for e in g}]
    handles = _by_shape(groups, model, joint, sign, own)
    used = {id(e) for h in handles if h.kind is not HandleKind.LIP for e in h.elements}
    protruding = {id(e) for group in groups for e in group}
    least = MIN_LEVER_SHARE * lever_arms(model, joint, corners(own)).max()
    found = strips_of(own, tuple(e for e in cut if id(e) not in used), out)
    strips = [s for s in found if _lever(model, joint, s.end) >= least]
    for strip in sorted(strips, key=lambda s: -s.half_length)[:MAX_STRIPS]:
        lip = id(strip.element) in protruding
        handles.append(_of_strip(strip, HandleKind.LIP if lip else HandleKind.RECESS))
    return tuple(replace(handle, in_pieces=True) for handle in handles)


def _own(elements: tuple[Element, ...], model: Articulated, joint: str) -> tuple[Element, ...]:
    links = rigid_links(model, joint)
    return tuple(e for e in elements if e.link in links)


def _by_shape(
    groups: list[list[Element]],
    model: Articulated,
    joint: str,
    sign: float,
    own: tuple[Element, ...],
) -> list[Handle]:
    """Return the handles of protrusions, long ones far from the hinge first."""
    handles = [_of(HandleSource.SHAPE, group, model, joint, sign, own) for group in groups]
    return sorted(handles, key=lambda h: -h.half_length * _lever(model, joint, h.center))


def _of_strip(strip: Strip, kind: HandleKind) -> Handle:
    depth = min(strip.depth, MAX_HELD_DEPTH)
    center = strip.end - strip.depth / 2 * strip.out
    return Handle(
        center, strip.end - depth / 2 * strip.out, strip.long, strip.out, strip.half_length,
        strip.thickness, depth, HandleSource.SHAPE, kind, strip.element.name,
        (strip.element,),
    )  # fmt: skip


def handle_path(item: SceneObject, joint: str, to: float) -> Float[np.ndarray, "k 3"]:
    """Return the handle's path in the world [m] from the joint's current value to another."""
    record = item.joint(joint)
    handle = find_handle(item.model, joint, opening_of(item.model, joint).sign)
    values = np.linspace(item.values()[joint], to, _POINTS)
    T_world_joint = item.link_poses()[record.parent] @ record.T_parent_joint
    return apply(T_world_joint @ joint_motion(record, values), handle.center[None])[:, 0]


def _lever(model: Articulated, joint: str, point: Float[np.ndarray, "3"]) -> float:
    return float(lever_arms(model, joint, point[None])[0])


def lever_arms(
    model: Articulated, joint: str, points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return the distances of a part's points from its hinge axis [m]; 1 for a slide."""
    record = model.joint(joint)
    if record.kind == "prismatic":
        return np.ones(len(points))
    return np.linalg.norm(np.cross(record.axis, points), axis=1)


def motion_direction(
    model: Articulated, joint: str, sign: float, point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction in which a point moves when the joint opens, in the part's frame."""
    record = model.joint(joint)
    if record.kind == "prismatic":
        return sign * record.axis
    velocity = sign * np.cross(record.axis, point)
    length = float(np.linalg.norm(velocity))
    return velocity / length if length > 1e-6 else sign * record.axis


def _of(
    found: HandleSource,
    group: list[Element],
    model: Articulated,
    joint: str,
    sign: float,
    part: tuple[Element, ...],
) -> Handle:
    """Build a handle from its elements."""
    center, rotation, half = model.box_around(corners(group))
    order = np.argsort(half)
    motion = motion_direction(model, joint, sign, center)
    # Of the two short axes, the outward one is that along which the part moves.
    long = rotation[:, order[2]]
    across = [order[0], order[1]]
    if abs(motion @ long) > 0.9:
        # A peg along the motion: `long` is the longer one of the other axes.
        across, long = [order[2], order[0]], rotation[:, order[1]]
    out_axis = max(across, key=lambda k: abs(float(motion @ rotation[:, k])))
    side = next(k for k in range(3) if k != out_axis and abs(rotation[:, k] @ long) < 0.5)
    out = rotation[:, out_axis] * np.sign(motion @ rotation[:, out_axis])
    along = int(np.argmax(np.abs(rotation.T @ long)))
    length = float(half[along])
    others = [e for e in part if not any(e is mine for mine in group)]
    core = core_of(center, long * length, out, float(half[out_axis]), group, others)
    kind = core.kind if length >= KNOB_ELONGATION * half[side] else HandleKind.KNOB
    thickness = 2 * float(min(half[side], half[along]))
    return Handle(
        center, center + core.shift * out, long, out, length, thickness, core.depth,
        found, kind, _name_of(group), tuple(group),
    )  # fmt: skip


def _panel_normal(
    part: tuple[Element, ...], model: Articulated, joint: str, sign: float
) -> Float[np.ndarray, "3"]:
    """Return the unit normal of a part's front, on the side to which it opens."""
    opens = motion_direction(model, joint, sign, corners(part).mean(0))
    center, rotation, _ = model.box_around(widest(part, opens).convex.vertices)
    opens = motion_direction(model, joint, sign, center)
    normal = rotation[:, int(np.argmax(np.abs(rotation.T @ opens)))]
    return normal * np.sign(normal @ opens)


def _name_of(group: list[Element]) -> str:
    return max(group, key=lambda e: float(np.ptp(e.convex.vertices, axis=0).max())).name


def _free_edges(
    part: tuple[Element, ...], model: Articulated, joint: str, sign: float
) -> list[Handle]:
    """Return the edge of a panel farthest from the hinge, or both edges of a drawer's front."""
    record = model.joint(joint)
    opens = motion_direction(model, joint, sign, corners(part).mean(0))
    # A drawer has a front and a box behind it; a door may be a frame around a pane.
    panel = [widest(part, opens)] if record.kind == "prismatic" else list(part)
    center, rotation, half = model.box_around(corners(panel))
    motion = motion_direction(model, joint, sign, center)
    normal = int(np.argmax(np.abs(rotation.T @ motion)))
    plane = [k for k in range(3) if k != normal]
    if record.kind == "prismatic":
        along = max(plane, key=lambda k: half[k])
    else:
        along = max(plane, key=lambda k: abs(float(record.axis @ rotation[:, k])))
    across = next(k for k in plane if k != along)
    far = rotation[:, across]
    signs = [1.0, -1.0]
    if record.kind != "prismatic":
        radial = center - record.axis * float(center @ record.axis)
        signs = [1.0 if far @ radial >= 0 else -1.0]
    return [_edge(rotation[:, normal], rotation[:, along], s * far, panel) for s in signs]


def _edge(
    normal: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    far: Float[np.ndarray, "3"],
    panel: list[Element],
) -> Handle:
    """Return the edge of a panel that lies farthest in a direction."""
    ends = np.array([(e.convex.vertices @ far).max() for e in panel])
    rim = [e for e, end in zip(panel, ends, strict=True) if end > ends.max() - EDGE_WIDTH]
    points = corners(rim)
    across, length, out = points @ normal, points @ along, points @ far
    middle = [(x.min() + x.max()) / 2 for x in (across, length)]
    where = middle[0] * normal + middle[1] * along + ends.max() * far
    return Handle(
        where, where, along, far,
        float(np.ptp(length)) / 2, float(np.ptp(across)), float(np.ptp(out)),
        HandleSource.EDGE, HandleKind.EDGE, _name_of(panel), tuple(rim),
    )  # fmt: skip


def front_face(model: Articulated, joint: str, sign: float) -> Handle | None:
    """Return the front of a part near its free edge; None if it has no collision geometry."""
    links = rigid_links(model, joint)
    part = tuple(e for e in part_elements(model, joint) if e.link in links)
    if not part:
        return None
    edge = _free_edges(part, model, joint, sign)[0]
    slides = model.joint(joint).kind == "prismatic"
    middle = edge.center - edge.out * (edge.depth / 2 if slides else PUSH_INSET)
    out = _panel_normal(part, model, joint, sign)
    tops = [float((e.convex.vertices @ out).max()) for e in edge.elements]
    front = middle + out * (max(tops) - float(middle @ out))
    return Handle(
        front, front, edge.long, out, edge.half_length, 0.0, edge.thickness, HandleSource.EDGE,
        HandleKind.FACE, edge.name, edge.elements,
    )  # fmt: skip
