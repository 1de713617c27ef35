"""The motion on the page: playing it, seeking, and moving the object's joints with sliders."""

from __future__ import annotations

import time

import numpy as np

from .compare import Compare
from .panel import NO_MOTION
from .playback import DetailControl, Playable, Player
from .state import PageState

TEXT_INTERVAL = 0.2
"""Time between updates of the text while the motion plays [s]."""


class MotionView:
    """Plays the motion that is shown, and those of the compared answers in step with it."""

    def __init__(self, state: PageState, compare: Compare, detail: DetailControl) -> None:
        self._state, self._compare, self._detail = state, compare, detail
        self._text_time = 0.0
        self.player = Player(self._show)
        panel = state.panel
        panel.on_click(panel.play, self.toggle)
        panel.on_change(panel.time, lambda: self.player.seek(float(panel.time.value)))
        panel.on_change(panel.speed, lambda: self.set_speed(float(panel.speed.value)))

    def load(self, story: Playable | None, *, at_end: bool = True) -> None:
        """Show another motion.

        Args:
            story: The motion; None where there is none.
            at_end: Whether to seek to its end, which is the state that an answer shows.
        """
        state, duration = self._state, 0.0 if story is None else story.duration
        state.shown.story = story
        self.player.load(duration)
        state.panel.show_duration(duration)
        state.robot.show_force(None)
        if story is None:
            state.panel.moment.content = NO_MOTION
        else:
            self.player.seek(duration if at_end else 0.0)

    def toggle(self) -> None:
        """Play the motion, or pause it."""
        state = self._state
        if self.player.playing:
            self.pause()
            self._show(self.player.now, False)
        elif state.shown.story is not None:
            with state.drawing:
                state.room.mark(())
                state.robot.verdict("feasible")
            state.panel.guide.done("play")
            self.player.play()

    def pause(self) -> None:
        """Pause the motion."""
        self.player.pause()
        self._state.panel.show_playing(False)

    def seek(self, seconds: float) -> None:
        """Show the motion at a time [s]."""
        self.player.seek(seconds)

    def step(self, seconds: float) -> None:
        """Seek forward, or backward by a negative time [s]."""
        self.player.seek(self.player.now + seconds)

    def set_speed(self, speed: float) -> None:
        """Set the playback speed, where 1 is real time [-]."""
        self.player.speed = speed

    def move_joints(self) -> None:
        """Move the object's joints to the values of their sliders."""
        self.pause()
        state = self._state
        state.shown.joints = state.panel.joint_values
        with state.drawing:
            state.show_room()
            state.room.move(state.shown.joints)

    def _show(self, seconds: float, playing: bool) -> None:
        state = self._state
        with state.drawing, state.server.atomic():
            story = state.shown.story
            if story is None:
                return
            moment = story.at(seconds)
            moment.show(state.room, state.robot)
            self._compare.show(seconds)
        if playing:
            self._detail.scene_moved()
        now = time.perf_counter()
        panel = state.panel
        panel.show_playing(self.player.playing)
        if playing and now - self._text_time <= TEXT_INTERVAL:
            return
        self._text_time = now
        text = moment.phase
        if moment.force is not None and moment.force.any():
            text += f", hand force {np.linalg.norm(moment.force):.0f} N"
        if state.room.active == state.shown.target:
            panel.show_joint_values(moment.object_q)
        panel.show_moment(seconds, text)
