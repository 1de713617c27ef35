"""Guess the base of a robot: the link on the floor, the footprint and the drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import RobotError
from momapos.core.geometry import apply, invert, rpy_of
from momapos.model.urdf import Articulated

from .amended_urdf import AddedFrame
from .gripper_guess import fixed_to, points_of
from .joint_tree import find_anchor
from .running_gear import (
    MIN_TRAIL,
    OMNI,
    WHEEL,
    DrivePlugin,
    RunningGear,
    Wheel,
    drawn_meshes,
    find_running_gear,
)

if TYPE_CHECKING:
    from jaxtyping import Float


PARALLEL_COSINE = 0.985
"""Cosine between axles from which they count as parallel [-]."""
COAXIAL = 0.03
"""Distance along the base between wheels that share an axle [m]."""
MIN_RADIUS = 0.02
"""Turning radius below which a base turns on the spot [m]."""
ASSUMED_STEERING = 0.5
"""Largest steering angle of a car-like base whose file states none [rad]; 28.6 degrees, a little
less than most vehicles steer, so that the assumed radius is rather too large."""
MAX_RADIUS = 100.0
"""Turning radius from which steering counts as stuck to one side [m]."""


@dataclass(frozen=True, eq=False)
class DriveGuess:
    """How a base drives."""

    drive: Literal["differential", "omni", "car"]
    why: str
    """One sentence."""
    ahead: Float[np.ndarray, "2"] | None = None
    """Unit vector along which it drives, either way, in the anchor's frame; None if any."""
    radius: float = 0.0
    """Least turning radius of the middle of its fixed axle, or of its wheels if all are steered
    [m]; 0 if it turns on the spot."""
    wheelbase: float = 0.0
    """Distance between steered wheels and that axle or middle [m]; 0 without steering."""
    axle: Float[np.ndarray, "2"] | None = None
    """That middle in the anchor's frame [m]: the point that never moves sideways."""
    doubt: str = ""
    """What the user should check."""
    skids: bool = False
    """Whether its wheels roll along parallel axles only, so that it skids in turns."""


def drive_by_wheels(model: Articulated) -> DriveGuess | None:
    """Derive the drive of a robot from the wheels in its URDF; None if they do not tell."""
    if model.urdf.path is None:
        return None
    anchor = find_anchor(model, [])
    try:
        gear = find_running_gear(model, anchor, drawn_meshes(None, model.urdf.path))
    except RobotError:  # a wheel without an axis
        return None
    return drive_of(gear)


def drive_of(gear: RunningGear) -> DriveGuess | None:
    """Derive the drive of a base from its wheels; None if it has no wheels that drive it.

    Wheels that the file fixes count as if they rolled. If only some are fixed, there is a doubt.
    """
    guess, wheels = _drive_of(gear), [wheel for wheel in gear.wheels if not wheel.caster]
    fixed = [wheel.link for wheel in wheels if wheel.fixed]
    if guess is None or guess.doubt or len(fixed) in (0, len(wheels)):
        return guess
    doubt = f"{_named(fixed)} cannot roll in this file, but counts as if it did; check drive"
    return replace(guess, doubt=doubt)


def _drive_of(gear: RunningGear) -> DriveGuess | None:
    wheels = [wheel for wheel in gear.wheels if not wheel.caster]
    rolling = [wheel for wheel in wheels if not wheel.steering]
    steered = [wheel for wheel in wheels if wheel.steering]
    if rolling:  # wheels that trail behind a free steering axis are casters next to others
        steered = [wheel for wheel in steered if not (wheel.free and wheel.trail > MIN_TRAIL)]
    limited = [wheel for wheel in steered if not wheel.free]
    if not rolling and not steered:
        modules = {wheel.steering for wheel in gear.wheels if wheel.free}
        return _swerve(len(modules)) if len(modules) > 1 else None
    if limited:
        return _steered(limited, rolling)
    if not rolling:
        return _swerve(len({wheel.steering for wheel in steered}))
    unlimited = [wheel for wheel in steered if wheel.unlimited]
    if unlimited:
        return _steered([_assumed(wheel) for wheel in unlimited], rolling, "have no limits")
    locked = [wheel for wheel in rolling if wheel.locked]
    if locked and len(locked) < len(rolling):
        fixed = [wheel for wheel in rolling if not wheel.locked]
        return _steered([_assumed(wheel) for wheel in locked], fixed, "cannot move in this file")
    if len(rolling) < 2:
        return None
    guess = _unsteered(rolling, gear)
    if gear.locked and guess.drive == "differential":
        why = f"{_named(gear.locked)} would steer its wheels, but cannot move in this file"
        return DriveGuess("car", why, guess.ahead)
    return guess


def _assumed(wheel: Wheel) -> Wheel:
    """Return a wheel with the assumed steering angle, of a file that states none."""
    steering = wheel.steering or wheel.locked
    return replace(wheel, steering=steering, least=-ASSUMED_STEERING, most=ASSUMED_STEERING)


def _swerve(modules: int) -> DriveGuess:
    joints = f"{modules} steering joints point" if modules > 1 else "a steering joint points"
    return DriveGuess("omni", f"{joints} its wheels in every direction (swerve drive)")


def _steered(limited: Sequence[Wheel], rolling: Sequence[Wheel], unknown: str = "") -> DriveGuess:
    """Return the drive of a base with limited steering: car-like, or it turns on the spot.

    The wheels roll without sliding if all their axles meet in one point (Ackermann). It is on the
    fixed axle, or on the line across the middle if all wheels are steered.

    Args:
        limited: The steered wheels.
        rolling: The others.
        unknown: Why the steering angle is assumed; "" if the file states it.
    """
    base = rolling or limited
    ahead = base[0].ahead
    middle = np.mean([wheel.center[:2] for wheel in base], axis=0)
    across = np.array([-ahead[1], ahead[0]])
    radius = max(
        _radius(wheel, (wheel.center[:2] - middle) @ np.stack([ahead, side * across], -1), side)
        for wheel in limited
        for side in (1, -1)
    )
    wheelbase = float(np.mean([abs((w.center[:2] - middle) @ ahead) for w in limited]))
    joints = list(dict.fromkeys(wheel.steering for wheel in limited))
    names = f"{_named(joints)} {'steer' if len(joints) > 1 else 'steers'}"
    turn = min(min(-wheel.least, wheel.most) for wheel in limited)
    if not rolling and wheelbase < COAXIAL:
        why = f"{names} by at most {turn:.2f} rad, and no wheel shows the fixed axle"
        return DriveGuess("car", f"{why}, so its turning radius is unknown", ahead)
    if radius >= MAX_RADIUS:
        why = f"{names} to one side only"
        return DriveGuess("car", f"{why}, so its turning radius is unknown", ahead)
    if radius < MIN_RADIUS:
        why = f"{names} far enough to turn about the middle of the fixed axle"
        return DriveGuess("differential", why, ahead)
    limits = f"by at most {turn:.2f} rad"
    doubt = ""
    if unknown:
        limits += f", an assumption because {_named(joints)} {unknown},"
        doubt = (
            f"{_named(joints)} {unknown}: a steering angle of {turn:.2f} rad is assumed, so a "
            f"least turning radius of {radius:.2f} m; correct base.min_turning_radius"
        )
    return DriveGuess(
        "car",
        f"{names} {limits} at a wheelbase of {wheelbase:.2f} m, so its "
        f"least turning radius is {radius:.2f} m",
        ahead, radius, wheelbase, middle, doubt,
    )  # fmt: skip


def _radius(wheel: Wheel, place: Float[np.ndarray, "2"], side: int) -> float:
    """Return the least radius of a turn to one side for which a wheel can be steered.

    Args:
        wheel: The wheel.
        place: Its position ahead and toward that side of the reference point [m].
        side: 1 for the left, -1 for the right.
    """
    ahead, aside = float(place[0]), float(place[1])
    # Wheels ahead of the axle turn toward the side, those behind it away from it.
    toward = wheel.most if side * np.sign(ahead or 1.0) > 0 else -wheel.least
    if abs(ahead) < 1e-6:
        return 0.0
    if toward <= 0.0:
        return float("inf")
    if toward >= np.pi / 2:
        return max(aside, 0.0)
    return max(aside + abs(ahead) / float(np.tan(toward)), 0.0)


def _unsteered(wheels: Sequence[Wheel], gear: RunningGear) -> DriveGuess:
    """Return the drive of a base with wheels that are not steered."""
    plain = [wheel for wheel in wheels if not wheel.rollers]
    if len(wheels) > 2 and (not plain or (gear.words and len(plain) == len(wheels))):
        return DriveGuess("omni", f"its {len(wheels)} wheels have rollers, by joints or names")
    wheels = plain if len(plain) > 1 else list(wheels)
    axles = np.array([wheel.axle[:2] for wheel in wheels])
    if np.abs(axles @ axles.T).min() < PARALLEL_COSINE:
        if len(wheels) > 2:
            return DriveGuess(
                "omni", f"the axles of its {len(wheels)} wheels point in different directions, so "
                "these roll sideways, too"
            )  # fmt: skip
        return DriveGuess("differential", "two wheels", doubt="the axles of its wheels differ")
    ahead = wheels[0].ahead
    places = np.array([wheel.center[:2] for wheel in wheels])
    along, across = places @ ahead, places @ [-ahead[1], ahead[0]]
    if np.ptp(across) < COAXIAL:
        line = "its wheels are in one line: it needs balance, or more wheels"
        return DriveGuess("differential", "its wheels do not steer", ahead, doubt=line)
    if np.ptp(along) < COAXIAL:
        return DriveGuess("differential", f"its {len(wheels)} driven wheels share one axle", ahead)
    doubt = (
        "its wheels share no axle and do not steer, so it turns on the spot by skidding; if they "
        "are mecanum wheels, set drive to omni; if it is a car-like base whose steering was left "
        "out, set drive to car, and min_turning_radius"
    )
    why = f"its {len(wheels)} wheels do not steer and have parallel axles (skid steering)"
    return DriveGuess("differential", why, ahead, doubt=doubt, skids=True)


def _named(names: Sequence[str]) -> str:
    return " and ".join(([", ".join(names[:-1])] if len(names) > 1 else []) + [names[-1]])


FLOOR_TOLERANCE = 0.005
"""Maximum distance of the floor from z = 0 of the base link [m]; hulls of round wheels reach 1 mm
too low."""
MAX_GROUND_CLEARANCE = 0.03
"""Maximum height of the base's lowest point above z = 0 of the base link, if no wheel has a shape
that shows the floor [m]."""
MAX_WHEEL_HEIGHT = 0.15
"""Maximum height of the geometry above a base_footprint link, if the wheels have none [m]."""
MAX_MOUNT_SIZE = 0.35
"""Size below which a base without wheels may be only the foot of an arm [m]."""
MAX_PLATE_HEIGHT = 0.05
"""Height up to which a small body on the floor is only a mounting plate [m]."""
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
    small = not len(points) or float(np.ptp(points[:, :2], axis=0).max()) < MAX_MOUNT_SIZE
    if small and not _stands_on_the_floor(model, firsts):
        raise RobotError(
            f"{model.urdf.path}: the arm has no base: there are no wheels and no geometry on the "
            "floor; put it on a driving box with --on-box LENGTHxWIDTHxHEIGHT of momapos robot "
            "check, or on another base by momapos robot build (docs/robots.md)"
        )


def _stands_on_the_floor(model: Articulated, firsts: Sequence[str]) -> bool:
    """Return whether a box, or a link below the one that carries an arm, stands on the floor.

    The lowest body of an arm alone is its own foot, of any shape, or a plate.
    """
    feet = {model.joint(name).parent for name in firsts}
    bodies = [
        (link, shape.kind, float(z.min()), float(z.max()))
        for link in base_links(model, firsts)
        for shape, hull in zip(model.urdf.links[link].collisions, model.hulls[link], strict=True)
        for z in [apply(model.rest_poses[link], hull.vertices)[:, 2]]
    ]
    standing = [
        kind == "box" or link not in feet
        for link, kind, low, high in bodies
        if abs(low) < FLOOR_TOLERANCE and high > MAX_PLATE_HEIGHT
    ]
    return any(standing)


def floor_range(model: Articulated, base_link: str, links: Sequence[str]) -> tuple[float, float]:
    """Return between which heights of the lowest point z = 0 of a base link is on the floor [m].

    A wheel with a shape shows where the floor is.

    Args:
        model: The robot.
        base_link: The link.
        links: The links that no arm moves.
    """
    if base_link == "base_footprint":
        return -FLOOR_TOLERANCE, MAX_WHEEL_HEIGHT
    rolling = {joint.child for joint in model.joints.values() if joint.kind == "continuous"}
    wheels = points_of(
        model, base_link, [name for name in links if name in rolling or WHEEL.search(name)]
    )
    low = float(points_of(model, base_link, links)[:, 2].min())
    shown = len(wheels) > 0 and float(wheels[:, 2].min()) < low + FLOOR_TOLERANCE
    return -FLOOR_TOLERANCE, FLOOR_TOLERANCE if shown else MAX_GROUND_CLEARANCE


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
        low, (least, most) = float(points[:, 2].min()), floor_range(model, name, body)
        if least <= low <= most:
            above = f", by its name; the geometry starts {low:.2f} m above it"
            named = name == "base_footprint" and low > MAX_GROUND_CLEARANCE
            notes.append(f"base_link: {name}{above if named else f'; {forward}'}")
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
    plugin: DrivePlugin | None,
    notes: list[str],
) -> str:
    """Return the drive that wheels and simulation tell, or guess it from names.

    Args:
        model: The robot.
        anchor: Root of what drives.
        boxed: Whether an arm stands on a driving box.
        guess: What the wheels tell.
        plugin: Plugin that drives the base in its maker's simulation; None without one.
        notes: Receives the reason.
    """
    if guess is not None and not boxed:
        guess = _weighed(guess, plugin)
        notes.append(f"drive: {guess.drive}: {guess.why}; speeds are guesses")
        if guess.doubt:
            notes.append(f"IMPORTANT: drive: {guess.doubt}")
        return guess.drive
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    if any(OMNI.search(name) for name in names):
        notes.append("drive: omni, by the names of its wheels")
        return "omni"
    if plugin is not None and not boxed:
        drive = "omni" if plugin.sideways else "differential"
        notes.append(
            f"drive: {drive}: {plugin.words} in its simulation, and no wheels tell; set "
            f"{'differential' if plugin.sideways else 'omni'} if the real base differs"
        )
        return drive
    if not (_named_wheels(model) or boxed or anchor != model.urdf.root or model.urdf.rigid):
        notes.append(
            "IMPORTANT: there are no wheels; a mobile robot needs a base: --on-box of momapos "
            "robot check or robot build puts an arm on one"
        )
    sideways = [
        joint.name
        for joint in model.urdf.joints
        if joint.kind == "prismatic" and anchor in model.links_below(joint.child)
    ]
    also = (
        f"; {', '.join(sideways)} slide: use omni if the base drives sideways" if sideways else ""
    )
    important = "" if boxed else "IMPORTANT: "
    notes.append(
        f"{important}drive: differential is a guess, as are its speeds; no wheels tell{also}"
    )
    return "differential"


def _weighed(guess: DriveGuess, plugin: DrivePlugin | None) -> DriveGuess:
    """Return what the wheels tell, together with the maker's simulation.

    Mecanum wheels look as wheels that skid, so there the simulation decides. Elsewhere the wheels
    do, and a contradiction is a doubt.
    """
    if plugin is None:
        return guess
    if plugin.sideways == (guess.drive == "omni"):
        why = f"{guess.why}, and {plugin.words}"
        return replace(guess, why=why, doubt="") if guess.skids else guess
    if guess.skids:
        why = f"its wheels have parallel axles, and {plugin.words}: mecanum wheels"
        return replace(guess, drive="omni", why=why, doubt="", skids=False)
    doubt = f"{plugin.words} in its simulation; set drive if the wheels of the file are wrong"
    return replace(guess, doubt="; ".join(filter(None, (guess.doubt, doubt))))


def outside(points: Float[np.ndarray, "n 3"], footprint: Float[np.ndarray, "k 2"]) -> float:
    """Return how far points protrude from a footprint [m]."""
    edge = np.roll(footprint, -1, 0) - footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, footprint)
    return float((points[:, :2] @ normal.T - offset).max())
