"""Check base-pose robustness: the task also works from all base poses within a given offset."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ArmPathResult, Attempt, PoseOutcome, PoseStatus, Tolerance
from momapos.planning.placement import (
    AttemptPose,
    BasePoseRule,
    BaseStatus,
    PlacementGeometry,
    base_pose_status,
)

from .base_pose_check import BasePoseChecks
from .query import PlacementQuery

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

SAMPLES = 150
"""Sampled offsets: if none fails, at least 98 % work with 95 % confidence [-]."""
NUM_FARTHEST = 16
"""Farthest offsets, at which the base alone is checked before any arm path is searched [-]."""


@dataclass(frozen=True)
class RobustChecks:
    """Check whether replanning also succeeds from the base poses around one with a motion."""

    query: PlacementQuery

    @property
    def tolerance(self) -> Tolerance:
        """Return the required tolerance."""
        place = self.query.config.place
        return Tolerance(place.robust_radius, float(np.radians(place.robust_turn)), SAMPLES)

    @cached_property
    def _checks(self) -> BasePoseChecks:
        return BasePoseChecks(self.query)

    @cached_property
    def _offsets(self) -> Float[np.ndarray, "n 3"]:
        """Return the sampled offsets, the farthest first: these fail most often."""
        required = self.tolerance
        unit = unit_offsets(required.samples, np.random.default_rng(self.query.seed))
        order = np.argsort(-np.abs(unit[:, 2]) - np.hypot(*unit[:, :2].T))
        return unit[order] * np.array([required.radius, required.radius, required.turn])

    def rule(self, geometry: PlacementGeometry) -> BasePoseRule:
        """Return the rule that the base is also free, and the arm long enough, around a pose.

        If not, replanning fails there, and no arm path need be searched.
        """
        exact = replace(geometry, clearance=0.0)

        def keeps(
            poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]
        ) -> Bool[np.ndarray, " n"]:
            kept = np.ones(len(poses), bool)
            for offset in self._offsets[:NUM_FARTHEST]:
                left = np.flatnonzero(kept)
                status, _outline = base_pose_status(exact, poses[left] + offset)
                kept[left] = status == BaseStatus.CLEAR
            return kept

        return BasePoseRule(keeps, self._not_robust)

    @property
    def _not_robust(self) -> PoseOutcome:
        return PoseOutcome(PoseStatus.LITTLE_ROOM, str(self.tolerance))

    def around(self, check: AttemptPose) -> AttemptPose:
        """Extend a check by the poses around the base pose."""

        def attempt(
            base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
        ) -> Attempt:
            found = check(base, screened, ways)
            if found.motion is None or works_around(self._checks, base, self._offsets):
                return found
            return Attempt(None, self._not_robust)

        return attempt


def works_around(
    checks: BasePoseChecks, base: Float[np.ndarray, "3"], offsets: Float[np.ndarray, "n 3"]
) -> bool:
    """Return whether a motion is found at all of some offsets [m], [m], [rad] from a base pose."""
    return all(checks(base + offset).motion is not None for offset in offsets)


def unit_offsets(count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Draw offsets uniformly from the unit disc, with a turn between -1 and 1."""
    angle, radius = rng.uniform(-np.pi, np.pi, count), np.sqrt(rng.uniform(size=count))
    turn = rng.uniform(-1.0, 1.0, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), turn], axis=-1)
