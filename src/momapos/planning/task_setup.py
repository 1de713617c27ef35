"""Prepare a scene, a robot and a task: build what every check of a base pose needs, once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Stopwatch, owner_cache
from momapos.core.geometry import inscribed_radius
from momapos.model.collision import CollisionWorld, build_world
from momapos.model.records import Motion, Outline, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.arm_motion import (
    CarryingStates,
    Feasibility,
    TaskLoads,
    collision_free_grasps,
    enclosed_by,
)
from momapos.planning.grasps import (
    FULL_DOF,
    GraspFilter,
    Handle,
    TaskMotion,
    in_front_of_parts,
    in_scene,
    scene_boxes,
    task_motion,
    with_other_handle,
)
from momapos.planning.navigation import (
    CostMap,
    NavigationMap,
    base_height,
    build_cost_map,
    build_navigation_map,
    check_arm_at_home,
    check_base,
    find_start,
    floor_plan,
)
from momapos.planning.placement import GraspModeScorer, PlacementGeometry, grasp_mode_scorers
from momapos.verification import PlanVerifier

from .config import PipelineConfig

if TYPE_CHECKING:
    from jaxtyping import Float

NO_OTHER_GRASP = "there is no other grasp"


@dataclass(frozen=True)
class PreparedTask:
    """A scene, a robot and a task, prepared for checks of base poses."""

    scene: Scene
    """The scene with the selected objects modeled and boxes for the others."""
    robot: Robot
    task: Task
    motion: TaskMotion
    """Tool poses of the grasps in which the hand is free; of all grasps if it is in none."""
    world: CollisionWorld
    """The scene as the arm's collision kernel takes it."""
    geometry: PlacementGeometry
    """The scene and the task as placement takes them."""
    no_grasp: str
    """Why no single grasp moves the part all the way from any base pose; "" if one may."""

    @cached_property
    def verifier(self) -> PlanVerifier:
        """Return the exact check."""
        scene, task, motion = self.scene, self.task, self.motion
        if task.joint is not None and motion.resistance is not None:
            scene = scene.with_resistance({task.object: {task.joint: motion.resistance}})
        if motion.weight is not None:
            scene = scene.with_mass(task.object, motion.weight.mass)
        return PlanVerifier(scene, self.robot, task)

    @cached_property
    def blocked(self) -> str:
        """Return what blocks the part itself along its motion; "" if it is free."""
        retreat = self.motion.retreat
        if retreat is None:
            return self.verifier.blocked(0.0) or ""
        return self.verifier.blocked(retreat.lift, retreat.slide) or ""

    @property
    def infeasible_reason(self) -> str:
        """Return why no base pose works with one grasp, if that is known beforehand, else ""."""
        return self.blocked or self.no_grasp

    def violation(self, base_pose: Float[np.ndarray, "3"], motion: Motion) -> str | None:
        """Return the first violation that the exact check finds in a motion; None if it is valid.

        Args:
            base_pose: x [m], y [m], yaw [rad].
            motion: What the robot does there.
        """
        x, y, yaw = map(float, base_pose)
        return self.verifier.first_violation((x, y, yaw), motion)

    @property
    def mode_scorers(self) -> tuple[GraspModeScorer, ...]:
        """Return the scorers of the grasp modes that this arm can use."""
        modes = grasp_mode_scorers(self.geometry.Ts_world_tool, self.motion.turning.groups)
        # Arms of few joints cannot follow with a rigid grasp, see `free_turn`.
        return modes if self.robot.chain.size >= FULL_DOF else modes[1:] or modes

    def feasibility(
        self,
        config: PipelineConfig,
        seed: int,
        *,
        watch: Stopwatch | None = None,
        homes: CarryingStates | None = None,
    ) -> Feasibility:
        """Return the check of base poses; the watch counts its exact part as a stage.

        `homes` yields the arm states in which an object is carried, see `Feasibility`.
        """

        def violation(base_pose: Float[np.ndarray, "3"], motion: Motion) -> str | None:
            if watch is None:
                return self.violation(base_pose, motion)
            with watch.stage("exact check"):
                return self.violation(base_pose, motion)

        return Feasibility(
            self.robot, self.world, self.motion, config.arm_planner, violation, seed,
            config.motion.home_again or bool(self.task.poses), homes,
            describe=lambda *state: self.verifier.contact(*state),
            refusal_detail=lambda why: self.verifier.contacts.get(why, ""),
        )  # fmt: skip


def prepare(
    scene: Scene,
    robot: Robot,
    task: Task,
    config: PipelineConfig,
    *,
    clearance: float,
    motion: TaskMotion | None = None,
    keep_grasps: GraspFilter | None = None,
    watch: Stopwatch | None = None,
) -> PreparedTask:
    """Prepare a scene, a robot and a task.

    Args:
        scene: The scene as it must be modeled.
        robot: The mobile manipulator.
        task: What must be done.
        config: How to plan.
        clearance: Distance that the base keeps from everything [m].
        motion: The task's motion in another version of the scene, if it is known.
        keep_grasps: Returns which grasps may be used; all by default.
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
            motion = in_scene(motion, scene)
        motion, world, no_grasp = _with_free_grasp(scene, robot, motion, config, keep_grasps)
    geometry = placement_geometry(scene, robot, motion, clearance)
    no_grasp = no_grasp or _overloaded_at_home(robot, motion)
    return PreparedTask(scene, robot, task, motion, world, geometry, no_grasp)


def _overloaded_at_home(robot: Robot, motion: TaskMotion) -> str:
    """Return which motor cannot hold the empty arm at home, or ""."""
    loads = TaskLoads(robot, motion)
    outcome = loads.limits.worst(loads.free(robot.home[None]), "home")
    if outcome is None:
        return ""
    return f"{outcome}; if springs bear the weight, set this effort to 0 in the URDF"


def _with_free_grasp(
    scene: Scene,
    robot: Robot,
    motion: TaskMotion,
    config: PipelineConfig,
    keep_grasps: GraspFilter | None,
) -> tuple[TaskMotion, CollisionWorld, str]:
    """Return the motion for the first handle with a free grasp, its world, and "".

    If no handle has one, return the motion, the world and the reason of the first handle that may
    be used.
    """
    found: list[tuple[TaskMotion, CollisionWorld, str]] = []
    passed: list[Handle] = []
    other: TaskMotion | None = motion
    while other is not None:
        world = collision_world(robot, other, config)
        is_free, obstacle = collision_free_grasps(robot, world, other)
        kept = np.ones(len(is_free), bool) if keep_grasps is None else keep_grasps(other)
        allowed = is_free & kept
        if allowed.any():
            rows = other.grasps.deepest(allowed)
            if config.motion.grasps.count is not None:
                rows &= np.cumsum(rows) <= config.motion.grasps.count
            usable = other.only(rows)
            enclosing = enclosed_by(robot, world, usable)
            if not enclosing:
                return usable, world, other.refusal
            *others, last = enclosing
            names = f"{', '.join(others)} and {last} enclose" if others else f"{last} encloses"
            why = f"{names} the hand in every grasp"
        else:
            why = NO_OTHER_GRASP if is_free.any() else _all_collide(other, obstacle)
        found.append((other, world, (other.refusal or why) if kept.any() else NO_OTHER_GRASP))
        passed += other.grasps.handles
        other = with_other_handle(motion, scene, robot, config.motion, passed)
    # The handle of a grasp that the caller excludes is not the one that is searched.
    return next((one for one in found if one[2] != NO_OTHER_GRASP), found[0])


def _all_collide(motion: TaskMotion, obstacle: str) -> str:
    """Return the reason that every grasp of a motion collides."""
    hits = f"the hand hits {obstacle} in every grasp"
    if motion.task.poses:
        return f"the hand hits {obstacle} on the path"
    if not motion.better_handle_reason or motion.handle is None:
        return hits
    return f"{motion.better_handle_reason}, and {hits} of {motion.handle}"


def placement_geometry(
    scene: Scene, robot: Robot, motion: TaskMotion, clearance: float
) -> PlacementGeometry:
    """Return the scene and the task as placement takes them; the base keeps a clearance [m]."""
    return PlacementGeometry(
        robot=robot,
        Ts_world_tool=np.ascontiguousarray(motion.Ts_world_tool[:, motion.waypoint_steps]),
        static=motion.static,
        sweep=motion.sweep(),
        floor_polygon=scene.floor_polygon,
        clearance=clearance,
    )


def collision_world(robot: Robot, motion: TaskMotion, config: PipelineConfig) -> CollisionWorld:
    """Return the scene and the moving part as the arm's collision kernel takes them."""
    return build_world(
        motion.static,
        motion.moving,
        motion.grasped,
        motion.labels,
        robot.spheres,
        clearance=config.arm_clearance,
    )


def cost_map(
    prepared: PreparedTask, start: Float[np.ndarray, "3"], keep_out: Sequence[Outline] = ()
) -> CostMap:
    """Return the driving lengths from a start, with every object where it is before the task.

    Args:
        prepared: The scene, the robot and the task.
        start: x [m], y [m], yaw [rad].
        keep_out: Areas that the base does not touch.
    """
    robot, (x, y) = prepared.robot, start[:2].tolist()
    radius = inscribed_radius(robot.footprint)
    return _cost_map(prepared.scene, (x, y), base_height(robot), radius, tuple(keep_out))


@owner_cache(8)
def _cost_map(
    scene: Scene,
    start: tuple[float, float],
    height: float,
    radius: float,
    keep_out: tuple[Outline, ...],
) -> CostMap:
    """Return the driving lengths of a base in a scene; all its tasks share them."""
    begin = np.array(start)
    plan = floor_plan(
        scene_boxes(scene), height=height, floor_polygon=scene.floor_polygon, start=begin,
        keep_out=keep_out,
    )  # fmt: skip
    return build_cost_map(plan, begin, radius=radius)


def start_pose(
    scene: Scene,
    robot: Robot,
    motion: TaskMotion,
    given: Float[np.ndarray, "3"] | None,
    nav_map: NavigationMap,
) -> Float[np.ndarray, "3"]:
    """Return the given start, else the scene's, else a free place in front of the furniture.

    Args:
        scene: The whole scene; if no start is given, all objects are modeled to find one.
        robot: The robot.
        motion: The task's motion, with the boxes that the start is checked against.
        given: x [m], y [m], yaw [rad], or None.
        nav_map: Where a start is searched.

    Raises:
        SceneError: The base collides there, or the arm at home does.
    """
    given = scene.start if given is None else given
    if given is None:
        return _roomy_start(scene, nav_map)
    pose = np.asarray(given, float)
    check_base(pose, robot, motion.static_obstacles(), motion.labels, scene.floor_polygon)
    check_arm_at_home(build_navigation_map(scene, robot), pose)
    return pose


@owner_cache(8)
def _roomy_start(scene: Scene, nav_map: NavigationMap) -> Float[np.ndarray, "3"]:
    """Return a free place in front of the furniture."""
    return roomy_place(scene, nav_map, in_front_of_parts(scene))


def roomy_place(
    scene: Scene, nav_map: NavigationMap, wish: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "3"]:
    """Return a free base pose with clearance near a position.

    Args:
        scene: The whole scene.
        nav_map: Where the robot fits with its arm at home.
        wish: The preferred position [m].

    Raises:
        SceneError: There is none.
    """
    height = base_height(nav_map.robot)
    plan = floor_plan(scene_boxes(scene), height=height, floor_polygon=scene.floor_polygon)
    return find_start(plan, wish, nav_map)
