"""When the arm is where: a path becomes a trajectory within limits of speed and acceleration."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.errors import InputError, require

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

CORNER = np.radians(10.0)
"""The arm stops where its path turns by more than this in joint space [rad]."""
_SAME = 1e-9
_GRID = 400
"""Points of a piece at which the limits are met, at least [-]."""


@dataclass(frozen=True)
class Trajectory:
    """Samples at equal times, the first and the last at rest."""

    q: Float[np.ndarray, "t n"]
    v: Float[np.ndarray, "t n"]
    a: Float[np.ndarray, "t n"]

    def __len__(self) -> int:
        return len(self.q)


def still(q: Float[np.ndarray, " n"], count: int) -> Trajectory:
    """Stay at a state."""
    rest = np.zeros((count, len(q)))
    return Trajectory(np.tile(q, (count, 1)), rest, rest)


def time_path(
    q: Float[np.ndarray, "m n"],
    speed: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
    step: float,
    *,
    tool: Float[np.ndarray, "m 3"] | None = None,
    tool_speed: float = np.inf,
) -> Trajectory:
    """Follow a path as fast as limits allow (Pham and Pham, TOPP-RA, 2018).

    Between its corners the path is a cubic spline through its states, which are close together;
    at a corner the arm stops, so that no spline swings out of the checked path.

    Args:
        q: States [rad] or [m].
        speed: Limit of each joint [rad/s] or [m/s].
        acceleration: Limit of each joint [rad/s^2] or [m/s^2].
        step: Time between samples [s].
        tool: Positions of the tool at the states [m], where its speed is limited too.
        tool_speed: That limit [m/s].

    Raises:
        InputError: No trajectory meets the limits, or a state is not finite.
    """
    if not np.isfinite(q).all():
        raise InputError("the motion holds NaN or infinity; nothing can be executed")
    keep = np.append(True, np.abs(np.diff(q, axis=0)).max(1, initial=0.0) > _SAME)
    q = q[keep]
    if len(q) < 2:
        return still(q[0], 1)
    length = None if tool is None else _along(tool[keep])
    ends = np.flatnonzero(_corners(q))
    pieces = []
    for first, last in pairwise(ends):
        part = slice(first, last + 1)
        travelled = None if length is None else length[part] - length[first]
        pieces.append(_piece(q[part], travelled, speed, acceleration, tool_speed, step))
    return Trajectory(
        *(np.concatenate([getattr(piece, key) for piece in pieces]) for key in ("q", "v", "a"))
    )


def _along(points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
    """Distance along a path of points [m]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _corners(q: Float[np.ndarray, "m n"]) -> Bool[np.ndarray, " m"]:
    """Where the path turns sharply, and its ends."""
    steps = np.diff(q, axis=0)
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", unit[:-1], unit[1:])
    return np.concatenate([[True], cosine < np.cos(CORNER), [True]])


def _piece(
    q: Float[np.ndarray, "m n"],
    travelled: Float[np.ndarray, " m"] | None,
    speed: Float[np.ndarray, " n"],
    acceleration: Float[np.ndarray, " n"],
    tool_speed: float,
    step: float,
) -> Trajectory:
    """A smooth piece from rest to rest; the tool's way is one more coordinate with its limit."""
    with require("physics"):
        import toppra
        from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    n = q.shape[1]
    path = q
    if travelled is not None and travelled[-1] > 1e-6:
        path = np.column_stack([q, travelled])
        speed, acceleration = np.append(speed, tool_speed), np.append(acceleration, 1e3)
    s = _along_max(q)
    spline = toppra.SplineInterpolator(s, path)
    limits = [
        constraint.JointVelocityConstraint(np.stack([-speed, speed], 1)),
        constraint.JointAccelerationConstraint(np.stack([-acceleration, acceleration], 1)),
    ]
    grid = np.linspace(s[0], s[-1], max(_GRID, 2 * len(s)))
    solver = algorithm.TOPPRA(limits, spline, grid, parametrizer="ParametrizeConstAccel")
    timed = solver.compute_trajectory(0.0, 0.0)
    if timed is None:
        raise InputError("no trajectory along the motion keeps the joints' limits")
    t = np.append(np.arange(0.0, timed.duration, step), timed.duration)
    samples = [timed(t, order)[:, :n] for order in (0, 1, 2)]
    samples[1][-1], samples[2][-1] = 0.0, 0.0
    return Trajectory(*samples)


def _along_max(q: Float[np.ndarray, "m n"]) -> Float[np.ndarray, " m"]:
    """Way along a path, by the joint that moves most in each step."""
    return np.append(0.0, np.cumsum(np.abs(np.diff(q, axis=0)).max(1)))


def joined(parts: list[Trajectory]) -> tuple[Trajectory, Int[np.ndarray, " t"]]:
    """One trajectory after the other, and the index of the part that each sample is of."""
    whole = Trajectory(
        *(np.concatenate([getattr(part, key) for part in parts]) for key in ("q", "v", "a"))
    )
    return whole, np.repeat(np.arange(len(parts)), [len(part) for part in parts])
