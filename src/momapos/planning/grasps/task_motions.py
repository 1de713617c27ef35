"""Turn a task into a motion: a straight approach, the grasp, and the path of the part."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import apply, invert
from momapos.model.records import Latch, Task
from momapos.model.robots import Robot
from momapos.model.scene import (
    MotionResistance,
    Scene,
    SceneObject,
    known_resistance,
    latch_to_turn,
    object_mass,
    release_problem,
    resistance_along,
)
from momapos.model.urdf import Articulated, Joint, opening_of

from .config import SUBSTEPS, GraspConfig, MotionConfig
from .grasp_families import (
    MIN_LEVER,
    GraspSelection,
    select_inner_pushes,
    select_part_grasps,
    select_presses,
)
from .hand_boxes import closes_fingers, hand_of
from .handle_shapes import CarriedPart
from .handles import Handle, HandleKind, find_handle, handles_in_turn
from .motion_boxes import bodies_moved_by, held_elements, moving_boxes, static_boxes
from .motion_record import TaskMotion, Weight, no_turning, turning_about
from .own_grasps import own_poses
from .part_grasps import pinch_capacity
from .part_motion import lever_arms, levers_along, motion_directions
from .pose_targets import path_motion, targets_of, tool_poses_of
from .retreats import Retreat, along_slide, retreats
from .rigid_grasps import select_object_grasps

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class PartValues:
    """Values of a part's joint, and of its latch, at the steps of a manipulation."""

    part: Float[np.ndarray, " v"]
    """[rad] or [m]"""
    latch: Float[np.ndarray, " v"] | None = None
    """[rad] or [m]; None if no latch is turned."""

    def after_turn(self, latch: Float[np.ndarray, " u"]) -> PartValues:
        """Return the values with a latch that is turned first; the part rests meanwhile.

        Args:
            latch: Values of the latch.
        """
        part = np.concatenate([np.full(len(latch) - 1, self.part[0]), self.part])
        return PartValues(part, np.append(latch, np.full(len(self.part) - 1, latch[-1])))

    @property
    def waypoints(self) -> int:
        """Number of waypoints, `SUBSTEPS` steps apart."""
        return (len(self.part) - 1) // SUBSTEPS + 1


def select_latch_grasps(
    robot: Robot,
    target: SceneObject,
    model: Articulated,
    joint: str,
    sign: float,
    resistance: MotionResistance,
    turn: tuple[Latch, Float[np.ndarray, " u"]],
    config: GraspConfig,
    excluded: Collection[Handle] = (),
) -> GraspSelection:
    """Select the grasps by which a hand turns a latch and then moves the part that it held.

    The hand closes on the latch: what only touches one side of it, as a hook does, turns it and
    does not pull.

    Args:
        robot: The robot.
        target: The object.
        model: Its model, see `SceneObject.posed_model`.
        joint: The joint of the part.
        sign: Its opening direction (+1 or -1).
        resistance: Resistance of the part.
        turn: The latch, and its values.
        config: The grasps to try.
        excluded: Handles to skip; not all of the latch's.
    """
    latch, values = turn
    chosen = select_part_grasps(
        robot, model, joint, sign, resistance, closes=False, config=config, excluded=excluded,
        latch=model.joint(latch.joint).child,
    )  # fmt: skip
    if chosen.reason:
        return chosen
    hand, part = hand_of(robot), CarriedPart.of(model, latch.joint)
    if not closes_fingers(robot):
        return replace(
            chosen, reason=f"{robot.name} has no hand that closes on {part.carrier}, to turn it "
            f"and then pull by it",
        )  # fmt: skip
    R, p = chosen.Ts_part_tool[:, :3, :3], chosen.Ts_part_tool[:, :3, 3]
    point = p + hand.pad_middle * (R @ hand.approach)
    way = motion_directions(part, float(np.sign(values[-1] - values[0])), point)[0]
    lean = np.abs(np.einsum("gi,gi->g", R @ hand.closing, way))
    capacity = pinch_capacity(robot.grip_force, config.friction, lean)
    levers = np.maximum(lever_arms(part, point), MIN_LEVER)
    if model.joint(latch.joint).kind != "prismatic":
        # Both pads turn a knob on whose axis the hand is: each is half the width away from it.
        axis = model.joint(latch.joint).axis
        across = np.linalg.norm(np.cross(R @ hand.closing, axis), axis=1)
        levers = np.hypot(levers, across * chosen.grasps.width / 2)
    usual = float(np.median(levers))
    resists = resistance_along(target, latch.joint, values, usual, config.resistance)
    need = config.grasp_margin * resists.largest / levers
    strong = capacity >= need
    if not strong.any():
        best = int(np.argmax(capacity / need))
        why = resists.source(int(resists.total.argmax()))
        return replace(
            chosen, reason=f"{robot.name} holds {part.carrier} with {capacity[best]:.0f} N at "
            f"most, and {need[best]:.0f} N are needed to turn it"
            f"{why and f' ({why})'}",
        )  # fmt: skip
    return GraspSelection(
        chosen.Ts_part_tool[strong], chosen.grasps.take(strong), "", chosen.better_handle_reason
    )


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
    if task.verb == "follow":
        path = with_approach(path_motion(scene, task, config), robot, config.grasps)
        return with_retreat(path, robot, config.grasps)
    if task.poses:
        return targets_of(scene, task, [tool_poses_of(pose) for pose in task.poses])[0].motion
    target = scene.object(task.object)
    if task.joint is None:
        return _rigid_motion(scene, robot, task, target, config)
    motion = _joint_motion(scene, robot, task, target, config, inside=inside)
    # A hand that pushes from behind has nothing to release.
    if task.verb == "press":
        return with_retreat(motion, robot, config.grasps)
    if not config.home_again or inside:
        return motion
    assert task.to is not None
    problem = release_problem(target, task.joint, task.to, config.grasps.resistance)
    motion = replace(motion, refusal=motion.refusal or problem)
    return with_retreat(motion, robot, config.grasps)


def with_approach(motion: TaskMotion, robot: Robot, config: GraspConfig) -> TaskMotion:
    """Extend the motion along a path by a straight approach to its begin."""
    approach = _straight_approach(robot, motion.Ts_world_tool[:, 0], config)
    steps = approach.shape[1]
    assert motion.pose_steps is not None
    return replace(
        motion,
        Ts_world_tool=np.concatenate([approach, motion.Ts_world_tool], axis=1),
        object_q=np.append(np.zeros(steps), motion.object_q),
        waypoint_steps=np.append(0, steps + motion.waypoint_steps),
        grasp_step=steps,
        holding=np.append(motion.holding[0] & (np.arange(steps) > 0), motion.holding),
        value=np.append(np.zeros(steps, np.int64), motion.value),
        pose_steps=steps + motion.pose_steps,
    )


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
        holding=np.append(motion.holding, motion.holding[-1] & (np.arange(steps) < steps - 1)),
        value=np.append(motion.value, np.repeat(motion.value[-1], steps)),
        release_step=held - 1,
        latch_q=None
        if motion.latch_q is None
        else np.append(motion.latch_q, np.repeat(motion.latch_q[-1], steps)),
    )


def with_other_handle(
    motion: TaskMotion, scene: Scene, robot: Robot, config: MotionConfig, excluded: list[Handle]
) -> TaskMotion | None:
    """Return the same motion with another handle; None if no other handle holds."""
    task, target = motion.task, scene.object(motion.task.object)
    if task.joint is None or motion.handle is None or motion.handle.kind is HandleKind.FACE:
        return None
    model, sign = target.posed_model(task.joint), opening_sign(target, task.joint, task.to)
    latch = latch_to_turn(target, task.joint)
    on = None if latch is None else model.joint(latch.joint).child
    if all(handle in excluded for handle in handles_in_turn(model, task.joint, sign, on)):
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
    target = scene.object(motion.task.touches)
    joint = motion.task.joint
    moved = target.model.links if joint is None else target.model.moved_by(joint)
    static, labels = static_boxes(scene, target, frozenset(moved))
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
    values = _steps(joint, start, task.to, config)
    model, sign = target.posed_model(joint.name), opening_sign(target, joint.name, task.to)
    latch = None if task.verb == "press" else latch_to_turn(target, joint.name)
    on = None if latch is None else model.joint(latch.joint).child
    handle = find_handle(model, joint.name, sign, on)
    part = CarriedPart(model, joint.name, handle.carrier)
    assumed = config.grasps.resistance
    levers = np.maximum(levers_along(part, handle.center[None], values)[:, 0], MIN_LEVER)
    resistance = resistance_along(target, joint.name, values, levers, assumed)
    known = known_resistance(target, joint.name, assumed)
    chosen = select_inner_pushes(robot, model, joint.name, sign, config.grasps) if inside else None
    if task.verb == "press":
        inward = -float(np.sign(task.to - start))
        chosen = select_presses(robot, model, joint.name, inward, resistance, config.grasps)
    path = PartValues(values)
    if latch is not None:
        turn = _steps(target.joint(latch.joint), target.values()[latch.joint], latch.to, config)
        path = path.after_turn(turn)
        chosen = select_latch_grasps(
            robot, target, model, joint.name, sign, resistance, (latch, turn), config.grasps,
            excluded,
        )  # fmt: skip
    elif chosen is None:
        chosen = select_part_grasps(
            robot, model, joint.name, sign, resistance,
            closes=task.verb == "close", config=config.grasps, excluded=excluded,
            own=own_poses(robot, target.name, joint.name),
        )  # fmt: skip
    bodies = bodies_moved_by(target, joint.name, path.part, path.latch)
    moving, moving_labels, grasped = moving_boxes(
        target, list(bodies.values()), held_elements(chosen.grasps.handles)
    )
    static, labels = static_boxes(scene, target, frozenset(target.model.moved_by(joint.name)))
    held = len(chosen.Ts_part_tool)
    Ts_world_carrier = np.stack([bodies[h.carrier][0] for h in chosen.grasps.handles])
    Ts_held = Ts_world_carrier[chosen.grasps.handle] @ chosen.Ts_part_tool[:, None]
    approach = _straight_approach(robot, Ts_held[:, 0], config.grasps)
    steps = approach.shape[1]
    turns = config.grasps.turning and latch is None
    turning = turning_about(robot, chosen) if turns else no_turning(held)
    Ts_world_tool = np.concatenate([approach, Ts_held], axis=1)
    return TaskMotion(
        task=task,
        Ts_world_tool=np.ascontiguousarray(Ts_world_tool),
        object_q=np.concatenate([np.full(steps, start), path.part]),
        waypoint_steps=np.concatenate([[0], steps + np.arange(path.waypoints) * SUBSTEPS]),
        grasp_step=steps,
        holding=np.arange(steps + len(path.part)) > 0,
        static=static,
        moving=moving,
        value=np.concatenate([np.zeros(steps, np.int64), np.arange(len(path.part))]),
        grasped=grasped,
        labels=(*labels, *moving_labels),
        grasps=chosen.grasps,
        refusal=chosen.reason,
        turning=turning,
        latch_q=None
        if path.latch is None
        else np.append(np.full(steps, path.latch[0]), path.latch),
        better_handle_reason=chosen.better_handle_reason,
        resistance=replace(known, lever=known.lever or float(levers.min())),
        effort=np.append(np.zeros(len(path.part) - len(values)), resistance.along),
    )


def opening_sign(target: SceneObject, joint: str, to: float | None) -> float:
    """Return on which side of the closed part a task moves it: toward larger values 1, else -1.

    Args:
        target: The object.
        joint: Its joint.
        to: Value at the end of the task [rad] or [m].
    """
    opening, start = opening_of(target.model, joint), target.values()[joint]
    ends = np.array([start if to is None else to, start]) - opening.closed
    away = float(ends[np.abs(ends).argmax()])
    return float(np.sign(away)) if away else opening.sign


def _steps(joint: Joint, start: float, to: float, config: MotionConfig) -> Float[np.ndarray, " v"]:
    """Return the values of a joint at the steps of its motion, `SUBSTEPS` per waypoint."""
    slides = joint.kind == "prismatic"
    step = config.waypoint_slide if slides else np.radians(config.waypoint_angle)
    count = config.waypoints or max(2, int(np.ceil(abs(to - start) / step - 1e-9)) + 1)
    return np.linspace(start, to, (count - 1) * SUBSTEPS + 1)


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
    """Build the motion of a rigid object: approach, grasp, retreat; reversed to place it."""
    if not robot.has_gripper:
        raise TaskError(
            f"{robot.name} has no gripper, so it cannot {task.verb} {target.name!r}; "
            "gripper_links must name links beyond the arm's own links"
        )
    T_object = _upright_frame(target)
    chosen, approaches = _object_grasps(robot, task, target, T_object, config)
    retreat = next(retreats(scene, task.object, config, approaches))
    if config.retreat == "back" and retreat.length:
        chosen = chosen.take(along_slide(retreat.slide, approaches))
    Ts_object_tool = chosen.Ts_part_tool
    places = retreat.path(config)
    Ts_world_object = np.tile(T_object, (len(places), 1, 1))
    Ts_world_object[:, :3, 3] += places
    weight = _weight(target, Ts_world_object, T_object, config)
    T_object_link = {n: invert(T_object) @ T for n, T in target.link_poses().items()}
    moving, moving_labels, grasped = moving_boxes(target, [(Ts_world_object, T_object_link)], None)
    static, labels = static_boxes(scene, target, frozenset(target.model.links))
    approach = _straight_approach(robot, T_object @ Ts_object_tool, config.grasps)
    steps = approach.shape[1]
    if task.verb == "pick":
        hold = Ts_world_object[None] @ Ts_object_tool[:, None]
        Ts = np.concatenate([approach, hold], axis=1)
        value = np.concatenate([np.zeros(steps, np.int64), np.arange(len(places))])
        waypoint_steps, first = np.append(0, steps + np.arange(0, len(places), SUBSTEPS)), steps
    else:
        # The hand lowers the object, releases it, and retracts along its approach.
        down = (Ts_world_object[None] @ Ts_object_tool[:, None])[:, ::-1]
        Ts = np.concatenate([down, approach[:, ::-1]], axis=1)
        value = np.concatenate([np.arange(len(places))[::-1], np.zeros(steps, np.int64)])
        first = len(places) - 1
        waypoint_steps = np.append(np.arange(0, len(places), SUBSTEPS), first + steps)
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
        refusal=chosen.reason or _too_heavy(robot, target, weight.mass),
        turning=no_turning(len(Ts)),
        weight=weight,
        retreat=retreat,
    )


def rigid_retreats(
    scene: Scene, robot: Robot, task: Task, config: MotionConfig
) -> Iterator[Retreat]:
    """Yield how a rigid object can leave where it stands, in the order of trying; at least one.

    Raises:
        TaskError: The object has no shape.
    """
    target = scene.object(task.object)
    _, approaches = _object_grasps(robot, task, target, _upright_frame(target), config)
    return retreats(scene, task.object, config, approaches)


def _object_grasps(
    robot: Robot,
    task: Task,
    target: SceneObject,
    T_object: Float[np.ndarray, "4 4"],
    config: MotionConfig,
) -> tuple[GraspSelection, Float[np.ndarray, "g 3"]]:
    """Return the grasps of an object, and the direction of each hand in the world."""
    chosen = select_object_grasps(
        robot, target, T_object, config.grasps, carried=task.verb == "place",
        own=own_poses(robot, target.name, None),
    )  # fmt: skip
    directions = (T_object @ chosen.Ts_part_tool)[:, :3, :3] @ robot.approach_axis
    return chosen, directions


def _too_heavy(robot: Robot, target: SceneObject, mass: float) -> str:
    """Return a reason if an object exceeds what the arm may carry in its gripper, else ""."""
    if robot.payload is None:
        return ""
    most = robot.payload - sum(robot.model.urdf.links[link].mass for link in robot.gripper_links)
    if mass <= most:
        return ""
    return f"{target.name} weighs {mass:.3g} kg, and {robot.title} carries {max(most, 0.0):.3g} kg"


def _weight(
    target: SceneObject,
    Ts_world_object: Float[np.ndarray, "v 4 4"],
    T_object: Float[np.ndarray, "4 4"],
    config: MotionConfig,
) -> Weight:
    """Return an object's weight along its motion, given by the path of a frame of it."""
    mass, center = object_mass(target, config.grasps.resistance)
    local = apply(invert(T_object) @ target.T_world_object, center[None])
    return Weight(mass, apply(Ts_world_object, local)[:, 0])


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
