"""How the arm comes to the grasp: slowly near things, slower where it feels them, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.model import Trajectory

from .config import ComplianceConfig, ExecutionConfig
from .geoms import HAND, Kind
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

_MOVING = (Kind.ARM, *HAND)
_SURROUNDINGS = (Kind.ROOM, Kind.PART, Kind.FLOOR)


@dataclass(frozen=True, eq=False)
class PacedTrajectory:
    """A trajectory that may be followed more slowly than it is timed, and backward."""

    plan: Trajectory
    pace: Float[np.ndarray, " t"]
    """Share of the timed speed at which each sample is passed at most [-]."""
    left: Float[np.ndarray, " t"]
    """Distance of the tool from where it ends, at each sample [m]."""
    gap: Float[np.ndarray, " t"]
    """Distance of the arm from its surroundings as far as the robot knows them, at each sample [m];
    large ones are not told apart."""

    @property
    def last(self) -> int:
        """Index of the last sample."""
        return len(self.plan) - 1

    def at(
        self, k: float, pace: float
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """State, speed and acceleration at a place between two samples.

        Args:
            k: Index of a sample, with a fraction.
            pace: Samples that pass in a step; below 0 on the way back.
        """
        i = min(int(k), self.last)
        j, share = min(i + 1, self.last), k - i
        q, v, a = (
            (1.0 - share) * values[i] + share * values[j]
            for values in (self.plan.q, self.plan.v, self.plan.a)
        )
        return q, pace * v, pace**2 * a


def paced(
    plan: Trajectory,
    path: Float[np.ndarray, "m n"],
    tool: Float[np.ndarray, "m 3"],
    room: Simulation,
    config: ExecutionConfig,
    *,
    value: float | None = None,
    careful: bool = False,
) -> PacedTrajectory:
    """Slow a trajectory down where the arm is near things, and where it comes to the grasp.

    Args:
        plan: As fast as the joints may go.
        path: Its states [rad] or [m].
        tool: Positions of the tool at these [m].
        room: The room as the robot knows it.
        config: How slow.
        value: Of the part's joint meanwhile [rad] or [m]; as the room has it by default.
        careful: Whether what the robot knows of the room may be wrong, so that it is nowhere fast.
    """
    step, compliance = config.timestep * config.substeps, config.compliance
    times = np.arange(len(plan)) * step
    gap = np.interp(times, plan.state_times, clearances(room, path, config.near, value))
    points = np.column_stack([np.interp(times, plan.state_times, tool[:, i]) for i in range(3)])
    speed = np.zeros(len(plan))
    if len(plan) > 1:
        speed = np.linalg.norm(np.gradient(points, axis=0), axis=1) / step
    left = np.linalg.norm(points - points[-1], axis=1)
    share = np.clip(gap / config.near, 0.0, 1.0)
    most = compliance.near_speed + share * (compliance.beside_speed - compliance.near_speed)
    most = np.where(share < 1.0, most, compliance.beside_speed if careful else np.inf)
    # Where the tool passes near its end and away again, only the last time counts.
    coming = np.maximum.accumulate(left[::-1])[::-1] <= compliance.near
    most = np.where(coming, np.minimum(most, compliance.near_speed), most)
    return PacedTrajectory(
        plan, _smooth(most / np.maximum(speed, 1e-9), compliance, step), left, gap
    )


def _smooth(
    pace: Float[np.ndarray, " t"], config: ComplianceConfig, step: float
) -> Float[np.ndarray, " t"]:
    """The largest pace below a given one and 1 that changes no faster than the arm can.

    At a pace p a sample takes step / p, so that p^2 changes by at most 2 rate step in it.
    """
    rise = 2.0 * config.pace_rate * step * np.arange(len(pace))
    squared = np.clip(pace, 1e-3, 1.0) ** 2
    forward = np.minimum.accumulate(squared - rise) + rise
    backward = (np.minimum.accumulate((forward + rise)[::-1]))[::-1] - rise
    return np.sqrt(backward)


def clearances(
    room: Simulation, path: Float[np.ndarray, "m n"], most: float, value: float | None = None
) -> Float[np.ndarray, " m"]:
    """Distance of the arm from its surroundings at some of its states [m]; at most `most`.

    The part's joint has a value [rad] or [m], by default that of the room.
    """
    data = mujoco.MjData(room.model)
    data.qpos[:] = room.data.qpos
    if value is not None:
        data.qpos[room.part_q] = value
    arm, things = np.isin(room.kinds, _MOVING), np.isin(room.kinds, _SURROUNDINGS)
    gaps = np.full(len(path), most)
    for i, q in enumerate(path):
        data.qpos[room.arm_q] = q
        mujoco.mj_kinematics(room.model, data)
        mujoco.mj_collision(room.model, data)
        geoms = data.contact.geom
        both = arm[geoms].any(1) & things[geoms].any(1)
        gaps[i] = min(most, data.contact.dist[both].min(initial=most))
    return gaps
