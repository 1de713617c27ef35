"""Scene, robot and task made ready: what every check of a base pose needs, built once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch
from momapos.core.geometry import inscribed_radius
from momapos.model.collision import CollisionWorld, build_world
from momapos.model.records import Motion, Task, TravelCost
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.arm_motion import Feasibility, collision_free_grasps
from momapos.planning.grasps import (
    FULL,
    LIFT,
    GraspFilter,
    Handle,
    TaskMotion,
    by_another_handle,
    in_front_of_parts,
    in_room,
    room_boxes,
    task_motion,
)
from momapos.planning.navigation import (
    NavigationMap,
    base_height,
    build_cost_map,
    check_arm_at_home,
    check_base,
    find_start,
    floor_plan,
)
from momapos.planning.placement import PlacementGeometry, ScoreWays, ways_of_holding
from momapos.verification import PlanVerifier

from .config import PipelineConfig

if TYPE_CHECKING:
    from jaxtyping import Float

NO_OTHER_GRASP = "there is no other grasp"


@dataclass(frozen=True)
class PreparedTask:
    """A scene, a robot and a task, made ready."""

    scene: Scene
    """The room as it is modeled."""
    robot: Robot
    task: Task
    motion: TaskMotion
    """Tool poses of the grasps for which the hand has room; of all where it has none for any."""
    world: CollisionWorld
    """The room as the arm's collision kernel wants it."""
    geometry: PlacementGeometry
    """The room and the task as placement wants them."""
    no_grasp: str
    """Why no single grasp moves it all the way, wherever the base stands; "" where some may."""

    @cached_property
    def verifier(self) -> PlanVerifier:
        """The exact check."""
        return PlanVerifier(self.scene, self.robot, self.task)

    @cached_property
    def blocked(self) -> str:
        """What the part runs into on its way, whoever moves it; "" where it is free."""
        return self.verifier.blocked(LIFT) or ""

    @property
    def infeasible_reason(self) -> str:
        """Why one grasp helps at no base pose, where that is known beforehand, else ""."""
        return self.blocked or self.no_grasp

    def violation(self, base_pose: Float[np.ndarray, "3"], motion: Motion) -> str | None:
        """What the exact check finds wrong with a motion; None where it holds.

        Args:
            base_pose: x [m], y [m], yaw [rad].
            motion: What the robot does there.
        """
        x, y, yaw = map(float, base_pose)
        return self.verifier.first_violation((x, y, yaw), motion)

    @property
    def ways(self) -> tuple[ScoreWays, ...]:
        """How base poses reach the ways of holding."""
        ways = ways_of_holding(self.geometry.Ts_world_tool, self.motion.turning.groups)
        # What holds still is beyond an arm of few joints, see `free_turn`.
        return ways if self.robot.chain.size >= FULL else ways[1:] or ways

    def feasibility(
        self,
        config: PipelineConfig,
        seed: int,
        *,
        out_of_time: Callable[[], bool] = lambda: False,
        watch: Stopwatch | None = None,
    ) -> Feasibility:
        """The check of base poses, its exact part counted as a stage of its own."""

        def violation(base_pose: Float[np.ndarray, "3"], motion: Motion) -> str | None:
            if watch is None:
                return self.violation(base_pose, motion)
            with watch.stage("exact check"):
                return self.violation(base_pose, motion)

        return Feasibility(
            self.robot, self.world, self.motion, config.arm_planner, violation, seed, out_of_time,
            config.motion.home_again,
        )  # fmt: skip


def prepare(
    scene: Scene,
    robot: Robot,
    task: Task,
    config: PipelineConfig,
    *,
    clearance: float,
    motion: TaskMotion | None = None,
    grasp_filter: GraspFilter | None = None,
    watch: Stopwatch | None = None,
) -> PreparedTask:
    """Make a scene, a robot and a task ready.

    Args:
        scene: The room as it is to be modeled.
        robot: The mobile manipulator.
        task: What is to be done.
        config: How to plan.
        clearance: Distance that the base keeps from everything [m].
        motion: The task's motion in another version of the room, where that is known.
        grasp_filter: Rules grasps out, such as those that failed; all are tried by default.
        watch: Counts the stages.

    Raises:
        TaskError: The gripper cannot hold the object.
        RobotError: The robot and the task do not fit together.
    """
    watch = watch or Stopwatch(lambda: 0.0)
    with watch.stage("model"):
        if motion is None:
            motion = task_motion(scene, robot, task, config.motion)
        else:
            motion = in_room(motion, scene)
        motion, world, no_grasp = _with_room(scene, robot, motion, config, grasp_filter)
    geometry = placement_geometry(scene, robot, motion, clearance)
    return PreparedTask(scene, robot, task, motion, world, geometry, no_grasp)


def _with_room(
    scene: Scene,
    robot: Robot,
    motion: TaskMotion,
    config: PipelineConfig,
    grasp_filter: GraspFilter | None,
) -> tuple[TaskMotion, CollisionWorld, str]:
    """A motion by the first handle that holds and at which the hand has room, and its world.

    Where it has no room at any, or none is allowed, the motion as it is given, and why no grasp
    helps.
    """
    found: list[tuple[TaskMotion, CollisionWorld, str]] = []
    passed: list[Handle] = []
    other: TaskMotion | None = motion
    while other is not None:
        world = collision_world(robot, other, config)
        has_room, obstacle = collision_free_grasps(robot, world, other)
        allowed = has_room if grasp_filter is None else has_room & grasp_filter(other)
        if allowed.any():
            return other.only(other.grasps.deepest(allowed)), world, other.refusal
        why = NO_OTHER_GRASP if has_room.any() else _no_room(other, obstacle)
        found.append((other, world, other.refusal or why))
        passed += other.grasps.handles
        other = by_another_handle(motion, scene, robot, config.motion, passed)
    return found[0]


def _no_room(motion: TaskMotion, obstacle: str) -> str:
    """That the hand has room for no grasp."""
    hits = f"the hand hits {obstacle} in every grasp"
    if not motion.passed_over or motion.handle is None:
        return hits
    return f"{motion.passed_over}, and {hits} of {motion.handle}"


def placement_geometry(
    scene: Scene, robot: Robot, motion: TaskMotion, clearance: float
) -> PlacementGeometry:
    """The room and the task as placement wants them; the base keeps a clearance [m]."""
    return PlacementGeometry(
        robot=robot,
        Ts_world_tool=np.ascontiguousarray(motion.Ts_world_tool[:, motion.waypoint_steps]),
        static=motion.static,
        sweep=motion.sweep(),
        floor_polygon=scene.floor_polygon,
        clearance=clearance,
    )


def collision_world(robot: Robot, motion: TaskMotion, config: PipelineConfig) -> CollisionWorld:
    """The room and the moving part as the arm's collision kernel wants them."""
    return build_world(
        motion.static,
        motion.moving,
        motion.grasped,
        motion.labels,
        robot.spheres,
        clearance=config.arm_clearance,
    )


def driving_lengths(prepared: PreparedTask, start: Float[np.ndarray, "3"]) -> TravelCost:
    """How far it is to drive from a start, past everything as it is before the task begins.

    Args:
        prepared: The room, the robot and the task.
        start: x [m], y [m], yaw [rad].
    """
    robot, obstacles = prepared.robot, prepared.motion.static_obstacles()
    polygon = prepared.scene.floor_polygon
    height = base_height(robot)
    plan = floor_plan(obstacles, height=height, floor_polygon=polygon, start=start[:2])
    return build_cost_map(plan, start[:2], radius=inscribed_radius(robot.footprint)).lengths


def start_pose(
    scene: Scene,
    robot: Robot,
    motion: TaskMotion,
    given: Float[np.ndarray, "3"] | None,
    nav_map: NavigationMap,
) -> Float[np.ndarray, "3"]:
    """The start that was given, the scene's, or a roomy place in front of the furniture.

    Args:
        scene: The whole room; where nobody gives a start, all of it is modeled to find one.
        robot: The robot.
        motion: The task, among the boxes that the start is checked against.
        given: x [m], y [m], yaw [rad], or None.
        nav_map: Where the robot fits with its arm at home.

    Raises:
        SceneError: The base cannot stand there, or not with its arm at home.
    """
    given = scene.start if given is None else given
    if given is None:
        return _roomy_start(scene, nav_map)
    pose = np.asarray(given, float)
    check_base(pose, robot, motion.static_obstacles(), motion.labels, scene.floor_polygon)
    check_arm_at_home(nav_map, pose)
    return pose


@lru_cache(maxsize=32)
def _roomy_start(scene: Scene, nav_map: NavigationMap) -> Float[np.ndarray, "3"]:
    """A roomy place in front of the furniture."""
    return roomy_place(scene, nav_map, in_front_of_parts(scene))


def roomy_place(
    scene: Scene, nav_map: NavigationMap, wish: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "3"]:
    """A pose with room around it near a place, among all objects as they are modeled.

    Args:
        scene: The whole room.
        nav_map: Where the robot fits in it.
        wish: Where the pose would best be [m].

    Raises:
        SceneError: Nowhere is there room.
    """
    height = base_height(nav_map.robot)
    plan = floor_plan(room_boxes(scene), height=height, floor_polygon=scene.floor_polygon)
    return find_start(plan, wish, nav_map)
