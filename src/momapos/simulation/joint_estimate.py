"""Estimate the joint of a part from the path of the hand that holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import orthonormal, pose, rotation_about, rotation_of

from .config import AXIS_ERROR, TILT_ERROR, ComplianceConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float

_UPDATE_STEPS = 3
"""Gauss-Newton steps per update, which starts at the previous estimate [-]."""
_INITIAL_STEPS = 8
"""Gauss-Newton steps of an estimate that starts at the model [-]."""
_SPACING = 0.005
"""Minimum distance between two hand positions used [m]."""


@dataclass(frozen=True, eq=False)
class Axis:
    """Position and direction of a joint in the world."""

    slides: bool
    direction: Float[np.ndarray, "3"]
    """Unit vector."""
    point: Float[np.ndarray, "3"]
    """Point on a hinge axis [m]."""

    def moved(self, value: float) -> Float[np.ndarray, "4 4"]:
        """Return the transform of the child link when the joint moves by a value [rad] or [m]."""
        if self.slides:
            return pose(value * self.direction)
        R = rotation_about(self.direction, np.array(value))
        return pose(self.point - R @ self.point, R)

    def shifted(self, by: Float[np.ndarray, "3"]) -> Axis:
        """Return the joint, translated [m]."""
        return replace(self, point=self.point + by)

    def lever_at(self, point: Float[np.ndarray, "3"]) -> float:
        """Return the speed of a point per speed of the joint [m/rad] or [-]."""
        if self.slides:
            return 1.0
        return max(float(np.linalg.norm(np.cross(self.direction, point - self.point))), 1e-3)

    def way_at(self, point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return the unit direction of a point's motion for an increasing joint value."""
        if self.slides:
            return self.direction
        way = np.cross(self.direction, point - self.point)
        return np.asarray(way / max(float(np.linalg.norm(way)), 1e-9))


@dataclass(frozen=True, eq=False)
class LearnedPart:
    """State of a part, as the hand has measured it."""

    value: float
    """Value of its joint at the hand's last contact [rad] or [m]."""
    axis: Axis
    """Its joint, as estimated."""
    offset: Float[np.ndarray, "3"]
    """Offset of the part from that joint and the planned grasp [m]."""
    way: tuple[Float[np.ndarray, "3"], ...] = ()
    """Positions of the hand while it held the part in its last grasp [m]."""


JointDoubt: TypeAlias = "Callable[[Sequence[Float[np.ndarray, '3']]], bool]"
"""Whether the path of a hand that holds a part [m] contradicts the believed joint."""


class JointEstimate:
    """Maximum a posteriori estimate of a joint, given its model and the path of the hand.

    A Gaussian prior keeps it near the model until the hand has moved far. Points of the hand on a
    hinge keep their distance from the axis and their height along it; on a slide they stay on a
    line.
    """

    def __init__(
        self, modeled: Axis, start: Float[np.ndarray, "3"], config: ComplianceConfig
    ) -> None:
        self.modeled, self.axis, self.config = modeled, modeled, config
        self.points = [np.array(start)]
        self._doubts = [0.0]
        one = orthonormal(modeled.direction)
        self._across = np.stack([one, np.cross(modeled.direction, one)])
        self._x = np.zeros(2 if modeled.slides else 4)  # rotations [rad], then translations [m]

    @property
    def tilt(self) -> float:
        """Angle between the estimated and the modeled axis [rad]."""
        return float(np.linalg.norm(self._x[:2]))

    @property
    def shift(self) -> float:
        """Distance of the estimated hinge from the modeled one, at the height of the hand [m]."""
        return float(np.linalg.norm(self._x[2:]))

    @property
    def misfit(self) -> float:
        """Negative log posterior density of the estimate, up to a constant [-]."""
        r, _ = self._residuals()
        return float(r @ r) / 2

    def value_at(self, point: Float[np.ndarray, "3"]) -> float:
        """Return the joint's motion since the start for a position of the hand [rad] or [m]."""
        axis, start = self.axis, self.points[0]
        if axis.slides:
            return float((point - start) @ axis.direction)
        arms = np.stack([start, point]) - axis.point
        sine = np.cross(arms[0], arms[1]) @ axis.direction
        along = arms @ axis.direction
        return float(np.arctan2(sine, arms[0] @ arms[1] - along[0] * along[1]))

    @classmethod
    def along(
        cls, modeled: Axis, way: Sequence[Float[np.ndarray, "3"]], config: ComplianceConfig
    ) -> JointEstimate:
        """Return the estimate for a whole path of the hand [m]."""
        estimate = cls(modeled, way[0], config)
        estimate.points += way[1:]
        estimate._doubts += [0.0] * (len(way) - 1)
        estimate._fit(_INITIAL_STEPS)
        return estimate

    def see(self, point: Float[np.ndarray, "3"], doubt: float = 0.0) -> bool:
        """Add a position of the hand; return whether it is far enough from the last one.

        Args:
            point: The position [m].
            doubt: Standard deviation of where the robot is, since the start [m].
        """
        if np.linalg.norm(point - self.points[-1]) < _SPACING:
            return False
        self.points.append(np.array(point))
        self._doubts.append(doubt)
        self._fit(_UPDATE_STEPS)
        return True

    def _fit(self, rounds: int) -> None:
        for _ in range(rounds):
            r, J = self._residuals()
            self._x = self._x - np.linalg.lstsq(J, r, rcond=None)[0]
        self.axis = self._axis(self._x)

    def _axis(self, x: Float[np.ndarray, " k"]) -> Axis:
        """Return the joint for its parameters, with a hinge's point nearest to the start."""
        direction = rotation_of(x[:2] @ self._across) @ self.modeled.direction
        if self.modeled.slides:
            return Axis(True, direction, self.modeled.point)
        along = (self.points[0] - self.modeled.point) @ self.modeled.direction
        foot = self.modeled.point + along * self.modeled.direction
        return Axis(False, direction, foot + x[2:] @ self._across)

    def _residuals(self) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r k"]]:
        """Return prior and measurements over their standard deviations, and their Jacobian."""
        sigma = np.full(len(self._x), TILT_ERROR)
        sigma[2:] = AXIS_ERROR
        r, step = self._off(self._x), 1e-6
        J = np.stack([(self._off(self._x + d) - r) / step for d in step * np.eye(len(self._x))], 1)
        # Neighboring points share the error of where the robot is: all tell as much of it as one.
        doubts = np.sqrt(len(r)) * np.array(self._doubts[1:])
        each = np.hypot(self.config.hand_error, doubts)
        noise = np.repeat(each, 3) if self.modeled.slides else np.tile(each, 2)
        return np.append(self._x / sigma, r / noise), np.vstack(
            [np.diag(1 / sigma), J / noise[:, None]]
        )

    def _off(self, x: Float[np.ndarray, " k"]) -> Float[np.ndarray, " r"]:
        """Return the offsets of the points from the path of the first one [m]."""
        axis, points = self._axis(x), np.array(self.points)
        away = points[1:] - points[0]
        if axis.slides:
            return (away - np.outer(away @ axis.direction, axis.direction)).ravel()
        arms = points - axis.point
        arms = arms - np.outer(arms @ axis.direction, axis.direction)
        radius = np.linalg.norm(arms, axis=1)
        return np.append(radius[1:] - radius[0], away @ axis.direction)
