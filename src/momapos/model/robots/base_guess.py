"""Guess the base of a robot: the link on the floor, the footprint and the drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.core.geometry import apply, invert, rpy_of
from momapos.model.urdf import Articulated

from .amended_urdf import AddedFrame
from .drive_guess import DriveGuess
from .gripper_guess import fixed_to, points_of
from .running_gear import OMNI, WHEEL, RunningGear

if TYPE_CHECKING:
    from jaxtyping import Float

FLOOR_TOLERANCE = 0.03
"""Maximum height of the base's lowest point above or below z = 0 of the base link [m]."""
MAX_WHEEL_HEIGHT = 0.15
"""Maximum height of the geometry above a base_footprint link, if the wheels have none [m]."""
MAX_MOUNT_SIZE = 0.35
"""Size below which a base without wheels is only the mounting plate of an arm [m]."""
UPRIGHT_COSINE = 0.999
"""Least cosine between the z axis of a base link and the vertical [-]."""
AHEAD_COSINE = 0.95
"""Least cosine between the x axis of a base link and the direction in which its wheels roll [-]."""
AXLE_TOLERANCE = 0.01
"""Largest distance of a car-like base's base link from the middle of its fixed axle [m]; at a
turning radius of 0.5 m the base link then moves sideways by 2 % of its path."""
FLOOR_FRAME = "base_floor"
MAX_CORNERS = 16


def base_links(model: Articulated, firsts: Sequence[str]) -> list[str]:
    """Return the links that no joint moves; for the first joints of all arms, the base's links."""
    moved = {link for joint in firsts for link in model.moved_by(joint)}
    return [name for name in model.links if name not in moved]


def refuse_without_base(
    model: Articulated, anchor: str, firsts: Sequence[str], gear: RunningGear
) -> None:
    """Check that the robot has more than an arm.

    Raises:
        RobotError: It has no base; the message says how to add one.
    """
    driving = anchor != model.urdf.root or bool(model.urdf.rigid)
    if driving or gear.wheels or _named_wheels(model):
        return
    points = points_of(model, model.urdf.root, base_links(model, firsts))
    if not len(points) or float(np.ptp(points[:, :2], axis=0).max()) < MAX_MOUNT_SIZE:
        raise RobotError(
            f"{model.urdf.path}: the arm has no base: there are no wheels and no geometry on the "
            "floor; put it on a driving box with --on-box LENGTHxWIDTHxHEIGHT of momapos robot "
            "check, or on another base with [mount] in a robot file (docs/robots.md)"
        )


def _named_wheels(model: Articulated) -> bool:
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    return any(WHEEL.search(name) or OMNI.search(name) for name in names)


def refuse_unknown_axle(model: Articulated, guess: DriveGuess | None) -> None:
    """Check that a car-like base shows about which axle it turns.

    Raises:
        RobotError: It does not; the message says what is missing.
    """
    if guess is not None and guess.drive == "car" and guess.axle is None:
        raise RobotError(
            f"{model.urdf.path}: the base is car-like: {guess.why}; give the steering joints "
            "limits and the other wheels joints, or write a robot file with base_link at the "
            'middle of the fixed axle, base.drive = "car" and base.min_turning_radius '
            "(docs/robots.md)"
        )


def _without_shapes(model: Articulated) -> RobotError:
    return RobotError(
        f"{model.urdf.path}: no link below the arm has collision geometry; add the collision "
        "geometry of the base or, if it is drawn, let the hulls of its drawings count with "
        "--visual-hulls of momapos robot check"
    )


def lift_as_base(model: Articulated, joints: Sequence[str], notes: list[str]) -> tuple[str, ...]:
    """Return the arm's joints without a lift that carries all geometry of the base.

    Some simulators lift a whole robot this way; the links below the lift have no geometry.
    """
    rest = list(joints)
    while len(rest) > 1 and not len(points_of(model, model.urdf.root, base_links(model, rest[:1]))):
        joint = model.joint(rest[0])
        if joint.kind != "prismatic":
            raise _without_shapes(model)
        notes.append(f"{joint.name} lifts all collision geometry: it stays at rest")
        rest.pop(0)
    return tuple(rest)


def find_base_link(
    model: Articulated,
    anchor: str,
    firsts: Sequence[str],
    gear: RunningGear,
    guess: DriveGuess | None,
    notes: list[str],
) -> tuple[str, AddedFrame | None]:
    """Find a link fixed to the base with z = 0 on the floor, z up and x ahead, or define a frame.

    The wheels tell where up and ahead are. Without any, these are z and x of the root. The base
    link of a car-like base is at the middle of its fixed axle, which never moves sideways.
    """
    rigid = fixed_to(model, anchor)
    usual: tuple[str, ...] = ("base_footprint", "base_link")
    preferred = [name for name in usual if name in rigid]
    body = base_links(model, firsts)
    up, ahead, seen = _directions(model, anchor, firsts, gear, guess)
    forward = "it drives along x" if seen else "its x axis is assumed to point forward"
    axle = guess.axle if guess is not None and guess.drive == "car" else None
    turned: dict[str, str] = {}
    for name in dict.fromkeys([*preferred, anchor, *rigid]):
        points = points_of(model, name, body)
        if not len(points):
            raise _without_shapes(model)
        R = model.rest_poses[name][:3, :3]
        if R[:, 2] @ up < UPRIGHT_COSINE or abs(R[:, 0] @ ahead) < AHEAD_COSINE:
            wrong = "z does not point up" if R[:, 2] @ up < UPRIGHT_COSINE else "x is not ahead"
            turned[name] = wrong
            continue
        if axle is not None and off_axle(model, name, anchor, axle) > AXLE_TOLERANCE:
            turned[name] = "it is not at the middle of the fixed axle"
            continue
        low = float(points[:, 2].min())
        if abs(low) <= FLOOR_TOLERANCE:
            notes.append(f"base_link: {name}; {forward}")
            return name, None
        if name == "base_footprint" and 0 < low < MAX_WHEEL_HEIGHT:
            notes.append(
                f"base_link: {name}, by its name; the geometry starts {low:.2f} m above it"
            )
            return name, None
    name = (preferred or [anchor])[-1]
    R = np.stack([ahead, np.cross(up, ahead), up], -1)
    rpy = rpy_of(model.rest_poses[name][:3, :3].T @ R)
    low = float((points_of(model, name, body) @ (model.rest_poses[name][:3, :3].T @ up)).min())
    T_name_world = invert(model.rest_poses[name])
    place, where = T_name_world[:3, :3] @ up * low, "at the base's lowest point"
    if axle is not None:
        middle = apply(model.rest_poses[anchor], np.array([[*axle, 0.0]]))
        away = apply(T_name_world, middle)[0]
        place += away - (away @ (T_name_world[:3, :3] @ up)) * (T_name_world[:3, :3] @ up)
        where = "under the middle of the fixed axle"
    x, y, z = np.round(place, 4) + 0.0
    frame = AddedFrame(FLOOR_FRAME, name, (float(x), float(y), float(z)), rpy)
    why = f" ({name}: {turned[name]})" if name in turned else ""
    notes.append(
        f"base_link: {FLOOR_FRAME}, a frame that the robot file adds {abs(low):.3f} m "
        f"{'below' if low < 0 else 'above'} {name}{why}, {where}; {forward}"
    )
    return FLOOR_FRAME, frame


def off_axle(
    model: Articulated, base_link: str, anchor: str, axle: Float[np.ndarray, "2"]
) -> float:
    """Return how far a base link is from the middle of the fixed axle, seen from above [m].

    Args:
        model: The robot.
        base_link: The base link.
        anchor: Link that carries the base.
        axle: The middle of the fixed axle in the anchor's frame [m].
    """
    T = invert(model.rest_poses[base_link]) @ model.rest_poses[anchor]
    away = apply(T, np.array([[*axle, 0.0]]))[0]
    return float(np.hypot(away[0], away[1]))


def _directions(
    model: Articulated,
    anchor: str,
    firsts: Sequence[str],
    gear: RunningGear,
    guess: DriveGuess | None,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], bool]:
    """Return where up and ahead are in the root's frame, and whether wheels tell ahead."""
    T = model.rest_poses[anchor]
    up = np.array([0.0, 0.0, 1.0])
    if gear.wheels:
        # The base drawn upside down: its wheels are above its body and above its arms.
        wheels = np.mean([apply(T, w.center[None])[0, 2] for w in gear.wheels])
        arms = [model.rest_poses[model.joint(name).child][2, 3] for name in firsts]
        links = {w.link for w in gear.wheels}
        names = [name for name in base_links(model, firsts) if name not in links]
        points = points_of(model, model.urdf.root, names)
        if len(points) and wheels > points[:, 2].mean() and wheels > max(arms):
            up = -up
    if guess is None or guess.ahead is None:
        return up, _level_x(T[:3, 0], up), False
    ahead = T[:3, :2] @ guess.ahead
    # Wheels roll both ways; x of the anchor tells which one is forward, or y if x is across.
    axes = T[:3, 0], T[:3, 1], -T[:3, 0]
    usual = next((axis for axis in axes if abs(axis @ ahead) > AHEAD_COSINE), T[:3, 0])
    return up, _level_x(ahead * np.sign(ahead @ usual), up), True


def _level_x(x: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    level = x - (x @ up) * up
    length = float(np.linalg.norm(level))
    return level / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])


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


def find_drive(
    model: Articulated,
    anchor: str,
    boxed: bool,
    guess: DriveGuess | None,
    plugin: str,
    notes: list[str],
) -> str:
    """Return the drive that the wheels tell, or guess it from names and simulation.

    Args:
        model: The robot.
        anchor: Root of what drives.
        boxed: Whether an arm stands on a driving box.
        guess: What the wheels tell.
        plugin: Plugin that drives the base in any direction in its maker's simulation; "" if none.
        notes: Receives the reason.
    """
    if guess is not None and not boxed:
        notes.append(f"drive: {guess.drive}: {guess.why}; speeds are guesses")
        if guess.doubt:
            notes.append(f"IMPORTANT: drive: {guess.doubt}")
        return guess.drive
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    if any(OMNI.search(name) for name in names):
        notes.append("drive: omni, by the names of its wheels")
        return "omni"
    if plugin and not boxed:
        notes.append(
            f"drive: omni: {plugin} drives it in any direction in its simulation, and no wheels "
            "tell; set differential if the real base cannot"
        )
        return "omni"
    if not (_named_wheels(model) or boxed or anchor != model.urdf.root or model.urdf.rigid):
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
    notes.append(f"drive: differential, with guessed speeds; no wheels tell{also}")
    return "differential"


def outside(points: Float[np.ndarray, "n 3"], footprint: Float[np.ndarray, "k 2"]) -> float:
    """Return how far points protrude from a footprint [m]."""
    edge = np.roll(footprint, -1, 0) - footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, footprint)
    return float((points[:, :2] @ normal.T - offset).max())
