"""Motions over time, their playback, and coarse drawing while the view moves.

While its camera moves, a browser sends its pose with each frame, so that the interval between these
messages is the frame time. A fast browser draws all points of a scan at all times. A slow one draws
few of them until its camera rests, and until a drag or a motion ends. The browser has both sets
already: a few bytes tell it which ones to show.
"""

from __future__ import annotations

import asyncio
import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from viser import _messages as messages

from momapos.apps.export import PhaseKind, Timeline, phases_of, plan_timeline
from momapos.core import InputError
from momapos.model.records import Motion, PlacementPlan, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene, part_values

from .robot_view import RobotView, joint_values
from .room_view import RoomView

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import CameraHandle, ClientHandle, ViserServer


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


@dataclass(frozen=True)
class TourStory:
    """The motions of several plans, each in its own room."""

    stories: tuple[Story, ...]
    scenes: tuple[Scene, ...]
    """The room before each task."""

    @classmethod
    def of(cls, plans: Sequence[PlacementPlan], scenes: Sequence[Scene], robot: Robot) -> TourStory:
        """Build the motion of solved plans.

        Args:
            plans: The plans, in order.
            scenes: The room of each plan.
            robot: The robot of all plans.

        Raises:
            InputError: A plan is for another robot, or there is no motion to show.
        """
        for number, plan in enumerate(plans, start=1):
            if (plan.robot_urdf, plan.joints) != (plans[0].robot_urdf, plans[0].joints):
                raise InputError(f"plan {number} of the tour is for another robot than the first")
        stories = [Story.of(p, robot, scene) for p, scene in zip(plans, scenes, strict=True)]
        return cls(tuple(stories), tuple(scenes))

    @cached_property
    def _ends(self) -> Float[np.ndarray, " k"]:
        """End of each task [s]."""
        return np.cumsum([story.duration for story in self.stories])

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self._ends[-1])

    def at(self, seconds: float) -> Moment:
        """Return the moment at a time [s], clipped to the duration."""
        last = len(self.stories) - 1
        k = min(int(np.searchsorted(self._ends, seconds, side="right")), last)
        story, began = self.stories[k], float(self._ends[k]) - self.stories[k].duration
        moment, task = story.at(seconds - began), story.task
        phase = (
            f"task {k + 1} of {last + 1}, {task.verb} {task.object or task.target}: {moment.phase}"
        )
        room = ActiveRoom(self.scenes[k], task.object, task.joint)
        return replace(moment, phase=phase, room=room)


def story_of(plans: Sequence[PlacementPlan], scenes: Sequence[Scene], robot: Robot) -> Playable:
    """Return the motion of one or several solved plans, each in its room.

    Raises:
        InputError: There is no motion to show.
    """
    if len(plans) == 1:
        return Story.of(plans[0], robot, scenes[0])
    return TourStory.of(plans, scenes, robot)


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


SLOW_FRAME_TIME = 0.12
"""A browser whose frames take longer is slow [s]."""
FRAME_GAPS = 2
"""Intervals of which the shortest counts as the frame time: longer ones may be pauses of the hand
[-]."""
SAME_FRAME_TIME, NEW_MOVEMENT_TIME = 0.03, 5.0
"""Messages that are closer together belong to one frame; after a longer interval a new movement
begins [s]."""
SLOW_FRAMES = 100.0
"""A browser counts as slow for this many frame times; measuring again then costs about 1 % of the
time [-]."""
REST_TIME = 0.4
"""A camera rests when it has sent nothing for this time, or for two frames [s]."""


class FrameTimer:
    """Measures how fast a browser draws while its camera moves."""

    def __init__(self) -> None:
        self._seen: deque[float] = deque(maxlen=FRAME_GAPS + 1)
        self._until = 0.0
        self.gap = 0.0
        """Last known frame time [s]."""

    def camera_moved(self, now: float) -> bool:
        """Record a camera message at a time [s]; return whether the browser is slow."""
        since = now - self._seen[-1] if self._seen else NEW_MOVEMENT_TIME
        if since > NEW_MOVEMENT_TIME:
            self._seen.clear()
        if since >= SAME_FRAME_TIME:
            self._seen.append(now)
            if len(self._seen) > FRAME_GAPS:
                self.gap = min(b - a for a, b in itertools.pairwise(self._seen))
                if self.gap > SLOW_FRAME_TIME:
                    self._until = now + SLOW_FRAMES * self.gap
        return self.slow(now)

    def slow(self, now: float) -> bool:
        """Return whether the browser counts as slow at a time [s]."""
        return now < self._until


class BrowserDetail:
    """Switches one browser between fine and coarse; called by the server's own thread only."""

    def __init__(self, switch: Callable[[bool], None], wanted: Callable[[], bool]) -> None:
        """Begin with fine.

        Args:
            switch: Makes the browser show coarse (True) or fine (False).
            wanted: Returns whether there is anything to draw coarsely.
        """
        self._switch, self._wanted = switch, wanted
        self._timer = FrameTimer()
        self._rest: asyncio.TimerHandle | None = None
        self.coarse = False

    def camera_moved(self, loop: asyncio.AbstractEventLoop) -> None:
        """Handle a message of the camera in the running loop."""
        self._moved(loop, slow=self._timer.camera_moved(loop.time()))

    def scene_moved(self, loop: asyncio.AbstractEventLoop) -> None:
        """Handle a movement in the scene, after which a browser sends no message."""
        self._moved(loop, slow=self._timer.slow(loop.time()))

    def _moved(self, loop: asyncio.AbstractEventLoop, *, slow: bool) -> None:
        if slow and self._wanted():
            self._show(coarse=True)
        self.close()
        if self.coarse:
            rest = max(REST_TIME, 2 * self._timer.gap)
            self._rest = loop.call_later(rest, lambda: self._show(coarse=False))

    def close(self) -> None:
        """Cancel the timer."""
        if self._rest is not None:
            self._rest.cancel()
            self._rest = None

    def _show(self, *, coarse: bool) -> None:
        if coarse != self.coarse:
            self.coarse = coarse
            self._switch(coarse)


class DetailControl:
    """Watches the cameras of all browsers."""

    def __init__(
        self, server: ViserServer, *, fine: str, coarse: str, wanted: Callable[[], bool]
    ) -> None:
        """Start to watch.

        Args:
            server: The server of the page.
            fine: The node that is shown at rest; nothing else may set its visibility.
            coarse: The node that replaces it in slow browsers; hidden at first.
            wanted: Returns whether there is anything to draw coarsely.
        """
        self._fine, self._coarse, self._wanted = fine, coarse, wanted
        self._browsers: dict[int, BrowserDetail] = {}
        self._loop = server.get_event_loop()
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._disconnected)

    def scene_moved(self) -> None:
        """Report a movement that all browsers draw, such as a dragged base; for any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._scene_moved)

    def _scene_moved(self) -> None:
        for browser in self._browsers.values():
            browser.scene_moved(self._loop)

    async def _connected(self, client: ClientHandle) -> None:
        browser = BrowserDetail(lambda coarse: self._switch(client, coarse=coarse), self._wanted)
        self._browsers[client.client_id] = browser

        async def moved(_: CameraHandle) -> None:
            browser.camera_moved(asyncio.get_running_loop())

        client.camera.on_update(moved)

    async def _disconnected(self, client: ClientHandle) -> None:
        browser = self._browsers.pop(client.client_id, None)
        if browser is not None:
            browser.close()

    def _switch(self, client: ClientHandle, *, coarse: bool) -> None:
        """Set the visibility of shared nodes in one browser, for which viser has no function."""
        with client.atomic():
            for node, visible in ((self._fine, not coarse), (self._coarse, coarse)):
                client._websock_connection.queue_message(
                    messages.SetSceneNodeVisibilityMessage(node, visible)
                )
