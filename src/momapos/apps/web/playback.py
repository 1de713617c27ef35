"""A plan over time: what is where at each moment, and playing it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.apps.export import PhaseKind, Timeline, phases_of, planned
from momapos.model.records import PlacementPlan, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .robot_view import RobotView, joint_values
from .room_view import RoomView

if TYPE_CHECKING:
    from jaxtyping import Float

RATE = 25.0
"""Pictures a second while it plays [1/s]."""
SPEEDS = ("0.5", "1", "2", "4", "8")
WORDS: dict[str, str] = {
    PhaseKind.DRIVE: "drive", PhaseKind.ARM: "move the arm", PhaseKind.CLOSE: "close the gripper",
    PhaseKind.OPEN: "open the gripper",
}  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """The room in which something happens."""

    scene: Scene
    active: str
    """The object that is moved."""


@dataclass(frozen=True)
class Moment:
    """Where everything is."""

    base: Float[np.ndarray, "3"]
    """x [m], y [m], yaw [rad]."""
    joints: dict[str, float]
    """Values of the arm's joints [rad] or [m]."""
    object_q: dict[str, float]
    """Value of the joint that the task moves [rad] or [m]; empty where it moves none."""
    words: str
    """What is being done."""
    force: Float[np.ndarray, "3"] | None = None
    """Of what is held on the hand [N]; None where nobody knows."""
    T_world_object: Float[np.ndarray, "4 4"] | None = None
    """Pose of the root link of a loose object; None where it stays."""
    setting: Setting | None = None
    """Where it is; None in the room that is shown."""

    def show(self, room: RoomView, robot: RobotView) -> None:
        """Put everything where it is."""
        if self.setting is not None:
            room.show(self.setting.scene, self.setting.active)
        robot.move(self.base, self.joints)
        robot.show_force(self.force)
        room.move(self.object_q)
        if self.T_world_object is not None:
            room.carry(self.T_world_object)


@dataclass(frozen=True)
class Story:
    """A plan as moments; for people, who need neither a controller's rate nor its speeds."""

    robot: Robot
    timeline: Timeline

    @classmethod
    def of(cls, plan: PlacementPlan, robot: Robot, scene: Scene) -> Story:
        """The story of a solved plan in its room.

        Raises:
            InputError: The plan is not solved, or no trajectory keeps the robot's limits.
        """
        return cls(robot, planned(plan, phases_of(plan, robot, step=1.0 / RATE), scene, robot))

    @property
    def task(self) -> Task:
        """What is done."""
        return self.timeline.task

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.timeline.samples.times[-1])

    def at(self, seconds: float) -> Moment:
        """The moment nearest to a time [s]; the first and the last hold before and after."""
        samples, poses = self.timeline.samples, self.timeline.Ts_world_object
        times, joint = samples.times, self.task.joint
        i = int(np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 1))
        return Moment(
            samples.base[i],
            joint_values(self.robot, samples.positions[i]),
            {} if joint is None else {joint: float(samples.object_q[i])},
            WORDS[self.timeline.stages[samples.phase[i]]],
            T_world_object=None if poses is None else poses[i],
        )


class Playable(Protocol):
    """What can be played."""

    @property
    def duration(self) -> float:
        """[s]"""
        ...

    def at(self, seconds: float) -> Moment:
        """What was where at a time [s]; the first and the last hold before and after."""
        ...


class Player:
    """Plays a story: its thread runs only while it plays."""

    def __init__(self, show: Callable[[float, bool], None]) -> None:
        """Play nothing yet.

        Args:
            show: Is told the time in the story [s], and whether it goes on.
        """
        self._show = show
        self._lock = threading.Lock()
        self._playing: threading.Event | None = None
        """Set to end the thread that plays."""
        self.duration, self.speed, self.now = 0.0, 1.0, 0.0

    @property
    def playing(self) -> bool:
        """Whether it plays now."""
        return self._playing is not None

    def load(self, duration: float) -> None:
        """Take another story, and stand at its beginning.

        Args:
            duration: How long it takes [s]; 0 where there is none.
        """
        self.pause()
        self.duration, self.now = duration, 0.0

    def play(self) -> None:
        """Play from where it stands, or from the beginning where it stands at the end."""
        with self._lock:
            if self._playing is not None or self.duration <= 0:
                return
            if self.now >= self.duration - 1e-6:
                self.now = 0.0
            ended = self._playing = threading.Event()
        threading.Thread(target=self._run, args=(ended,), name="page play", daemon=True).start()

    def pause(self) -> None:
        """Stand still."""
        with self._lock:
            if self._playing is not None:
                self._playing.set()
                self._playing = None

    def seek(self, seconds: float) -> None:
        """Go to a time in the story [s], and show it."""
        self.now = min(max(seconds, 0.0), self.duration)
        self._show(self.now, self.playing)

    def _run(self, ended: threading.Event) -> None:
        before = time.perf_counter()
        while not ended.wait(1.0 / RATE):
            after = time.perf_counter()
            self.now = min(self.now + self.speed * (after - before), self.duration)
            before = after
            if self.now >= self.duration:
                self.pause()
            self._show(self.now, self.playing)
