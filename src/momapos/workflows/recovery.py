"""What a robot tries next where a motion failed: the way home, another grasp, the room as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import invert, rotation_angle
from momapos.model.collision import CheckMotion, motion_checker
from momapos.model.records import Motion, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, scene_moving_as, way_about
from momapos.model.urdf import opening_of
from momapos.planning import PipelineConfig, collision_world
from momapos.planning.arm_motion import RESOLUTION, interpolate, plan_with_room
from momapos.planning.grasps import GraspFilter, TaskMotion, task_motion
from momapos.simulation import Axis, Learned

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

OTHER_POSITION, OTHER_ANGLE = 0.02, np.radians(20.0)
"""A grasp is another one when it is this far from those that failed [m], [rad]."""
LEANS = 0.03
"""A part falls by its weight where its way rises more steeply than this [-]; friction holds it on
a flatter one."""
_NEAR, _SAMPLES = 0.15, 300
"""How far beside a state that is too near to something the way home begins [rad] or [m], and how
many states are looked at [-]."""


def believed_scene(scene: Scene, task: Task, value: float, offset: Float[np.ndarray, "3"]) -> Scene:
    """The room as the hand left it: the part at another value, its object elsewhere [m]."""
    assert task.joint is not None
    joint = scene.object(task.object).model.joint(task.joint)
    moved = scene.with_joint(
        task.object, task.joint, float(np.clip(value, joint.lower, joint.upper))
    )
    item = moved.object(task.object)
    T = item.T_world_object.copy()
    T[:3, 3] += offset
    shifted = replace(item, T_world_object=T)
    return replace(moved, objects=tuple(shifted if o is item else o for o in moved.objects))


def taken_as_felt(scene: Scene, task: Task, axis: Axis, value: float) -> tuple[Scene, Task, float]:
    """The room, the task and a value with a part that moves as the hand found it.

    Args:
        scene, task: As believed; the part is shut at 0, and opens to more, in what is returned.
        axis: Where the hand found the joint.
        value: To which the hand has moved it [rad] or [m].

    Raises:
        SceneError: The part moves together with others.
    """
    assert task.joint is not None
    assert task.to is not None
    item = scene.object(task.object)
    opening = opening_of(item.model, task.joint)
    moved = opening.sign * (value - opening.closed)
    way = way_about(item, task.joint, axis.direction, axis.point, moved)
    first, to = (
        float(np.clip(opening.sign * (at - opening.closed), 0.0, way.upper))
        for at in (item.values()[task.joint], task.to)
    )
    other = scene_moving_as(scene, task.object, task.joint, way)
    return other.with_joint(task.object, task.joint, first), replace(task, to=to), moved


def falls_shut(scene: Scene, task: Task, learned: Learned) -> bool:
    """Whether a part falls shut where it is let go: the hand has found that opening lifts it."""
    if task.joint is None or not learned.way:
        return False
    rises = float(learned.axis.way_at(learned.way[-1])[2])
    return opening_of(scene.object(task.object).model, task.joint).sign * rises > LEANS


def without_pushes(config: PipelineConfig) -> PipelineConfig:
    """The same with one hold for the whole way: the part does not stay where it is let go."""
    grasps = config.motion.grasps
    families = tuple(family for family in grasps.families if family != "push")
    return replace(config, motion=replace(config.motion, grasps=replace(grasps, families=families)))


def grasp_in_part(scene: Scene, task: Task, motion: Motion) -> Float[np.ndarray, "4 4"]:
    """Where a motion takes hold of its part: the tool in the object's frame, the part shut."""
    return invert(_part_pose(scene, task)) @ motion.Ts_world_tool[0]


def other_grasps(
    scene: Scene, task: Task, failed: Sequence[Float[np.ndarray, "4 4"]]
) -> GraspFilter:
    """Accepts the grasps that differ from those that failed, see `grasp_in_part`."""
    back = invert(_part_pose(scene, task))

    def accept(motion: TaskMotion) -> Bool[np.ndarray, " g"]:
        Ts = back @ motion.Ts_world_tool[:, motion.grasp_step]
        accepted = np.ones(len(Ts), bool)
        for T in failed:
            away = np.linalg.norm(Ts[:, :3, 3] - T[:3, 3], axis=-1)
            angle = rotation_angle(Ts[:, :3, :3], np.broadcast_to(T[:3, :3], Ts[:, :3, :3].shape))
            accepted &= (away > OTHER_POSITION) | (angle > OTHER_ANGLE)
        return accepted

    return accept


def _part_pose(scene: Scene, task: Task) -> Float[np.ndarray, "4 4"]:
    """Pose of the object's frame, moved along with its part from where that is shut."""
    item, name = scene.object(task.object), task.joint
    assert name is not None
    link, closed = item.model.joint(name).child, opening_of(item.model, name).closed
    shut = item.model.link_poses({**item.values(), name: closed})[link]
    return item.link_poses()[link] @ invert(shut)


def arm_way_home(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"],
    q: Float[np.ndarray, " n"],
    *,
    config: PipelineConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """States of the arm from one back to home, close together; None where no way is found.

    Args:
        scene: The room as the hand left it.
        robot: The robot.
        task: What it was about.
        base_pose: x [m], y [m], yaw [rad].
        q: Where the joints that the arm moves are [rad] or [m].
        config: How to plan.
        seed: Same seed, same way.
    """
    try:
        motion = task_motion(scene, robot, task, config.motion)
    except TaskError:  # what is left of the way is too short to be planned
        return None
    world = collision_world(robot, motion, replace(config, arm_clearance=0.0))
    chain = robot.chain
    checker = partial(
        motion_checker, world, chain, robot.spheres, base_pose, value=int(motion.value[0]),
        holding=False, step=RESOLUTION,
    )  # fmt: skip
    q = chain.freedom_values(q)
    begin = _free_state(q, chain.lower, chain.upper, checker(), np.random.default_rng(seed))
    if begin is None:
        return None
    way = plan_with_room(
        begin, robot.home, chain.lower, chain.upper, checker,
        config=config.arm_planner, seed=seed,
    )  # fmt: skip
    if way is None:
        return None
    return chain.joint_values(interpolate(np.concatenate([q[None], way])))


def _free_state(
    q: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    free: CheckMotion,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"] | None:
    """A free state near one that may be too near to something: spheres hold more than the arm."""
    away = rng.uniform(-_NEAR, _NEAR, (_SAMPLES, len(q)))
    away = away[np.argsort(np.abs(away).max(1))]
    states = np.clip(q + np.concatenate([np.zeros((1, len(q))), away]), lower, upper)
    return next((state for state in states if free(state, state)), None)
