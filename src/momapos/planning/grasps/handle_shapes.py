"""Analyze the shape of a moving part: its panel, and what protrudes from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model.urdf import Articulated, Geometry

from .swept_boxes import Convex, convex_of

if TYPE_CHECKING:
    from jaxtyping import Float

HANDLE_WORD = "handle"
_MODELS = 1024
"""Number of parts whose geometry is cached [-]."""
PANEL_SHARE = 0.25
"""Elements whose face has this share of the widest one's area belong to the panel [-]."""
MIN_PROTRUSION = 0.008
"""Minimum height of a handle above the panel [m]."""
CONTACT_GAP = 0.01
"""Elements whose axis-aligned boxes are within twice this distance form one group [m]."""
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


def rigid_links(model: Articulated, joint: str) -> tuple[str, ...]:
    """Return the child link of a joint and all links fixed to it."""
    links = {model.joint(joint).child}
    for other in model.urdf.joints:
        if other.parent in links and not other.movable:
            links.add(other.child)
    return tuple(name for name in model.links if name in links)


def poses_in_part(
    model: Articulated, joint: str, links: tuple[str, ...]
) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Return the poses of links in the frame of the moving link, with all joints at rest."""
    poses = model.rest_poses
    T_part_root = invert(poses[model.joint(joint).child])
    return {name: T_part_root @ poses[name] for name in links}


def named_shapes(model: Articulated, joint: str) -> list[tuple[str, Geometry]]:
    """Return the shapes named "handle" on the part itself, not on parts jointed to it."""
    return model.shapes_named(HANDLE_WORD, rigid_links(model, joint))


@lru_cache(maxsize=_MODELS)
def part_elements(model: Articulated, joint: str) -> tuple[Element, ...]:
    """Return the collision elements of all links that a joint moves."""
    links = model.moved_by(joint)
    T_link = poses_in_part(model, joint, links)
    return tuple(
        Element(link, hull.name or link, convex_of(hull, T_link[link]), index)
        for link in links
        for index, hull in enumerate(model.hulls[link])
    )


@lru_cache(maxsize=_MODELS)
def part_pieces(model: Articulated, joint: str) -> tuple[Element, ...]:
    """Return the same, with non-convex meshes split into convex pieces."""
    links = model.moved_by(joint)
    T_link = poses_in_part(model, joint, links)
    found: list[Element] = []
    for whole in part_elements(model, joint):
        assert whole.index is not None
        pieces = model.pieces(whole.link, whole.index)
        T, name = T_link[whole.link], whole.name
        cut = [Element(whole.link, name, convex_of(piece, T), whole.index) for piece in pieces]
        found += cut if len(cut) > 1 else [whole]
    return tuple(found)


@lru_cache(maxsize=_MODELS)
def visual_elements(model: Articulated, joint: str) -> tuple[Element, ...]:
    """Return the convex hulls of the visuals of the links that a joint moves rigidly."""
    links = rigid_links(model, joint)
    T_link = poses_in_part(model, joint, links)
    return tuple(
        Element(link, shape.name or link, convex_of(model.hull(link, shape), T_link[link]), None)
        for link in links
        for shape in model.urdf.links[link].visuals
    )


@lru_cache(maxsize=_MODELS)
def named_elements(model: Articulated, joint: str) -> tuple[Element, ...]:
    """Return the elements named "handle"; for a visual, its collision elements if there are any."""
    links = rigid_links(model, joint)
    T_link = poses_in_part(model, joint, links)
    by_link = {link: [e for e in part_elements(model, joint) if e.link == link] for link in links}
    found: list[Element] = []
    for link, shape in named_shapes(model, joint):
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
    area = _faces(elements, out)
    panel = area > PANEL_SHARE * area.max()
    tops = np.array([(e.convex.vertices @ out).max() for e in elements])
    front = tops[panel].max()
    sizes = np.array([np.ptp(e.convex.vertices, axis=0).max() for e in elements])
    chosen = [
        e
        for e, wide, top, size in zip(elements, panel, tops, sizes, strict=True)
        if not wide and top > front + MIN_PROTRUSION and size > MIN_PROTRUSION
    ]
    return clusters(chosen)


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
