"""Guess the base of a robot: the link on the floor, the footprint and the drive."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.model.urdf import Articulated

from .amended_urdf import AddedFrame
from .gripper_guess import fixed_to, points_of
from .joint_tree import WHEEL

if TYPE_CHECKING:
    from jaxtyping import Float

_OMNI = re.compile(r"mecanum|omni|swerve", re.I)
FLOOR_TOLERANCE = 0.03
"""Maximum height of the base's lowest point above or below z = 0 of the base link [m]."""
MAX_WHEEL_HEIGHT = 0.15
"""Maximum height of the geometry above a base_footprint link, if the wheels have none [m]."""
MAX_MOUNT_SIZE = 0.35
"""Size below which a base without wheels is only the mounting plate of an arm [m]."""
FLOOR_FRAME = "base_floor"
MAX_CORNERS = 16


def base_links(model: Articulated, firsts: Sequence[str]) -> list[str]:
    """Return the links that no joint moves; for the first joints of all arms, the base's links."""
    moved = {link for joint in firsts for link in model.moved_by(joint)}
    return [name for name in model.links if name not in moved]


def refuse_without_base(model: Articulated, anchor: str, firsts: Sequence[str]) -> None:
    """Check that the robot has more than an arm.

    Raises:
        RobotError: It has no base; the message says how to add one.
    """
    driving = anchor != model.urdf.root or bool(model.urdf.rigid)
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    wheels = any(WHEEL.search(name) or _OMNI.search(name) for name in names)
    if driving or wheels:
        return
    points = points_of(model, model.urdf.root, base_links(model, firsts))
    if not len(points) or float(np.ptp(points[:, :2], axis=0).max()) < MAX_MOUNT_SIZE:
        raise RobotError(
            f"{model.urdf.path}: the arm has no base: there are no wheels and no geometry on the "
            "floor; put it on a driving box with --on-box LENGTHxWIDTHxHEIGHT of momapos robot "
            "check, or on another base with [mount] in a robot file (docs/robots.md)"
        )


def lift_as_base(model: Articulated, joints: Sequence[str], notes: list[str]) -> tuple[str, ...]:
    """Return the arm's joints without a lift that carries all geometry of the base.

    Some simulators lift a whole robot this way; the links below the lift have no geometry.
    """
    rest = list(joints)
    while len(rest) > 1 and not len(points_of(model, model.urdf.root, base_links(model, rest[:1]))):
        joint = model.joint(rest[0])
        if joint.kind != "prismatic":
            raise RobotError(
                f"{model.urdf.path}: no link below the arm has collision geometry; add the "
                "collision geometry of the base"
            )
        notes.append(f"{joint.name} lifts all collision geometry: it stays at rest")
        rest.pop(0)
    return tuple(rest)


def find_base_link(
    model: Articulated, anchor: str, firsts: Sequence[str], notes: list[str]
) -> tuple[str, AddedFrame | None]:
    """Find a link fixed to the base with z = 0 on the floor, or define a frame there."""
    rigid = fixed_to(model, anchor)
    usual: tuple[str, ...] = ("base_footprint", "base_link")
    preferred = [name for name in usual if name in rigid]
    body = base_links(model, firsts)
    offsets = {}
    for name in dict.fromkeys([*preferred, anchor, *rigid]):
        points = points_of(model, name, body)
        if not len(points):
            raise RobotError(
                f"{model.urdf.path}: no link below the arm has collision geometry; add the "
                "collision geometry of the base"
            )
        offsets[name] = low = float(points[:, 2].min())
        if abs(low) <= FLOOR_TOLERANCE:
            notes.append(f"base_link: {name}; its x axis is assumed to point forward")
            return name, None
        if name == "base_footprint" and 0 < low < MAX_WHEEL_HEIGHT:
            notes.append(
                f"base_link: {name}, by its name; the geometry starts {low:.2f} m above it"
            )
            return name, None
    name = (preferred or [anchor])[-1]
    frame = AddedFrame(FLOOR_FRAME, name, (0.0, 0.0, round(offsets[name], 4)))
    if model.rest_poses[name][2, 2] < 0.999:
        notes.append(f"IMPORTANT: the z axis of {name} does not point up; check the base link")
    notes.append(
        f"base_link: {FLOOR_FRAME}, a frame that the robot file adds {-offsets[name]:.3f} m below "
        f"{name}, at the base's lowest point; its x axis is assumed to point forward"
    )
    return FLOOR_FRAME, frame


def find_footprint(
    model: Articulated, base_link: str, firsts: Sequence[str], notes: list[str]
) -> Float[np.ndarray, "k 2"]:
    """Return the outline of everything that does not move with an arm, seen from above."""
    from scipy.spatial import ConvexHull

    points = points_of(model, base_link, base_links(model, firsts))[:, :2]
    outline = points[ConvexHull(points).vertices]
    if len(outline) > MAX_CORNERS:
        # Circumscribe it with the intersections of neighboring tangents.
        angle = np.arange(MAX_CORNERS) * 2 * np.pi / MAX_CORNERS
        normal = np.stack([np.cos(angle), np.sin(angle)], -1)
        reach = (outline @ normal.T).max(0)
        pairs = np.stack([normal, np.roll(normal, -1, 0)], 1)
        ends = np.stack([reach, np.roll(reach, -1)], -1)
        outline = np.linalg.solve(pairs, ends[..., None])[..., 0]
        outline = outline[np.linalg.norm(outline - np.roll(outline, 1, 0), axis=1) > 1e-4]
    size = np.ptp(outline, axis=0)
    notes.append(f"footprint: outline of the base's geometry, {size[0]:.2f} x {size[1]:.2f} m")
    return outline


def find_drive(model: Articulated, anchor: str, boxed: bool, notes: list[str]) -> str:
    """Guess the drive from the names of the wheels."""
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    if any(_OMNI.search(name) for name in names):
        notes.append("drive: omni, by the names of its wheels")
        return "omni"
    wheels = any(WHEEL.search(name) for name in names)
    if not (wheels or boxed or anchor != model.urdf.root or model.urdf.rigid):
        notes.append(
            "IMPORTANT: there are no wheels; a mobile robot needs a base: --on-box of momapos "
            "robot check or [mount] puts an arm on one"
        )
    sideways = [
        joint.name
        for joint in model.urdf.joints
        if joint.kind == "prismatic" and anchor in model.links_below(joint.child)
    ]
    also = (
        f"; {', '.join(sideways)} slide: use omni if the base drives sideways" if sideways else ""
    )
    notes.append(f"drive: differential, with guessed speeds{also}")
    return "differential"


def outside(points: Float[np.ndarray, "n 3"], footprint: Float[np.ndarray, "k 2"]) -> float:
    """Return how far points protrude from a footprint [m]."""
    edge = np.roll(footprint, -1, 0) - footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, footprint)
    return float((points[:, :2] @ normal.T - offset).max())
