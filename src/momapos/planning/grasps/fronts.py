"""Find the front of a part and its free edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.model.urdf import Articulated

from .handle_core import HandleKind
from .handle_records import Handle, HandleSource
from .handle_shapes import (
    CarriedPart,
    Element,
    corners,
    front_area,
    longest_name,
    own_elements,
    parts_moved_by,
    widest,
)
from .part_motion import motion_direction

if TYPE_CHECKING:
    from jaxtyping import Float

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
