"""The recorded motion of a run in simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momapos.apps.export import recorded_motion
from momapos.core.geometry import pose_wxyz, wrap_angle
from momapos.model.robots import Robot
from momapos.simulation import RunMotion, RunRecord

from .playback import Moment
from .robot_view import home_values


@dataclass(frozen=True)
class RunStory:
    """A run as moments, interpolated between those of the record."""

    robot: Robot
    joint: str | None
    """The joint that the task moves; None for a movable object."""
    motion: RunMotion

    @classmethod
    def of(cls, record: RunRecord, robot: Robot) -> RunStory:
        """Build the motion of a run.

        Raises:
            InputError: The record has no motion, or belongs to another robot.
        """
        motion, task = recorded_motion(record, robot), record.true_task or record.task
        return cls(robot, task.joint, motion)

    @property
    def duration(self) -> float:
        """[s]"""
        return self.motion.times[-1]

    def at(self, seconds: float) -> Moment:
        """Interpolate the moment at a time [s], clipped to the duration."""
        motion = self.motion
        times = np.array(motion.times)
        i = int(np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 2))
        step = times[i + 1] - times[i]
        share = float(np.clip((seconds - times[i]) / step, 0.0, 1.0)) if step > 0 else 1.0

        def between(values: tuple[float, ...]) -> float:
            return values[i] + share * (values[i + 1] - values[i])

        begin, end = np.array(motion.bases[i]), np.array(motion.bases[i + 1])
        base = begin + share * np.append(end[:2] - begin[:2], wrap_angle(end[2] - begin[2]))
        moved = {name: between(values) for name, values in motion.joints.items()}
        object_q = {self.joint: between(motion.part)} if self.joint and motion.part else {}
        object_q |= {name: between(values) for name, values in motion.latch.items()}
        near = i + round(share)
        return Moment(
            base, {**home_values(self.robot), **moved}, object_q, motion.stages[near],
            np.array(motion.forces[near]) if motion.forces else None,
            pose_wxyz(motion.poses[near][:3], motion.poses[near][3:]) if motion.poses else None,
        )  # fmt: skip
