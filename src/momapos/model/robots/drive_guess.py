"""Derive how a base drives from its wheels: which ways their axles and steering let it move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import RobotError
from momapos.model.urdf import Articulated

from .joint_tree import find_anchor
from .running_gear import MIN_TRAIL, RunningGear, Wheel, drawn_meshes, find_running_gear

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
    """Derive the drive of a base from its wheels; None if it has no wheels that drive it."""
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
    return DriveGuess("differential", why, ahead, doubt=doubt)


def _named(names: Sequence[str]) -> str:
    return " and ".join(([", ".join(names[:-1])] if len(names) > 1 else []) + [names[-1]])
