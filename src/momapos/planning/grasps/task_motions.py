"""A task as motion: tool poses over time, and what else moves meanwhile."""

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
from .grasp_families import Grasps, holding_grasps, inside_grasps
from .handle_core import HandleKind
from .handles import Handle, find_handle, handles_in_turn, lever_arms
from .resistance import resistance_of
from .rigid_grasps import holding_object
from .task_boxes import held_elements, moving_boxes, static_boxes
from .turning_grasps import Turning, no_turning, turning_about

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

LIFT = 0.05
"""How far a rigid object is lifted, or the gripper drawn back [m]."""


@dataclass(frozen=True)
class TaskMotion:
    """Tool poses of every grasp along the motion, and the boxes that move with it."""

    task: Task
    Ts_world_tool: Float[np.ndarray, "g d 4 4"]
    """Straight approach first, then the motion itself."""
    object_q: Float[np.ndarray, " d"]
    """Value of the object's joint at each step [rad] or [m]; zeros for rigid objects."""
    waypoint_steps: Int[np.ndarray, " w"]
    """Steps that are waypoints; the first is the pre-grasp."""
    grasp_step: int
    """Step at which the gripper holds the object."""
    holding: Bool[np.ndarray, " d"]
    """Whether the gripper may touch what it grasps."""
    static: Boxes
    """Boxes that stand still, world frame."""
    moving: MovingBoxes
    """Boxes that move, at each value, world frame."""
    value: Int[np.ndarray, " d"]
    """Index of each step's value into `moving`."""
    grasped: Bool[np.ndarray, " m"]
    """Moving boxes that the gripper may touch."""
    labels: tuple[str, ...]
    """Names of the standing, then of the moving boxes."""
    grasps: Grasps
    """How each grasp holds."""
    refusal: str
    """Why no grasp holds, wherever the base stands; "" where some do."""
    turning: Turning
    """Grasps between which the hand may turn."""
    release_step: int | None = None
    """Step after which the hand lets go of the part of a joint; None where it never does."""
    passed_over: str = ""
    """Why a better handle than that of the grasps is not held; "" where there is none."""

    def __repr__(self) -> str:
        grasps, steps = self.Ts_world_tool.shape[:2]
        what = f"{self.task.verb} {self.task.object}"
        return f"<TaskMotion of {what}: {grasps} grasps, {steps} steps>"

    @property
    def waypoints(self) -> Float[np.ndarray, "w 3"]:
        """Tool positions of the plainest grasp at the waypoints, pre-grasp left out [m]."""
        return self.Ts_world_tool[0, self.waypoint_steps[1:], :3, 3]

    def only(self, rows: Bool[np.ndarray, " g"]) -> TaskMotion:
        """The same motion with some of its grasps."""
        return replace(
            self,
            Ts_world_tool=self.Ts_world_tool[rows],
            grasps=self.grasps.take(rows),
            turning=self.turning.only(rows),
        )

    @property
    def closed(self) -> Bool[np.ndarray, " d"]:
        """At which steps the fingers are closed about what they hold, if they close at all."""
        steps = np.arange(len(self.object_q))
        if self.task.verb == "place":
            return steps <= self.grasp_step
        last = steps[-1] if self.release_step is None else self.release_step
        return (self.grasp_step <= steps) & (steps <= last)

    @property
    def closes(self) -> Bool[np.ndarray, " d"]:
        """At which steps the fingers close about what they hold, or open to let it go."""
        steps = [s for s in (self.grasp_step, self.release_step) if s is not None]
        return np.isin(np.arange(len(self.object_q)), steps)

    @property
    def free_ends(self) -> tuple[int, ...]:
        """Steps at which the arm comes from a motion of its own choice, or goes on with one."""
        return (0,) if self.release_step is None else (0, len(self.object_q) - 1)

    @property
    def lanes(self) -> tuple[Int[np.ndarray, "k g"], Int[np.ndarray, " w"]]:
        """Grasps between which the hand may go on its way to a waypoint: those with the same
        number in the row of numbers that is the waypoint's. On the approach it keeps its grasp."""
        grasps = np.arange(len(self.Ts_world_tool))
        return np.stack([0 * grasps, grasps]), (self.layer_of == 1).astype(np.int64)

    @property
    def layer_of(self) -> Int[np.ndarray, " w"]:
        """Waypoints with the same number have the same states of the arm."""
        return np.arange(len(self.waypoint_steps))

    @property
    def handle(self) -> Handle | None:
        """What the first grasp holds; None for rigid objects."""
        handles = self.grasps.handles
        return handles[int(self.grasps.handle[0])] if handles else None

    def tool_poses(self, grasps: Int[np.ndarray, " w"]) -> Float[np.ndarray, "d 4 4"]:
        """Tool poses at every step, for the grasp that the hand has at each waypoint.

        Between waypoints with different grasps it turns about the axis of `turning`.
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

    def holds(self, way: int) -> tuple[Hold, ...]:
        """What a plan says of a way of holding; nothing of a rigid object."""
        if self.task.joint is None:
            return ()
        grasp = int(self.turning.members(np.array([way]))[0, 0])
        last = len(self.object_q) - 1 if self.release_step is None else self.release_step
        axis = self.turning.axis_of(way)
        words = self.grasps.describe(grasp, turns=axis is not None)
        family = str(self.grasps.family[grasp])
        return (Hold(0, last - self.grasp_step, axis, family, words),)

    def carried_out(
        self, way: int, Ts_world_tool: Float[np.ndarray, "d 4 4"]
    ) -> tuple[Int[np.ndarray, " k"], tuple[Hold, ...]]:
        """The steps of a motion that are carried out, and its holds.

        Args:
            way: The way of holding.
            Ts_world_tool: Where the tool is at every step.
        """
        return np.arange(len(Ts_world_tool)), self.holds(way)

    def sweep(self) -> Boxes:
        """The moving boxes at all values, as one set."""
        return self.moving.sweep()

    def static_obstacles(self) -> Boxes:
        """All boxes as they are before the task begins; `labels` names them in this order."""
        first = self.moving.at(0)
        return Boxes(
            np.concatenate([self.static.center, first.center]),
            np.concatenate([self.static.rotation, first.rotation]),
            np.concatenate([self.static.half, first.half]),
        )


def task_motion(
    scene: Scene, robot: Robot, task: Task, config: MotionConfig, *, inside: bool = False
) -> TaskMotion:
    """Turn a task into tool poses.

    Args:
        scene: The room.
        robot: Whose hand.
        task: What moves.
        config: How finely the motion is cut, and what grasps are tried.
        inside: Whether a part that is ajar is pushed on from behind, and not held.

    Raises:
        TaskError: The object cannot be held by this gripper.
    """
    target = scene.object(task.object)
    if task.joint is None:
        return _rigid_motion(scene, robot, task, target, config)
    motion = _joint_motion(scene, robot, task, target, config, inside=inside)
    # A hand that pushes from behind holds nothing that it could draw back from.
    return (
        with_retreat(motion, robot, config.grasps) if config.home_again and not inside else motion
    )


def with_retreat(motion: TaskMotion, robot: Robot, config: GraspConfig) -> TaskMotion:
    """The same motion, at the end of which the hand lets go and draws straight back."""
    last = motion.Ts_world_tool[:, -1]
    back = _straight_approach(robot, last, config)[:, ::-1]
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


def by_another_handle(
    motion: TaskMotion, scene: Scene, robot: Robot, config: MotionConfig, passed: list[Handle]
) -> TaskMotion | None:
    """The same motion by a handle that is not passed over; None where none of them holds."""
    task, target = motion.task, scene.object(motion.task.object)
    if task.joint is None or motion.handle is None or motion.handle.kind is HandleKind.FACE:
        return None
    sign = opening_of(target.model, task.joint).sign
    if all(handle in passed for handle in handles_in_turn(target.model, task.joint, sign)):
        return None
    other = _joint_motion(scene, robot, task, target, config, inside=False, passed=passed)
    # The push comes where no handle holds, and was tried with the first.
    if other.refusal or other.handle is None or other.handle.kind is HandleKind.FACE:
        return None
    retreats = motion.release_step is not None
    return with_retreat(other, robot, config.grasps) if retreats else other


GraspFilter: TypeAlias = "Callable[[TaskMotion], Bool[np.ndarray, ' g']]"
"""Which grasps of a task may be used."""


def in_room(motion: TaskMotion, scene: Scene) -> TaskMotion:
    """The same motion of the same object, among what stands in another version of its room."""
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
    passed: Collection[Handle] = (),
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
    chosen = inside_grasps(robot, target.model, joint.name, sign, config.grasps) if inside else None
    if chosen is None:
        chosen = holding_grasps(
            robot, target.model, joint.name, sign, torque,
            closes=task.verb == "close", config=config.grasps, passed=passed,
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
        passed_over=chosen.passed_over,
    )


def _count(kind: str, span: float, config: MotionConfig) -> int:
    step = config.waypoint_slide if kind == "prismatic" else np.radians(config.waypoint_angle)
    return max(2, int(np.ceil(span / step - 1e-9)) + 1)


def _straight_approach(
    robot: Robot, Ts_world_tool: Float[np.ndarray, "g 4 4"], config: GraspConfig
) -> Float[np.ndarray, "g s 4 4"]:
    """Tool poses on the straight line to the grasp, the grasp itself left out."""
    steps = max(2, int(np.ceil(config.pregrasp / 0.02)))
    back = np.linspace(config.pregrasp, 0.0, steps + 1)[:-1]
    T = np.tile(Ts_world_tool[:, None], (1, steps, 1, 1))
    direction = Ts_world_tool[:, :3, :3] @ robot.approach_axis
    T[:, :, :3, 3] -= back[None, :, None] * direction[:, None]
    return T


def _rigid_motion(
    scene: Scene, robot: Robot, task: Task, target: SceneObject, config: MotionConfig
) -> TaskMotion:
    """Pick: approach, grasp, lift. Place: the same backwards, from release to retreat."""
    if not robot.has_gripper:
        raise TaskError(
            f"{robot.name} has no gripper, so it cannot {task.verb} {target.name!r}; its "
            "gripper_links name nothing beyond the arm's own links"
        )
    T_object = _upright_frame(target)
    chosen = holding_object(robot, target, T_object, config.grasps, carried=task.verb == "place")
    Ts_object_tool = chosen.Ts_part_tool
    lifts = np.linspace(0.0, LIFT, config.substeps + 1)
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
        # The hand comes down with the object, lets go, and backs off along its approach.
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
    """A frame in the middle of a rigid object, z up and turned as the object is."""
    poses = target.link_poses()
    points = [
        hull.vertices @ T[:3, :3].T + T[:3, 3]
        for name, T in poses.items()
        for hull in target.model.hulls[name]
    ]
    if not points:
        raise TaskError(f"{target.name!r} has no shape that could be held")
    x = target.T_world_object[:3, 0]
    yaw = float(np.arctan2(x[1], x[0])) if np.hypot(x[0], x[1]) > 1e-6 else 0.0
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    local = np.concatenate(points) @ R
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, R @ ((local.min(0) + local.max(0)) / 2)
    return T
