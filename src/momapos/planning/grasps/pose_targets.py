"""Turn tool poses into motions: each pose is a task whose only grasp is the pose itself.

A tolerance gives a pose several tool poses, which are its grasps: turns about an axis, leans of
it, and shifts. All poses with the same contact are the grasps of one motion of one step, so that
the arm's kernels answer for all of them at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import orthonormal, rotation_about
from momapos.model.records import Task, ToolPose
from momapos.model.scene import Scene

from .grasp_families import Grasps
from .motion_boxes import moving_boxes, static_boxes
from .motion_record import TaskMotion, Turning

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


def tool_poses_of(pose: ToolPose) -> Float[np.ndarray, "v 4 4"]:
    """Return tool poses within a pose's tolerance, the pose itself first."""
    T = pose.T_world_tool
    leans, spins = [np.eye(3)], [np.eye(3)]
    if pose.axis is not None:
        axis = np.array(pose.axis)
        if pose.cone > pose.rotation:
            side = orthonormal(axis)
            around = 2 * np.pi * np.arange(LEANS) / LEANS
            across = rotation_about(axis, around) @ side
            leans += [rotation_about(one, INSIDE * pose.cone) for one in across]
        step = MAX_SPIN_STEP if len(leans) > 1 else SPIN_STEP
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
    target = scene.object(contact)
    links = target.link_poses()
    moving, moving_labels, grasped = moving_boxes(target, [(np.eye(4)[None], links)], None)
    static, labels = static_boxes(scene, target, frozenset(target.model.links))
    column = np.arange(sizes.max())
    first = np.cumsum(sizes) - sizes
    groups = np.where(column < sizes[:, None], first[:, None] + column, -1)
    turning = Turning(np.zeros(len(tools)), groups, np.array([0.0, 0.0, 1.0]), tools[:, :3, :3])
    none, unknown = np.zeros(len(tools), np.int64), np.full(len(tools), np.nan)
    grasps = Grasps(none, unknown, none.astype(float), none.astype(float), (), none, none)
    motion = TaskMotion(
        task=task,
        Ts_world_tool=np.ascontiguousarray(tools[:, None]),
        object_q=np.zeros(1),
        waypoint_steps=np.zeros(1, np.int64),
        grasp_step=0,
        holding=np.array([bool(contact)]),
        static=static,
        moving=moving,
        value=np.zeros(1, np.int64),
        grasped=grasped,
        labels=(*labels, *moving_labels),
        grasps=grasps,
        refusal="",
        turning=turning,
    )
    return PoseTargets(motion, np.repeat(rows, sizes), rows)
