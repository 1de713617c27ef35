"""Restrict base poses: areas, facing direction, driving length."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from momapos.core.geometry import all_inside, any_overlap, place_points, wrap_angle
from momapos.model.records import BaseRegion, PoseOutcome, PoseStatus

from .area import PlacementGeometry

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


class PoseRule(Protocol):
    """One condition on base poses."""

    def keeps(
        self, poses: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"], /
    ) -> Bool[np.ndarray, " n"]:
        """Return which base poses satisfy it, given the driving length to each [m]."""
        ...

    @property
    def otherwise(self) -> PoseOutcome:
        """Return the outcome of the others."""
        ...


class BasePoseRule(NamedTuple):
    """One condition on base poses, see `PoseRule`."""

    keeps: Callable[[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]], Bool[np.ndarray, " n"]]
    """Return which base poses satisfy it, given the driving length to each [m]."""
    otherwise: PoseOutcome
    """Outcome of the others."""


def rules(region: BaseRegion, geometry: PlacementGeometry) -> list[BasePoseRule]:
    """Return the conditions of a region; the base faces the first grasp."""

    def inside(poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]) -> np.ndarray:
        outlines = place_points(poses, geometry.robot.footprint)
        each = [all_inside(np.array(area), outlines) for area in region.keep_in]
        return np.asarray(np.array(each).any(0))

    def outside(poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]) -> np.ndarray:
        outlines = place_points(poses, geometry.robot.base_outline)
        each = [any_overlap(np.array(area), outlines) for area in region.keep_out]
        return np.asarray(~np.array(each).any(0))

    def faces(poses: Float[np.ndarray, "n 3"], _: Float[np.ndarray, " n"]) -> np.ndarray:
        toward = geometry.Ts_world_tool[0, 1, :2, 3] - poses[:, :2]
        turn = wrap_angle(np.arctan2(toward[:, 1], toward[:, 0]) - poses[:, 2])
        return np.asarray(np.abs(turn) <= region.facing)

    def is_near(_: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"]) -> np.ndarray:
        return np.asarray((travel <= region.most_driving) | np.isinf(travel))

    every = (
        (bool(region.keep_in), inside, PoseStatus.NOT_KEPT_IN),
        (bool(region.keep_out), outside, PoseStatus.NOT_KEPT_OUT),
        (region.facing is not None, faces, PoseStatus.NOT_FACING),
        (region.most_driving is not None, is_near, PoseStatus.TOO_LONG_A_DRIVE),
    )
    return [BasePoseRule(keeps, PoseOutcome(status)) for applies, keeps, status in every if applies]
