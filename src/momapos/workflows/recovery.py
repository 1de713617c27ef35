"""Recover from a failed motion: the path home, another grasp, the scene as the hand left it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import invert, rotation_angle
from momapos.model.collision import StraightMotions, build_motions
from momapos.model.records import Motion, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, hypothesis_about, scene_with_part_motion
from momapos.model.urdf import opening_of
from momapos.planning import PipelineConfig, collision_world
from momapos.planning.arm_motion import RESOLUTION, interpolate, plan_with_clearance
from momapos.planning.grasps import GraspFilter, TaskMotion, task_motion
from momapos.simulation import Axis, LearnedPart

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_GRASP_DISTANCE, MIN_GRASP_ANGLE = 0.02, np.radians(20.0)
"""A new grasp differs from the failed ones by at least this distance [m] or this angle [rad]."""
MAX_RESTING_SLOPE = 0.03
"""Slope of a released part's path above which it falls closed; below, friction holds it [-]."""
_START_RANGE, _START_SAMPLES = 0.15, 300
"""Maximum joint offset of the start of the path home from the current state [rad] or [m], and the
number of sampled states [-]."""


def believed_scene(scene: Scene, task: Task, value: float, offset: Float[np.ndarray, "3"]) -> Scene:
    """Return the scene as the hand left it: the part at a value, its object offset [m]."""
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


def with_estimated_joint(
    scene: Scene, task: Task, axis: Axis, value: float
) -> tuple[Scene, Task, float]:
    """Return scene, task and joint value for the joint that the hand has measured.

    In the returned scene, the part is closed at 0 and opens with a positive value.

    Args:
        scene, task: The scene and the task as believed.
        axis: The measured joint.
        value: Joint value to which the hand moved the part [rad] or [m].

    Raises:
        SceneError: The joint is coupled with others.
    """
    assert task.joint is not None
    assert task.to is not None
    item = scene.object(task.object)
    opening = opening_of(item.model, task.joint)
    moved = opening.sign * (value - opening.closed)
    measured = hypothesis_about(item, task.joint, axis.direction, axis.point, moved)
    first, to = (
        float(np.clip(opening.sign * (at - opening.closed), 0.0, measured.upper))
        for at in (item.values()[task.joint], task.to)
    )
    other = scene_with_part_motion(scene, task.object, task.joint, measured)
    return other.with_joint(task.object, task.joint, first), replace(task, to=to), moved


def falls_closed(scene: Scene, task: Task, learned: LearnedPart) -> bool:
    """Check whether a released part falls closed because opening lifts it."""
    if task.joint is None or not learned.way:
        return False
    slope = float(learned.axis.way_at(learned.way[-1])[2])
    sign = opening_of(scene.object(task.object).model, task.joint).sign
    return sign * slope > MAX_RESTING_SLOPE


def without_pushes(config: PipelineConfig) -> PipelineConfig:
    """Return the configuration with one grasp for the whole motion, so that it never lets go."""
    grasps = config.motion.grasps
    families = tuple(family for family in grasps.families if family != "push")
    return replace(config, motion=replace(config.motion, grasps=replace(grasps, families=families)))


def grasp_in_part(scene: Scene, task: Task, motion: Motion) -> Float[np.ndarray, "4 4"]:
    """Return the first grasp of a motion: the tool in the object's frame, with the part closed."""
    return invert(_part_pose(scene, task)) @ motion.Ts_world_tool[0]


def other_grasps(
    scene: Scene, task: Task, failed: Sequence[Float[np.ndarray, "4 4"]]
) -> GraspFilter:
    """Return a filter that accepts grasps different from the failed ones, see `grasp_in_part`."""
    back = invert(_part_pose(scene, task))

    def accept(motion: TaskMotion) -> Bool[np.ndarray, " g"]:
        Ts = back @ motion.Ts_world_tool[:, motion.grasp_step]
        accepted = np.ones(len(Ts), bool)
        for T in failed:
            away = np.linalg.norm(Ts[:, :3, 3] - T[:3, 3], axis=-1)
            angle = rotation_angle(Ts[:, :3, :3], np.broadcast_to(T[:3, :3], Ts[:, :3, :3].shape))
            accepted &= (away > MIN_GRASP_DISTANCE) | (angle > MIN_GRASP_ANGLE)
        return accepted

    return accept


def _part_pose(scene: Scene, task: Task) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the object's frame, moved with the part from its closed value."""
    item, name = scene.object(task.object), task.joint
    assert name is not None
    link, closed = item.model.joint(name).child, opening_of(item.model, name).closed
    T_object_closed = item.model.link_poses({**item.values(), name: closed})[link]
    return item.link_poses()[link] @ invert(T_object_closed)


def arm_home_path(
    scene: Scene,
    robot: Robot,
    task: Task,
    base_pose: Float[np.ndarray, "3"],
    q: Float[np.ndarray, " n"],
    *,
    config: PipelineConfig,
    seed: int,
) -> Float[np.ndarray, "k n"] | None:
    """Plan a path of the arm from a state back to home.

    Args:
        scene: The scene as the hand left it.
        robot: The robot.
        task: The task.
        base_pose: x [m], y [m], yaw [rad].
        q: Values of the joints that the arm moves [rad] or [m].
        config: Configuration of the planner.
        seed: Same seed, same path.

    Returns:
        Densely interpolated states; None if there is no path.
    """
    try:
        motion = task_motion(scene, robot, task, config.motion)
    except TaskError:  # the remaining opening is too short to plan
        return None
    world = collision_world(robot, motion, replace(config, arm_clearance=0.0))
    chain = robot.chain
    checker = partial(
        build_motions, world, chain, robot.spheres.by_hulls, base_pose, value=int(motion.value[0]),
        holding=False, step=RESOLUTION,
    )  # fmt: skip
    q = chain.freedom_values(q)
    begin = _free_state(q, chain.lower, chain.upper, checker(), np.random.default_rng(seed))
    if begin is None:
        return None
    path = plan_with_clearance(
        begin, robot.home, chain.lower, chain.upper, checker,
        config=config.arm_planner, seed=seed,
    )  # fmt: skip
    if path is None:
        return None
    away = interpolate(np.stack([q, begin]))
    return chain.joint_values(np.concatenate([away[:-1], path.states()]))


def _free_state(
    q: Float[np.ndarray, " n"],
    lower: Float[np.ndarray, " n"],
    upper: Float[np.ndarray, " n"],
    free: StraightMotions,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"] | None:
    """Return the nearest sampled state without a collision: spheres enclose more than the arm."""
    away = rng.uniform(-_START_RANGE, _START_RANGE, (_START_SAMPLES, len(q)))
    away = away[np.argsort(np.abs(away).max(1))]
    states = np.clip(q + np.concatenate([np.zeros((1, len(q))), away]), lower, upper)
    return next((state for state in states if free(state, state)), None)
