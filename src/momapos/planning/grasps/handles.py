"""Find the handles of a moving part, or its free edges if it has none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError, owner_cache
from momapos.core.geometry import apply
from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated, fit_box, opening_of, opens_both_ways

from .handle_shapes import (
    MIN_PROTRUSION,
    PANEL_SHARE,
    CarriedPart,
    Element,
    clusters,
    corners,
    front_along,
    front_area,
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
    widest,
)
from .part_motion import lever_arms, motion_direction, part_path

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


MAX_HELD_DEPTH = 0.04
"""Only the outer end of a deeper handle is grasped [m]."""
FINGER_SPACE = 0.008
"""Space for a finger behind a handle [m]."""
_CORE_LEVELS = 41
"""Samples of the space behind a handle [-]."""
_MAX_GAP = 1e-4
"""Elements with a smaller gap are one body [m]."""


class HandleKind(StrEnum):
    """The kind of a handle; plans contain the words."""

    BAR = "bar"
    """Long, with space behind it."""
    KNOB = "knob"
    LEVER = "lever"
    """A bar that is fixed at one end."""
    LIP = "lip"
    """Long, without space behind it."""
    RECESS = "recessed pull"
    """A strip of the front itself, next to a pocket or a groove."""
    EDGE = "edge"
    """The free edge of a panel without a handle."""
    FACE = "face"
    """The front of a panel, for pushing or suction."""


@dataclass(frozen=True)
class Core:
    """The part of a handle that a hand grasps, without its fixings."""

    shift: float
    """Offset from the middle of the whole handle outwards [m]."""
    depth: float
    """Size along the outward direction [m]."""
    kind: HandleKind


def core_of(
    center: Float[np.ndarray, "3"],
    half_long: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "3"],
    half_out: float,
    group: list[Element],
    others: list[Element],
) -> Core:
    """Find the solid outer part of a handle, and classify it by the space behind it.

    Args:
        center: Middle of the handle.
        half_long: Vector from there to its end.
        out: Outward unit vector.
        half_out: Half the size along `out` [m].
        group: Elements of the handle.
        others: Elements of the rest of the part.
    """
    top = half_out + FINGER_SPACE
    solid = _spans(group, center + top * out, -out)
    covered = _spans(others, center + top * out, -out)
    first = solid[:, 0].min(initial=np.inf)
    if not np.isfinite(first):
        return Core(0.0, 2 * half_out, HandleKind.BAR)
    last = first
    for begin, end in solid[np.argsort(solid[:, 0])]:
        last = max(last, end) if begin <= last + _MAX_GAP else last
    inside = covered[covered[:, 0] > first, 0].min(initial=np.inf)
    depth = min(last - first, inside - first, MAX_HELD_DEPTH)
    shift = top - first - depth / 2
    kind = _kind_of(center, half_long, out, half_out, float(first), [*group, *others])
    return Core(float(shift), float(depth), kind)


def _spans(
    elements: list[Element], origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 2"]:
    """Return where a line enters and leaves the elements that it hits [m]."""
    spans = [e.convex.span(origin, direction) for e in elements]
    return np.array([span for span in spans if span[0] < span[1]]).reshape(-1, 2)


def _kind_of(
    center: Float[np.ndarray, "3"],
    half_long: Float[np.ndarray, "3"],
    out: Float[np.ndarray, "3"],
    half_out: float,
    first: float,
    elements: list[Element],
) -> HandleKind:
    """Classify a bar, lever or lip by the space behind its middle and its ends.

    Args:
        center, half_long, out, half_out: See `core_of`.
        first: Where the handle begins, measured from `FINGER_SPACE` outside its outer side [m].
        elements: All elements of the part.
    """
    levels = np.linspace(half_out + FINGER_SPACE - first, -half_out - FINGER_SPACE, _CORE_LEVELS)
    step = float(levels[0] - levels[-1]) / (_CORE_LEVELS - 1)
    shares = np.array([-0.95, -0.5, 0.0, 0.5, 0.95])
    points = center + shares[:, None, None] * half_long + levels[:, None] * out
    free = ~_filled(elements, points)
    if free[1:4].all(0).sum() * step < FINGER_SPACE:
        return HandleKind.LIP
    ends = free[[0, 4]].sum(1) * step >= FINGER_SPACE
    return HandleKind.LEVER if ends[0] != ends[1] else HandleKind.BAR


def _filled(elements: list[Element], points: Float[np.ndarray, "k n 3"]) -> Bool[np.ndarray, "k n"]:
    """Check which points lie inside an element."""
    filled = np.zeros(points.shape[:-1], bool)
    for element in elements:
        filled |= element.convex.depth(points) > -1e-6
    return filled


class HandleSource(StrEnum):
    """How a handle was found; plans contain the words."""

    NAME = "name"
    SHAPE = "shape"
    EDGE = "edge"


@dataclass(frozen=True, eq=False)
class Handle:
    """A handle, edge or face to grasp or push, in the frame of the link that carries it."""

    carrier: str
    """The link that carries it: the joint's child, or that of one of its mimic joints."""
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
    whole: bool = False
    """Whether the part is nothing but this handle, as the lever of a tap."""

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


MAX_WIDTH = 0.06
"""Maximum size of a strip across its long axis [m]."""
MIN_LENGTH = 0.02
"""Minimum length of a strip [m]."""
APPROACH_LENGTH = 0.06
"""Length of the straight approach that must be free [m]."""
_SHARES = np.array([-0.5, 0.0, 0.5])
_STEPS = 9
_MIN_COSINE = 0.9
"""Cosine above which directions count as the same [-]."""


@dataclass(frozen=True, eq=False)
class Strip:
    """A piece that two fingers reach around from one side, in the part's frame."""

    element: Element
    end: Float[np.ndarray, "3"]
    """Middle of the side that faces the hand [m]."""
    long: Float[np.ndarray, "3"]
    out: Float[np.ndarray, "3"]
    """Unit vectors along the strip (long) and toward the hand (out)."""
    half_length: float
    thickness: float
    depth: float
    """Half length, size between the fingers, and size toward the hand [m]."""


def strips_of(
    elements: tuple[Element, ...], pieces: tuple[Element, ...], front: Float[np.ndarray, "3"]
) -> list[Strip]:
    """Find the narrow pieces of a part with space for a finger on both sides.

    Args:
        elements: All elements of the part.
        pieces: The elements that may be grasped.
        front: Unit normal of the part's front; no hand approaches from behind.
    """
    return [s for piece in pieces for s in _sides(piece, front) if _is_graspable(s, elements)]


def _sides(piece: Element, front: Float[np.ndarray, "3"]) -> list[Strip]:
    """Return a strip for each side of a piece from which fingers may approach."""
    center, rotation, half = fit_box(piece.convex.vertices)
    order = np.argsort(half)
    if 2 * half[order[1]] > MAX_WIDTH or 2 * half[order[2]] < MIN_LENGTH:
        return []
    long = rotation[:, order[2]]
    strips = []
    for out_axis, between in ((order[0], order[1]), (order[1], order[0])):
        for side in (1.0, -1.0):
            out = side * rotation[:, out_axis]
            thick, depth = 2 * float(half[between]), 2 * float(half[out_axis])
            if out @ front > -_MIN_COSINE:
                end = center + depth / 2 * out
                strips.append(Strip(piece, end, long, out, float(half[order[2]]), thick, depth))
    return strips


def _is_graspable(strip: Strip, elements: tuple[Element, ...]) -> bool:
    """Check that fingers fit on both sides of a strip, at its middle or middle of a half."""
    across = np.cross(strip.out, strip.long)
    along = _SHARES[:, None] * strip.half_length * strip.long
    levels = (
        np.linspace(-min(FINGER_SPACE, strip.depth), APPROACH_LENGTH, _STEPS)[:, None] * strip.out
    )
    near, far = strip.thickness / 2 + 1e-3, strip.thickness / 2 + FINGER_SPACE
    beside = np.array([-far, -near, near, far])[:, None] * across
    points = strip.end + along[:, None, None] + levels[:, None] + beside
    filled = np.zeros(points.shape[:-1], bool)
    for element in elements:
        if element is not strip.element:
            filled |= element.convex.depth(points) > 0.0
    return bool((~filled).all((1, 2)).any())


PUSH_INSET = 0.05
"""Distance from the free edge at which a door is pushed [m]."""
EDGE_WIDTH = 0.02
"""Elements of a panel that end this close to its edge form the edge [m]."""


def panel_normal(
    elements: tuple[Element, ...], part: CarriedPart, sign: float
) -> Float[np.ndarray, "3"]:
    """Return the unit normal of a part's front, on the side to which it opens."""
    opens = motion_direction(part, sign, corners(elements).mean(0))
    front = widest(elements, opens)
    center, rotation, _ = part.model.box_around(front.convex.vertices)
    opens = motion_direction(part, sign, center)
    normal = rotation[:, int(np.argmax(np.abs(rotation.T @ opens)))]
    return normal * np.sign(normal @ opens)


def free_edges(elements: tuple[Element, ...], part: CarriedPart, sign: float) -> list[Handle]:
    """Return the edge of a panel farthest from the hinge, or both edges of a drawer's front."""
    record = next(j for j in part.model.urdf.joints if j.child == part.carrier)
    opens = motion_direction(part, sign, corners(elements).mean(0))
    # A drawer has a front and a box behind it; a door may be a frame around a pane.
    panel = [widest(elements, opens)] if record.kind == "prismatic" else list(elements)
    center, rotation, half = part.model.box_around(corners(panel))
    motion = motion_direction(part, sign, center)
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
    return [
        _edge(rotation[:, normal], rotation[:, along], s * far, panel, part.carrier) for s in signs
    ]


def _edge(
    normal: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    far: Float[np.ndarray, "3"],
    panel: list[Element],
    carrier: str,
) -> Handle:
    """Return the edge of a panel that lies farthest in a direction."""
    ends = np.array([(e.convex.vertices @ far).max() for e in panel])
    rim = [e for e, end in zip(panel, ends, strict=True) if end > ends.max() - EDGE_WIDTH]
    points = corners(rim)
    across, length, out = points @ normal, points @ along, points @ far
    middle = [(x.min() + x.max()) / 2 for x in (across, length)]
    where = middle[0] * normal + middle[1] * along + ends.max() * far
    return Handle(
        carrier, where, where, along, far,
        float(np.ptp(length)) / 2, float(np.ptp(across)), float(np.ptp(out)),
        HandleSource.EDGE, HandleKind.EDGE, longest_name(panel), tuple(rim),
    )  # fmt: skip


def front_part(model: Articulated, joint: str, sign: float) -> CarriedPart | None:
    """Return the part with the widest front, of the links that a joint and its mimic joints move.

    None if they have no collision geometry.
    """
    parts = [part for part in parts_moved_by(model, joint) if own_elements(part)]
    if len(parts) < 2:
        return parts[0] if parts else None

    def width(part: CarriedPart) -> float:
        own = own_elements(part)
        return front_area(own, motion_direction(part, sign, corners(own).mean(0)))

    return max(parts, key=width)


def front_face(part: CarriedPart | None, sign: float) -> Handle | None:
    """Return the front of a part near its free edge; None if it has no collision geometry."""
    own = () if part is None else own_elements(part)
    if part is None or not own:
        return None
    edge = free_edges(own, part, sign)[0]
    slides = part.model.joint(part.joint).kind == "prismatic"
    middle = edge.center - edge.out * (edge.depth / 2 if slides else PUSH_INSET)
    out = panel_normal(own, part, sign)
    tops = [float((e.convex.vertices @ out).max()) for e in edge.elements]
    front = middle + out * (max(tops) - float(middle @ out))
    return Handle(
        part.carrier, front, front, edge.long, out, edge.half_length, 0.0, edge.thickness,
        HandleSource.EDGE, HandleKind.FACE, edge.name, edge.elements,
    )  # fmt: skip


MAX_PRESS_INSET = 0.15
"""Largest distance of a push from the part's edge: a hand next to a door's frame fits [m]."""
MIN_PRESS_COSINE = 0.86
"""Least cosine between a face and the motion of its point, for which friction of 0.6 holds [-]."""


def pressed_faces(part: CarriedPart, sign: float) -> tuple[Handle, ...]:
    """Return the faces of a part that move straight in when they are pushed, the best first.

    A button has one. A rocker turns about a hinge in its middle, so each of its faces has a half
    whose push moves it in one direction; the half farther from the hinge comes first.

    Args:
        part: The part.
        sign: Direction in which the part comes out (+1 or -1).
    """
    own = own_elements(part)
    record = next(j for j in part.model.urdf.joints if j.child == part.carrier)
    if record.kind == "prismatic":
        face = front_face(part, sign)
        return () if face is None else (face,)
    center, rotation, half = part.model.box_around(corners(own))
    along = int(np.argmax(np.abs(rotation.T @ record.axis)))
    found = []
    for normal, across in permutations([k for k in range(3) if k != along]):
        inset = min(MAX_PRESS_INSET, half[across] / 4)
        for out, side in product((1.0, -1.0), repeat=2):
            away = out * rotation[:, normal]
            reach = half[normal] * away + side * (half[across] - inset) * rotation[:, across]
            cosine = float(motion_direction(part, sign, center + reach) @ away)
            lever = float(lever_arms(part, (center + reach)[None])[0])
            if cosine > MIN_PRESS_COSINE:
                face = Handle(
                    part.carrier, center + reach, center + reach, rotation[:, along], away,
                    float(half[along]), 0.0, float(2 * half[normal]), HandleSource.EDGE,
                    HandleKind.FACE, longest_name(list(own)), own,
                )  # fmt: skip
                found.append((lever, face))
    least = MIN_LEVER_SHARE * max((lever for lever, _ in found), default=0.0)
    far = [one for one in found if one[0] >= least]
    return tuple(face for _, face in sorted(far, key=lambda one: -one[0]))


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
