"""Motions over time, and their playback."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.apps.export import PhaseKind, Timeline, phases_of, plan_timeline
from momapos.model.records import Motion, PlacementPlan, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, part_values

from .robot_view import RobotView, joint_values
from .room_view import RoomView

if TYPE_CHECKING:
    from jaxtyping import Float

RATE = 25.0
"""Frame rate [1/s]."""
SPEEDS = ("0.5", "1", "2", "4", "8")
WORDS: dict[str, str] = {
    PhaseKind.DRIVE: "drive", PhaseKind.ARM: "move the arm", PhaseKind.CLOSE: "close the gripper",
    PhaseKind.OPEN: "open the gripper", PhaseKind.DRIVE_AND_ARM: "drive and move the arm",
}  # fmt: skip


@dataclass(frozen=True)
class ActiveRoom:
    """A room, and the object that moves in it, by its joint if it has one."""

    scene: Scene
    active: str
    joint: str | None


@dataclass(frozen=True, eq=False)
class Moment:
    """The state of the robot and the object at a time."""

    base: Float[np.ndarray, "3"]
    """x [m], y [m], yaw [rad]."""
    joints: dict[str, float]
    """Values of the arm's joints [rad] or [m]."""
    object_q: dict[str, float]
    """Value of the joint that the task moves, and of its latch [rad] or [m]; empty where it moves
    none."""
    phase: str
    """The phase of the motion."""
    force: Float[np.ndarray, "3"] | None = None
    """Force of the object on the hand [N]; None where unknown."""
    T_world_object: Float[np.ndarray, "4 4"] | None = None
    """Pose of the root link of a movable object; None where it stays."""
    room: ActiveRoom | None = None
    """None for the room that is shown."""

    def show(self, room: RoomView, robot: RobotView) -> None:
        """Draw this moment."""
        if self.room is not None:
            room.show(self.room.scene, self.room.active, self.room.joint)
        self.show_robot(robot)
        room.move(self.object_q)
        if self.T_world_object is not None:
            room.carry(self.T_world_object)

    def show_robot(self, robot: RobotView) -> None:
        """Draw the robot at this moment."""
        robot.move(self.base, self.joints)
        robot.show_force(self.force)


@dataclass(frozen=True)
class Story:
    """The motion of a plan, sampled for viewing and not for a controller."""

    robot: Robot
    timeline: Timeline

    @classmethod
    def of(cls, plan: PlacementPlan, robot: Robot, scene: Scene) -> Story:
        """Build the motion of a solved plan in its room.

        Raises:
            InputError: The plan is not solved, or no trajectory satisfies the robot's limits.
        """
        phases = phases_of(plan, robot, step=1.0 / RATE)
        return cls(robot, plan_timeline(plan, phases, scene, robot))

    @cached_property
    def _words(self) -> tuple[str, ...]:
        """What happens in each phase."""
        task, words = self.timeline.task, []
        holds = task.verb == "place"
        for stage in self.timeline.stages:
            holds = stage == PhaseKind.CLOSE or (holds and stage != PhaseKind.OPEN)
            moves = stage == PhaseKind.ARM and holds
            words.append(f"{task.verb} {task.object}" if moves else WORDS[stage])
        return tuple(words)

    @property
    def task(self) -> Task:
        """The task of the plan."""
        return self.timeline.task

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.timeline.samples.times[-1])

    def at(self, seconds: float) -> Moment:
        """Return the sampled moment at a time [s], clipped to the duration."""
        samples, poses = self.timeline.samples, self.timeline.Ts_world_object
        times = samples.times
        i = int(np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 1))
        return Moment(
            samples.base[i],
            joint_values(self.robot, samples.positions[i]),
            self.timeline.object_values(i),
            self._words[samples.phase[i]],
            T_world_object=None if poses is None else poses[i],
        )


def values_at_end(scene: Scene, task: Task, motion: Motion) -> dict[str, float]:
    """Return the values of the object's joints that a motion moves, at its end [rad] or [m]."""
    latch = None if motion.latch_q is None else float(motion.latch_q[-1])
    return part_values(scene.object(task.object), task.joint, float(motion.object_q[-1]), latch)


class Playable(Protocol):
    """A motion that can be played."""

    @property
    def duration(self) -> float:
        """[s]"""
        ...

    def at(self, seconds: float) -> Moment:
        """Return the moment at a time [s], clipped to the duration."""
        ...


class Player:
    """Plays a motion in a thread that runs only while it plays."""

    def __init__(self, show: Callable[[float, bool], None]) -> None:
        """Play nothing yet.

        Args:
            show: Called with the time [s], and whether the motion goes on.
        """
        self._show = show
        self._lock = threading.Lock()
        self._playing: threading.Event | None = None
        """Event that ends the thread; None while paused."""
        self.duration, self.speed, self.now = 0.0, 1.0, 0.0

    @property
    def playing(self) -> bool:
        """Whether the motion plays now."""
        return self._playing is not None

    def load(self, duration: float) -> None:
        """Stop, and go to the beginning of another motion with a duration [s]; 0 for none."""
        self.pause()
        self.duration, self.now = duration, 0.0

    def play(self) -> None:
        """Play from the current time, or from the beginning if it is at the end."""
        with self._lock:
            if self._playing is not None or self.duration <= 0:
                return
            if self.now >= self.duration - 1e-6:
                self.now = 0.0
            ended = self._playing = threading.Event()
        threading.Thread(target=self._run, args=(ended,), name="page play", daemon=True).start()

    def pause(self) -> None:
        """Pause the motion."""
        with self._lock:
            if self._playing is not None:
                self._playing.set()
                self._playing = None

    def seek(self, seconds: float) -> None:
        """Go to a time [s], and show it."""
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
