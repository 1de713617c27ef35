"""A question: what is asked, and what stays the same while it is answered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.config import PipelineConfig
from momapos.manipulation.motion import GraspFilter
from momapos.navigation.convex_polygons import ConvexPolygons
from momapos.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.navigation.start import outlines_after
from momapos.outcomes import PoseOutcome
from momapos.placement.problem import PoseFilter
from momapos.protocols import ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.stopwatch import Stopwatch
from momapos.types import ANYWHERE, BaseRegion, Task

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
