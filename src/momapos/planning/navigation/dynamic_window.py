"""The Dynamic Window Approach: choose the best velocity that is reachable within one step.

Source: Fox, Burgard, Thrun, "The Dynamic Window Approach to Collision Avoidance", 1997; for omni
bases with vx, vy and yaw rate. Two differences: progress is measured along the planned path, by
position and heading, instead of by the heading to the goal; and the clearance is that of the real
footprint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import refuse_below
from momapos.core.compiled import F1, F2, entry, kernel
from momapos.model.robots import Robot

from .convex_polygons import PrismArrays
from .footprint_map import NavigationMap
from .global_path import METERS_PER_RADIAN, BasePath
from .outline_gaps import OutlineArrays, Scratch, gap, gaps, scratch_for, select, wrapped

if TYPE_CHECKING:
    from jaxtyping import Float


HORIZON = 1.2
"""Time for which a velocity is simulated [s]."""
DEVIATION_COST = 2.5
"""Cost of deviation from the path, in progress per deviation [-]."""
CROWDING_COST = 0.1
"""Cost of contact relative to the preferred gap, in progress [m]."""
PREDICTION_TIME = 2.5
"""Time for which moving obstacles are predicted, at constant velocity [s]."""


@dataclass(frozen=True)
class WindowConfig:
    """How velocities are chosen."""

    preferred_clearance: float = 0.06
    """Preferred gap to obstacles [m]."""
    margin: float = 0.02
    """Smallest gap to obstacles; smaller where the path itself is closer [m]."""
    distance: float = 0.15
    """Distance kept to moving obstacles [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "preferred_clearance", "margin", "distance")


class PathAhead(NamedTuple):
    """The remaining part of the path."""

    poses: F2
    s: F1
    """Progress at each [m]."""


class WindowWeights(NamedTuple):
    """Weights for rating velocities: limits of the base, and the values of a WindowConfig."""

    dt: float
    """Time until the next control step [s]."""
    acceleration: float
    """[m/s^2]"""
    yaw_acceleration: float
    """[rad/s^2]"""
    needed_clearance: float
    """Smallest gap to obstacles [m]."""
    horizon: float
    deviation: float
    preferred_clearance: float
    crowding: float
    look: float
    distance: float


class HeldVelocity(NamedTuple):
    """How long a held velocity is checked, and with which gaps."""

    stop: float
    """Time after which a braking base would have stopped [s]."""
    horizon: float
    """Time until which gaps count for the score [s]."""
    end: float
    """Time until which gaps are checked [s]."""
    speed: float
    """Speed of the robot's fastest point [m/s]."""
    needed_clearance: float
    """[m]"""
    dull: float
    """Gap below which the velocity cannot become the best [m]."""


class MovingDiscs(NamedTuple):
    """Moving obstacles."""

    discs: F2
    """x, y, vx, vy, radius (d, 5)."""
    keep: F1
    """Distance kept to each [m]."""
    look: float
    """Time for which they are predicted [s]."""


class GapQuery(NamedTuple):
    """Arguments of `gap`."""

    surroundings: OutlineArrays
    candidates: int
    cap: float
    scratch: Scratch


@kernel
def _carried(pose, v, t, out):
    """Compute the pose after a time at a constant velocity in the base frame."""
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


@kernel
def _progress(pose, path, deviation):
    """Return a pose's progress along the path, minus the cost of its deviation from it [m]."""
    best = -np.inf
    for k in range(len(path.poses)):
        beside = np.hypot(pose[0] - path.poses[k, 0], pose[1] - path.poses[k, 1])
        beside += METERS_PER_RADIAN * abs(wrapped(pose[2] - path.poses[k, 2]))
        best = max(best, path.s[k] - deviation * beside)
    return best


@entry
def disc_separation(pose: F1, x: float, y: float, prisms: PrismArrays) -> float:
    """Return the separation of a point from the nearest prism [m], at most the distance."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    u = c * (x - pose[0]) + s * (y - pose[1])
    v = c * (y - pose[1]) - s * (x - pose[0])
    normal, level, first = prisms.normal, prisms.level, prisms.first
    least = np.inf
    for prism in range(len(first) - 1):
        widest = -np.inf
        for i in range(first[prism], first[prism + 1]):
            widest = max(widest, normal[i, 0] * u + normal[i, 1] * v - level[i])
        least = min(least, widest)
    return least


@kernel
def _meets(pose, v, held, braking, moving, prisms, at):
    """Return when a robot that holds a velocity, then brakes along its arc, meets a disc [s]."""
    discs = moving.discs
    for step in range(1, int(moving.look / 0.1) + 1):
        t = 0.1 * step
        b = min(max(t - held, 0.0), braking)
        arc = min(t, held) + (b - b * b / (2 * braking) if braking > 0 else 0.0)
        _carried(pose, v, arc, at)
        for d in range(len(discs)):
            x, y = discs[d, 0] + t * discs[d, 2], discs[d, 1] + t * discs[d, 3]
            if disc_separation(at, x, y, prisms) - discs[d, 4] < moving.keep[d]:
                return t
    return np.inf


@kernel
def _held(pose, v, hold, near, at):
    """Return the smallest gap while a velocity is held [m], and when a gap gets too small [s].

    For a velocity that cannot become the best, this time is 0.
    """
    need, stop = hold.needed_clearance, hold.stop
    surroundings, count, cap, scratch = near
    # Check the stopping pose first: most collisions show there.
    _carried(pose, v, stop, at)
    if gap(at[0], at[1], at[2], surroundings, count, cap, scratch) < need:
        return cap, stop
    t, least = 0.0, cap
    while True:
        _carried(pose, v, t, at)
        g = gap(at[0], at[1], at[2], surroundings, count, cap, scratch)
        if g < need:
            return least, t
        if t <= hold.horizon:
            least = min(least, g)
        if least <= hold.dull:
            return least, 0.0
        if t >= hold.end:
            return least, np.inf
        finest = 0.005 if t < stop else 0.03  # after the stop only the score depends on gaps
        ahead = t + max(g - need / 2, finest) / max(hold.speed, 1e-6)
        t = stop if t < stop < ahead else min(hold.end, ahead)


@entry
def rate(
    pose: F1,
    samples: F2,
    surroundings: OutlineArrays,
    path: PathAhead,
    discs: F2,
    weights: WindowWeights,
) -> np.ndarray:
    """Score velocities; minus infinity if the base could not stop in time.

    They are evaluated in the order of their score without obstacles, until the remaining ones
    cannot become the best; these score minus infinity as well.

    Args:
        pose: Estimated pose of the base (3,).
        samples: Velocities in the base frame (m, 3) [m/s, m/s, rad/s].
        surroundings: The robot and the obstacles.
        path: The remaining path.
        discs: x, y, vx, vy, radius of moving obstacles (d, 5).
        weights: Limits and weights.
    """
    prisms, bounds = surroundings.prisms, surroundings.obstacles.bounds
    horizon, dt, look = weights.horizon, weights.dt, weights.look
    preferred, crowding = weights.preferred_clearance, weights.crowding
    scratch = scratch_for(surroundings)
    out, at, keep = np.empty(len(samples)), np.empty(3), np.empty(len(discs))
    cap = max(2 * preferred, 0.15)
    # Moving obstacles may stop at once: a base that follows one must be able to stop behind it.
    halted, apart = discs.copy(), np.empty(len(discs))
    for d in range(len(discs)):
        now = disc_separation(pose, discs[d, 0], discs[d, 1], prisms) - discs[d, 4]
        keep[d], apart[d] = min(weights.distance, now), min(weights.needed_clearance, now)
        halted[d, 2] = halted[d, 3] = 0.0
    moving, standing = MovingDiscs(discs, keep, look), MovingDiscs(halted, apart, look)
    worth = np.zeros(len(samples))
    for m in range(len(samples)):
        out[m] = -np.inf
        for share in (0.5, 1.0):
            _carried(pose, samples[m], share * horizon, at)
            worth[m] += 0.5 * _progress(at, path, weights.deviation)
    best = -np.inf
    for m in np.argsort(-worth, kind="mergesort"):
        if worth[m] <= best:
            break
        v = samples[m]
        speed = np.hypot(v[0], v[1])
        braking = max(speed / weights.acceleration, abs(v[2]) / weights.yaw_acceleration)
        stop = dt + braking / 2  # stopping distance along the arc [s at full speed]
        end = max(horizon, stop)
        points = speed + prisms.radius * abs(v[2])
        count = select(pose[0], pose[1], points * end + prisms.radius + cap, bounds, scratch.near)
        dull = -np.inf if crowding <= 0 else preferred * (1 - (worth[m] - best) / crowding)
        hold = HeldVelocity(stop, horizon, end, points, weights.needed_clearance, dull)
        least, met = _held(pose, v, hold, GapQuery(surroundings, count, cap, scratch), at)
        most = worth[m] - crowding * max(0.0, 1 - least / preferred)
        if met <= stop:
            continue
        waits = 0.0
        if len(discs):
            if _meets(pose, v, dt, braking, moving, prisms, at) < np.inf:
                continue
            if _meets(pose, v, dt, braking, standing, prisms, at) < np.inf:
                continue
            hit = _meets(pose, v, look, braking, moving, prisms, at)
            waits = max(0.0, 1 - hit / look)
        score = 0.0
        for share in (0.5, 1.0):
            _carried(pose, v, min(share * horizon, met), at)
            score += 0.5 * _progress(at, path, weights.deviation)
        # Being stopped by an obstacle never scores more than driving on.
        out[m] = min(score - worth[m], 0.0) + most - waits
        best = max(best, out[m])
    return out


def velocity_window(
    robot: Robot, now: Float[np.ndarray, "3"], dt: float
) -> Float[np.ndarray, "m 3"]:
    """Sample the velocities reachable in one step; the first brakes along the present arc."""
    braking = max(
        float(np.hypot(now[0], now[1])) / robot.max_acceleration,
        abs(float(now[2])) / robot.max_yaw_acceleration,
    )
    brake = now * max(0.0, 1 - dt / braking) if braking > 0 else np.zeros(3)
    step, turn = robot.max_acceleration * dt, robot.max_yaw_acceleration * dt
    share = np.linspace(-1, 1, 7 if robot.drive == "omni" else 13)
    w = now[2] + turn * np.sign(share) * np.abs(share) ** 1.5  # densest at the present rate
    w = np.append(w, np.clip(0.0, now[2] - turn, now[2] + turn))
    if robot.drive != "omni":
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
    if robot.drive == "car":
        pairs = pairs[robot.min_turning_radius * np.abs(pairs[:, 2]) <= np.abs(pairs[:, 0]) + 1e-9]
    return np.concatenate([brake[None], pairs])


@dataclass(frozen=True, eq=False)
class Steering:
    """Chooses velocities along a path."""

    nav_map: NavigationMap
    path: BasePath
    config: WindowConfig
    dt: float

    def ratings(
        self,
        pose: Float[np.ndarray, "3"],
        samples: Float[np.ndarray, "m 3"],
        index: int,
        discs: Float[np.ndarray, "d 5"],
    ) -> Float[np.ndarray, " m"]:
        """Score velocities at an estimated pose and its index on the path, see `rate`.

        Gaps below the margin are allowed only where the path itself is closer. A base that is
        already closer must not come closer still.
        """
        nav_map, c, path = self.nav_map, self.config, self.path
        robot = nav_map.robot
        ahead = HORIZON * (robot.max_speed + METERS_PER_RADIAN * robot.max_yaw_rate)
        end = max(int(np.searchsorted(path.s, path.s[index] + ahead)), index + 1)
        here = float(gaps(pose[None], nav_map.prisms, nav_map.planning_obstacles, cap=0.2)[0])
        need = min(c.margin, 0.6 * float(path.gap[index : end + 1].min()), here)
        surroundings = OutlineArrays(nav_map.prisms.arrays, nav_map.planning_obstacles.arrays)
        ahead_of = slice(index, end + 1)
        weights = WindowWeights(
            self.dt, robot.max_acceleration, robot.max_yaw_acceleration, need, HORIZON,
            DEVIATION_COST, c.preferred_clearance, CROWDING_COST, PREDICTION_TIME, c.distance,
        )  # fmt: skip
        rest = PathAhead(path.poses[ahead_of], path.s[ahead_of] - path.s[index])
        return rate(pose, samples, surroundings, rest, discs, weights)

    def choose(
        self,
        pose: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
        index: int,
        discs: Float[np.ndarray, "d 5"],
    ) -> Float[np.ndarray, "3"]:
        """Return the best velocity; braking if none is safe."""
        samples = velocity_window(self.nav_map.robot, velocity, self.dt)
        scores = self.ratings(pose, samples, index, discs)
        return samples[int(np.argmax(scores))]

    def allows(
        self,
        pose: Float[np.ndarray, "3"],
        velocity: Float[np.ndarray, "3"],
        index: int,
        discs: Float[np.ndarray, "d 5"],
    ) -> bool:
        """Check whether a base that follows the path exactly can stop from a velocity."""
        return bool(np.isfinite(self.ratings(pose, velocity[None], index, discs)[0]))
