"""A question: what is asked, and what stays the same while it is answered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import Stopwatch
from momapos.model.records import ANYWHERE, BaseRegion, PoseOutcome, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.grasps import GraspFilter
from momapos.planning.navigation import (
    ConvexPolygons,
    NavigationMap,
    build_navigation_map,
    outlines_after,
)
from momapos.planning.placement import PoseFilter

from .config import PipelineConfig

if TYPE_CHECKING:
    from jaxtyping import Float

AlsoAtPose: TypeAlias = "Callable[[Float[np.ndarray, '3']], PoseOutcome | None]"
"""What a base pose does not allow beside the task; None where it allows all."""


@dataclass(frozen=True)
class PlacementQuery:
    """What stays the same while the model of the room grows."""

    scene: Scene
    robot: Robot
    task: Task
    reach: ReachScorer
    start: Float[np.ndarray, "3"] | None
    pose_filter: PoseFilter | None
    config: PipelineConfig
    seed: int
    watch: Stopwatch
    grasp_filter: GraspFilter | None = None
    """Which grasps may be used; None for all."""
    region: BaseRegion = ANYWHERE
    """Where the base is allowed to stand."""
    also: AlsoAtPose | None = None
    """What else is asked of a base pose where a motion was found."""

    @cached_property
    def nav_map(self) -> NavigationMap:
        """Where the robot fits with its arm at home, among all objects as they are."""
        return build_navigation_map(self.scene, self.robot)

    @cached_property
    def outlines_after(self) -> ConvexPolygons:
        """What the task moves, as it leaves it."""
        return outlines_after(self.scene, self.robot, self.task)
