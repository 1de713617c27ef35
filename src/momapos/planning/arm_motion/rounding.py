"""Round the corners of arm paths, so that the arm does not stop at them.

A corner becomes a quintic Bezier curve that leaves and joins the path with its direction and
without curvature, so that the rounded path has continuous curvature. It lies in the triangle of its
corner, and is checked like the path itself: what is free is what the arm executes.
"""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

    from momapos.model.collision import StraightMotions

CORNER = np.radians(10.0)
"""Smaller turns between two steps are no corners: the arm does not stop at them [rad]."""
MAX_TURN = np.radians(2.0)
"""Mean turn between states of a rounded corner; the largest is up to four times as large [rad]."""
MAX_LENGTH = 1.0
"""Largest length of the path before and after a corner that is replaced [rad] or [m]."""
MIN_LENGTH = 0.01
"""The arm stops at a corner that cannot be rounded over this length [rad] or [m]."""
TRIES = 4
"""Lengths that are tried, each half of the one before [-]."""
HANDLE = 0.3
"""Distance of the curve's control points, as a share of the length that it replaces. At 0.2 the
curve bends most at its ends, at 0.5 in its middle [-]."""
_BERNSTEIN = np.array([comb(5, k) for k in range(6)])


def fill_curve(states: Float[np.ndarray, "m n"], step: float) -> Float[np.ndarray, "k n"]:
    """Add states on the cubic spline through the states of a curve.

    Args:
        states: States of a path without corners, such as one that follows a tool pose.
        step: Largest joint step between the states returned, nearly [rad] or [m].
    """
    largest = np.abs(np.diff(states, axis=0)).max(initial=0.0)
    pieces = int(np.ceil(largest / step - 1e-9))
    if len(states) < 3 or pieces < 2:
        return states
    slope = spline_slopes(states)
    change, share = np.diff(states, axis=0)[:, None], np.arange(pieces)[None, :, None] / pieces
    begin, end = (slope[part, None] for part in (slice(-1), slice(1, None)))
    bend = begin + end - 2.0 * change
    # The cubic of each step that has the values and slopes of its ends.
    inside = begin + share * (change - begin - bend + share * bend)
    filled = (states[:-1, None] + share * inside).reshape(-1, states.shape[1])
    return np.concatenate([filled, states[-1:]])


def spline_slopes(states: Float[np.ndarray, "m n"]) -> Float[np.ndarray, "m n"]:
    """Return the slopes of the not-a-knot cubic spline through evenly spaced values, at these.

    The second derivative is continuous everywhere, and the third at the second value and at the
    last but one. Through three values this is a parabola.

    Source: de Boor, "A Practical Guide to Splines" (1978), chapter IV.

    Args:
        states: At least three values, one step apart.
    """
    change = np.diff(states, axis=0)
    inner = 3.0 * (change[:-1] + change[1:])
    first = 0.5 * (5.0 * change[0] + change[1])  # slope of the first value + 2 * of the second
    last = 0.5 * (change[-2] + 5.0 * change[-1])
    inner[0], inner[-1] = inner[0] - first, inner[-1] - last
    size = len(inner)
    if size == 1:
        middle = 0.5 * (change[:1] + change[1:])
    else:
        matrix = 4.0 * np.eye(size) + np.eye(size, k=1) + np.eye(size, k=-1)
        matrix[0, 0] = matrix[-1, -1] = 2.0
        middle = np.asarray(np.linalg.solve(matrix, inner), float)
    return np.concatenate([[first - 2.0 * middle[0]], middle, [last - 2.0 * middle[-1]]])


def round_corners(
    states: Float[np.ndarray, "m n"], free: StraightMotions, step: float
) -> Float[np.ndarray, "k n"]:
    """Replace the corners of a path by curves that are free; corners without one remain.

    Args:
        states: States of the path, close together.
        free: The check of straight motions.
        step: Largest joint step between states of a curve [rad] or [m].

    Returns:
        The states between the curves, and states of the curves.
    """
    moved = np.append(True, np.abs(np.diff(states, axis=0)).max(1, initial=0.0) > 1e-9)
    q = states[moved]
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    along = np.append(0.0, np.cumsum(lengths))
    directions = np.diff(q, axis=0) / lengths[:, None]
    cosine = np.einsum("ij,ij->i", directions[:-1], directions[1:])
    corners = np.flatnonzero(cosine < np.cos(CORNER)) + 1
    ends = np.concatenate([along[:1], along[corners], along[-1:]])
    parts, kept = [], 0
    for corner, before, after in zip(
        corners.tolist(), *(np.diff(ends)[i:][: len(corners)] for i in (0, 1)), strict=True
    ):
        longest = min(before / 2, after / 2, MAX_LENGTH)
        angle = float(np.arccos(np.clip(cosine[corner - 1], -1.0, 1.0)))
        for length in longest * 0.5 ** np.arange(TRIES):
            if length < MIN_LENGTH:
                break
            curve = _curve(q, along, directions, along[corner], length, step, angle)
            if free.along(curve):
                first = int(np.searchsorted(along, along[corner] - length - 1e-9))
                parts += [q[kept:first], curve]
                kept = int(np.searchsorted(along, along[corner] + length + 1e-9))
                break
    return np.concatenate([*parts, q[kept:]])


def _curve(
    q: Float[np.ndarray, "m n"],
    along: Float[np.ndarray, " m"],
    directions: Float[np.ndarray, "l n"],
    corner: float,
    length: float,
    step: float,
    angle: float,
) -> Float[np.ndarray, "k n"]:
    """Return states of the curve that replaces a corner.

    Args:
        q: States of the path.
        along: Position of each state along the path.
        directions: Unit direction from each state to the next.
        corner: Position of the corner.
        length: Length of the path before and after the corner that is replaced.
        step: Largest joint step [rad] or [m].
        angle: Angle of the corner [rad].
    """
    ends = np.array([corner - length, corner + length])
    # The segment that contains each end; at the corner's side if the end is a state.
    at = np.array(
        [np.searchsorted(along, ends[0] + 1e-9) - 1, np.searchsorted(along, ends[1] - 1e-9) - 1]
    )
    points = q[at] + (ends - along[at])[:, None] * directions[at]
    out = HANDLE * length * np.arange(3)[:, None]
    control = np.concatenate([
        points[0] + out * directions[at[0]], (points[1] - out * directions[at[1]])[::-1]
    ])  # fmt: skip
    count = int(np.ceil(max(2.0 * length / step, angle / MAX_TURN, 4.0)))
    t = np.linspace(0.0, 1.0, count + 1)[:, None]
    k = np.arange(6)
    return np.asarray((_BERNSTEIN * t**k * (1.0 - t) ** (5 - k)) @ control)
