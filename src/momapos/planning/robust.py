"""Base poses beside which the robot may stand as well, by as much as was asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import ArmPathResult, Attempt, PoseOutcome, PoseStatus, Tolerance
from momapos.planning.placement import (
    AttemptPose,
    BaseStatus,
    PlacementGeometry,
    Rule,
    base_pose_status,
)

from .base_pose_check import BasePoseChecks
from .query import PlacementQuery

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

SAMPLES = 150
"""Where so many poses work and none fails, at least 98 % do at a confidence of 95 % [-]."""


FARTHEST = 16
"""Of the poses around one, those at which the base alone is looked at first [-]."""


@dataclass(frozen=True)
class RobustChecks:
    """Asks of a base pose with a motion whether the motion is found anew around it."""

    query: PlacementQuery

    @property
    def tolerance(self) -> Tolerance:
        """What is asked for."""
        place = self.query.config.place
        return Tolerance(place.robust_radius, float(np.radians(place.robust_turn)), SAMPLES)

    @cached_property
    def _checks(self) -> BasePoseChecks:
        return BasePoseChecks(self.query)

    @cached_property
    def _offsets(self) -> Float[np.ndarray, "n 3"]:
        """Of the poses around one, the farthest first: there it fails most."""
        asked = self.tolerance
        unit = unit_offsets(asked.samples, np.random.default_rng(self.query.seed))
        order = np.argsort(-np.abs(unit[:, 2]) - np.hypot(*unit[:, :2].T))
        return unit[order] * np.array([asked.radius, asked.radius, asked.turn])

    def rule(self, geometry: PlacementGeometry) -> Rule:
        """Around a base pose the base stands clear and the arm is long enough.

        Without that the motion is not found there, and no arm path has to be looked for.
        """
        exact = replace(geometry, clearance=0.0)

        def keeps(
            poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]
        ) -> Bool[np.ndarray, " n"]:
            kept = np.ones(len(poses), bool)
            for offset in self._offsets[:FARTHEST]:
                left = np.flatnonzero(kept)
                status, _outline = base_pose_status(exact, poses[left] + offset)
                kept[left] = status == BaseStatus.CLEAR
            return kept

        return Rule(keeps, self._little_room)

    @property
    def _little_room(self) -> PoseOutcome:
        return PoseOutcome(PoseStatus.LITTLE_ROOM, str(self.tolerance))

    def around(self, check: AttemptPose) -> AttemptPose:
        """A check that asks for the poses around as well."""

        def attempt(
            base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
        ) -> Attempt:
            found = check(base, screened, ways)
            if found.motion is None or works_around(self._checks, base, self._offsets):
                return found
            return Attempt(None, self._little_room)

        return attempt


def works_around(
    checks: BasePoseChecks, base: Float[np.ndarray, "3"], offsets: Float[np.ndarray, "n 3"]
) -> bool:
    """Whether the motion is found from a base pose at all of some offsets [m], [m], [rad]."""
    return all(checks(base + offset).motion is not None for offset in offsets)


def unit_offsets(count: int, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Offsets drawn evenly in the unit disc, with a turn between -1 and 1."""
    angle, radius = rng.uniform(-np.pi, np.pi, count), np.sqrt(rng.uniform(size=count))
    turn = rng.uniform(-1.0, 1.0, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), turn], axis=-1)
