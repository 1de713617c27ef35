"""What physics did, over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from viser.transforms import SO3

from momapos.apps.export import recorded_motion
from momapos.model.robots import Robot
from momapos.simulation import RunMotion, RunRecord

from .playback import Moment
from .robot_view import home_values

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class RunStory:
    """A run as moments; between those of the record they are in between."""

    robot: Robot
    joint: str | None
    """The joint that the task moves; None of loose objects."""
    motion: RunMotion

    @classmethod
    def of(cls, record: RunRecord, robot: Robot) -> RunStory:
        """The story of a run.

        Raises:
            InputError: Its record does not say what moved, or it is one of another robot.
        """
        motion, task = recorded_motion(record, robot), record.true_task or record.task
        return cls(robot, task.joint, motion)

    @property
    def duration(self) -> float:
        """[s]"""
        return self.motion.times[-1]

    def at(self, seconds: float) -> Moment:
        """What was where at a time [s]; the first and the last hold before and after."""
        motion = self.motion
        times = np.array(motion.times)
        i = int(np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 2))
        long = times[i + 1] - times[i]
        share = float(np.clip((seconds - times[i]) / long, 0.0, 1.0)) if long > 0 else 1.0

        def between(values: tuple[float, ...]) -> float:
            return values[i] + share * (values[i + 1] - values[i])

        begin, end = np.array(motion.bases[i]), np.array(motion.bases[i + 1])
        turn = (end[2] - begin[2] + np.pi) % (2 * np.pi) - np.pi
        base = begin + share * np.append(end[:2] - begin[:2], turn)
        moved = {name: between(values) for name, values in motion.joints.items()}
        object_q = {self.joint: between(motion.part)} if self.joint and motion.part else {}
        near = i + round(share)
        return Moment(
            base, {**home_values(self.robot), **moved}, object_q, motion.stages[near],
            np.array(motion.forces[near]) if motion.forces else None,
            _matrix(motion.poses[near]) if motion.poses else None,
        )  # fmt: skip


def _matrix(pose: tuple[float, ...]) -> Float[np.ndarray, "4 4"]:
    """x, y, z and the quaternion wxyz as a transform."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = SO3(np.array(pose[3:])).as_matrix(), pose[:3]
    return T
