"""The method, one call a stage.

Importance, perception, driving and physics are stages of their own; here a scene is already
modelled, and the answer is where to stand and how to move.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata

import numpy as np
from jaxtyping import Float

from momapos.config import PipelineConfig
from momapos.errors import SceneError
from momapos.geometry.polygons import all_inside, inscribed_radius
from momapos.kinematics.base_collision import base_hits
from momapos.kinematics.collision import FREE
from momapos.kinematics.world import World, build_world
from momapos.manipulation.feasibility import Feasibility, hand_clears
from momapos.manipulation.handles import opening_direction
from momapos.manipulation.motion import TaskMotion, task_motion
from momapos.manipulation.tasks import openable
from momapos.navigation.cost_map import FloorPlan, build_cost_map, floor_plan
from momapos.navigation.start import find_start
from momapos.placement.area import Site, footprints
from momapos.placement.place import Problem, Search, search
from momapos.protocols import Clock, ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.types import Motion, PlacementPlan, Task
from momapos.verification.exact import ExactWorld

DEFAULT = PipelineConfig()
ROOM_MARGIN = 2.0
"""Free border that is mapped around a room without a known floor [m]."""


@dataclass(frozen=True)
class Answer:
    """A plan, and what the search saw on the way; the latter is for pictures and benchmarks."""

    plan: PlacementPlan
    site: Site
    motion: TaskMotion
    search: Search
    start: Float[np.ndarray, "3"]
    slides: bool
    """Whether the part slides [m]; it turns otherwise [rad]."""


@dataclass
class _Stopwatch:
    clock: Clock
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        began = self.clock()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + self.clock() - began


def place(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    config: PipelineConfig = DEFAULT,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> Answer:
    """Answer where the robot must stand, and how it moves, to do a task.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        task: What is to be done, see `make_task`.
        reach: The robot's reachability map.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        config: How to search.
        seed: Same seed, same answer.
        clock: Measures the stages and the timeout.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
    """
    began, watch = clock(), _Stopwatch(clock)
    with watch.stage("model"):
        motion = task_motion(scene, robot, task, config.motion)
        world = arm_world(robot, motion, config)
        roomy, obstacle = hand_clears(robot, world, motion)
        if roomy.any():
            motion = replace(motion, Ts_world_tool=motion.Ts_world_tool[roomy])
    with watch.stage("drive"):
        plan = room_plan(scene, robot, motion)
        start = start_pose(scene, robot, plan, motion, start)
        cost = build_cost_map(plan, start[:2], radius=inscribed_radius(robot.footprint))
    with watch.stage("exact model"):
        exact = ExactWorld(scene, robot, task)
    site = Site(
        robot=robot,
        Ts_world_tool=np.ascontiguousarray(motion.Ts_world_tool[:, motion.coarse]),
        static=motion.static,
        sweep=motion.sweep(),
        floor=scene.floor,
        clearance=config.place.clearance,
    )

    def refuse(base: Float[np.ndarray, "3"], found: Motion) -> str | None:
        with watch.stage("exact check"):
            return exact.refusal((float(base[0]), float(base[1]), float(base[2])), found)

    def out_of_time() -> bool:
        return clock() - began > config.timeout

    feasible = Feasibility(robot, world, motion, config.planner, refuse, seed, out_of_time)
    problem = Problem(
        site=site,
        reach=reach,
        travel_cost=cost.lengths,
        attempt=feasible,
        screen=feasible.screen,
        hopeless="" if roomy.any() else f"the hand hits {obstacle} in every grasp",
        start=start,
        out_of_time=out_of_time,
    )
    with watch.stage("search"):
        result = search(problem, config.place, np.random.default_rng(seed))
    timing = {**watch.seconds, "total": clock() - began}
    return Answer(
        plan=_plan(scene, robot, task, result, config, seed, timing),
        site=site,
        motion=motion,
        search=result,
        start=start,
        slides=slides(scene, task),
    )


@cache
def _versions() -> dict[str, str]:
    """What the answer depends on, beside its inputs."""
    return {name: metadata.version(name) for name in ("momapos", "numpy", "ompl")}


def slides(scene: Scene, task: Task) -> bool:
    """Whether a task moves a part along a line, and does not turn it."""
    if task.joint is None:
        return False
    return scene.object(task.object).model.joint(task.joint).kind == "prismatic"


def arm_world(robot: Robot, motion: TaskMotion, config: PipelineConfig) -> World:
    """The room as the arm's collision kernel wants it."""
    return build_world(
        motion.static,
        motion.moving,
        motion.grasped,
        motion.labels,
        robot.spheres,
        clearance=config.arm_clearance,
    )


def room_plan(scene: Scene, robot: Robot, motion: TaskMotion) -> FloorPlan:
    """What stands in the base's way before the task begins."""
    height = float((robot.base.center + robot.base.half)[:, 2].max(initial=0.3))
    closed = motion.standing_boxes()
    return floor_plan(closed, height=height, margin=ROOM_MARGIN, floor=scene.floor)


def start_pose(
    scene: Scene,
    robot: Robot,
    plan: FloorPlan,
    motion: TaskMotion,
    start: Float[np.ndarray, "3"] | None,
) -> Float[np.ndarray, "3"]:
    """The start that was given, the scene's, or a roomy place in front of the furniture.

    Raises:
        SceneError: The base cannot stand there.
    """
    given = start if start is not None else scene.start
    if given is None:
        return find_start(plan, _in_front(scene))
    pose = np.asarray(given, float)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise SceneError("the start must be three numbers: x [m], y [m], yaw")
    hit = int(base_hits(pose[None], robot.base, motion.standing_boxes(), clearance=0.0)[0])
    where = f"start ({pose[0]:.2f}, {pose[1]:.2f}, {np.degrees(pose[2]):.0f} deg)"
    if hit != FREE:
        raise SceneError(f"{where}: the base of {robot.name} would hit {motion.labels[hit]}")
    if scene.floor is not None and not all_inside(scene.floor, footprints(robot, pose[None]))[0]:
        raise SceneError(f"{where}: the base of {robot.name} would stand off the floor")
    return pose


def _in_front(scene: Scene) -> Float[np.ndarray, "2"]:
    """A point before the doors and drawers of the room, on the side to which they open."""
    points = [
        point[:2] + 1.5 * direction[:2]
        for name, joint in openable(scene)
        for point, direction in [opening_direction(scene.object(name), joint)]
    ]
    if points:
        return np.mean(points, axis=0)
    return np.mean([item.bounds[:, :2].mean(0) for item in scene.objects], axis=0)


def _plan(
    scene: Scene,
    robot: Robot,
    task: Task,
    result: Search,
    config: PipelineConfig,
    seed: int,
    timing: dict[str, float],
) -> PlacementPlan:
    solved = result.motion is not None and result.base is not None
    base = result.base
    return PlacementPlan(
        scene=str(scene.path) if scene.path else scene.name,
        robot_name=robot.name,
        robot_urdf=str(robot.model.urdf.path),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=task,
        status="solved" if solved else "timeout" if result.timed_out else "infeasible",
        joints=robot.arm_joints,
        base_pose=None if base is None else (float(base[0]), float(base[1]), float(base[2])),
        motion=result.motion,
        navigation_cost=float(result.cost) if solved else None,
        candidates=result.candidates(),
        timing=timing,
        method=config.place.method,
        seed=seed,
        versions=_versions(),
    )
