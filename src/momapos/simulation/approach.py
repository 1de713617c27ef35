"""Pace of the arm on its approach: slow near obstacles, slower under contact forces, reversible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.model import Trajectory

from .base_drive import base_coordinates
from .config import (
    BESIDE_SPEED,
    NEAR_GRASP,
    NEAR_SPEED,
    OBSERVED_DISTANCE,
    PACE_RATE,
    SUBSTEPS,
    ExecutionConfig,
)
from .geoms import HAND, Kind
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

_MOVING = (Kind.ARM, *HAND)
_SURROUNDINGS = (Kind.ROOM, Kind.PART, Kind.FLOOR)


@dataclass(frozen=True, eq=False)
class PacedTrajectory:
    """A timed trajectory that may be followed more slowly than timed, and backward."""

    plan: Trajectory
    pace: Float[np.ndarray, " t"]
    """Maximum speed at each sample, as a share of the timed speed [-]."""
    left: Float[np.ndarray, " t"]
    """Distance of the tool from its final position at each sample [m]."""
    gap: Float[np.ndarray, " t"]
    """Distance from the arm to the known surroundings at each sample [m], capped at
    `ExecutionConfig.near`."""

    @property
    def last(self) -> int:
        """Index of the last sample."""
        return len(self.plan) - 1

    def at(
        self, k: float, pace: float
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Interpolate position, velocity and acceleration between two samples.

        Args:
            k: Fractional sample index.
            pace: Samples per step; negative on the way back.
        """
        i, j, share = self._between(k)
        q, v, a = (
            (1.0 - share) * values[i] + share * values[j]
            for values in (self.plan.q, self.plan.v, self.plan.a)
        )
        return q, pace * v, pace**2 * a

    def base_at(self, k: float) -> Float[np.ndarray, "3"] | None:
        """Interpolate the pose of a moving base between two samples; None if it stands still."""
        if self.plan.base is None:
            return None
        i, j, share = self._between(k)
        return (1.0 - share) * self.plan.base[i] + share * self.plan.base[j]

    def _between(self, k: float) -> tuple[int, int, float]:
        i = min(int(k), self.last)
        return i, min(i + 1, self.last), k - i


def pace_trajectory(
    plan: Trajectory,
    path: Float[np.ndarray, "m n"],
    tool: Float[np.ndarray, "m 3"],
    room: Simulation,
    config: ExecutionConfig,
    *,
    value: float | None = None,
    careful: bool = False,
    base: Float[np.ndarray, "m 3"] | None = None,
) -> PacedTrajectory:
    """Slow a trajectory down near obstacles and before the grasp.

    Args:
        plan: Trajectory at the joints' speed limits.
        path: Its states [rad] or [m].
        tool: Tool positions at these states [m].
        room: The room as the robot knows it.
        config: Speeds and distances.
        value: Value of the part's joint meanwhile [rad] or [m]; by default as in the room.
        careful: Limit the speed everywhere, because the known room may be wrong.
        base: Poses of a base that moves, at these states; None if it stands where it was first.
    """
    step = config.timestep * SUBSTEPS
    times = np.arange(len(plan)) * step
    gaps = clearances(room, path, OBSERVED_DISTANCE, value, base)
    gap = np.interp(times, plan.state_times, gaps)
    points = np.column_stack([np.interp(times, plan.state_times, tool[:, i]) for i in range(3)])
    speed = np.zeros(len(plan))
    if len(plan) > 1:
        speed = np.linalg.norm(np.gradient(points, axis=0), axis=1) / step
    left = np.linalg.norm(points - points[-1], axis=1)
    share = np.clip(gap / OBSERVED_DISTANCE, 0.0, 1.0)
    most = NEAR_SPEED + share * (BESIDE_SPEED - NEAR_SPEED)
    most = np.where(share < 1.0, most, BESIDE_SPEED if careful else np.inf)
    # If the tool passes near its end and leaves again, only the last arrival counts.
    coming = np.maximum.accumulate(left[::-1])[::-1] <= NEAR_GRASP
    most = np.where(coming, np.minimum(most, NEAR_SPEED), most)
    return PacedTrajectory(plan, _smooth(most / np.maximum(speed, 1e-9), step), left, gap)


def _smooth(pace: Float[np.ndarray, " t"], step: float) -> Float[np.ndarray, " t"]:
    """Return the largest pace below `pace` and 1 whose rate of change is bounded.

    At pace p a sample takes step / p, so p^2 changes by at most 2 rate step per sample.
    """
    rise = 2.0 * PACE_RATE * step * np.arange(len(pace))
    squared = np.clip(pace, 1e-3, 1.0) ** 2
    forward = np.minimum.accumulate(squared - rise) + rise
    backward = (np.minimum.accumulate((forward + rise)[::-1]))[::-1] - rise
    return np.sqrt(backward)


def clearances(
    room: Simulation,
    path: Float[np.ndarray, "m n"],
    most: float,
    value: float | None = None,
    base: Float[np.ndarray, "m 3"] | None = None,
) -> Float[np.ndarray, " m"]:
    """Return the distance from the arm to its surroundings at each state [m], capped at `most`.

    `value` is the value of the part's joint [rad] or [m]; by default as in the room. `base` is the
    pose of a base that moves.
    """
    stands = np.zeros((len(path), 3)) if base is None else base_coordinates(room, base)
    data = mujoco.MjData(room.model)
    data.qpos[:] = room.data.qpos
    if value is not None:
        data.qpos[room.part_q] = value
    arm, obstacles = np.isin(room.kinds, _MOVING), np.isin(room.kinds, _SURROUNDINGS)
    gaps = np.full(len(path), most)
    for i, q in enumerate(path):
        data.qpos[room.arm_q], data.qpos[room.base_q] = q, stands[i]
        mujoco.mj_kinematics(room.model, data)
        mujoco.mj_collision(room.model, data)
        geoms = data.contact.geom
        both = arm[geoms].any(1) & obstacles[geoms].any(1)
        gaps[i] = min(most, data.contact.dist[both].min(initial=most))
    return gaps
