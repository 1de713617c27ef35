"""The method, one call a stage.

Perception, driving and physics are stages of their own; here a scene is known, and the answer is
where to stand and how to move.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.config import PipelineConfig
from momapos.geometry.polygons import inscribed_radius
from momapos.importance.key_objects import Selection, everything, start_of
from momapos.importance.rank import Importance, rank
from momapos.manipulation.motion import TaskMotion, task_motion
from momapos.manipulation.nearness import boxes_near_base, boxes_near_swept_volume, near_boxes
from momapos.manipulation.tasks import hand_path, slides
from momapos.navigation.cost_map import base_height, build_cost_map, floor_plan
from momapos.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.navigation.global_path import BasePath, plan_path
from momapos.outcomes import PoseOutcome, PoseStatus
from momapos.placement.place import PoseFilter, Problem, Search, search
from momapos.prepare import PreparedTask, prepare, start_pose
from momapos.protocols import Clock, ReachScorer
from momapos.reachability.store import load_reach_map
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene, upright_boxes
from momapos.stopwatch import Stopwatch
from momapos.types import ArmPathResult, Attempt, PlacementPlan, Task
from momapos.verification.exact import PlanVerifier

if TYPE_CHECKING:
    from jaxtyping import Float, Int

DEFAULT = PipelineConfig()


@dataclass(frozen=True)
class PlacementResult:
    """A plan, and what the search saw on the way; the latter is for pictures and benchmarks."""

    plan: PlacementPlan
    prepared: PreparedTask
    search: Search
    start: Float[np.ndarray, "3"]
    """Where the base was: x [m], y [m], yaw [rad]."""

    @property
    def slides(self) -> bool:
        """Whether the part slides [m]; it turns otherwise [rad]."""
        return slides(self.prepared.scene, self.plan.task)

    def __repr__(self) -> str:
        task = self.plan.task
        what = task.object if task.joint is None else f"{task.object}/{task.joint}"
        name, status = self.plan.robot_name, self.plan.status
        return f"<PlacementResult of {name}: {task.verb} {what}: {status}>"


def plan_base_placement(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer | None = None,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    pose_filter: PoseFilter | None = None,
    config: PipelineConfig = DEFAULT,
    cache_dir: Path | None = None,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> PlacementResult:
    """Answer where the robot must stand, and how it moves, to do a task.

    Objects that matter are modeled, all others are boxes; what turns out to matter later is
    modeled then. A "no" is given with everything modeled.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        task: What is to be done, see `make_task`.
        reach: The robot's reachability map; None to load it, or to build it at the first use.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        pose_filter: Rules base poses out, such as those that were driven to in vain.
        config: How to search.
        cache_dir: Where maps are kept; the user's cache folder by default.
        seed: Same seed, same answer.
        clock: Measures the stages and the timeout.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
    """
    watch = Stopwatch(clock)
    if reach is None:
        reach = load_reach_map(robot, cache_dir)
    query = _Query(scene, robot, task, reach, start, pose_filter, config, seed, watch)
    with watch.stage("importance"):
        path = hand_path(scene, task.object, task.joint, task.to)
        ranked = rank(scene, task.object, config.importance, path=path, seed=seed)
    with watch.stage("model"):
        motion = task_motion(scene.with_box_proxies({task.object}), robot, task, config.motion)
    selection = _first_selection(query, ranked, motion)
    while True:
        result = _search(query, selection, motion)
        if result.plan.status == "solved":
            selection, holds = _expand_model(query, selection, result)
            if holds:
                break
        elif result.plan.status == "timeout" or not selection.boxes:
            break
        else:
            selection = selection.relax_alpha()
    timing = {**watch.seconds, "total": watch.total}
    plan = replace(result.plan, key_objects=selection.record(), timing=timing)
    return replace(result, plan=plan)


@dataclass(frozen=True)
class _Query:
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

    @cached_property
    def nav_map(self) -> NavigationMap:
        """Where the robot fits with its arm at home, among all objects as they are."""
        return build_navigation_map(self.scene, self.robot)


def _first_selection(query: _Query, ranked: Importance, motion: TaskMotion) -> Selection:
    """S at the configured alpha, with what the door or the robot stands in already."""
    if query.config.place.method == "exhaustive":
        return everything(ranked)
    selection = start_of(ranked)
    names = selection.boxes
    boxes = upright_boxes([query.scene.object(name) for name in names])
    hit = boxes_near_swept_volume(motion, boxes, margin=0.0)
    start = query.scene.start if query.start is None else query.start
    if start is not None and np.isfinite(start).all() and len(start) == 3:
        hit |= boxes_near_base(query.robot, np.asarray(start, float), boxes, margin=0.0)
    return selection.join(names[i] for i in np.flatnonzero(hit))


def _search(query: _Query, selection: Selection, motion: TaskMotion) -> PlacementResult:
    """Search base poses with the selected objects modeled."""
    robot, config, watch = query.robot, query.config, query.watch
    modeled = query.scene.with_box_proxies(selection.names)
    clearance = config.place.clearance
    prepared = prepare(
        modeled, robot, query.task, config, clearance=clearance, motion=motion, watch=watch
    )
    with watch.stage("drive"):
        obstacles = prepared.motion.static_obstacles()
        plan = floor_plan(obstacles, height=base_height(robot), floor_polygon=modeled.floor_polygon)
        start = start_pose(query.scene, robot, prepared.motion, query.start, query.nav_map)
        cost = build_cost_map(plan, start[:2], radius=inscribed_radius(robot.footprint))

    # What is compiled and read before, once after installation, is not the search's time.
    left, begun = config.timeout - watch.seconds.get("search", 0.0), watch.clock()

    def out_of_time() -> bool:
        return watch.clock() - begun > left

    feasible = prepared.feasibility(config, query.seed, out_of_time=out_of_time, watch=watch)
    paths: dict[bytes, BasePath | None] = {}

    def attempt(
        base: Float[np.ndarray, "3"], screened: ArmPathResult, grasps: Int[np.ndarray, " k"]
    ) -> Attempt:
        """A motion at a base pose that can be driven to with the arm at home."""
        found = feasible(base, screened, grasps)
        if found.motion is None:
            return found
        with watch.stage("way"):
            path = paths[base.tobytes()] = plan_path(query.nav_map, start, base)
        if path is None:
            return Attempt(None, PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME))
        return found

    problem = Problem(
        geometry=prepared.geometry,
        reach=query.reach,
        travel_cost=cost.lengths,
        attempt=attempt,
        screen=feasible.screen,
        infeasible_reason=prepared.infeasible_reason,
        start=start,
        out_of_time=out_of_time,
        pose_filter=query.pose_filter,
    )
    # Only a room without stand-ins can tell that there is no base pose at all; in any other one
    # round of samples has to do.
    brief = replace(config.place, grid=False, rounds=min(1, config.place.rounds))
    search_config = brief if selection.boxes else config.place
    with watch.stage("search"):
        found = search(problem, search_config, np.random.default_rng(query.seed))
    path = None if found.base is None else paths.get(found.base.tobytes())
    return PlacementResult(_plan(query, found, start, path), prepared, found, start)


def _expand_model(
    query: _Query, selection: Selection, result: PlacementResult
) -> tuple[Selection, bool]:
    """Model what a plan comes near, and check it again, until nothing new is near.

    Returns:
        The selection, and whether the plan holds with it.
    """
    found, pose = result.plan.motion, result.plan.base_pose
    assert found is not None
    assert pose is not None
    robot, motion = query.robot, result.prepared.motion
    while selection.boxes:
        with query.watch.stage("expand model"):
            names = selection.boxes
            boxes = upright_boxes([query.scene.object(name) for name in names])
            near = near_boxes(
                robot, motion, np.array(pose), found, boxes, margin=query.config.near
            )  # fmt: skip
        if not near.any():
            break
        joined = selection.join(names[i] for i in np.flatnonzero(near))
        selection = replace(joined, rounds=selection.rounds + 1)
        with query.watch.stage("exact check"):
            verifier = PlanVerifier(
                query.scene.with_box_proxies(selection.names), robot, query.task
            )
            violation = verifier.first_violation(pose, found)
        if violation is not None:
            return selection, False
    return selection, True


def _plan(
    query: _Query, found: Search, start: Float[np.ndarray, "3"], path: BasePath | None
) -> PlacementPlan:
    robot, base = query.robot, found.base
    solved = found.motion is not None and base is not None
    return PlacementPlan(
        scene=str(query.scene.path) if query.scene.path else query.scene.name,
        robot_name=robot.name,
        robot_urdf=str(robot.model.urdf.path),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=query.task,
        status="solved" if solved else "timeout" if found.timed_out else "infeasible",
        robot_file=robot.source,
        robot_srdf=_named_srdf(robot),
        robot_rest=robot.model.held,
        scene_joints=query.scene.joints_set,
        joints=robot.arm_joints,
        start=(float(start[0]), float(start[1]), float(start[2])),
        base_path=None if path is None else path.poses,
        base_pose=None if base is None else (float(base[0]), float(base[1]), float(base[2])),
        motion=found.motion,
        navigation_cost=float(found.cost) if solved else None,
        candidates=found.candidates(),
        method=query.config.place.method,
        seed=query.seed,
        versions=_versions(),
    )


def _named_srdf(robot: Robot) -> str | None:
    """The SRDF, where it is not the one that everybody finds beside the URDF."""
    urdf = robot.model.urdf.path
    beside = None if urdf is None else urdf.with_suffix(".srdf")
    return None if robot.srdf is None or robot.srdf == beside else str(robot.srdf)


@cache
def _versions() -> dict[str, str]:
    """What the answer depends on, beside its inputs."""
    return {name: metadata.version(name) for name in ("momapos", "numpy", "ompl")}
