"""Find the handles of a moving part, or its free edges if it has none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError, owner_cache
from momapos.core.geometry import apply
from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated, fit_box, opening_of, opens_both_ways

from .front_strips import Strip, strips_of
from .fronts import free_edges, front_part, panel_normal
from .handle_core import MAX_HELD_DEPTH, HandleKind, core_of
from .handle_records import Handle, HandleSource
from .handle_shapes import (
    MIN_PROTRUSION,
    PANEL_SHARE,
    CarriedPart,
    Element,
    clusters,
    corners,
    front_along,
    in_pieces,
    longest_name,
    model_of,
    named_elements,
    named_shapes,
    own_elements,
    part_elements,
    part_pieces,
    parts_moved_by,
    protrusions,
    rigid_links,
    visual_elements,
)
from .part_motion import lever_arms, motion_direction, part_path

if TYPE_CHECKING:
    from jaxtyping import Float

KNOB_ELONGATION = 1.5
"""A handle less elongated than this is a knob, which can be approached at any roll [-]."""
MAX_STRIPS = 4
"""Maximum number of strips of a part, the longest ones [-]."""
MIN_LEVER_SHARE = 0.5
"""Minimum lever arm of a strip, as a share of the part's largest one: close to the hinge, an error
of the hand moves the free edge by much more [-]."""
MAX_LEVER_LENGTH, MAX_LEVER_BREADTH = 0.3, 0.08
"""A part smaller than this is its own handle: hands open by 8 to 14 cm, and levers of taps and
windows are 5 to 25 cm long [m]."""
MAX_SIDE_SLANT = 0.7
"""Cosine with the opening direction below which a face counts as a side of the part [-]."""


def has_handle(model: Articulated, joint: str) -> bool:
    """Check whether the part that a joint moves has geometry named "handle"."""
    return any(named_shapes(part) for part in parts_moved_by(model, joint))


def opening_direction(
    item: SceneObject, joint: str
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the middle of a part and the direction in which it opens, in the world."""
    part, middle, direction = _opening(item.model, joint)
    T_world_part = item.link_poses()[part.carrier]
    return apply(T_world_part, middle[None])[0], T_world_part[:3, :3] @ direction


@owner_cache()
def _opening(
    model: Articulated, joint: str
) -> tuple[CarriedPart, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the same in the part's frame, and the part."""
    part = front_part(model, joint, opening_of(model, joint).sign) or CarriedPart.of(model, joint)
    links = rigid_links(part)
    T_link = part.poses(links)
    centers = [apply(T_link[n], h.vertices).mean(0) for n in links for h in model.hulls[n]]
    middle = np.mean(centers, axis=0) if centers else np.zeros(3)
    return part, middle, motion_direction(part, opening_of(model, joint).sign, middle)


def handle_path(item: SceneObject, joint: str, to: float) -> Float[np.ndarray, "k 3"]:
    """Return the handle's path in the world [m] from the joint's current value to another."""
    handle = find_handle(item.model, joint, opening_of(item.model, joint).sign)
    return part_path(item, CarriedPart(item.model, joint, handle.carrier), handle.center, to)


def held_thickness(item: SceneObject, joint: str | None) -> float:
    """Return the thickness of a part's thinnest handle, else of its edges, or of an object [m]."""
    if joint is None:
        poses = item.link_poses()
        hulls = [apply(poses[n], h.vertices) for n in poses for h in item.model.hulls[n]]
        return float(2 * item.model.box_around(np.concatenate(hulls))[2].min())
    found = find_handles(item.posed_model(joint), joint, opening_of(item.model, joint).sign)
    handles = [handle for handle in found if not handle.edge] or found
    return min(handle.thickness for handle in handles)


def find_handle(model: Articulated, joint: str, sign: float, latch: str | None = None) -> Handle:
    """Return the first handle of a part, or of a latch on it; see `handles_in_turn`.

    Raises:
        TaskError: The part or the latch has no geometry.
    """
    if latch is None:
        return find_handles(model, joint, sign)[0]
    handle = next(handles_in_turn(model, joint, sign, latch), None)
    if handle is None:
        raise TaskError(f"the latch {latch!r} has no shape; give its link a collision element")
    return handle


@owner_cache()
def find_handles(model: Articulated, joint: str, sign: float) -> tuple[Handle, ...]:
    """Find the handles of the part that a joint moves, the most probable first.

    The order: the largest group named "handle"; protrusions of the panel, in the collision elements
    or else in the visuals; without these, handles in the convex pieces of the meshes; then the free
    edges of the panel. The handle may be on a link that follows the joint, or on a joint of its own
    such as that of a lever. If nothing protrudes on the side to which the part opens, the other
    faces count: a sliding door has its handle in front.

    Args:
        model: The object.
        joint: The joint.
        sign: Opening direction of the joint (+1 or -1), which the handle faces.

    Raises:
        TaskError: The part has no geometry.
    """
    parts = parts_moved_by(model, joint)
    known = _named_first([h for part in parts for h in handles_by_hulls(part, sign)])
    bodies = [part for part in parts if own_elements(part)]
    if not bodies and not known:
        raise TaskError(f"joint {joint!r} moves no geometry; it must move a link with a shape")
    taken = {(e.link, e.index) for handle in known for e in handle.elements}
    edges: list[Handle] = []
    for part in bodies:
        bare = tuple(e for e in own_elements(part) if (e.link, e.index) not in taken)
        edges += free_edges(bare or own_elements(part), part, sign)
    cut = () if known else (h for part in parts for h in handles_by_pieces(part, sign))
    return (*known, *cut, *edges)


def _named_first(handles: list[Handle]) -> list[Handle]:
    return sorted(handles, key=lambda handle: handle.found is not HandleSource.NAME)


def handles_in_turn(
    model: Articulated, joint: str, sign: float, latch: str | None = None
) -> Iterator[Handle]:
    """Yield the handles, the most probable first; split meshes only when needed.

    Args:
        model: The object.
        joint: The joint.
        sign: Its opening direction (+1 or -1), which the handles face.
        latch: A link of the part; its handles alone count, the last of which is all of it.
    """
    if latch is not None:
        part = CarriedPart(model, joint, latch)
        yield from handles_by_hulls(part, sign)
        yield from handles_by_pieces(part, sign)
        whole = _as_handle(part, sign)
        yield from (h for h in whole if h not in handles_by_hulls(part, sign))
        return
    found = find_handles(model, joint, sign)
    yield from (h for h in found if not h.edge)
    known = {id(e) for h in found for e in h.elements}
    for part in parts_moved_by(model, joint):
        cut = (h for h in handles_by_pieces(part, sign) if h not in found)
        yield from (h for h in cut if not known >= {id(e) for e in h.elements})
    yield from (h for h in found if h.edge)


@owner_cache(owner=model_of)
def handles_by_hulls(part: CarriedPart, sign: float) -> tuple[Handle, ...]:
    """Find the geometry named "handle" and the elements that protrude from the panel."""
    own, named = own_elements(part), named_elements(part)
    if not own:
        groups = clusters(named)[:1]
        return tuple(_of(HandleSource.NAME, group, part, sign, own, None) for group in groups)
    opens = panel_normal(own, part, sign)
    handles = _on_face(named, part, sign, own, opens, None)
    if opens_both_ways(part.model, part.joint):
        handles += _on_face(named, part, sign, own, -opens, -opens)
    if any(h.found is HandleSource.NAME for h in handles) or (handles and not named):
        return tuple(_named_first(handles))
    if not named and _is_hand_sized(part, own):
        return _as_handle(part, sign)
    faces, in_plane = _side_faces(own, opens)
    aside = next(filter(None, (_on_face(named, part, sign, own, f, f) for f in faces)), [])
    aside = [h for h in aside if not (named or _is_panel(h, own)) or h.found is HandleSource.NAME]
    whole = [_of(HandleSource.NAME, g, part, sign, own, None) for g in clusters(named)[:1]]
    return (*aside, *whole, *handles) if in_plane else (*whole, *handles, *aside)


def _is_panel(handle: Handle, own: tuple[Element, ...]) -> bool:
    """Check whether a shape that protrudes aside is a panel itself, such as a drawer's front."""
    largest = max(map(_face_area, own))
    return any(_face_area(element) > PANEL_SHARE * largest for element in handle.elements)


def _face_area(element: Element) -> float:
    """Return the area of the largest face of the box around an element [m^2]."""
    return float(np.prod(np.sort(np.ptp(element.convex.vertices, axis=0))[1:]))


@owner_cache(owner=model_of)
def _as_handle(part: CarriedPart, sign: float) -> tuple[Handle, ...]:
    """Return a part as its own handle; empty without geometry."""
    own = list(own_elements(part))
    if not own:
        return ()
    return (replace(_of(HandleSource.SHAPE, own, part, sign, (), None), whole=True),)


def _is_hand_sized(part: CarriedPart, own: tuple[Element, ...]) -> bool:
    """Check whether a part is its own handle: the lever of a tap, a knob, a switch."""
    _, _, half = part.model.box_around(corners(own))
    length, breadth, _ = np.sort(2 * half)[::-1].tolist()
    return bool(length < MAX_LEVER_LENGTH and breadth < MAX_LEVER_BREADTH)


def _on_face(
    named: tuple[Element, ...],
    part: CarriedPart,
    sign: float,
    own: tuple[Element, ...],
    face: Float[np.ndarray, "3"],
    facing: Float[np.ndarray, "3"] | None,
) -> list[Handle]:
    """Return the handles that protrude from a face: the largest named group, then the others.

    Args:
        named: Elements named "handle".
        part, sign, own: The part, its opening direction and its elements.
        face: Outward normal of the face.
        facing: Direction from which a hand comes; by default that in which the handle moves.
    """
    panel = tuple(e for e in own if not any(e is handle for handle in named))
    front = front_along(panel, face) if panel else -np.inf
    out = [g for g in clusters(named) if (corners(g) @ face).max() > front + MIN_PROTRUSION]
    handles = [_of(HandleSource.NAME, group, part, sign, own, facing) for group in out[:1]]
    known = {id(e) for group in out[:1] for e in group}
    shaped = protrusions(own, face) or protrusions((*own, *visual_elements(part)), face)
    groups = [group for group in shaped if not known & {id(e) for e in group}]
    return handles + _by_shape(groups, part, sign, own, facing)


def _side_faces(
    own: tuple[Element, ...], opens: Float[np.ndarray, "3"]
) -> tuple[list[Float[np.ndarray, "3"]], bool]:
    """Return the outward normals of a part's other faces, and whether it slides in its plane."""
    panel = max(own, key=_face_area)
    _, rotation, half = fit_box(panel.convex.vertices)
    order = np.argsort(half)
    axes = [rotation[:, k] for k in order if abs(rotation[:, k] @ opens) < MAX_SIDE_SLANT]
    in_plane = abs(float(rotation[:, order[0]] @ opens)) < MAX_SIDE_SLANT
    return [s * axis for axis in axes for s in (1.0, -1.0)], in_plane


@owner_cache(owner=model_of)
def handles_by_pieces(part: CarriedPart, sign: float) -> tuple[Handle, ...]:
    """Find protrusions and strips among the convex pieces of the meshes."""
    whole = part_elements(part)
    links = rigid_links(part)
    own = tuple(e for e in part_pieces(part) if e.link in links)
    cut = [e for e in own if not any(e is other for other in whole)]
    if not cut:
        return ()
    out = panel_normal(own, part, sign)
    of_cut = {id(e) for e in cut}
    groups = [g for g in protrusions(own, out) if of_cut & {id(e) for e in g}]
    handles = _by_shape(groups, part, sign, own, None)
    used = {id(e) for h in handles if h.kind is not HandleKind.LIP for e in h.elements}
    protruding = {id(e) for group in groups for e in group}
    least = MIN_LEVER_SHARE * lever_arms(part, corners(own)).max()
    found = strips_of(own, tuple(e for e in cut if id(e) not in used), out)
    strips = [s for s in found if float(lever_arms(part, s.end[None])[0]) >= least]
    for strip in sorted(strips, key=lambda s: -s.half_length)[:MAX_STRIPS]:
        lip = id(strip.element) in protruding
        kind = HandleKind.LIP if lip else HandleKind.RECESS
        handles.append(_of_strip(strip, kind, part.carrier))
    return tuple(replace(handle, in_pieces=True) for handle in handles)


def _by_shape(
    groups: list[list[Element]],
    part: CarriedPart,
    sign: float,
    own: tuple[Element, ...],
    facing: Float[np.ndarray, "3"] | None,
) -> list[Handle]:
    """Return the handles of protrusions, long ones far from the hinge first."""
    handles = [_of(HandleSource.SHAPE, group, part, sign, own, facing) for group in groups]
    levers = {h: float(lever_arms(part, h.center[None])[0]) for h in handles}
    return sorted(handles, key=lambda h: -h.half_length * levers[h])


def _of_strip(strip: Strip, kind: HandleKind, carrier: str) -> Handle:
    depth = min(strip.depth, MAX_HELD_DEPTH)
    center = strip.end - strip.depth / 2 * strip.out
    return Handle(
        carrier, center, strip.end - depth / 2 * strip.out, strip.long, strip.out,
        strip.half_length, strip.thickness, depth, HandleSource.SHAPE, kind, strip.element.name,
        (strip.element,),
    )  # fmt: skip


def _of(
    found: HandleSource,
    group: list[Element],
    part: CarriedPart,
    sign: float,
    own: tuple[Element, ...],
    facing: Float[np.ndarray, "3"] | None,
) -> Handle:
    """Build a handle from its elements; by default it faces the direction in which it moves."""
    center, rotation, half = part.model.box_around(corners(group))
    order = np.argsort(half)
    motion = motion_direction(part, sign, center) if facing is None else facing
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
    others = [e for e in own if not any(e is mine for mine in group)]
    core = core_of(center, long * length, out, float(half[out_axis]), group, others)
    if core.kind is HandleKind.LIP and len(cut := in_pieces(part, group)) > len(group):
        # The hull of a bow fills the space behind its bar.
        bow = core_of(center, long * length, out, float(half[out_axis]), cut, others)
        if bow.kind is not HandleKind.LIP:
            core, group = bow, cut
    kind = core.kind if length >= KNOB_ELONGATION * half[side] else HandleKind.KNOB
    thickness = 2 * float(min(half[side], half[along]))
    return Handle(
        part.carrier, center, center + core.shift * out, long, out, length, thickness, core.depth,
        found, kind, longest_name(group), tuple(group),
    )  # fmt: skip
