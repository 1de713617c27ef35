"""The Dynamic Window Approach: the best of the velocities that can be had within one step.

Source: Fox, Burgard, Thrun, "The Dynamic Window Approach to Collision Avoidance", 1997; for omni
bases with vx, vy and yaw rate. What differs: progress is measured along the planned way, position
and heading alike, in place of the heading to the goal; and the clearance is that of the real
footprint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from momapos.navigation.clearance import gap, gaps, select, wrapped
from momapos.navigation.footprint_map import Ground
from momapos.navigation.global_path import TURN, Path
from momapos.robots.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class WindowConfig:
    """How velocities are chosen."""

    horizon: float = 1.2
    """How long a velocity is imagined to be held [s]."""
    deviation: float = 2.5
    """Progress that a metre beside the way is worth [-]."""
    liked: float = 0.06
    """Gap to everything that is kept where there is room [m]."""
    crowding: float = 0.1
    """Progress that is given up to get from touching to that gap [m]."""
    margin: float = 0.02
    """Gap that is never gone below, but where the way itself goes closer [m]."""
    look: float = 2.5
    """How far ahead moving obstacles are followed, at the velocity they have [s]."""
    distance: float = 0.15
    """Distance kept to moving obstacles [m]."""


@njit(cache=True, nogil=True)
def _carried(pose, v, t, out):
    """The pose after a time at a constant velocity in the base frame."""
    turn = v[2] * t
    if abs(turn) < 1e-9:
        x, y = v[0] * t, v[1] * t
    else:
        along, across = np.sin(turn) / v[2], (1 - np.cos(turn)) / v[2]
        x, y = along * v[0] - across * v[1], across * v[0] + along * v[1]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    out[0] = pose[0] + c * x - s * y
    out[1] = pose[1] + s * x + c * y
    out[2] = pose[2] + turn


@njit(cache=True, nogil=True)
def _progress(pose, way, s, deviation):
    """How far along the way a pose is, less what it is beside it [m]."""
    best = -np.inf
    for k in range(len(way)):
        beside = np.hypot(pose[0] - way[k, 0], pose[1] - way[k, 1])
        beside += TURN * abs(wrapped(pose[2] - way[k, 2]))
        best = max(best, s[k] - deviation * beside)
    return best


@njit(cache=True, nogil=True)
def _to_disc(pose, x, y, body):
    """Separation of a point from both outlines of the robot [m]; no more than the distance."""
    _, normal, level, start, _ = body
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u = c * (x - pose[0]) + s * (y - pose[1])
    v = c * (y - pose[1]) - s * (x - pose[0])
    least = np.inf
    for part in range(2):
        widest = -np.inf
        for i in range(start[part], start[part + 1]):
            widest = max(widest, normal[i, 0] * u + normal[i, 1] * v - level[i])
        least = min(least, widest)
    return least


@njit(cache=True, nogil=True)
def _meets(pose, v, held, braking, discs, body, look, keep, at):
    """Time at which a robot that holds a velocity, then brakes along its arc, meets a disc [s]."""
    for step in range(1, int(look / 0.1) + 1):
        t = 0.1 * step
        b = min(max(t - held, 0.0), braking)
        arc = min(t, held) + (b - b * b / (2 * braking) if braking > 0 else 0.0)
        _carried(pose, v, arc, at)
        for d in range(len(discs)):
            x, y = discs[d, 0] + t * discs[d, 2], discs[d, 1] + t * discs[d, 3]
            if _to_disc(at, x, y, body) - discs[d, 4] < keep[d]:
                return t
    return np.inf


@njit(cache=True, nogil=True)
def _held(pose, v, span, need, dull, body, things, near, count, cap, work, at):
    """Smallest gap while a velocity is held [m], and when too small a gap is met [s].

    A velocity that is of no interest meets one at once.

    Args:
        pose, v, need: See `rate`.
        span: Time after which a braking base would stand, until which gaps count, and until which
            they are looked at [s]; how fast the robot's fastest point moves [m/s].
        dull: Gap at which the velocity is of no more interest [m].
        body, things, near, count, cap, work: See `gap`.
        at: Scratch (3,).
    """
    stop, horizon, end, points = span
    # Most that cannot be stopped in time would touch where they stop.
    _carried(pose, v, stop, at)
    if gap(at[0], at[1], at[2], body, things, near, count, cap, work) < need:
        return cap, stop
    t, least = 0.0, cap
    while True:
        _carried(pose, v, t, at)
        g = gap(at[0], at[1], at[2], body, things, near, count, cap, work)
        if g < need:
            return least, t
        if t <= horizon:
            least = min(least, g)
        if least <= dull:
            return least, 0.0
        if t >= end:
            return least, np.inf
        finest = 0.005 if t < stop else 0.03  # beyond the stop only the score is at stake
        ahead = t + max(g - need / 2, finest) / max(points, 1e-6)
        t = stop if t < stop < ahead else min(end, ahead)


@njit(cache=True, nogil=True)
def rate(pose, samples, dt, limits, body, things, way, s, discs, need, taste):
    """Score velocities, minus infinity for those after which the base could not stop in time.

    They are looked at in the order of what they would be worth in an empty room, and no further
    once they cannot become the best; those left out are minus infinity as well.

    Args:
        pose: Where the base believes to be (3,).
        samples: Velocities in the base frame (m, 3) [m/s, m/s, rad/s].
        dt: Time until the next choice [s].
        limits: Acceleration [m/s^2] and yaw acceleration [rad/s^2].
        body, things: See `clearance`.
        way, s: Poses of the way ahead (n, 3) and progress at each [m].
        discs: x, y, vx, vy, radius of moving obstacles (d, 5).
        need: Gap that is never gone below [m].
        taste: The numbers of a WindowConfig.
    """
    horizon, deviation, liked, crowding, look, distance = taste
    near, work = np.empty(len(things[4]), np.int64), np.empty((len(body[0]), 5))
    out, at, keep = np.empty(len(samples)), np.empty(3), np.empty(len(discs))
    cap = max(2 * liked, 0.15)
    for d in range(len(discs)):
        keep[d] = min(distance, _to_disc(pose, discs[d, 0], discs[d, 1], body) - discs[d, 4])
    worth = np.zeros(len(samples))
    for m in range(len(samples)):
        out[m] = -np.inf
        for share in (0.5, 1.0):
            _carried(pose, samples[m], share * horizon, at)
            worth[m] += 0.5 * _progress(at, way, s, deviation)
    best = -np.inf
    for m in np.argsort(-worth, kind="mergesort"):
        if worth[m] <= best:
            break
        v = samples[m]
        speed = np.hypot(v[0], v[1])
        braking = max(speed / limits[0], abs(v[2]) / limits[1])
        stop = dt + braking / 2  # braking along the arc, it comes this far [s at full speed]
        end = max(horizon, stop)
        points = speed + body[4] * abs(v[2])
        count = select(pose[0], pose[1], points * end + body[4] + cap, things[5], near)
        dull = -np.inf if crowding <= 0 else liked * (1 - (worth[m] - best) / crowding)
        span = (stop, horizon, end, points)
        least, met = _held(pose, v, span, need, dull, body, things, near, count, cap, work, at)
        most = worth[m] - crowding * max(0.0, 1 - least / liked)
        if met <= stop:
            continue
        waits = 0.0
        if len(discs):
            if _meets(pose, v, dt, braking, discs, body, look, keep, at) < np.inf:
                continue
            hit = _meets(pose, v, look, braking, discs, body, look, keep, at)
            waits = max(0.0, 1 - hit / look)
        score = 0.0
        for share in (0.5, 1.0):
            _carried(pose, v, min(share * horizon, met), at)
            score += 0.5 * _progress(at, way, s, deviation)
        # To be stopped by something is never worth more than to go on.
        out[m] = min(score - worth[m], 0.0) + most - waits
        best = max(best, out[m])
    return out


def velocity_window(
    robot: Robot, now: Float[np.ndarray, "3"], dt: float
) -> Float[np.ndarray, "m 3"]:
    """Velocities within reach in one step; the first is braking along the present arc."""
    braking = max(
        float(np.hypot(now[0], now[1])) / robot.max_acceleration,
        abs(float(now[2])) / robot.max_yaw_acceleration,
    )
    brake = now * max(0.0, 1 - dt / braking) if braking > 0 else np.zeros(3)
    step, turn = robot.max_acceleration * dt, robot.max_yaw_acceleration * dt
    share = np.linspace(-1, 1, 13 if robot.drive == "differential" else 7)
    w = now[2] + turn * np.sign(share) * np.abs(share) ** 1.5  # finest around the present rate
    w = np.append(w, np.clip(0.0, now[2] - turn, now[2] + turn))
    if robot.drive == "differential":
        vx = now[0] + step * np.append(np.linspace(-1, 1, 7), np.clip(-now[0] / step, -1, 1))
        linear = np.stack([vx, np.zeros(len(vx))], -1)
    else:
        angle = np.linspace(0, 2 * np.pi, 7, endpoint=False)
        ring = np.stack([np.cos(angle), np.sin(angle)], -1)
        rest = -now[:2] * min(1.0, step / max(float(np.hypot(now[0], now[1])), 1e-12))
        linear = now[:2] + np.concatenate([np.zeros((1, 2)), step * ring, step / 3 * ring, [rest]])
    speed = np.hypot(*linear.T)
    linear = linear[speed <= robot.max_speed + 1e-9]
    w = w[np.abs(w) <= robot.max_yaw_rate + 1e-9]
    pairs = np.column_stack([np.repeat(linear, len(w), axis=0), np.tile(w, len(linear))])
    return np.concatenate([brake[None], pairs])


@dataclass(frozen=True, eq=False)
class Steering:
    """Chooses velocities along one way."""

    ground: Ground
    path: Path
    config: WindowConfig
    dt: float

    def ratings(
        self,
        pose: Float[np.ndarray, "3"],
        samples: Float[np.ndarray, "m 3"],
        index: int,
        discs: Float[np.ndarray, "d 5"],
    ) -> Float[np.ndarray, " m"]:
        """Score of velocities at a believed pose that is at some index of the way; see `rate`.

        No gap smaller than the margin is allowed, but where the way itself has none; a base that
        is nearer already may not come nearer still.
        """
        ground, c, path = self.ground, self.config, self.path
        robot = ground.robot
        ahead = c.horizon * (robot.max_speed + TURN * robot.max_yaw_rate)
        end = max(int(np.searchsorted(path.s, path.s[index] + ahead)), index + 1)
        here = float(gaps(pose[None], ground.body, ground.things, cap=0.2)[0])
        need = min(c.margin, 0.6 * float(path.gap[index : end + 1].min()), here)
        return rate(
            pose, samples, self.dt,
            (robot.max_acceleration, robot.max_yaw_acceleration),
            ground.body.arrays, ground.things.arrays,
            path.poses[index : end + 1], path.s[index : end + 1] - path.s[index],
            discs, need,
            (c.horizon, c.deviation, c.liked, c.crowding, c.look, c.distance),
        )  # fmt: skip

    def choose(
        self,
        pose: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
        index: int,
        discs: Float[np.ndarray, "d 5"],
    ) -> Float[np.ndarray, "3"]:
        """The velocity to have next; braking where none is safe."""
        samples = velocity_window(self.ground.robot, velocity, self.dt)
        scores = self.ratings(pose, samples, index, discs)
        return samples[int(np.argmax(scores))]

    def allows(
        self,
        pose: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
        discs: Float[np.ndarray, "d 5"],
    ) -> bool:
        """Whether a base that follows the way exactly can have a velocity and still stop."""
        return bool(np.isfinite(self.ratings(pose, velocity[None], 0, discs)[0]))
