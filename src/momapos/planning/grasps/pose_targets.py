"""Turn tool poses into motions: each pose is a task whose only grasp is the pose itself.

A tolerance gives a pose several tool poses, which are its grasps: turns about an axis, leans of
it, and shifts. All poses with the same contact are the grasps of one motion of one step, so that
the arm's kernels answer for all of them at once. A path through poses is one motion of many steps,
and its grasps are what its tolerance allows; those that differ by a turn about its axis are a
group, so that the tool may turn on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import invert, orthonormal, rotation_about
from momapos.model.records import Task, ToolPose
from momapos.model.scene import Scene

from .config import SUBSTEPS, MotionConfig
from .grasp_families import Grasps
from .motion_boxes import moving_boxes, static_boxes
from .motion_record import MIN_GROUP, TaskMotion, Turning, no_turning

if TYPE_CHECKING:
    from jaxtyping import Float, Int

SPIN_STEP = np.radians(30.0)
"""Turn between two tool poses of one pose [rad]; half of it is at most lost at either side."""
MAX_SPIN_STEP = np.radians(45.0)
"""The same for poses whose axis may lean, too [rad]."""
LEANS = 6
"""Directions in which an axis leans [-]."""
INSIDE = 0.9
"""Share of a tolerance that is used [-]; the rest is for what the arm is off."""
MIN_SHIFT = 0.01
"""Smaller position tolerances are not used to shift the tool [m]."""
PATH_SPIN_STEP = np.radians(22.5)
"""The same as `SPIN_STEP` along a path, where the tool may turn from one to the next between two
waypoints [rad]; see `MAX_TURN` of the arm's path."""
MAX_JUMP, JUMP_SHARE = 0.2, 20.0
"""A path with a gap above this [m] that is so many times its median gap has lost points [-]."""
MIN_JUMP_POSES = 8
"""Number of poses from which on a gap is compared with the median [-]; a few may be corners."""
MAX_PATH_TURN = np.radians(120.0)
"""Largest turn between two poses of a path [rad]; beyond, the way to turn is not clear."""


@dataclass(frozen=True, eq=False)
class PoseTargets:
    """Tool poses that satisfy the poses of a task, with the motion that they are grasps of."""

    motion: TaskMotion
    """One step; the groups of its turning are the tool poses of each pose."""
    pose: Int[np.ndarray, " g"]
    """The pose of the task that each tool pose satisfies; ascending."""
    rows: Int[np.ndarray, " p"]
    """The poses of the task, one for each group."""

    def modes(self, poses: Int[np.ndarray, " k"]) -> Int[np.ndarray, " k"]:
        """Return the grasp modes of some of its poses: all tool poses of each."""
        return len(self.pose) + np.searchsorted(self.rows, poses)


def tool_poses_of(
    pose: ToolPose, spin_step: float = float(SPIN_STEP)
) -> Float[np.ndarray, "v 4 4"]:
    """Return tool poses within a pose's tolerance, the pose itself first, then turns about an axis.

    Args:
        pose: The pose.
        spin_step: Turn between two of them [rad].
    """
    T = pose.T_world_tool
    leans, spins = [np.eye(3)], [np.eye(3)]
    if pose.axis is not None:
        axis = np.array(pose.axis)
        if pose.cone > pose.rotation:
            side = orthonormal(axis)
            around = 2 * np.pi * np.arange(LEANS) / LEANS
            across = rotation_about(axis, around) @ side
            leans += [rotation_about(one, INSIDE * pose.cone) for one in across]
        step = MAX_SPIN_STEP if len(leans) > 1 else spin_step
        if pose.spin >= np.pi - 1e-9:
            count = int(np.ceil(2 * np.pi / step))
            turns = 2 * np.pi * np.arange(1, count) / count
        else:
            count = int(np.ceil(INSIDE * pose.spin / step)) if pose.spin > pose.rotation else 0
            turns = INSIDE * pose.spin * np.arange(1, count + 1) / max(count, 1)
            turns = np.concatenate([turns, -turns])
        spins += list(rotation_about(axis, turns))
    R = np.array([lean @ spin for lean in leans for spin in spins])
    shifts = [np.zeros(3)]
    for k, most in enumerate(pose.position):
        if most >= MIN_SHIFT:
            shifts += [INSIDE * most * sign * np.eye(3)[k] for sign in (1.0, -1.0)]
    Ts = np.tile(T, (len(R) + len(shifts) - 1, 1, 1))
    Ts[: len(R), :3, :3] = T[:3, :3] @ R
    Ts[len(R) :, :3, 3] += np.array(shifts[1:]).reshape(-1, 3) @ T[:3, :3].T
    return Ts


def targets_of(
    scene: Scene, task: Task, Ts: Sequence[Float[np.ndarray, "_ 4 4"]]
) -> list[PoseTargets]:
    """Return the motions of a task's poses, one for each object that is to be touched.

    Args:
        scene: The scene.
        task: The task.
        Ts: The tool poses of each pose, see `tool_poses_of`; poses without any are left out.

    Raises:
        UnknownNameError: There is no such object.
    """
    contacts = [pose.contact for pose in task.poses]
    found = []
    for contact in dict.fromkeys(contacts):
        rows = np.array([k for k, one in enumerate(contacts) if one == contact and len(Ts[k])], int)
        if len(rows):
            found.append(_targets(scene, task, [Ts[k] for k in rows.tolist()], rows, contact))
    return found


def _targets(
    scene: Scene,
    task: Task,
    Ts: Sequence[Float[np.ndarray, "_ 4 4"]],
    rows: Int[np.ndarray, " p"],
    contact: str,
) -> PoseTargets:
    """Return the motion of poses at which the hand touches the same object, or none."""
    sizes = np.array([len(one) for one in Ts])
    tools = np.concatenate(Ts)
    column = np.arange(sizes.max())
    first = np.cumsum(sizes) - sizes
    groups = np.where(column < sizes[:, None], first[:, None] + column, -1)
    turning = Turning(np.zeros(len(tools)), groups, np.array([0.0, 0.0, 1.0]), tools[:, :3, :3])
    none = np.zeros(1, np.int64)
    motion = _motion(scene, task, contact, tools[:, None], none, turning)
    return PoseTargets(motion, np.repeat(rows, sizes), rows)


def path_motion(scene: Scene, task: Task, config: MotionConfig) -> TaskMotion:
    """Return the motion along a path, without the way there and back.

    Between two poses the tool moves straight and turns evenly. What all poses tolerate are the
    grasps: the tool keeps its lean and its shift, and may turn about the axis on the way.

    Args:
        scene: The scene.
        task: The task with the poses.
        config: The resolution.

    Raises:
        InputError: The poses touch different objects, two differ by too large a turn, or one is far
            from the others, as if points were missing.
        UnknownNameError: There is no such object.
    """
    poses = task.poses
    for k, one in enumerate(poses):
        if one.contact != poses[0].contact:
            raise InputError(
                f"{task.pose_names[k]} touches {one.contact or 'nothing'} and the path before "
                f"{poses[0].contact or 'nothing'}; plan a path for each"
            )
    Ts, poses_at, waypoints = _resampled(task, config)
    common = _common(poses)
    variants = invert(common.T_world_tool) @ tool_poses_of(common, float(PATH_SPIN_STEP))
    turning = _spins(common, variants)
    motion = _motion(scene, task, poses[0].contact, Ts @ variants[:, None], waypoints, turning)
    return replace(motion, pose_steps=poses_at)


def _resampled(
    task: Task, config: MotionConfig
) -> tuple[Float[np.ndarray, "d 4 4"], Int[np.ndarray, " p"], Int[np.ndarray, " w"]]:
    """Return close tool poses along a path, the index of each of its poses, and of the waypoints.

    Raises:
        InputError: Two poses differ by too large a turn, or are farther apart than all others.
    """
    from scipy.spatial.transform import Rotation

    given = np.stack([pose.T_world_tool for pose in task.poses])
    R, point = Rotation.from_matrix(given[:, :3, :3]), given[:, :3, 3]
    turns = (R[:-1].inv() * R[1:]).as_rotvec()
    length, angle = (np.linalg.norm(v, axis=1) for v in (np.diff(point, axis=0), turns))
    if len(given) < 2:
        raise InputError("a path needs two poses or more; momapos place reach takes one")
    wide = int(angle.argmax())
    if angle[wide] > MAX_PATH_TURN:
        raise InputError(
            f"{task.pose_names[wide + 1]} is turned by {np.degrees(angle[wide]):.0f} deg from the "
            f"pose before; a path turns by at most {np.degrees(MAX_PATH_TURN):.0f} deg between two"
        )
    far, usual = int(length.argmax()), float(np.median(length))
    if len(given) > MIN_JUMP_POSES and length[far] > max(MAX_JUMP, JUMP_SHARE * usual):
        raise InputError(
            f"{task.pose_names[far + 1]} is {100 * length[far]:.0f} cm from the pose before, and "
            f"others are {100 * usual:.2g} cm apart; the path jumps"
        )
    size = np.maximum(length / config.waypoint_slide, angle / np.radians(config.waypoint_angle))
    cuts = np.maximum(np.ceil(SUBSTEPS * size - 1e-9).astype(int), 1)
    leg = np.repeat(np.arange(len(cuts)), cuts)
    at = np.concatenate([[0], np.cumsum(cuts)])
    share = (np.arange(len(leg)) - at[leg] + 1) / cuts[leg]
    Ts = np.tile(np.eye(4), (len(leg) + 1, 1, 1))
    Ts[0] = given[0]
    Ts[1:, :3, :3] = (R[leg] * Rotation.from_rotvec(share[:, None] * turns[leg])).as_matrix()
    Ts[1:, :3, 3] = point[leg] + share[:, None] * np.diff(point, axis=0)[leg]
    passed = np.concatenate([[0.0], np.cumsum((size / cuts)[leg])])
    whole = np.arange(1, int(np.ceil(passed[-1] - 1e-9)))
    inner = np.searchsorted(passed, passed[-1] * whole / (len(whole) + 1))
    return Ts, at, np.unique(np.concatenate([[0], inner, [len(Ts) - 1]]))


def _common(poses: Sequence[ToolPose]) -> ToolPose:
    """Return the first pose of a path, with what all of them tolerate."""
    first, axes = poses[0], {one.axis for one in poses}
    free = len(axes) == 1
    return replace(
        first,
        position=tuple(np.min([one.position for one in poses], axis=0).tolist()),
        rotation=min(one.rotation for one in poses),
        axis=first.axis if free else None,
        spin=min(one.spin for one in poses) if free else 0.0,
        cone=min(one.cone for one in poses) if free else 0.0,
    )


def _spins(pose: ToolPose, variants: Float[np.ndarray, "v 4 4"]) -> Turning:
    """Group the variants that differ from the pose by a turn about its axis only."""
    R = variants[:, :3, :3]
    if pose.axis is None:
        return no_turning(len(variants))
    axis = np.array(pose.axis)
    same = (np.abs(R @ axis - axis).max(1) < 1e-9) & (np.abs(variants[:, :3, 3]).max(1) < 1e-9)
    side = orthonormal(axis)
    turned = R @ side
    angles = np.where(same, np.arctan2(np.cross(side, turned) @ axis, turned @ side), 0.0)
    group = np.flatnonzero(same)
    enough = len(group) >= MIN_GROUP
    return Turning(angles, group[None] if enough else np.zeros((0, 1), np.int64), axis, R)


def _motion(
    scene: Scene, task: Task, contact: str, Ts_world_tool: Float[np.ndarray, "g d 4 4"],
    waypoints: Int[np.ndarray, " w"], turning: Turning,
) -> TaskMotion:  # fmt: skip
    """Return a motion of the tool, whose hand may touch one object, or none."""
    target = scene.object(contact)
    links = target.link_poses()
    moving, moving_labels, grasped = moving_boxes(target, [(np.eye(4)[None], links)], None)
    static, labels = static_boxes(scene, target, frozenset(target.model.links))
    grasps, steps = Ts_world_tool.shape[:2]
    none, unknown = np.zeros(grasps, np.int64), np.full(grasps, np.nan)
    return TaskMotion(
        task=task,
        Ts_world_tool=np.ascontiguousarray(Ts_world_tool),
        object_q=np.zeros(steps),
        waypoint_steps=waypoints,
        grasp_step=0,
        holding=np.full(steps, bool(contact)),
        static=static,
        moving=moving,
        value=np.zeros(steps, np.int64),
        grasped=grasped,
        labels=(*labels, *moving_labels),
        grasps=Grasps(none, unknown, 0.0 * none, 0.0 * none, (), none, np.arange(grasps)),
        refusal="",
        turning=turning,
    )
