"""Analyze the shape of a moving part, and when moving boxes touch it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import F1, F2, F3, entry, kernel
from momapos.core.geometry import apply, invert
from momapos.model.kinematics import BoxArrays
from momapos.model.urdf import Articulated, Boxes, Geometry, Hull, Joint

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


NEVER = np.inf
_STILL = 1e-9
"""Rate of approach along an axis below which the distance counts as constant [-]."""
_NORMAL_DIGITS = 4
"""Decimals to which face normals are compared [-]."""


@dataclass(frozen=True, eq=False)
class Convex:
    """A convex hull: its corners and the planes of its faces."""

    vertices: Float[np.ndarray, "m 3"]
    normals: Float[np.ndarray, "k 3"]
    """Distinct outward unit normals."""
    offsets: Float[np.ndarray, " k"]
    """Distances of the planes from the origin along their normals [m]."""

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, " *n"]:
        """Return the depth of points inside the hull; negative outside [m]."""
        return (self.offsets - points @ self.normals.T).min(-1)

    def surface(
        self, points: Float[np.ndarray, "g n 3"], outward: Float[np.ndarray, "g 3"]
    ) -> tuple[Float[np.ndarray, "g n"], Float[np.ndarray, "g n"]]:
        """Return the depth of points [m], and the angle at which a line from them leaves the hull.

        Args:
            points: Points in groups.
            outward: Unit direction of each group's lines.

        Returns:
            Depth, negative outside; cosine between the line and the normal of the exit face.
        """
        depth, cosine = np.empty(points.shape[:2]), np.empty(points.shape[:2])
        _surface(
            np.ascontiguousarray(points), np.ascontiguousarray(outward), self.normals,
            self.offsets, depth, cosine,
        )  # fmt: skip
        return depth, cosine

    def span(
        self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
    ) -> tuple[float, float]:
        """Return where a line enters and leaves the hull [m]; end <= begin if it misses."""
        rate, gap = self.normals @ direction, self.offsets - self.normals @ origin
        facing, leaving = rate < -_STILL, rate > _STILL
        if (gap[~facing & ~leaving] < 0).any():
            return 0.0, 0.0
        begin = (gap[facing] / rate[facing]).max(initial=-np.inf)
        end = (gap[leaving] / rate[leaving]).min(initial=np.inf)
        return float(begin), float(end)


def convex_of(hull: Hull, T: Float[np.ndarray, "4 4"]) -> Convex:
    """Transform a hull."""
    vertices = hull.vertices @ T[:3, :3].T + T[:3, 3]
    a, b, c = (vertices[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals = normals[length > 0] / length[length > 0, None]
    _, first = np.unique(np.round(normals, _NORMAL_DIGITS) + 0.0, axis=0, return_index=True)
    normals = normals[first]
    return Convex(vertices, normals, (vertices @ normals.T).max(0))


@dataclass(frozen=True, eq=False)
class Touch:
    """The travel at which each box of each pose touches a hull [m]."""

    begin: Float[np.ndarray, "g b"]
    """First contact; NEVER without contact, negative if they overlap at the start."""
    end: Float[np.ndarray, "g b"]
    """End of the contact."""
    cosine: Float[np.ndarray, "g b"]
    """Cosine between the line and the contact normal at the first contact [-]."""


def touches_hull(
    boxes: Boxes,
    hull: Convex,
    R: Float[np.ndarray, "g 3 3"],
    p: Float[np.ndarray, "g 3"],
    direction: Float[np.ndarray, "3"],
    margin: float = 0.0,
) -> Touch:
    """Compute when boxes that move along a line touch a hull.

    The separating axes are the face normals of both bodies. For crossing edges this reports a
    contact slightly early, never late.

    Args:
        boxes: Boxes in the tool frame.
        hull: Hull in the part's frame.
        R, p: Poses of the tool in the part.
        direction: Unit vector of the motion in the tool frame.
        margin: Distance that counts as contact [m].
    """
    begin, end, cosine = (np.empty((len(R), len(boxes))) for _ in range(3))
    _touches(
        BoxArrays(boxes.center, boxes.rotation, boxes.half), hull.vertices, hull.normals,
        hull.offsets, np.ascontiguousarray(R), np.ascontiguousarray(p), direction, margin,
        begin, end, cosine,
    )  # fmt: skip
    return Touch(begin, end, cosine)


@entry
def _touches(
    boxes: BoxArrays,
    vertices: F2,
    normals: F2,
    offsets: F1,
    R: F3,
    p: F2,
    direction: F1,
    margin: float,
    begin: F2,
    end: F2,
    cosine: F2,
) -> None:
    """Fill in `begin`, `end` and `cosine`; works in the tool frame, where the boxes are fixed."""
    center, rotation, half = boxes
    own_normals, own_offsets = np.empty_like(normals), np.empty(len(normals))
    own = np.empty_like(vertices)
    for g in range(len(R)):
        for k in range(len(normals)):
            own_offsets[k] = offsets[k]
            for i in range(3):
                own_offsets[k] -= normals[k, i] * p[g, i]
                own_normals[k, i] = 0.0
                for j in range(3):
                    own_normals[k, i] += normals[k, j] * R[g, j, i]
        for m in range(len(vertices)):
            for i in range(3):
                own[m, i] = 0.0
                for j in range(3):
                    own[m, i] += (vertices[m, j] - p[g, j]) * R[g, j, i]
        for b in range(len(center)):
            first, last, lean = -np.inf, np.inf, 0.0
            # Along the normals of the hull.
            for k in range(len(normals)):
                middle, reach, rate = 0.0, 0.0, 0.0
                for i in range(3):
                    middle += own_normals[k, i] * center[b, i]
                    rate += own_normals[k, i] * direction[i]
                    along = 0.0
                    for j in range(3):
                        along += own_normals[k, j] * rotation[b, j, i]
                    reach += abs(along) * half[b, i]
                gap = middle - reach - own_offsets[k] - margin
                when = _nearing(gap, rate)
                if when > first:
                    first, lean = when, abs(rate)
                if rate > _STILL:
                    last = min(last, -gap / rate)
            # Along the axes of the box, both ways.
            for i in range(3):
                at, rate, low, high = 0.0, 0.0, np.inf, -np.inf
                for j in range(3):
                    at += center[b, j] * rotation[b, j, i]
                    rate += direction[j] * rotation[b, j, i]
                for m in range(len(own)):
                    along = 0.0
                    for j in range(3):
                        along += own[m, j] * rotation[b, j, i]
                    low, high = min(low, along), max(high, along)
                for sign in (-1.0, 1.0):
                    gap = (at - high if sign > 0 else low - at) - half[b, i] - margin
                    when = _nearing(gap, sign * rate)
                    if when > first:
                        first, lean = when, abs(rate)
                    if sign * rate > _STILL:
                        last = min(last, -gap / (sign * rate))
            begin[g, b] = first if first <= last else np.inf
            end[g, b], cosine[g, b] = last, lean


@kernel
def _nearing(gap, rate):
    """Return the travel at which two bodies meet along an axis."""
    if rate < -_STILL:
        return -gap / rate
    return np.inf if gap > 0.0 and rate <= _STILL else -np.inf


@entry
def _surface(points: F3, outward: F2, normals: F2, offsets: F1, depth: F2, cosine: F2) -> None:
    rates = np.empty(len(normals))
    for g in range(len(points)):
        for k in range(len(normals)):
            rates[k] = 0.0
            for i in range(3):
                rates[k] += outward[g, i] * normals[k, i]
        for n in range(points.shape[1]):
            least, nearest, leaves = np.inf, np.inf, 0
            for k in range(len(normals)):
                inside = offsets[k]
                for i in range(3):
                    inside -= points[g, n, i] * normals[k, i]
                least = min(least, inside)
                if rates[k] > _STILL and inside / rates[k] < nearest:
                    nearest, leaves = inside / rates[k], k
            depth[g, n], cosine[g, n] = least, rates[leaves]


HANDLE_WORD = "handle"
PANEL_SHARE = 0.25
"""Elements whose face has this share of the widest one's area belong to the panel [-]."""
MIN_PROTRUSION = 0.008
"""Minimum height of a handle above the panel [m]."""
CONTACT_GAP = 0.01
"""Elements whose axis-aligned boxes are within twice this distance form one group [m]."""
MAX_HANDLE_BREADTH = 0.25
"""A jointed link whose second extent is smaller may be a handle: levers at both sides of a door are
15 cm across, drawers and flaps inside doors more than 25 cm [m]."""
VISUAL_TOLERANCE = 0.01
"""A collision element represents a visual if it exceeds the visual's box by less [m]."""


@dataclass(frozen=True, eq=False)
class Element:
    """One convex element of a part, in the frame of the moving link."""

    link: str
    name: str
    convex: Convex
    index: int | None
    """Index among the collision elements of its link; None for a visual."""

    @property
    def low(self) -> Float[np.ndarray, "3"]:
        """Lower corner of the axis-aligned box [m]."""
        return self.convex.vertices.min(0)

    @property
    def high(self) -> Float[np.ndarray, "3"]:
        """Upper corner of the axis-aligned box [m]."""
        return self.convex.vertices.max(0)


@dataclass(frozen=True)
class CarriedPart:
    """What a joint and its mimic joints move, in the frame of a link that carries some of it."""

    model: Articulated
    joint: str
    carrier: str
    """The child link of the joint or of one of its mimic joints."""

    @classmethod
    def of(cls, model: Articulated, joint: str) -> CarriedPart:
        """Return the part in the frame of the joint's own child link."""
        return cls(model, joint, model.joint(joint).child)

    @property
    def leads(self) -> bool:
        """Whether the joint itself moves the carrier, not one of its mimic joints."""
        return self.model.joint(self.joint).child == self.carrier

    @property
    def moved(self) -> tuple[str, ...]:
        """All links of its own that move."""
        model = self.model
        return tuple(name for name in model.moved_by(self.joint) if name not in model.contents)

    def poses(self, links: Collection[str]) -> dict[str, Float[np.ndarray, "4 4"]]:
        """Return the poses of links in the carrier's frame, with all joints at rest."""
        poses = self.model.rest_poses
        T_carrier_root = invert(poses[self.carrier])
        return {name: T_carrier_root @ poses[name] for name in links}


def model_of(part: CarriedPart) -> Articulated:
    """Return the model of a part, in which everything about the part is cached."""
    return part.model


def parts_moved_by(model: Articulated, joint: str) -> tuple[CarriedPart, ...]:
    """Return what a joint moves in the frame of each carrier, that of the joint's child first."""
    carriers = dict.fromkeys([model.joint(joint).child, *model.rigid_groups(joint).values()])
    return tuple(CarriedPart(model, joint, carrier) for carrier in carriers)


@owner_cache(owner=model_of)
def rigid_links(part: CarriedPart) -> tuple[str, ...]:
    """Return the carrier of a part, the links fixed to it, and the handles jointed to it."""
    model, links = part.model, {part.carrier}
    for other in model.urdf.joints:
        fixed = not other.movable or is_handle_joint(model, other)
        if other.parent in links and fixed and other.child not in model.contents:
            links.add(other.child)
    return tuple(name for name in model.links if name in links)


def is_handle_joint(model: Articulated, joint: Joint) -> bool:
    """Check whether a joint moves only a handle of another part, such as a lever or a T-handle."""
    if not joint.movable or joint.mimic is not None or model.followers(joint.name):
        return False
    if not any(joint.parent in model.links_below(other.child) for other in model.joints.values()):
        return False
    return _size_of_links(model, joint.name)[1] < MAX_HANDLE_BREADTH


@owner_cache()
def _size_of_links(model: Articulated, joint: str) -> tuple[float, float, float]:
    """Return the extents of what a joint moves, the largest first; infinite without a shape [m]."""
    points = [
        apply(T, hull.vertices)
        for link, T in CarriedPart.of(model, joint).poses(model.moved_by(joint)).items()
        for hull in model.hulls[link]
    ]
    if not points:
        return np.inf, np.inf, np.inf
    a, b, c = np.sort(np.ptp(np.concatenate(points), axis=0))[::-1].tolist()
    return a, b, c


def named_shapes(part: CarriedPart) -> list[tuple[str, Geometry]]:
    """Return the shapes named "handle" on the part itself and on handles jointed to it."""
    return part.model.shapes_named(HANDLE_WORD, rigid_links(part))


@owner_cache(owner=model_of)
def part_elements(part: CarriedPart) -> tuple[Element, ...]:
    """Return the collision elements of all links that a joint moves."""
    T_link = part.poses(part.moved)
    return tuple(
        Element(link, hull.name or link, convex_of(hull, T_link[link]), index)
        for link in part.moved
        for index, hull in enumerate(part.model.hulls[link])
    )


@owner_cache(owner=model_of)
def part_pieces(part: CarriedPart) -> tuple[Element, ...]:
    """Return the same, with non-convex meshes split into convex pieces."""
    return tuple(piece for whole in part_elements(part) for piece in _pieces_of(part, whole))


def in_pieces(part: CarriedPart, elements: list[Element]) -> list[Element]:
    """Return elements of a part with non-convex meshes split into convex pieces."""
    return [piece for whole in elements for piece in _pieces_of(part, whole)]


@owner_cache(owner=model_of)
def _pieces_of(part: CarriedPart, whole: Element) -> tuple[Element, ...]:
    if whole.index is None or len(pieces := part.model.pieces(whole.link, whole.index)) < 2:
        return (whole,)
    T = part.poses([whole.link])[whole.link]
    return tuple(Element(whole.link, whole.name, convex_of(p, T), whole.index) for p in pieces)


@owner_cache(owner=model_of)
def visual_elements(part: CarriedPart) -> tuple[Element, ...]:
    """Return the convex hulls of the visuals of the links that move rigidly with the carrier."""
    model, links = part.model, rigid_links(part)
    T_link = part.poses(links)
    return tuple(
        Element(link, shape.name or link, convex_of(model.hull(link, shape), T_link[link]), None)
        for link in links
        for shape in model.urdf.links[link].visuals
    )


@owner_cache(owner=model_of)
def named_elements(part: CarriedPart) -> tuple[Element, ...]:
    """Return the elements named "handle"; for a visual, its collision elements if there are any."""
    model, links = part.model, rigid_links(part)
    T_link = part.poses(links)
    by_link = {link: [e for e in part_elements(part) if e.link == link] for link in links}
    found: list[Element] = []
    for link, shape in named_shapes(part):
        solid = [
            e
            for e, known in zip(by_link[link], model.urdf.links[link].collisions, strict=True)
            if known is shape
        ]
        if not solid:
            convex = convex_of(model.hull(link, shape), T_link[link])
            drawn = Element(link, shape.name or link, convex, None)
            solid = [e for e in by_link[link] if _inside(e, drawn)] or [drawn]
        found += [e for e in solid if not any(e is other for other in found)]
    return tuple(found)


def own_elements(part: CarriedPart) -> tuple[Element, ...]:
    """Return the collision elements that move rigidly with a part's carrier."""
    links = rigid_links(part)
    return tuple(e for e in part_elements(part) if e.link in links)


def _inside(element: Element, other: Element) -> bool:
    return bool(
        (element.low >= other.low - VISUAL_TOLERANCE).all()
        and (element.high <= other.high + VISUAL_TOLERANCE).all()
    )


def protrusions(elements: tuple[Element, ...], out: Float[np.ndarray, "3"]) -> list[list[Element]]:
    """Find what protrudes from a part's panel on the side to which it opens.

    The panel consists of the elements with wide faces, see `PANEL_SHARE`.

    Args:
        elements: The part.
        out: Unit vector in which it opens.

    Returns:
        Groups of touching elements.
    """
    if len(elements) < 2:
        return []
    tops, panel = _tops(elements, out)
    front = tops[panel].max()
    sizes = np.array([np.ptp(e.convex.vertices, axis=0).max() for e in elements])
    chosen = [
        e
        for e, wide, top, size in zip(elements, panel, tops, sizes, strict=True)
        if not wide and top > front + MIN_PROTRUSION and size > MIN_PROTRUSION
    ]
    return clusters(chosen)


def front_along(elements: tuple[Element, ...], out: Float[np.ndarray, "3"]) -> float:
    """Return where the panel of a part ends in a direction [m]."""
    tops, panel = _tops(elements, out)
    return float(tops[panel].max())


def _tops(
    elements: tuple[Element, ...], out: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, " e"], Bool[np.ndarray, " e"]]:
    """Return where each element ends in a direction [m], and which belong to the panel."""
    area = _faces(elements, out)
    tops = np.array([(e.convex.vertices @ out).max() for e in elements])
    return tops, area > PANEL_SHARE * area.max()


def front_area(elements: tuple[Element, ...], out: Float[np.ndarray, "3"]) -> float:
    """Return the area of the widest face across a direction [m^2]."""
    return float(_faces(elements, out).max())


def _faces(elements: tuple[Element, ...], out: Float[np.ndarray, "3"]) -> Float[np.ndarray, " e"]:
    """Return the area of each element's bounding rectangle across a direction [m^2]."""
    across = np.linalg.svd(out[None])[2][1:]
    return np.array([np.ptp(e.convex.vertices @ across.T, axis=0).prod() for e in elements])


def widest(elements: tuple[Element, ...], out: Float[np.ndarray, "3"]) -> Element:
    """Return the element with the widest face across a direction; the foremost of similar ones."""
    area = _faces(elements, out)
    tops = np.array([(e.convex.vertices @ out).max() for e in elements])
    return elements[int(np.lexsort((tops, area > 0.9 * area.max()))[-1])]


def clusters(elements: list[Element] | tuple[Element, ...]) -> list[list[Element]]:
    """Group elements whose axis-aligned boxes are within 2 cm, the longest group first."""
    if not elements:
        return []
    low = np.array([e.low for e in elements]) - CONTACT_GAP
    high = np.array([e.high for e in elements]) + CONTACT_GAP
    touch = np.all((low[:, None] <= high[None]) & (low[None] <= high[:, None]), axis=2)
    joined = touch @ touch  # transitive closure
    while (joined != touch).any():
        touch, joined = joined, joined @ joined
    first = joined.argmax(axis=1)
    groups = [[e for e, k in zip(elements, first, strict=True) if k == g] for g in np.unique(first)]
    return sorted(groups, key=lambda group: -float(np.linalg.norm(np.ptp(corners(group), axis=0))))


def corners(elements: list[Element] | tuple[Element, ...]) -> Float[np.ndarray, "n 3"]:
    """Return the corners of all elements."""
    return np.concatenate([e.convex.vertices for e in elements])


def longest_name(elements: list[Element]) -> str:
    """Return the name of the longest element."""
    return max(elements, key=lambda e: float(np.ptp(e.convex.vertices, axis=0).max())).name
