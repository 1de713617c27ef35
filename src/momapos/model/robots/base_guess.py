"""The base of a robot, guessed: the link on the floor, the footprint, how it drives."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.model.urdf import Articulated

from .amended_urdf import Frame
from .gripper_guess import fixed_to, points_of
from .joint_tree import WHEEL

if TYPE_CHECKING:
    from jaxtyping import Float

_OMNI = re.compile(r"mecanum|omni|swerve", re.I)
FLOOR_TOLERANCE = 0.03
"""How far the lowest point of the base may be from the base link's z = 0 [m]."""
WHEELS_HIGH = 0.15
"""How far above a link called base_footprint the geometry may begin, where wheels have none [m]."""
SMALL = 0.35
"""A base without wheels, smaller than this, is what an arm is screwed down with [m]."""
FLOOR_FRAME = "base_floor"
MAX_CORNERS = 16


def base_links(model: Articulated, firsts: Sequence[str]) -> list[str]:
    """Links that no joint moves: those of the base, where these are the first ones of all arms."""
    moved = {link for joint in firsts for link in model.moved_by(joint)}
    return [name for name in model.links if name not in moved]


def refuse_without_base(model: Articulated, anchor: str, firsts: Sequence[str]) -> None:
    """Make sure that the robot is more than an arm.

    Raises:
        RobotError: It is not; the message says what would help.
    """
    driving = anchor != model.urdf.root or bool(model.urdf.rigid)
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    wheels = any(WHEEL.search(name) or _OMNI.search(name) for name in names)
    if driving or wheels:
        return
    points = points_of(model, model.urdf.root, base_links(model, firsts))
    if not len(points) or float(np.ptp(points[:, :2], axis=0).max()) < SMALL:
        raise RobotError(
            f"{model.urdf.path}: an arm without a base: it has no wheels and nothing that stands "
            "on the floor; to put it on a box that drives, add --on-box 0.6x0.5x0.7 (length, "
            "width, height in m), and for another base see [mount] in docs/robots.md"
        )


def lift_as_base(model: Articulated, joints: Sequence[str], notes: list[str]) -> tuple[str, ...]:
    """The arm's joints without a lift that carries all geometry of the base.

    Simulators raise a whole robot so; what is below it has no geometry, and would be no base.
    """
    rest = list(joints)
    while len(rest) > 1 and not len(points_of(model, model.urdf.root, base_links(model, rest[:1]))):
        joint = model.joint(rest[0])
        if joint.kind != "prismatic":
            raise RobotError(
                f"{model.urdf.path}: no link below the arm has collision geometry; add the base's"
            )
        notes.append(f"{joint.name} lifts all that has collision geometry: it is kept at rest")
        rest.pop(0)
    return tuple(rest)


def find_base_link(
    model: Articulated, anchor: str, firsts: Sequence[str], notes: list[str]
) -> tuple[str, Frame | None]:
    """A link fixed to the base whose z = 0 is the floor; or a frame that must be added there."""
    rigid = fixed_to(model, anchor)
    usual: tuple[str, ...] = ("base_footprint", "base_link")
    preferred = [name for name in usual if name in rigid]
    body = base_links(model, firsts)
    offsets = {}
    for name in dict.fromkeys([*preferred, anchor, *rigid]):
        points = points_of(model, name, body)
        if not len(points):
            raise RobotError(
                f"{model.urdf.path}: no link below the arm has collision geometry; add the base's"
            )
        offsets[name] = low = float(points[:, 2].min())
        if abs(low) <= FLOOR_TOLERANCE:
            notes.append(f"base_link: {name}, whose x axis is taken as forward")
            return name, None
        if name == "base_footprint" and 0 < low < WHEELS_HIGH:
            notes.append(
                f"base_link: {name}, by its name; the geometry begins {low:.2f} m above it"
            )
            return name, None
    name = (preferred or [anchor])[-1]
    frame = Frame(FLOOR_FRAME, name, (0.0, 0.0, round(offsets[name], 4)))
    if model.rest_poses[name][2, 2] < 0.999:
        notes.append(f"IMPORTANT: the z axis of {name} does not point up; is it the base?")
    notes.append(
        f"base_link: {FLOOR_FRAME}, a frame that the robot file adds {-offsets[name]:.3f} m below "
        f"{name}, where the base's lowest point is; its x axis is taken as forward"
    )
    return FLOOR_FRAME, frame


def find_footprint(
    model: Articulated, base_link: str, firsts: Sequence[str], notes: list[str]
) -> Float[np.ndarray, "k 2"]:
    """Outline of all that does not move with an arm, seen from above."""
    from scipy.spatial import ConvexHull

    points = points_of(model, base_link, base_links(model, firsts))[:, :2]
    outline = points[ConvexHull(points).vertices]
    if len(outline) > MAX_CORNERS:
        # Around it, so that nothing sticks out: where neighboring tangents meet.
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
    """How the base drives, by the names of its wheels."""
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    if any(_OMNI.search(name) for name in names):
        notes.append("drive: omni, as its wheels are named so")
        return "omni"
    wheels = any(WHEEL.search(name) for name in names)
    if not (wheels or boxed or anchor != model.urdf.root or model.urdf.rigid):
        notes.append(
            "IMPORTANT: there are no wheels: is this a mobile robot? An arm alone needs a base, "
            "see --on-box"
        )
    sideways = [
        joint.name
        for joint in model.urdf.joints
        if joint.kind == "prismatic" and anchor in model.links_below(joint.child)
    ]
    also = f"; {', '.join(sideways)} slide: if it can drive sideways, say omni" if sideways else ""
    notes.append(f"drive: differential, with speeds that are a guess{also}")
    return "differential"


def outside(points: Float[np.ndarray, "n 3"], footprint: Float[np.ndarray, "k 2"]) -> float:
    """How far points stick out of a footprint [m]."""
    edge = np.roll(footprint, -1, 0) - footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, footprint)
    return float((points[:, :2] @ normal.T - offset).max())
