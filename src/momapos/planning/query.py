"""A question about one task: the one argument of every planner, checked where it is built."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypedDict

import numpy as np

from momapos.core import (
    Clock,
    InputError,
    Stopwatch,
    TaskError,
    as_path,
    expect,
    expect_callable,
    finite_array,
    processor_time,
    shown,
    time_limit,
    whole_number,
)
from momapos.model.records import ANYWHERE, BaseRegion, PoseOutcome, ReachScorer, Task
from momapos.model.robots import Robot, with_closed_hand
from momapos.model.scene import Scene, SceneObject
from momapos.planning.grasps import GraspFilter
from momapos.planning.navigation import (
    ConvexPolygons,
    NavigationMap,
    build_navigation_map,
    outlines_after,
)
from momapos.planning.placement import OURS, PoseCost, PoseMask
from momapos.planning.reachability import ArmLength, ReachMap, load_reach

from .config import PipelineConfig

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True)
class CheckedReach:
    """A scorer whose arguments are copies, and whose scores are checked."""

    scorer: ReachScorer

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the scores of the scorer.

        Raises:
            InputError: They are not one number in [0, 1] for each base pose and grasp.
        """
        scores = np.asarray(self.scorer.min_score(bases.copy(), Ts_world_tool.copy()))
        shape = (len(bases), len(Ts_world_tool))
        if scores.shape != shape or scores.dtype.kind not in "fiub":
            raise InputError(
                f"reach.min_score must return an array of shape {shape}, a score for each base "
                f"pose and grasp, not an array of {scores.dtype} of shape {scores.shape}"
            )
        if not ((scores >= 0.0) & (scores <= 1.0)).all():
            raise InputError("reach.min_score must return scores in [0, 1]")
        return scores.astype(float)


def checked_reach(reach: ReachScorer) -> ReachScorer:
    """Return a scorer with checks, unless it is one of momapos."""
    return reach if isinstance(reach, ReachMap | ArmLength | CheckedReach) else CheckedReach(reach)


FinalCheck: TypeAlias = "Callable[[Float[np.ndarray, '3']], PoseOutcome | None]"
"""Returns why a base pose with a motion is rejected; None if it is accepted."""
DEFAULT = PipelineConfig()


class QueryOptions(TypedDict, total=False):
    """Keywords of `PlacementQuery.of`, and of every function that builds a query."""

    start: Sequence[float] | Float[np.ndarray, "3"] | None
    region: BaseRegion
    keep_poses: PoseMask | None
    pose_cost: PoseCost | None
    keep_grasps: GraspFilter | None
    config: PipelineConfig
    cache_dir: str | Path | None
    seed: int
    clock: Clock


@dataclass(frozen=True, eq=False)
class PlacementQuery:
    """A scene, a robot and a task, and the conditions under which an answer counts.

    `PlacementQuery.of` builds one and loads the reachability map.

    Raises:
        InputError: A field has the wrong type, shape or range.
    """

    scene: Scene
    """What moves with the part of the task is a link of its object, see `Scene.with_contents`."""
    robot: Robot
    task: Task
    reach: ReachScorer
    """The robot's reachability map."""
    start: Float[np.ndarray, "3"] | None = None
    """Where the base is now: x [m], y [m], yaw [rad]; None for the scene's start."""
    config: PipelineConfig = DEFAULT
    region: BaseRegion = ANYWHERE
    """Where the base may stand."""
    keep_poses: PoseMask | None = None
    """Returns for base poses (n, 3) which of them may be tried, as n bools; None for all."""
    keep_grasps: GraspFilter | None = None
    """Returns which grasps of a motion may be used; None for all."""
    final_check: FinalCheck | None = None
    """A last condition on base poses for which a motion was found; None for no condition."""
    pose_cost: PoseCost | None = None
    """Returns a further cost of base poses (n, 3), as driving lengths [m]; None for none."""
    from_home: bool = False
    """Whether the arm begins at home also where it carries an object, as after another task."""
    carried: Float[np.ndarray, " n"] | None = None
    """The arm's state in which an object is carried, at the start to place it, at the end to pick
    it up; None to choose it [rad] or [m]."""
    seed: int = 0
    watch: Stopwatch = field(default_factory=lambda: Stopwatch(processor_time))

    def __post_init__(self) -> None:
        expect("scene", self.scene, Scene, "load_scene reads one")
        expect("robot", self.robot, Robot, "load_robot reads one")
        expect("task", self.task, Task, "make_task makes one")
        if self.task.joint is not None:
            loaded = self.scene.with_contents(self.task.object, self.task.joint)
            object.__setattr__(self, "scene", loaded)
        if not hasattr(self.reach, "min_score"):
            raise InputError("reach must be a reachability map; load_reach_map reads one")
        object.__setattr__(self, "reach", checked_reach(self.reach))
        expect("config", self.config, PipelineConfig, "set its stages, as place=PlaceConfig()")
        level = self.config.motion.level
        if level is not None and self.task.joint is None:
            _refuse_tilted(self.scene.object(self.task.object), level)
            object.__setattr__(self, "task", replace(self.task, level=math.radians(level)))
        if self.task.verb == "press":
            object.__setattr__(self, "robot", with_closed_hand(self.robot))
        expect("region", self.region, BaseRegion)
        for name in ("keep_poses", "keep_grasps", "final_check", "pose_cost"):
            if getattr(self, name) is not None:
                expect_callable(name, getattr(self, name))
        if self.pose_cost is not None and self.config.place.method not in OURS:
            raise InputError(
                f"pose_cost needs the method {' or '.join(OURS)}, not {self.config.place.method!r}"
            )
        if self.start is not None:
            object.__setattr__(self, "start", finite_array("start", self.start, (3,)))
        object.__setattr__(self, "seed", whole_number("seed", self.seed, 0, 2**63 - 1))

    @classmethod
    def of(
        cls,
        scene: Scene,
        robot: Robot,
        task: Task,
        reach: ReachScorer | None = None,
        *,
        start: Sequence[float] | Float[np.ndarray, "3"] | None = None,
        region: BaseRegion = ANYWHERE,
        keep_poses: PoseMask | None = None,
        pose_cost: PoseCost | None = None,
        keep_grasps: GraspFilter | None = None,
        config: PipelineConfig = DEFAULT,
        cache_dir: str | Path | None = None,
        seed: int = 0,
        clock: Clock = processor_time,
    ) -> PlacementQuery:
        """Build a query.

        Args:
            scene: The scene.
            robot: The mobile manipulator.
            task: What must be done, see `make_task`.
            reach: The robot's reachability map; None to load it, or to build it at first use.
            start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
            region: Where the base may stand.
            keep_poses: Returns for base poses (n, 3) which of them may be tried, as n bools. This
                keeps the robot west of x = 2 m: `lambda poses: poses[:, 0] < 2.0`.
            pose_cost: Returns a further cost of base poses (n, 3), as n driving lengths of at least
                0 [m]: among feasible base poses that of the least total cost is chosen.
            keep_grasps: Returns which grasps of a motion may be used, as bools.
            config: How to search.
            cache_dir: Folder of the cached maps; the user's cache folder by default.
            seed: The same seed gives the same answer.
            clock: Measures the stages and the time limit [s]; by default the processor time of the
                process, without that of compiling kernels. A program that also computes in
                other threads may pass `time.thread_time` or `time.monotonic`.

        Raises:
            InputError: An argument has the wrong type, shape or range.
        """
        expect("robot", robot, Robot, "load_robot reads one")
        folder = None if cache_dir is None else as_path("cache_dir", cache_dir)
        expect_callable("clock", clock)
        if reach is None:
            reach = load_reach(robot, folder)
        return cls(
            scene, robot, task, reach, start, config, region, keep_poses, keep_grasps,  # type: ignore[arg-type]
            pose_cost=pose_cost, seed=seed, watch=Stopwatch(clock),
        )  # fmt: skip

    def in_time(self) -> AbstractContextManager[None]:
        """Return a context that ends its work when the time of the answer is over.

        Raises:
            OutOfTimeError: It is over.
        """
        return time_limit(self.config.timeout - self.watch.total, self.watch.clock)

    @cached_property
    def nav_map(self) -> NavigationMap:
        """Return where the robot fits with its arm at home, among all objects as they are.

        The base keeps out of the region's areas.
        """
        # An object that the robot carries is not yet where the scene has it.
        carries = self.task.verb == "place"
        scene = self.scene.without(self.task.object) if carries else self.scene
        return build_navigation_map(scene, self.robot, self.region.keep_out)

    @cached_property
    def outlines_after(self) -> ConvexPolygons:
        """Return the outlines of what the task moves, at its pose after the task."""
        return outlines_after(self.scene, self.robot, self.task)

    def kept(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which base poses `keep_poses` allows.

        Raises:
            InputError: It returns anything but one bool per pose.
        """
        assert self.keep_poses is not None
        mask = np.asarray(self.keep_poses(poses.copy()))
        if mask.shape != (len(poses),) or mask.dtype != bool:
            raise InputError(
                f"keep_poses must return {len(poses)} bools, one per base pose, not an array of "
                f"{mask.dtype} of shape {mask.shape}"
            )
        return mask

    def own_cost(self, poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the cost of base poses by `pose_cost` [m].

        Raises:
            InputError: It returns anything but one number of at least 0 per pose.
        """
        assert self.pose_cost is not None
        cost = np.asarray(self.pose_cost(poses.copy()))
        if cost.shape != (len(poses),) or cost.dtype.kind not in "fiu":
            raise InputError(
                f"pose_cost must return {len(poses)} numbers, one per base pose, not an array of "
                f"{cost.dtype} of shape {cost.shape}"
            )
        if not (np.isfinite(cost) & (cost >= 0.0)).all():
            raise InputError(
                "pose_cost must return finite numbers of at least 0; keep_poses excludes poses"
            )
        return cost.astype(float)


def as_query(
    first: object, rest: tuple[object, ...], options: Mapping[str, object]
) -> PlacementQuery:
    """Return the query that a caller passes whole, or in its parts.

    Raises:
        InputError: Parts are missing, superfluous or wrong.
    """
    if isinstance(first, PlacementQuery):
        if rest or options:
            raise InputError("a PlacementQuery is passed alone; set its fields instead")
        return first
    parts = dict(zip(("robot", "task", "reach"), rest, strict=False)) | dict(options)
    unknown = sorted(set(parts) - {"robot", "task", "reach", *QueryOptions.__annotations__})
    if unknown or len(rest) > 3:
        raise InputError(
            f"unknown argument {shown(unknown[0] if unknown else rest[3])}; known are scene, "
            f"robot, task, reach, {', '.join(QueryOptions.__annotations__)}"
        )
    if not {"robot", "task"} <= set(parts):
        raise InputError("scene, robot and task are needed, or a PlacementQuery")
    return PlacementQuery.of(first, **parts)  # type: ignore[arg-type]


def _refuse_tilted(item: SceneObject, level: float) -> None:
    """Refuse to keep an object level that does not stand upright.

    Raises:
        TaskError: It is tilted by more than the level [deg].
    """
    cosine = float(np.clip(item.T_world_object[2, 2], -1.0, 1.0))
    tilt = math.degrees(math.acos(cosine))
    if tilt > level:
        raise TaskError(
            f"{item.name} is tilted by {tilt:.0f} deg in the scene, more than the {level:g} deg to "
            "which it is to stay level"
        )
