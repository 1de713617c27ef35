"""Bring the states of a motion so close together that its executed curve is the checked path.

Straight motions between the states are what is planned and checked. What is executed is a smooth
curve through the states (see `trajectory`), which leaves them where the path bends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .records import Motion

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_CORNER_ANGLE = np.radians(20.0)
"""The arm stops where its path turns by more than this in joint space [rad]."""
MAX_DEVIATION = 0.001
"""How far the executed curve may leave the straight motions between states, about [rad] or [m]: the
tip of an arm of one meter then does by a millimeter, a third of what the exact check tolerates as
overlap."""
MAX_PIECES = 8
"""Largest number of intervals into which one is divided [-]."""
_SAME = 1e-9
"""Nearer states count as equal [rad] or [m]."""
_AT = np.array([0.25, 0.5, 0.75])
"""Where the deviation is measured, as a share of an interval [-]."""

ToolPoses = Callable[["Float[np.ndarray, 'm n']", "Float[np.ndarray, 'm 3'] | None"], np.ndarray]
"""Returns the tool's poses in the world (m, 4, 4) at states of the joints and of a moving base."""


def corners(q: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
    """Return which states, no two of them equal, are corners or ends of the path."""
    steps = np.diff(q, axis=0)
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", unit[:-1], unit[1:])
    return np.concatenate([[True], cosine < np.cos(MAX_CORNER_ANGLE), [True]])


def deviation(q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " k"]:
    """Return by how much the executed curve leaves the straight motion in each interval.

    The largest of all joints counts [rad] or [m].
    """
    if len(q) < 3:
        return np.zeros(max(len(q) - 1, 0))
    s, slopes = _parameters(q)
    bends = _bends(q, s, slopes)
    return np.abs(np.stack([_off(bends, t) for t in _AT])).max((0, 2), initial=0.0)


def with_close_states(motion: Motion, tool_poses: ToolPoses) -> Motion:
    """Add states to the manipulation, on the curve that is executed, see `MAX_DEVIATION`.

    Args:
        motion: A motion without times.
        tool_poses: Returns the tool's poses at states.
    """
    q = motion.q if motion.base is None else np.column_stack([motion.q, motion.base])
    if len(q) < 3:
        return motion
    pieces = np.ceil(np.sqrt(deviation(q) / MAX_DEVIATION) - 1e-9)
    pieces = np.clip(pieces, 1, MAX_PIECES).astype(np.int64)
    if (pieces == 1).all():
        return motion
    (s, slopes), n = _parameters(q), motion.q.shape[1]
    # A joint that turns back does so at its limit at the most.
    states = np.clip(_between(q, _bends(q, s, slopes), pieces), q.min(0), q.max(0))
    base = None if motion.base is None else states[:, n:]

    def along(values: Float[np.ndarray, " m"]) -> Float[np.ndarray, " k"]:
        column = values[:, None]
        return _between(column, _bends(column, s, _monotone(column, s)), pieces)[:, 0]

    new = np.append(0, np.cumsum(pieces))
    Ts = tool_poses(states[:, :n], base)
    Ts[new] = motion.Ts_world_tool
    return replace(
        motion,
        q=states[:, :n],
        base=base,
        object_q=along(motion.object_q),
        latch_q=None if motion.latch_q is None else along(motion.latch_q),
        Ts_world_tool=Ts,
        holds=tuple(
            replace(one, first=int(new[one.first]), last=int(new[one.last])) for one in motion.holds
        ),
    )


def _parameters(
    q: Float[np.ndarray, "m n"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "2 k n"]]:
    """Return the states' positions along the path, and slopes at both ends of each interval.

    The slope at a state is that of the parabola through it and its neighbors. Next to a corner or
    end, where the arm rests, the parabola is that of the neighbor.
    """
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    s = np.append(0.0, np.cumsum(lengths))
    slopes = np.stack([_secants(q, s)] * 2)
    moved = np.flatnonzero(np.append(True, lengths > _SAME))
    if len(moved) < 3:
        return s, slopes
    kept = q[moved]
    h = np.diff(s[moved])
    m = np.diff(kept, axis=0) / h[:, None]
    inner = (h[1:, None] * m[:-1] + h[:-1, None] * m[1:]) / (h[:-1] + h[1:])[:, None]
    stops = corners(kept)[:, None]
    slopes[:, moved[1:] - 1] = _next_to_ends(m, inner, stops[:-1], stops[1:])
    return s, slopes


def _next_to_ends(
    m: Float[np.ndarray, "k c"],
    inner: Float[np.ndarray, "k_minus_1 c"],
    starts: Bool[np.ndarray, "k #c"],
    ends: Bool[np.ndarray, "k #c"],
) -> Float[np.ndarray, "2 k c"]:
    """Return slopes at both ends of each interval, given those at the states between two.

    An interval that starts or ends the curve has one parabola: that of its other end.
    """
    begin, end = np.concatenate([m[:1], inner]), np.concatenate([inner, m[-1:]])
    alone = starts & ends
    return np.stack([
        np.where(starts, np.where(alone, m, 2.0 * m - end), begin),
        np.where(ends, np.where(alone, m, 2.0 * m - begin), end),
    ])  # fmt: skip


def _monotone(
    values: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "2 k c"]:
    """Return slopes with which the curve turns back only where the values do.

    They are those of parabolas, as in `_parameters`, up to three times those of the straight
    motions. Between a rest and a motion the slope jumps. Source: Fritsch and Carlson, Monotone
    Piecewise Cubic Interpolation, SIAM J. Numer. Anal. 17 (1980).
    """
    m, h = _secants(values, s), np.diff(s)[:, None]
    if len(m) < 2:
        return np.stack([m, m])
    a, b = m[:-1], m[1:]
    inner = (h[1:] * a + h[:-1] * b) / np.maximum(h[1:] + h[:-1], _SAME)
    turns = a * b <= 0.0
    starts, ends = (np.pad(turns, (one, (0, 0)), constant_values=True) for one in ((1, 0), (0, 1)))
    slopes = _next_to_ends(m, inner, starts, ends)
    return np.clip(slopes, np.minimum(0.0, 3.0 * m), np.maximum(0.0, 3.0 * m))


def _secants(
    values: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "k c"]:
    h = np.diff(s)[:, None]
    return np.where(h > _SAME, np.diff(values, axis=0) / np.maximum(h, _SAME), 0.0)


def _bends(
    values: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"], slopes: Float[np.ndarray, "2 k c"]
) -> Float[np.ndarray, "2 k c"]:
    """Return the slopes relative to the straight motion, times the length of the interval."""
    return (
        (slopes - _secants(values, s)) * np.diff(s)[:, None] * np.array([1.0, -1.0])[:, None, None]
    )


def _off(
    bends: Float[np.ndarray, "2 k c"], t: float | Float[np.ndarray, "k 1"]
) -> Float[np.ndarray, "k c"]:
    """Return how far cubic curves are from the straight motions, at a share of each interval."""
    return np.asarray(t * (1.0 - t) * ((1.0 - t) * bends[0] + t * bends[1]))


def _between(
    values: Float[np.ndarray, "m c"],
    bends: Float[np.ndarray, "2 k c"],
    pieces: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "r c"]:
    """Return the values on the curve with each interval divided into pieces."""
    row = np.repeat(np.arange(len(pieces)), pieces)
    within = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    t = (within / pieces[row])[:, None]
    out = values[row] + t * (values[row + 1] - values[row]) + _off(bends[:, row], t)
    return np.vstack([out, values[-1:]])
