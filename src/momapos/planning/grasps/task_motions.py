"""Turn a task into a motion: tool poses at every step, and the boxes that move with them."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import invert, rotation_about
from momapos.model.records import Hold, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Boxes, MovingBoxes, joint_motion, opening_of

from .config import GraspConfig, MotionConfig
from .grasp_families import Grasps, select_inner_pushes, select_part_grasps
from .handle_core import HandleKind
from .handles import Handle, find_handle, handles_in_turn, lever_arms
from .resistance import resistance_of
from .rigid_grasps import select_object_grasps
from .task_boxes import held_elements, moving_boxes, static_boxes
from .turning_grasps import Turning, no_turning, turning_about

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

LIFT_HEIGHT = 0.05
"""Height by which a rigid object is lifted [m]."""


@dataclass(frozen=True, eq=False)
class TaskMotion:
    """Tool poses of every grasp along the motion, and the boxes that move with it."""

    task: Task
    Ts_world_tool: Float[np.ndarray, "g d 4 4"]
    """Straight approach, then the motion."""
    object_q: Float[np.ndarray, " d"]
    """Value of the object's joint at each step [rad] or [m]; zeros for rigid objects."""
    waypoint_steps: Int[np.ndarray, " w"]
    """Steps that are waypoints; the first is the pre-grasp."""
    grasp_step: int
    """Step at which the hand grasps the object."""
    holding: Bool[np.ndarray, " d"]
    """Whether the gripper may touch the grasped part, at each step."""
    static: Boxes
    """Static boxes in the world."""
    moving: MovingBoxes
    """Moving boxes in the world, at each value."""
    value: Int[np.ndarray, " d"]
    """Index into `moving` at each step."""
    grasped: Bool[np.ndarray, " m"]
    """Moving boxes that the gripper may touch."""
    labels: tuple[str, ...]
    """Names of the static boxes, then of the moving ones."""
    grasps: Grasps
    refusal: str
    """Why no grasp holds, for any base pose; "" if some do."""
    turning: Turning
    """Grasps between which the hand may turn."""
    release_step: int | None = None
    """Step after which the hand releases the part of a joint; None if it never does."""
    better_handle_reason: str = ""
    """Why a better handle is not used; "" if there is none."""

    def __repr__(self) -> str:
        grasps, steps = self.Ts_world_tool.shape[:2]
        what = f"{self.task.verb} {self.task.object}"
        return f"<TaskMotion of {what}: {grasps} grasps, {steps} steps>"

    @property
    def waypoints(self) -> Float[np.ndarray, "w 3"]:
        """Tool positions of the first grasp at the waypoints, without the pre-grasp [m]."""
        return self.Ts_world_tool[0, self.waypoint_steps[1:], :3, 3]

    def only(self, rows: Bool[np.ndarray, " g"]) -> TaskMotion:
        """Return the motion with a subset of its grasps."""
        return replace(
            self,
            Ts_world_tool=self.Ts_world_tool[rows],
            grasps=self.grasps.take(rows),
            turning=self.turning.only(rows),
        )

    @property
    def closed(self) -> Bool[np.ndarray, " d"]:
        """Whether the fingers are closed at each step, if they close at all."""
        steps = np.arange(len(self.object_q))
        if self.task.verb == "place":
            return steps <= self.grasp_step
        last = steps[-1] if self.release_step is None else self.release_step
        return (self.grasp_step <= steps) & (steps <= last)

    @property
    def closes(self) -> Bool[np.ndarray, " d"]:
        """Whether the fingers close or open at each step."""
        steps = [s for s in (self.grasp_step, self.release_step) if s is not None]
        return np.isin(np.arange(len(self.object_q)), steps)

    @property
    def free_ends(self) -> tuple[int, ...]:
        """Steps at which a free arm motion ends or begins."""
        return (0,) if self.release_step is None else (0, len(self.object_q) - 1)

    @property
    def lanes(self) -> tuple[Int[np.ndarray, "k g"], Int[np.ndarray, " w"]]:
        """Rows of grasp numbers, and the row of each waypoint.

        On its path to a waypoint, the hand may change between grasps with the same number in the
        waypoint's row. It keeps its grasp during the approach.
        """
        grasps = np.arange(len(self.Ts_world_tool))
        return np.stack([0 * grasps, grasps]), (self.layer_of == 1).astype(np.int64)

    @property
    def layer_of(self) -> Int[np.ndarray, " w"]:
        """Layer of each waypoint; waypoints of one layer share their arm states."""
        return np.arange(len(self.waypoint_steps))

    @property
    def handle(self) -> Handle | None:
        """Handle of the first grasp; None for rigid objects."""
        handles = self.grasps.handles
        return handles[int(self.grasps.handle[0])] if handles else None

    def tool_poses(self, grasps: Int[np.ndarray, " w"]) -> Float[np.ndarray, "d 4 4"]:
        """Return the tool pose at every step, given the grasp at each waypoint.

        Between waypoints with different grasps the hand turns about the axis of `turning`.
        """
        first = grasps[0]
        Ts = self.Ts_world_tool[first]
        if (grasps == first).all():
            return Ts
        steps = np.arange(len(Ts))
        turn = np.interp(steps, self.waypoint_steps, self.turning.angles[grasps])
        axis = self.turning.axis @ self.turning.R_part_tool[first]
        out = Ts.copy()
        out[:, :3, :3] = Ts[:, :3, :3] @ rotation_about(axis, turn - self.turning.angles[first])
        return out

    def holds(self, mode: int) -> tuple[Hold, ...]:
        """Return a plan's record of a grasp mode; empty for rigid objects."""
        if self.task.joint is None:
            return ()
        grasp = int(self.turning.members(np.array([mode]))[0, 0])
        last = len(self.object_q) - 1 if self.release_step is None else self.release_step
        axis = self.turning.axis_of(mode)
        words = self.grasps.describe(grasp, turns=axis is not None)
        family = str(self.grasps.family[grasp])
        return (Hold(0, last - self.grasp_step, axis, family, words),)

    def executed_steps(
        self, mode: int, Ts_world_tool: Float[np.ndarray, "d 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], tuple[Hold, ...]]:
        """Return the steps that are executed in a grasp mode, and the holds.

        Args:
            mode: The grasp mode.
            Ts_world_tool: Tool pose at every step.
        """
        return np.arange(len(Ts_world_tool)), self.holds(mode)

    def sweep(self) -> Boxes:
        """Return the moving boxes at all values as one set."""
        return self.moving.sweep()

    def static_obstacles(self) -> Boxes:
        """Return all boxes as they are before the task, in the order of `labels`."""
        return Boxes.join([self.static, self.moving.at(0)])


def task_motion(
    scene: Scene, robot: Robot, task: Task, config: MotionConfig, *, inside: bool = False
) -> TaskMotion:
    """Turn a task into a motion.

    Args:
        scene: The scene.
        robot: The robot.
        task: The task.
        config: The resolution of the motion, and the grasps to try.
        inside: Whether to push a part that is ajar from behind instead of grasping it.

    Raises:
        TaskError: The robot has no gripper for a rigid object, or the object has no shape.
    """
    target = scene.object(task.object)
    if task.joint is None:
        return _rigid_motion(scene, robot, task, target, config)
    motion = _joint_motion(scene, robot, task, target, config, inside=inside)
    # A hand that pushes from behind has nothing to release.
    retreats = config.home_again and not inside
    return with_retreat(motion, robot, config.grasps) if retreats else motion


def with_retreat(motion: TaskMotion, robot: Robot, config: GraspConfig) -> TaskMotion:
    """Extend a motion: at its end the hand releases the part and retracts straight."""
    back = _straight_approach(robot, motion.Ts_world_tool[:, -1], config)[:, ::-1]
    steps = back.shape[1]
    held = motion.Ts_world_tool.shape[1]
    return replace(
        motion,
        Ts_world_tool=np.concatenate([motion.Ts_world_tool, back], axis=1),
        object_q=np.append(motion.object_q, np.repeat(motion.object_q[-1], steps)),
        waypoint_steps=np.append(motion.waypoint_steps, held + steps - 1),
        holding=np.append(motion.holding, np.arange(steps) < steps - 1),
        value=np.append(motion.value, np.repeat(motion.value[-1], steps)),
        release_step=held - 1,
    )


def with_other_handle(
    motion: TaskMotion, scene: Scene, robot: Robot, config: MotionConfig, excluded: list[Handle]
) -> TaskMotion | None:
    """Return the same motion with another handle; None if no other handle holds."""
    task, target = motion.task, scene.object(motion.task.object)
    if task.joint is None or motion.handle is None or motion.handle.kind is HandleKind.FACE:
        return None
    sign = opening_of(target.model, task.joint).sign
    if all(handle in excluded for handle in handles_in_turn(target.model, task.joint, sign)):
        return None
    other = _joint_motion(scene, robot, task, target, config, inside=False, excluded=excluded)
    # A push is the last resort, and was tried with the first handle.
    if other.refusal or other.handle is None or other.handle.kind is HandleKind.FACE:
        return None
    retreats = motion.release_step is not None
    return with_retreat(other, robot, config.grasps) if retreats else other


GraspFilter: TypeAlias = "Callable[[TaskMotion], Bool[np.ndarray, ' g']]"
"""Return which grasps of a task may be used."""


def in_scene(motion: TaskMotion, scene: Scene) -> TaskMotion:
    """Return the same motion with the static boxes of another version of the scene."""
    target = scene.object(motion.task.object)
    joint = motion.task.joint
    moved = target.model.links if joint is None else target.model.moved_by(joint)
    static, labels = static_boxes(scene, target, set(moved))
    return replace(motion, static=static, labels=(*labels, *motion.labels[len(motion.static) :]))


def _joint_motion(
    scene: Scene,
    robot: Robot,
    task: Task,
    target: SceneObject,
    config: MotionConfig,
    *,
    inside: bool,
    excluded: Collection[Handle] = (),
) -> TaskMotion:
    assert task.joint is not None
    assert task.to is not None
    joint = target.joint(task.joint)
    start = target.values()[joint.name]
    count = config.waypoints or _count(joint.kind, abs(task.to - start), config)
    values = np.linspace(start, task.to, (count - 1) * config.substeps + 1)
    sign = opening_of(target.model, joint.name).sign
    handle = find_handle(target.model, joint.name, sign)
    lever = float(lever_arms(target.model, joint.name, handle.center[None])[0])
    torque = resistance_of(target, joint.name, values, lever, config.grasps.resistance)
    chosen = (
        select_inner_pushes(robot, target.model, joint.name, sign, config.grasps)
        if inside
        else None
    )
    if chosen is None:
        chosen = select_part_grasps(
            robot, target.model, joint.name, sign, torque,
            closes=task.verb == "close", config=config.grasps, excluded=excluded,
        )  # fmt: skip
    Ts_part_tool = chosen.Ts_part_tool
    poses = target.link_poses()
    T_world_joint = poses[joint.parent] @ joint.T_parent_joint
    Ts_world_part = T_world_joint @ joint_motion(joint, values)
    moved = target.model.moved_by(joint.name)
    Ts_part_link = {n: invert(poses[joint.child]) @ poses[n] for n in moved}
    moving, moving_labels, grasped = moving_boxes(
        target, Ts_world_part, Ts_part_link, held_elements(chosen.grasps.handles)
    )
    static, labels = static_boxes(scene, target, set(moved))
    approach = _straight_approach(robot, Ts_world_part[0] @ Ts_part_tool, config.grasps)
    steps = approach.shape[1]
    held = len(chosen.Ts_part_tool)
    turning = turning_about(robot, chosen) if config.grasps.turning else no_turning(held)
    Ts_world_tool = np.concatenate([approach, Ts_world_part[None] @ Ts_part_tool[:, None]], axis=1)
    return TaskMotion(
        task=task,
        Ts_world_tool=np.ascontiguousarray(Ts_world_tool),
        object_q=np.concatenate([np.full(steps, start), values]),
        waypoint_steps=np.concatenate([[0], steps + np.arange(count) * config.substeps]),
        grasp_step=steps,
        holding=np.arange(steps + len(values)) > 0,
        static=static,
        moving=moving,
        value=np.concatenate([np.zeros(steps, np.int64), np.arange(len(values))]),
        grasped=grasped,
        labels=(*labels, *moving_labels),
        grasps=chosen.grasps,
        refusal=chosen.reason,
        turning=turning,
        better_handle_reason=chosen.better_handle_reason,
    )


def _count(kind: str, span: float, config: MotionConfig) -> int:
    step = config.waypoint_slide if kind == "prismatic" else np.radians(config.waypoint_angle)
    return max(2, int(np.ceil(span / step - 1e-9)) + 1)


def _straight_approach(
    robot: Robot, Ts_world_tool: Float[np.ndarray, "g 4 4"], config: GraspConfig
) -> Float[np.ndarray, "g s 4 4"]:
    """Return tool poses on the straight line to the grasp, excluding the grasp."""
    steps = max(2, int(np.ceil(config.pregrasp / 0.02)))
    back = np.linspace(config.pregrasp, 0.0, steps + 1)[:-1]
    T = np.tile(Ts_world_tool[:, None], (1, steps, 1, 1))
    direction = Ts_world_tool[:, :3, :3] @ robot.approach_axis
    T[:, :, :3, 3] -= back[None, :, None] * direction[:, None]
    return T


def _rigid_motion(
    scene: Scene, robot: Robot, task: Task, target: SceneObject, config: MotionConfig
) -> TaskMotion:
    """Build the motion of a rigid object: approach, grasp, lift; reversed to place it."""
    if not robot.has_gripper:
        raise TaskError(
            f"{robot.name} has no gripper, so it cannot {task.verb} {target.name!r}; "
            "gripper_links must name links beyond the arm's own links"
        )
    T_object = _upright_frame(target)
    chosen = select_object_grasps(
        robot, target, T_object, config.grasps, carried=task.verb == "place"
    )
    Ts_object_tool = chosen.Ts_part_tool
    lifts = np.linspace(0.0, LIFT_HEIGHT, config.substeps + 1)
    Ts_world_object = np.tile(T_object, (len(lifts), 1, 1))
    Ts_world_object[:, 2, 3] += lifts
    T_object_link = {n: invert(T_object) @ T for n, T in target.link_poses().items()}
    moving, moving_labels, grasped = moving_boxes(target, Ts_world_object, T_object_link, None)
    static, labels = static_boxes(scene, target, set(target.model.links))
    approach = _straight_approach(robot, T_object @ Ts_object_tool, config.grasps)
    steps = approach.shape[1]
    if task.verb == "pick":
        hold = Ts_world_object[None] @ Ts_object_tool[:, None]
        Ts = np.concatenate([approach, hold], axis=1)
        value = np.concatenate([np.zeros(steps, np.int64), np.arange(len(lifts))])
        waypoint_steps, first = np.array([0, steps, steps + len(lifts) - 1]), steps
    else:
        # The hand lowers the object, releases it, and retracts along its approach.
        down = (Ts_world_object[None] @ Ts_object_tool[:, None])[:, ::-1]
        Ts = np.concatenate([down, approach[:, ::-1]], axis=1)
        value = np.concatenate([np.arange(len(lifts))[::-1], np.zeros(steps, np.int64)])
        waypoint_steps = np.array([0, len(lifts) - 1, len(lifts) - 1 + steps])
        first = len(lifts) - 1
    return TaskMotion(
        task=task,
        Ts_world_tool=np.ascontiguousarray(Ts),
        object_q=np.zeros(Ts.shape[1]),
        waypoint_steps=waypoint_steps,
        grasp_step=first,
        holding=(np.arange(Ts.shape[1]) > 0) | (task.verb == "place"),
        static=static,
        moving=moving,
        value=value,
        grasped=grasped,
        labels=(*labels, *moving_labels),
        grasps=chosen.grasps,
        refusal=chosen.reason,
        turning=no_turning(len(Ts)),
    )


def _upright_frame(target: SceneObject) -> Float[np.ndarray, "4 4"]:
    """Return a frame in the middle of a rigid object, with z up and the object's yaw."""
    poses = target.link_poses()
    points = [
        hull.vertices @ T[:3, :3].T + T[:3, 3]
        for name, T in poses.items()
        for hull in target.model.hulls[name]
    ]
    if not points:
        raise TaskError(f"{target.name!r} has no collision shape, so it cannot be grasped")
    x = target.T_world_object[:3, 0]
    yaw = float(np.arctan2(x[1], x[0])) if np.hypot(x[0], x[1]) > 1e-6 else 0.0
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    local = np.concatenate(points) @ R
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, R @ ((local.min(0) + local.max(0)) / 2)
    return T
