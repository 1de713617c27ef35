"""Motion over time, from a plan or from the record of a run in physics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import pose_planar, pose_wxyz
from momapos.model.records import PlacementPlan, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.simulation import DRIVE, RunMotion, RunRecord

from .carried_object import CarriedObject
from .phases import Phase, PhaseKind, Samples, samples_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

LIMIT_SLACK = 0.2
"""Distance beyond a joint limit that the soft limits of the physics engine may give way to a load
[rad] or [m]."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """Motion of robot and object over time; sample times never decrease."""

    task: Task
    joints: tuple[str, ...]
    """Joints of the robot, one per column of the positions."""
    samples: Samples
    stages: tuple[str, ...]
    """Name of each phase, in order."""
    arm: tuple[bool, ...]
    """Whether the arm moves in each phase."""
    base_path: Float[np.ndarray, "k 3"] | None
    """Path of the base: x [m], y [m], yaw [rad]; None without a drive."""
    Ts_world_object: Float[np.ndarray, "t 4 4"] | None
    """Pose of a movable object's root link; None if the task moves a joint."""
    latch: str = ""
    """Joint of the object's latch that is turned; "" if none is."""

    def object_values(self, sample: int) -> dict[str, float]:
        """Return the values of the object's joints that move, at a sample [rad] or [m]."""
        if self.task.joint is None:
            return {}
        samples = self.samples
        turned = {self.latch: float(samples.latch_q[sample])} if self.latch else {}
        return {self.task.joint: float(samples.object_q[sample]), **turned}

    def phases(self) -> Iterator[tuple[int, slice]]:
        """Yield the index and the samples of each phase."""
        phase = self.samples.phase
        cuts = np.flatnonzero(np.diff(phase)) + 1
        for first, end in pairwise([0, *cuts.tolist(), len(phase)]):
            yield int(phase[first]), slice(first, end)


def plan_timeline(
    plan: PlacementPlan, phases: tuple[Phase, ...], scene: Scene, robot: Robot
) -> Timeline:
    """Return the timeline of a solved plan with its phases, see `phases_of`."""
    assert plan.motion is not None
    samples, kinds = samples_of(phases), tuple(phase.kind for phase in phases)
    carried, poses = CarriedObject.of(scene, plan.task, plan.motion), None
    latch = scene.object(plan.task.object).latch
    if carried is not None:
        tools = robot.chain.tool_poses(robot.chain.freedom_values(samples.positions))
        tools = pose_planar(samples.base) @ tools
        poses = carried.poses(plan.task, kinds, samples.phase, tools)
    return Timeline(
        plan.task, plan.joints, samples, tuple(map(str, kinds)),
        tuple(kind in (PhaseKind.ARM, PhaseKind.DRIVE_AND_ARM) for kind in kinds),
        _base_path(plan), poses,
        "" if latch is None or plan.motion.latch_q is None else latch.joint,
    )  # fmt: skip


def _base_path(plan: PlacementPlan) -> Float[np.ndarray, "k 3"] | None:
    """Return the path of the base from the start to its last pose; None without a drive."""
    moved = None if plan.motion is None else plan.motion.base
    parts = [part for part in (plan.base_path, moved) if part is not None]
    return np.concatenate(parts) if parts else None


def run_timeline(record: RunRecord, robot: Robot) -> Timeline:
    """Return the timeline of a run; velocities are differences of the recorded positions.

    Args:
        record: The record, with its motion.
        robot: The robot of the plan.

    Raises:
        InputError: The record has no motion, or belongs to another robot.
    """
    motion, task = recorded_motion(record, robot), record.true_task or record.task
    later = np.append(np.diff(motion.times) > 0, True)  # of samples at one time, the last
    times = np.array(motion.times)[later]
    base = np.array(motion.bases)[later]
    positions = np.zeros((len(times), len(motion.joints)))
    for column, values in enumerate(motion.joints.values()):
        positions[:, column] = np.array(values)[later]
    velocities = np.asarray(np.gradient(positions, times, axis=0))
    words = np.array(motion.stages)[later]
    phase = np.cumsum(np.append(False, words[1:] != words[:-1]))
    stages = tuple(words[np.searchsorted(phase, np.arange(phase[-1] + 1))].tolist())
    part = np.array(motion.part)[later] if motion.part else np.zeros(len(times))
    latch, turned = next(iter(motion.latch.items()), ("", motion.times))
    poses = None
    if motion.poses:
        rows = [pose_wxyz(tuple(row[:3]), tuple(row[3:])) for row in motion.poses]
        poses = np.stack(rows)[later]
    drives: Bool[np.ndarray, " t"] = words == DRIVE
    return Timeline(
        task, tuple(motion.joints),
        Samples(times, base, positions, velocities, part, phase, np.array(turned)[later]),
        stages, tuple(stage != DRIVE for stage in stages), base[drives] if drives.any() else None,
        poses, latch,
    )  # fmt: skip


def recorded_motion(record: RunRecord, robot: Robot) -> RunMotion:
    """Return the motion of a run.

    Raises:
        InputError: The record has no motion, belongs to another robot, or leaves its limits.
    """
    motion = record.motion
    if motion is None or len(motion.times) < 2:
        raise InputError(
            "the run record contains no motion; 'momapos run ... --out FILE' writes one with motion"
        )
    unknown = next((name for name in motion.joints if name not in robot.model.joints), None)
    if unknown is not None:
        raise InputError(f"the run record moves {unknown!r:.60}, which is no joint of {robot.name}")
    for name, values in motion.joints.items():
        joint = robot.model.joint(name)
        low, high = joint.lower - LIMIT_SLACK, joint.upper + LIMIT_SLACK
        beyond = next((value for value in values if not low <= value <= high), None)
        if beyond is not None:
            raise InputError(
                f"the run record moves {name!r:.60} to {beyond:g}; its limits are {joint.lower:g} "
                f"to {joint.upper:g}"
            )
    return motion
