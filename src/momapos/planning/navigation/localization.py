"""Localization: the controller's pose estimate from noisy fixes and odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import refuse_below
from momapos.core.geometry import wrap_angle

from .base_motion import integrate

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class NoiseConfig:
    """Noise of the robot's sensors; all errors are Gaussian and independent."""

    position: float = 0.02
    """Standard deviation of x and of y of a fix [m]."""
    heading: float = float(np.radians(1.0))
    """Standard deviation of the heading of a fix [rad]."""
    odometry: float = 0.03
    """Standard deviation of the odometry's velocities, as a share of them, drawn each step [-]."""
    fused: bool = True
    """Whether fixes are fused with odometry; otherwise the last fix is the estimate."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "position", "heading", "odometry")


class Localizer:
    """A Kalman filter with one variance for the position and one for the heading.

    Odometry predicts the pose, and a fix of the whole pose corrects it, as with any robot that
    navigates by a map. Errors of position and heading are taken as independent, except that heading
    uncertainty adds position uncertainty while driving.
    """

    def __init__(
        self, pose: Float[np.ndarray, "3"], noise: NoiseConfig, rng: np.random.Generator
    ) -> None:
        self.noise, self.rng = noise, rng
        self.variance = np.array([noise.position, noise.position, noise.heading]) ** 2
        self._of_fix = self.variance.copy()
        self.pose = self._fix(pose)

    def _fix(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        return pose + self.rng.normal(size=3) * np.sqrt(self._of_fix)

    def step(
        self, pose: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"], dt: float
    ) -> None:
        """Update the estimate after a control step.

        Args:
            pose: The true pose, which the fix measures.
            velocity: Mean true velocity in the step, which odometry measures, base frame.
            dt: Length of the step [s].
        """
        fix = self._fix(pose)
        measured = velocity * (1 + self.noise.odometry * self.rng.normal(size=3))
        if not self.noise.fused:
            self.pose = fix
            return
        self.pose = integrate(self.pose, measured, dt)
        distance = float(np.hypot(velocity[0], velocity[1])) * dt
        turn = abs(float(velocity[2])) * dt
        spread = (self.noise.odometry * distance) ** 2 + distance**2 * self.variance[2]
        self.variance += [spread, spread, (self.noise.odometry * turn) ** 2]
        total = self.variance + self._of_fix
        gain = np.divide(self.variance, total, out=np.ones(3), where=self._of_fix > 0)
        error = fix - self.pose
        error[2] = wrap_angle(error[2])
        self.pose = self.pose + gain * error
        self.variance = (1 - gain) * self.variance
