"""Choose one grasp, and where to put an item, for picking it up, carrying it and placing it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError
from momapos.core.geometry import compose, invert, latin_hypercube
from momapos.model.records import Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning.arm_motion import carried_at_home
from momapos.planning.grasps import GraspFilter, TaskMotion
from momapos.planning.placement import (
    BaseStatus,
    PlacementGeometry,
    base_pose_status,
    sampling_box,
    task_frame,
)

from .carrying import SAME_GRASP
from .query import PlacementQuery
from .result import PlacementResult
from .spots import spots_for
from .task_setup import PreparedTask, prepare

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_CHOICES = 8
"""Number of ways that are tried for one item [-]."""
TOGETHER = 4
"""Number of spots at which all grasps are tried together: that of the pick is then kept [-]."""
ALONE = 3
"""Number of grasps that are tried alone at one spot [-]."""
SAMPLES = 1024
"""Base poses from which the reach of each grasp is counted [-]."""


@dataclass(frozen=True, eq=False)
class Carry:
    """How an item is moved: in one of some grasps, from where it stands to where it is put."""

    T_world_goal: Float[np.ndarray, "4 4"]
    """Pose of the item at its goal."""
    Ts_object_tool: Float[np.ndarray, "g 4 4"]
    """The grasps that are free at both ends and with the arm at home in between."""
    reached: int = 0
    """From how many of some base poses a grasp is within reach at both ends, at least [-]."""
    fails_alone: bool = False
    """Whether the item cannot be picked up or placed there with any grasp."""
    carried: Float[np.ndarray, " n"] | None = None
    """The arm's state in which the item is carried, if it is picked up already [rad] or [m]."""

    def keeps(self, scene: Scene, task: Task, also: GraspFilter | None) -> GraspFilter:
        """Return the filter that keeps only these grasps for a task in a scene.

        Without any it keeps all of a task that fails anyway, for its reasons, and none of the
        last one otherwise.
        """
        T_world_object = scene.object(task.object).T_world_object

        def same(motion: TaskMotion) -> Bool[np.ndarray, " g"]:
            grasps = _grasps(motion, T_world_object)
            if not len(self.Ts_object_tool):
                return np.full(len(grasps), self.fails_alone or task.verb == "pick")
            kept = _same(grasps, self.Ts_object_tool).any(1)
            return np.asarray(kept if also is None else kept & also(motion))

        return same

    def holding(self, scene: Scene, answer: PlacementResult) -> Carry:
        """Return the same with only the grasp and the carrying state of an answer in a scene."""
        task, motion = answer.plan.task, answer.plan.motion
        assert motion is not None
        T_world_object = scene.object(task.object).T_world_object
        grasp = invert(T_world_object) @ motion.Ts_world_tool[:1]
        q = motion.approach[0] if motion.home is None or task.verb == "place" else motion.home[-1]
        carried = answer.prepared.robot.chain.freedom_values(q)
        return replace(self, Ts_object_tool=grasp, carried=carried)


def at_home_only(robot: Robot, also: GraspFilter | None) -> GraspFilter:
    """Return the filter that keeps the grasps in which the arm can carry an object at home."""

    def kept(motion: TaskMotion) -> Bool[np.ndarray, " g"]:
        free = carried_at_home(robot, motion)
        return free if also is None else free & also(motion)

    return kept


def carries_for(query: PlacementQuery, scene: Scene, name: str, place: str | None) -> list[Carry]:
    """Return how an item can be moved to a place, in the order of trying.

    First the search picks the item up in any grasp that is free at both ends and with the arm at
    home, and keeps it. Then grasps are tried alone, those within reach from the most base poses
    first.

    Args:
        query: A question with robot, reach and configuration.
        scene: The scene in which the item is picked up.
        name: The item.
        place: Where to, see `spots_for`; None for where it is.

    Raises:
        TaskError: The place has no room, or the hand cannot hold the item.
        UnknownNameError: There is no such place.
    """
    item = scene.object(name)
    pick = _prepared(query, scene, Task("pick", name))
    if pick.infeasible_reason:
        return [Carry(item.T_world_object, np.zeros((0, 4, 4)), fails_alone=True)]
    goals = [item.T_world_object]
    if place is not None:
        start = query.start if query.start is not None else scene.start
        near = None if start is None else start[:2]
        goals = spots_for(scene, item, place, start=near, heights=_heights(pick.geometry))
    picks = _grasps(pick.motion, item.T_world_object)
    within = _reached(query, pick)
    together, alone = list[Carry](), list[Carry]()
    fails_alone = True
    for T in goals:
        there = _prepared(query, scene.with_pose(name, T), Task("place", name))
        if there.infeasible_reason:
            continue
        fails_alone = False
        same = _same(picks, _grasps(there.motion, T))
        at_home = carried_at_home(query.robot, there.motion)
        if same[:, at_home].any():  # else it is carried in another state, see `carrying_homes`
            same[:, ~at_home] = False
        i, j = np.nonzero(same)
        if len(i):
            count = np.minimum(within[i], _reached(query, there)[j])
            i, count = (rows[np.argsort(-count, kind="stable")] for rows in (i, count))
            together.append(Carry(T, picks[i], int(count[0])))
            alone += [
                Carry(T, picks[i[k : k + 1]], int(count[k])) for k in range(min(len(i), ALONE))
            ]
    ranked = [*sorted(together, key=_unreached)[:TOGETHER], *sorted(alone, key=_unreached)]
    nothing = Carry(goals[0], np.zeros((0, 4, 4)), fails_alone=fails_alone)
    likely = [one for one in ranked if one.reached]
    return likely[:MAX_CHOICES] or ranked[:1] or [nothing]


def _unreached(carry: Carry) -> int:
    return -carry.reached


def _same(
    Ts: Float[np.ndarray, "g 4 4"], others: Float[np.ndarray, "h 4 4"]
) -> Bool[np.ndarray, "g h"]:
    """Return which of some grasps are which of others."""
    return np.asarray(np.abs(Ts[:, None] - others[None]).sum((2, 3)) < SAME_GRASP)


def _heights(geometry: PlacementGeometry) -> tuple[float, float]:
    """Return the heights that a robot's hand can reach [m]."""
    shoulder, reach = float(geometry.shoulder[2]), geometry.robot.reach + geometry.lift
    return shoulder - reach, shoulder + reach


def _prepared(query: PlacementQuery, scene: Scene, task: Task) -> PreparedTask:
    return prepare(
        scene, query.robot, task, query.config, clearance=query.config.place.clearance,
        keep_grasps=query.keep_grasps,
    )  # fmt: skip


def _grasps(
    motion: TaskMotion, T_world_object: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "g 4 4"]:
    """Return the tool poses of a motion's grasps in the object."""
    return np.asarray(invert(T_world_object) @ motion.Ts_world_tool[:, motion.grasp_step])


def _reached(query: PlacementQuery, prepared: PreparedTask) -> Int[np.ndarray, " g"]:
    """Return from how many free base poses each grasp is within reach, of some samples."""
    geometry = prepared.geometry
    corners = sampling_box(geometry)
    if corners is None:
        return np.zeros(len(geometry.Ts_world_tool), np.int64)
    unit = latin_hypercube(np.random.default_rng(query.seed), SAMPLES, 3)
    low, high = np.append(corners[0], -np.pi), np.append(corners[1], np.pi)
    poses = compose(task_frame(geometry), low + unit * (high - low))
    poses = poses[base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR]
    return np.asarray((query.reach.min_score(poses, geometry.Ts_world_tool) > 0.0).sum(0))


def refuse_place(verb: str, name: str, to: float | str | None) -> None:
    """Refuse a place that is none.

    Raises:
        TaskError: There is none, or it is a number.
    """
    if not isinstance(to, str):
        raise TaskError(
            f"{verb} {name} needs a place: an object or a part of it, a point as 1.2,0.4,0.75, or "
            "an area of the scene"
        )
