"""Runs as episodes for learning: states, actions and images at equal time steps."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import InputError
from momapos.model.records import Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.simulation import RunRecord

from .episode_images import Camera, EpisodeRenderer
from .timeline import Timeline, run_timeline

if TYPE_CHECKING:
    from jaxtyping import Float32, UInt8

RATE = 10.0
"""Frames per second, the rate of a record [1/s]."""
BASE = ("base_x", "base_y", "base_yaw")
GRIPPER = "gripper"
PART = ("value", "x", "y", "z", "qw", "qx", "qy", "qz")
_HOLDING = ("grip", "manipulate", "dwell")
"""Stages in which the hand is closed."""
MIN_FRAMES = 2
MAX_THREADS = 4
"""Threads that render; more only wait for the one that writes [-]."""


@dataclass(frozen=True, eq=False)
class Episode:
    """A run at equal time steps; row t of `action` leads from frame t to frame t + 1."""

    robot: str
    instruction: str
    """The task in words, such as "open the fridge by its door hinge"."""
    success: bool
    names: tuple[str, ...]
    """Names of the columns of `state` and `action`: joints, base, gripper."""
    state: Float32[np.ndarray, "t n"]
    """Joint values [rad] or [m], pose of the base x [m], y [m], yaw [rad], and whether the hand is
    closed, 0 or 1 [-]."""
    action: Float32[np.ndarray, "t n"]
    """The state to reach at the next frame; that of the last frame is the state there."""
    part: Float32[np.ndarray, "t 8"]
    """What the task moves, see `PART`: the value of the joint [rad] or [m], 0 without one, and the
    object's pose in the world [m]."""
    cameras: tuple[Camera, ...]
    size: tuple[int, int]
    """Width and height of the images [px]."""
    samples: tuple[int, ...]
    """Sample of the timeline of each frame."""
    renderer: EpisodeRenderer

    def __len__(self) -> int:
        return len(self.state)

    def images(self) -> Iterator[Mapping[Camera, UInt8[np.ndarray, "h w 3"]]]:
        """Render the images of all frames in order, with a thread for each processor.

        A bounded number of frames is ahead of the one that is used, because images can be large.
        """
        if not self.cameras:
            return
        self.renderer.prepare(self.cameras)
        threads = max(1, min(MAX_THREADS, os.cpu_count() or 1))
        ahead: deque[Future[Mapping[Camera, UInt8[np.ndarray, "h w 3"]]]] = deque()
        with ThreadPoolExecutor(threads) as pool:
            for sample in self.samples:
                ahead.append(pool.submit(self.renderer.images, sample, self.cameras))
                if len(ahead) > 2 * threads:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()


def episode_of(
    record: RunRecord, scene: Scene, robot: Robot, cameras: Sequence[Camera], size: tuple[int, int]
) -> Episode:
    """Return a run as an episode.

    Args:
        record: The record, with its motion.
        scene: The true scene of the run.
        robot: The robot of its plan.
        cameras: Cameras to render.
        size: Width and height of the images [px].

    Raises:
        InputError: The record has no motion, or is shorter than two frames.
    """
    timeline = run_timeline(record, robot)
    times = timeline.samples.times
    wanted = np.arange(times[0], times[-1] + 1e-6, 1.0 / RATE)
    if len(wanted) < MIN_FRAMES:
        raise InputError(f"the run takes {np.ptp(times):.2f} s, less than {MIN_FRAMES} frames")
    nearest = np.clip(np.searchsorted(times, wanted - 0.5 / RATE), 0, len(times) - 1)
    state = _state(timeline)[nearest]
    return Episode(
        robot.name, instruction_of(timeline.task), record.success,
        (*timeline.joints, *BASE, GRIPPER), state, np.concatenate([state[1:], state[-1:]]),
        _part(timeline, scene)[nearest], tuple(cameras), size, tuple(nearest.tolist()),
        EpisodeRenderer.of(scene, robot, timeline, size),
    )  # fmt: skip


def instruction_of(task: Task) -> str:
    """Return a task in words."""
    name = task.object.replace("_", " ")
    if task.joint is None:
        return f"pick up the {name}" if task.verb == "pick" else f"put down the {name}"
    return f"{task.verb} the {name} by its {task.joint.replace('_', ' ')}"


def _state(timeline: Timeline) -> Float32[np.ndarray, "t n"]:
    samples = timeline.samples
    holding = np.isin(np.array(timeline.stages)[samples.phase], _HOLDING)
    columns = [samples.positions, samples.base, holding[:, None]]
    return np.concatenate(columns, axis=1, dtype=np.float32)


def _part(timeline: Timeline, scene: Scene) -> Float32[np.ndarray, "t 8"]:
    count = len(timeline.samples.times)
    Ts = timeline.Ts_world_object
    if Ts is None:
        Ts = np.tile(scene.object(timeline.task.object).T_world_object, (count, 1, 1))
    value = timeline.samples.object_q if timeline.task.joint is not None else np.zeros(count)
    wxyz = Rotation.from_matrix(Ts[:, :3, :3]).as_quat(scalar_first=True)
    return np.concatenate([value[:, None], Ts[:, :3, 3], wxyz], axis=1, dtype=np.float32)


def check_alike(first: Episode, other: Episode, where: str) -> None:
    """Refuse an episode that does not fit into the set of another one.

    Raises:
        InputError: It is of another robot, or has other joints.
    """
    if other.names != first.names:
        raise InputError(
            f"{where}: moves other joints ({other.robot}) than the runs before it ({first.robot}); "
            "a set holds the runs of one robot, so give a folder for each"
        )
