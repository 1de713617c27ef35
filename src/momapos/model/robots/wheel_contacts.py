"""The area that a robot stands on: the outline of where its wheels meet the floor."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, convex_hull, edge_normals, invert
from momapos.model.urdf import Articulated

from .running_gear import WHEEL

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_CONTACT_HEIGHT = 0.015
"""Maximum height of the lowest point of a wheel, since casters and meshes are imprecise [m]."""
_FLAT = 0.005
"""Points of a shape that are this near its lowest one form its contact [m]."""
MIN_WIDTH = 0.1
"""Least width of the area to stand on; less is an axle whose casters are not modeled [m]. The
library robots stand on 0.23 to 0.55 m."""
_UPRIGHT = 0.99
"""Cosine to the vertical of the axis of a drive unit [-]."""
_CORNERS = 24
"""Corners of a circle [-]."""


def support_outline(
    model: Articulated, base_link: str, links: Collection[str]
) -> Float[np.ndarray, "k 2"] | None:
    """Return the outline of the points on which a robot stands, in the base frame [m].

    These are its wheels or, if they are only an axle, all that reaches the floor. Wheels below one
    turning joint (a drive unit that turns under the body) support the circle that lies within them
    wherever the unit is.

    Args:
        model: The robot.
        base_link: Link on the floor, z up.
        links: The links that the arm does not move.

    Returns:
        Corners, counterclockwise; None if what reaches the floor is narrower than `MIN_WIDTH`.
    """
    poses = model.rest_poses
    T_base_root = invert(poses[base_link])
    rolling = {joint.child for joint in model.joints.values() if joint.kind == "continuous"}
    wheels, everything, rolling_links = [], [], []
    for link in links:
        for hull in model.hulls[link]:
            points = apply(T_base_root @ poses[link], hull.vertices)
            lowest = float(points[:, 2].min())
            if lowest > MAX_CONTACT_HEIGHT:
                continue
            contact = points[points[:, 2] < lowest + _FLAT, :2]
            everything.append(contact)
            if link in rolling or WHEEL.search(link):
                wheels.append(contact.mean(0, keepdims=True))
                rolling_links.append(link)
    outlines = (_hull(np.concatenate(found)) for found in (wheels, everything) if found)
    outline = next((outline for outline in outlines if outline is not None), None)
    axis = _turning_unit(model, T_base_root, rolling_links)
    return outline if outline is None or axis is None else _within(outline, axis)


def _turning_unit(
    model: Articulated, T_base_root: Float[np.ndarray, "4 4"], wheels: Collection[str]
) -> Float[np.ndarray, "2"] | None:
    """Return the position of the vertical axis about which all wheels turn together; None if none.

    The unit's joint turns endlessly, as no limit keeps its wheels where they are at rest.
    """
    for joint in model.joints.values():
        if joint.kind == "continuous" and len(wheels) > 1:
            T = T_base_root @ model.rest_poses[joint.child]
            upright = abs((T[:3, :3] @ joint.axis)[2]) > _UPRIGHT
            if upright and set(wheels) <= set(model.links_below(joint.child)) - {joint.child}:
                return T[:2, 3]
    return None


def _within(
    outline: Float[np.ndarray, "k 2"], center: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "c 2"] | None:
    """Return the largest circle about a point within a convex outline; None if it is too small."""
    edge = np.roll(outline, -1, 0) - outline
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    radius = float((normal * (outline - center)).sum(1).min())
    if radius < MIN_WIDTH / 2:
        return None
    angle = np.arange(_CORNERS) * 2 * np.pi / _CORNERS
    return center + radius * np.stack([np.cos(angle), np.sin(angle)], -1)


def _hull(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k 2"] | None:
    """Return the corners of the convex hull; None if it is too narrow to stand on."""
    hull = convex_hull(points) if len(points) > 2 else points
    if len(hull) < 3:
        return None
    normals = edge_normals(hull)
    inside = (normals * hull).sum(1)[:, None] - normals @ hull.T
    return hull if inside.max(1).min() >= MIN_WIDTH else None
