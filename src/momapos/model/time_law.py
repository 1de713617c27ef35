"""Time a smooth path within limits of speed, acceleration and jerk, from rest to rest.

TOPP-RA (Pham and Pham, 2018) finds the fastest motion within the limits of speed and acceleration;
its acceleration jumps. The mean of its position over a moving window of time has the same path and
a continuous acceleration (Biagiotti and Melchiorri, FIR filters for online trajectory planning with
time- and frequency-domain specifications, Control Engineering Practice, 2012). What then exceeds a
limit, because the motion is elsewhere on its path, is slowed down as a whole.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError

from .toppra_import import import_toppra

if TYPE_CHECKING:
    from jaxtyping import Float

WINDOW = 0.06
"""Shortest time over which the position is averaged [s]: three samples of a controller at 50 Hz."""
_MAX_WINDOW = 1.0
"""Longest such time; a small jerk limit then slows the whole motion [s]."""
_NO_LIMIT = 1e3
"""A finite number in place of infinity [m/s] or [m/s^2]."""
_MIN_GRID_POINTS = 400
"""Smallest number of points per piece at which the limits hold [-]."""
_CHECK_STEP = 0.004
"""Longest time between the samples at which the limits are checked [s]."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples at equal time steps; the first and last are at rest."""

    q: Float[np.ndarray, "t n"]
    v: Float[np.ndarray, "t n"]
    a: Float[np.ndarray, "t n"]
    state_times: Float[np.ndarray, " m"]
    """Time at which each state of the path is passed, from the first sample [s]."""
    base: Float[np.ndarray, "t 3"] | None = None
    """x [m], y [m], yaw [rad] of the base; None if it stands still."""
    base_v: Float[np.ndarray, "t 3"] | None = None
    """Velocity of the base in the world [m/s], [m/s], [rad/s]."""

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of each coordinate of a path; infinite where there is none."""

    speed: Float[np.ndarray, " c"]
    acceleration: Float[np.ndarray, " c"]
    jerk: Float[np.ndarray, " c"]

    @classmethod
    def join(cls, parts: Sequence[Limits]) -> Limits:
        """Concatenate the limits of several sets of coordinates."""
        names = ("speed", "acceleration", "jerk")
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def take(self, which: Any) -> Limits:
        """Return the limits of some coordinates."""
        return Limits(self.speed[which], self.acceleration[which], self.jerk[which])


def time_piece(
    path: Float[np.ndarray, "m c"], s: Float[np.ndarray, " m"], limits: Limits, step: float
) -> Trajectory:
    """Time a smooth piece of a path, a cubic spline through its states.

    Args:
        path: States, close together [rad] or [m].
        s: Increasing positions of the states along the path, from 0.
        limits: Of each coordinate.
        step: Time between samples [s].

    Raises:
        InputError: The limits cannot be met.
    """
    toppra = import_toppra()
    logging.getLogger("toppra").setLevel(logging.ERROR)
    spline = toppra.SplineInterpolator(s, path)
    profile = _Profile.fastest(spline, s, limits)
    window = _window(spline, profile, limits)
    end = profile.duration + window
    fine = np.linspace(0.0, end, max(100, int(np.ceil(end / _CHECK_STEP))) + 1)
    passed = np.interp(s, np.maximum.accumulate(profile.averaged(fine, window)[0]), fine)
    passed[-1] = end
    # The acceleration of a cubic spline is largest near its knots.
    checked = profile.averaged(np.concatenate([fine, passed]), window)
    # A whole number of steps, so that the last sample is at the end.
    count = max(1, int(np.ceil(end * _slowdown(spline, checked, limits) / step - 1e-9)))
    factor = end / (count * step)
    q, v, a, _ = _derivatives(spline, profile.averaged(np.linspace(0.0, end, count + 1), window))
    v[[0, -1]] = a[[0, -1]] = 0.0
    return Trajectory(q, factor * v, factor**2 * a, passed / factor)


def _window(spline: Any, profile: _Profile, limits: Limits) -> float:
    """Return the time over which to average the position, so that the jerk keeps its limits [s].

    Over a window w an acceleration changes from one extreme a to the other: a jerk of 2 a / w.
    """
    _, *along = profile.at(profile.times)
    _, _, acceleration, _ = _derivatives(spline, (*along, np.zeros(len(profile.times))))
    needed = 2.0 * np.abs(acceleration).max(0) / limits.jerk
    return float(np.clip(needed.max(), WINDOW, _MAX_WINDOW))


def _slowdown(spline: Any, along: tuple[Float[np.ndarray, " t"], ...], limits: Limits) -> float:
    """Return the factor on the duration with which a motion keeps all limits."""
    _, *rates = _derivatives(spline, along)
    bounds = limits.speed, limits.acceleration, limits.jerk
    excess = [(np.abs(x).max(0) / bound).max() for x, bound in zip(rates, bounds, strict=True)]
    return float(max(1.0, *(x ** (1.0 / (k + 1)) for k, x in enumerate(excess))))


def _derivatives(
    spline: Any, along: tuple[Float[np.ndarray, " t"], ...]
) -> tuple[Float[np.ndarray, "t c"], ...]:
    """Return position, speed, acceleration and jerk of the coordinates by time.

    Args:
        spline: The path.
        along: Position along the path and its three derivatives by time.
    """
    s, v, a, j = along
    q, dq, ddq, dddq = (spline.cspl(s, order) for order in range(4))
    v, a, j = v[:, None], a[:, None], j[:, None]
    return q, dq * v, ddq * v**2 + dq * a, dddq * v**3 + 3.0 * ddq * v * a + dq * j


@dataclass(frozen=True, eq=False)
class _Profile:
    """Motion along a path at constant acceleration between times, from rest to rest."""

    times: Float[np.ndarray, " g"]
    position: Float[np.ndarray, " g"]
    speed: Float[np.ndarray, " g"]
    acceleration: Float[np.ndarray, " g_minus_1"]
    integral: Float[np.ndarray, " g"]
    """Integral of the position over time."""

    @classmethod
    def fastest(cls, spline: Any, s: Float[np.ndarray, " m"], limits: Limits) -> _Profile:
        """Return the fastest motion within the limits of speed and acceleration."""
        toppra = import_toppra()
        grid = np.linspace(s[0], s[-1], max(_MIN_GRID_POINTS, 2 * len(s)))
        bounds = [np.minimum(limit, _NO_LIMIT) for limit in (limits.speed, limits.acceleration)]
        kept = [
            toppra.constraint.JointVelocityConstraint(np.stack([-bounds[0], bounds[0]], 1)),
            toppra.constraint.JointAccelerationConstraint(np.stack([-bounds[1], bounds[1]], 1)),
        ]
        solver = toppra.algorithm.TOPPRA(kept, spline, grid, parametrizer="ParametrizeConstAccel")
        if solver.compute_trajectory(0.0, 0.0) is None:
            raise InputError("no trajectory along the motion meets the joints' limits")
        speed = np.array(solver.problem_data.sd_vec)
        spans = 2.0 * np.diff(grid) / (speed[:-1] + speed[1:])
        times = np.append(0.0, np.cumsum(spans))
        acceleration = np.diff(speed) / spans
        areas = grid[:-1] * spans + speed[:-1] * spans**2 / 2 + acceleration * spans**3 / 6
        return cls(times, grid, speed, acceleration, np.append(0.0, np.cumsum(areas)))

    @property
    def duration(self) -> float:
        """Return the time at the end [s]."""
        return float(self.times[-1])

    def averaged(
        self, t: Float[np.ndarray, " t"], window: float
    ) -> tuple[Float[np.ndarray, " t"], ...]:
        """Return the mean position over the window before each time, and three derivatives."""
        now, before = self.at(t), self.at(t - window)
        return tuple((x - y) / window for x, y in zip(now, before, strict=True))

    def at(self, t: Float[np.ndarray, " t"]) -> tuple[Float[np.ndarray, " t"], ...]:
        """Return integral, position, speed and acceleration; it rests before and after."""
        i = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        inside = np.clip(t, 0.0, self.duration)
        x, a = inside - self.times[i], self.acceleration[i]
        moving = (t >= 0.0) & (t < self.duration)
        position = self.position[i] + self.speed[i] * x + a * x**2 / 2
        area = self.integral[i] + self.position[i] * x + self.speed[i] * x**2 / 2 + a * x**3 / 6
        area = area + np.maximum(t - self.duration, 0.0) * self.position[-1]
        return (
            area, position, np.where(moving, self.speed[i] + a * x, 0.0), np.where(moving, a, 0.0)
        )  # fmt: skip
