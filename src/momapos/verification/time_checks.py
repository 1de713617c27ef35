"""Check that a plan's times keep the speed and acceleration limits of the robot's file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Motion

from .report import Check, Limits, at_most
from .robot_collision_model import RobotCollisionModel

if TYPE_CHECKING:
    from jaxtyping import Float

_STILL = 1e-9
"""A joint that moves less between two states rests [rad] or [m]."""


def time_checks(robot: RobotCollisionModel, motion: Motion, limits: Limits) -> Iterator[Check]:
    """Check the times of the states, if the plan has any.

    Of a joint only its mean speed between two states is known. It never exceeds the joint's limit,
    and from one interval to the next it changes by no more than the acceleration limit times half
    the length of both, if the joint keeps its limits in between. Both phases start and end at rest.
    """
    phases = ((motion.approach, motion.approach_times), (motion.q, motion.times))
    means = [_means(q, times) for q, times in phases if times is not None and len(times) > 1]
    if not means:
        return
    speed = np.vstack([np.abs(v) for v, _ in means]) / robot.speed
    yield _worst("joint speed by the plan's times", speed, robot, limits)
    if np.isfinite(robot.acceleration).any():
        change = np.vstack([_changes(v, length) for v, length in means]) / robot.acceleration
        yield _worst("joint acceleration by the plan's times", change, robot, limits)


def _means(
    q: Float[np.ndarray, "m n"], times: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, " k"]]:
    """Return the mean velocity in each interval, and its length [s]."""
    moved, length = np.diff(q, axis=0), np.diff(times)
    still = np.abs(moved) <= _STILL
    with np.errstate(divide="ignore"):
        return np.where(still, 0.0, moved / np.where(still, 1.0, length[:, None])), length


def _changes(v: Float[np.ndarray, "k n"], length: Float[np.ndarray, " k"]) -> np.ndarray:
    """Return the least acceleration that changes the mean velocities so, from rest to rest."""
    half = np.convolve(np.pad(length, 1), (0.5, 0.5), mode="valid")[:, None]
    rest = np.zeros((1, v.shape[1]))
    change = np.abs(np.diff(v, axis=0, prepend=rest, append=rest))
    change = np.where(np.isfinite(change), change, np.inf)
    return np.divide(change, half, out=np.where(change > 0.0, np.inf, 0.0), where=half > 0.0)


def _worst(
    name: str, share: Float[np.ndarray, "k n"], robot: RobotCollisionModel, limits: Limits
) -> Check:
    worst = robot.joints[int(share.max(0).argmax())]
    percent = 100.0 * float(share.max(initial=0.0))
    return at_most(name, percent, 100.0 * limits.speed, "%", worst, worst)
