"""Check how the base moves, without collision geometry: ends, steps, what the wheels can do."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle
from momapos.model.records import Motion

from .path_checks import MAX_MAGNITUDE, DensePath
from .report import Check, Limits, at_most, verdict

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_SIDEWAYS, SIDEWAYS_SHARE = 3e-4, 0.05
"""A base that cannot drive sideways may move so far in total [m], beyond a share of its path."""
MAX_OVERTURN = math.radians(0.1)
"""A car-like base may turn so far in total beyond what its turning radius allows [rad]."""
MAX_BASE_STEP, MAX_BASE_TURN = 0.05, 0.1
"""Largest distance [m] and turn [rad] between consecutive poses of a base path."""
MAX_BASE_GAP = 1e-6
"""Largest difference of a plan's base pose and the first one of its manipulation [m] or [rad]."""


def base_path_checks(
    way: Float[np.ndarray, "k 3"], ends: Float[np.ndarray, "2 3"], limits: Limits
) -> Iterator[Check]:
    """Check that a base path leads from the start to the base pose in small steps."""
    if not len(way) or len(way) > limits.states or np.abs([*way, *ends]).max() > MAX_MAGNITUDE:
        yield verdict(f"base path has 1 to {limits.states} poses", False)
        return
    off = _max_offset(way[[0, -1]], ends)
    yield at_most("base path from start to base pose", 1000 * off[0], 1000 * limits.join, "mm")
    yield at_most("base path from start to base pose, turn", off[1], limits.join, "rad")
    step, turn = _max_offset(way[1:], way[:-1])
    yield at_most("step of the base path", 1000 * step, 1000 * MAX_BASE_STEP, "mm")
    yield at_most("turn of the base path", turn, MAX_BASE_TURN, "rad")


def known_base_checks(
    base_pose: tuple[float, float, float], motion: Motion, drive: str | None
) -> Iterator[Check]:
    """Check that a moving base has a pose for each state, and a drive to move with."""
    if motion.base is None:
        return
    fits = motion.base.shape == (len(motion.q), 3)
    yield verdict("one base pose for each state of the manipulation", fits, str(len(motion.base)))
    yield verdict("drive of the moving base is known", drive is not None)
    if fits and len(motion.base):
        off = max(_max_offset(motion.base[:1], np.array([base_pose])))
        name = "base_pose is the first base pose of the manipulation"
        yield at_most(name, off, MAX_BASE_GAP, "rad|m")


def moving_base_checks(
    path: DensePath, motion: Motion, drive: str | None, radius: float | None, limits: Limits
) -> Iterator[Check]:
    """Check that the base can move so during the manipulation, at all interpolated states."""
    if motion.base is None or path.base is None:
        return
    steps = np.abs(np.diff(motion.base, axis=0)).max(1, initial=0.0)
    where = f"state {int(steps.argmax())}" if len(steps) else ""
    yield at_most(
        "largest step of the base", steps.max(initial=0.0), limits.jump, "rad|m", where, "the base"
    )
    driven = path.base[path.approach :]
    yield from wheel_checks(driven, drive, radius, "base", lambda k: path.where(path.approach + k))


def wheel_checks(
    way: Float[np.ndarray, "k 3"],
    drive: str | None,
    radius: float | None,
    what: str = "base path",
    where: Callable[[int], str] = lambda k: f"pose {k}",
) -> Iterator[Check]:
    """Check that the wheels of the base can follow a base path.

    Tolerances add up over the path, so that many small steps allow no more than a large one.

    Args:
        way: x [m], y [m], yaw [rad].
        drive: "differential", "omni" or "car"; None if unknown, which checks nothing.
        radius: Least turning radius of a car-like base [m].
        what: What moves, for the names of the checks.
        where: Names a pose by its index.
    """
    if drive is None or drive == "omni":
        return
    step, turn = np.diff(way[:, :2], axis=0), wrap_angle(np.diff(way[:, 2]))
    middle = way[:-1, 2] + turn / 2  # an arc's chord has the heading of its middle
    ahead = np.abs(step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle))
    across = np.abs(step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle))
    beyond = np.maximum(across - SIDEWAYS_SHARE * ahead, 0.0)
    yield at_most(
        f"{what} moves sideways, which its drive cannot", 1000 * beyond.sum(),
        1000 * MAX_SIDEWAYS, "mm", _largest(beyond, where), "the base",
    )  # fmt: skip
    if drive == "car" and radius is not None:
        over = np.maximum(np.abs(turn) - ahead / radius, 0.0)
        yield at_most(
            f"{what} turns tighter than its drive can", math.degrees(over.sum()),
            math.degrees(MAX_OVERTURN), "deg", _largest(over, where), "the base",
        )  # fmt: skip


def _largest(beyond: Float[np.ndarray, " n"], where: Callable[[int], str]) -> str:
    return f"most after {where(int(beyond.argmax()))}" if beyond.any() else ""


def _max_offset(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
    """Return the largest distance [m] and turn [rad] between poses."""
    away = a - b
    distance = np.hypot(away[:, 0], away[:, 1]).max(initial=0.0)
    return float(distance), float(np.abs(wrap_angle(away[:, 2])).max(initial=0.0))
