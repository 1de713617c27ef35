"""What moves over time: as a plan says, or as physics did it in a run."""

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

from .carried_object import Carried
from .phases import Phase, PhaseKind, Samples, samples_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


@dataclass(frozen=True)
class Timeline:
    """What moves, from the beginning to the end; time rises from sample to sample, or stays."""

    task: Task
    """What is done."""
    joints: tuple[str, ...]
    """Of the robot, one for each column of the positions."""
    samples: Samples
    stages: tuple[str, ...]
    """What is done in each phase of the samples, in order."""
    arm: tuple[bool, ...]
    """Whether the arm moves in it."""
    base_path: Float[np.ndarray, "k 3"] | None
    """Where the base drives: x [m], y [m], yaw [rad]; None where it does not."""
    Ts_world_object: Float[np.ndarray, "t 4 4"] | None
    """Pose of a loose object's root link; None where the task moves a joint."""

    def stretches(self) -> Iterator[tuple[int, slice]]:
        """Each phase by number, and which samples are of it."""
        phase = self.samples.phase
        cuts = np.flatnonzero(np.diff(phase)) + 1
        for first, end in pairwise([0, *cuts.tolist(), len(phase)]):
            yield int(phase[first]), slice(first, end)


def planned(plan: PlacementPlan, phases: tuple[Phase, ...], scene: Scene, robot: Robot) -> Timeline:
    """What a solved plan says.

    Args:
        plan: The plan.
        phases: Its phases, see `phases_of`.
        scene: Its room.
        robot: Its robot.
    """
    assert plan.motion is not None
    samples, kinds = samples_of(phases), tuple(phase.kind for phase in phases)
    carried, poses = Carried.of(scene, plan.task, plan.motion), None
    if carried is not None:
        tools = robot.chain.tool_poses(robot.chain.freedom_values(samples.positions))
        tools = pose_planar(samples.base) @ tools
        poses = carried.poses(plan.task, kinds, samples.phase, tools)
    return Timeline(
        plan.task, plan.joints, samples, tuple(map(str, kinds)),
        tuple(kind is PhaseKind.ARM for kind in kinds), plan.base_path, poses,
    )  # fmt: skip


def executed(record: RunRecord, robot: Robot) -> Timeline:
    """What physics did in a run; velocities are differences of the recorded positions.

    Args:
        record: The record, with what moved.
        robot: The robot of its plan.

    Raises:
        InputError: It does not say what moved, or it is one of another robot.
    """
    motion, task = recorded_motion(record, robot), record.true_task or record.task
    later = np.append(np.diff(motion.times) > 0, True)  # of moments at one time the last
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
    poses = None
    if motion.poses:
        rows = [pose_wxyz(tuple(row[:3]), tuple(row[3:])) for row in motion.poses]
        poses = np.stack(rows)[later]
    drives: Bool[np.ndarray, " t"] = words == DRIVE
    return Timeline(
        task, tuple(motion.joints),
        Samples(times, base, positions, velocities, part, phase),
        stages, tuple(stage != DRIVE for stage in stages), base[drives] if drives.any() else None,
        poses,
    )  # fmt: skip


def recorded_motion(record: RunRecord, robot: Robot) -> RunMotion:
    """What moved in a run.

    Raises:
        InputError: Its record does not say what moved, or it is one of another robot.
    """
    motion = record.motion
    if motion is None or len(motion.times) < 2:
        raise InputError(
            "the record does not say what moved; momapos run ... --out writes one that does"
        )
    unknown = [name for name in motion.joints if name not in robot.model.joints]
    if unknown:
        raise InputError(f"the record moves {unknown[0]!r:.60}, which {robot.name} has not")
    return motion
