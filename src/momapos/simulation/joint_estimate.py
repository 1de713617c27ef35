"""Where a part's joint really is, estimated from the way that the hand takes while it holds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core.geometry import orthonormal, pose, rotation_about, rotation_of

from .config import ComplianceConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Float

_ROUNDS = 3
"""Gauss-Newton steps for each estimate, which begins at the last one [-]."""
_ROUNDS_AT_ONCE = 8
"""Likewise where the estimate begins at the model [-]."""
_SPACING = 0.005
"""Way of the hand between two points that count [m]."""


@dataclass(frozen=True, eq=False)
class Axis:
    """Where a joint is, in the world."""

    slides: bool
    direction: Float[np.ndarray, "3"]
    """Unit vector."""
    point: Float[np.ndarray, "3"]
    """On the axis of a hinge [m]."""

    def moved(self, value: float) -> Float[np.ndarray, "4 4"]:
        """How a joint moves what hangs on it, when it moves by a value [rad] or [m]."""
        if self.slides:
            return pose(value * self.direction)
        R = rotation_about(self.direction, np.array(value))
        return pose(self.point - R @ self.point, R)

    def shifted(self, by: Float[np.ndarray, "3"]) -> Axis:
        """The same joint elsewhere [m]."""
        return replace(self, point=self.point + by)

    def lever_at(self, point: Float[np.ndarray, "3"]) -> float:
        """Way of a point when the joint moves by 1 [m/rad] or [-]."""
        if self.slides:
            return 1.0
        return max(float(np.linalg.norm(np.cross(self.direction, point - self.point))), 1e-3)

    def way_at(self, point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Unit vector along which a point moves when the joint's value rises."""
        if self.slides:
            return self.direction
        way = np.cross(self.direction, point - self.point)
        return np.asarray(way / max(float(np.linalg.norm(way)), 1e-9))


@dataclass(frozen=True, eq=False)
class Learned:
    """What the hand has learned of the part."""

    value: float
    """Where the hand has its joint, or had it last [rad] or [m]."""
    axis: Axis
    """Its joint, as the hand found it."""
    offset: Float[np.ndarray, "3"]
    """How far it is from where that joint and the plan's grasp have it [m]."""
    way: tuple[Float[np.ndarray, "3"], ...] = ()
    """Where the hand was while it held the part in its last hold, one after the other [m]."""


Doubt: TypeAlias = "Callable[[Sequence[Float[np.ndarray, '3']]], bool]"
"""Whether the way of a hand that holds a part [m] speaks against the joint as believed."""


class JointEstimate:
    """The most likely joint: near the modeled one, and fit for the way that the hand took.

    A Gaussian prior holds it near the model as long as the hand has not moved far. Points of the
    hand on a hinge keep their distance from the axis and their height along it; on a slide they
    stay on a line.
    """

    def __init__(
        self, modeled: Axis, start: Float[np.ndarray, "3"], config: ComplianceConfig
    ) -> None:
        self.modeled, self.axis, self.config = modeled, modeled, config
        self.points = [np.array(start)]
        one = orthonormal(modeled.direction)
        self._across = np.stack([one, np.cross(modeled.direction, one)])
        self._x = np.zeros(2 if modeled.slides else 4)  # turns [rad], then shifts [m]

    @property
    def tilt(self) -> float:
        """Angle between the estimated and the modeled axis [rad]."""
        return float(np.linalg.norm(self._x[:2]))

    @property
    def shift(self) -> float:
        """Distance of the estimated hinge from the modeled one, where the hand is [m]."""
        return float(np.linalg.norm(self._x[2:]))

    @property
    def misfit(self) -> float:
        """How improbable the way is for a joint that is about where it is modeled: minus the
        logarithm of its density, but for a constant [-]."""
        r, _ = self._residuals()
        return float(r @ r) / 2

    def value_at(self, point: Float[np.ndarray, "3"]) -> float:
        """How far the joint has moved since the start, by where the hand is [rad] or [m]."""
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
        """The estimate for a whole way of the hand [m]."""
        estimate = cls(modeled, way[0], config)
        estimate.points += way[1:]
        estimate._fit(_ROUNDS_AT_ONCE)
        return estimate

    def see(self, point: Float[np.ndarray, "3"]) -> bool:
        """Take a position of the hand into account [m]; whether it is far enough to count."""
        if np.linalg.norm(point - self.points[-1]) < _SPACING:
            return False
        self.points.append(np.array(point))
        self._fit(_ROUNDS)
        return True

    def _fit(self, rounds: int) -> None:
        for _ in range(rounds):
            r, J = self._residuals()
            self._x = self._x - np.linalg.lstsq(J, r, rcond=None)[0]
        self.axis = self._axis(self._x)

    def _axis(self, x: Float[np.ndarray, " k"]) -> Axis:
        """The joint for its parameters; a hinge turns about the point nearest to the start."""
        direction = rotation_of(x[:2] @ self._across) @ self.modeled.direction
        if self.modeled.slides:
            return Axis(True, direction, self.modeled.point)
        along = (self.points[0] - self.modeled.point) @ self.modeled.direction
        foot = self.modeled.point + along * self.modeled.direction
        return Axis(False, direction, foot + x[2:] @ self._across)

    def _residuals(self) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r k"]]:
        """Prior and measurements, each over its standard deviation, and their derivatives."""
        sigma = np.full(len(self._x), self.config.tilt_error)
        sigma[2:] = self.config.axis_error
        r, step = self._off(self._x), 1e-6
        J = np.stack([(self._off(self._x + d) - r) / step for d in step * np.eye(len(self._x))], 1)
        noise = self.config.hand_error
        return np.append(self._x / sigma, r / noise), np.vstack([np.diag(1 / sigma), J / noise])

    def _off(self, x: Float[np.ndarray, " k"]) -> Float[np.ndarray, " r"]:
        """How far the points are off the way of the first one [m]."""
        axis, points = self._axis(x), np.array(self.points)
        away = points[1:] - points[0]
        if axis.slides:
            return (away - np.outer(away @ axis.direction, axis.direction)).ravel()
        arms = points - axis.point
        arms = arms - np.outer(arms @ axis.direction, axis.direction)
        radius = np.linalg.norm(arms, axis=1)
        return np.append(radius[1:] - radius[0], away @ axis.direction)
