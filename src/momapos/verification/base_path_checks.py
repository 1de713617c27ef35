"""Check a base path without collision geometry: its ends, its steps, what the wheels can do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import wrap_angle

from .path_checks import MAX_MAGNITUDE
from .report import Check, Limits, at_most, verdict

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_SIDEWAYS, SIDEWAYS_SHARE = 3e-4, 0.05
"""A base that cannot drive sideways may move so far in total [m], beyond a share of its path."""
MAX_OVERTURN = math.radians(0.1)
"""A car-like base may turn so far in total beyond what its turning radius allows [rad]."""
MAX_BASE_STEP, MAX_BASE_TURN = 0.05, 0.1
"""Largest distance [m] and turn [rad] between consecutive poses of a base path."""


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


def wheel_checks(
    way: Float[np.ndarray, "k 3"], drive: str | None, radius: float | None
) -> Iterator[Check]:
    """Check that the wheels of the base can follow a base path.

    Tolerances add up over the path, so that many small steps allow no more than a large one.

    Args:
        way: x [m], y [m], yaw [rad].
        drive: "differential", "omni" or "car"; None if unknown, which checks nothing.
        radius: Least turning radius of a car-like base [m].
    """
    if drive is None or drive == "omni":
        return
    step, turn = np.diff(way[:, :2], axis=0), wrap_angle(np.diff(way[:, 2]))
    middle = way[:-1, 2] + turn / 2  # an arc's chord has the heading of its middle
    ahead = np.abs(step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle))
    across = np.abs(step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle))
    beyond = np.maximum(across - SIDEWAYS_SHARE * ahead, 0.0)
    yield at_most(
        "base path moves sideways, which its drive cannot", 1000 * beyond.sum(),
        1000 * MAX_SIDEWAYS, "mm", _largest(beyond),
    )  # fmt: skip
    if drive == "car" and radius is not None:
        over = np.maximum(np.abs(turn) - ahead / radius, 0.0)
        yield at_most(
            "base path turns tighter than the base can", math.degrees(over.sum()),
            math.degrees(MAX_OVERTURN), "deg", _largest(over),
        )  # fmt: skip


def _largest(beyond: Float[np.ndarray, " n"]) -> str:
    return f"most after pose {int(beyond.argmax())}" if beyond.any() else ""


def _max_offset(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> tuple[float, float]:
    """Return the largest distance [m] and turn [rad] between poses."""
    away = a - b
    distance = np.hypot(away[:, 0], away[:, 1]).max(initial=0.0)
    return float(distance), float(np.abs(wrap_angle(away[:, 2])).max(initial=0.0))
