"""The motion on the page: played, paused, at any time; the joints of the object by hand."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from .playback import Playable, Player

if TYPE_CHECKING:
    from .page import Page

NO_MOTION = "There is no motion yet."
TELLS = 0.2
"""While it plays the words change so often [s]."""


class MotionView:
    """Shows a story."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._told = 0.0
        self.player = Player(self._show)
        self.story: Playable | None = None

    def load(self, story: Playable | None, *, at_end: bool = True) -> None:
        """Take another story; None: there is none.

        Args:
            story: What is to be shown.
            at_end: Whether it stands at its end, as the answer does that is drawn.
        """
        self.story = story
        duration = 0.0 if story is None else story.duration
        self.player.load(duration)
        self._page.panel.show_story(duration)
        self._page.robot.show_force(None)
        if story is None:
            self._page.panel.moment.content = NO_MOTION
        else:
            self.player.seek(duration if at_end else 0.0)

    def toggle(self) -> None:
        """Play the motion, or pause it."""
        if self.player.playing:
            self.pause()
            self._show(self.player.now, False)
        elif self.story is not None:
            with self._page.drawing:
                self._page.room.mark(())
                self._page.robot.verdict("feasible")
            self.player.play()

    def pause(self) -> None:
        """Stand still."""
        self.player.pause()
        self._page.panel.show_playing(False)

    def seek(self, seconds: float) -> None:
        """Show the motion at a time [s]."""
        self.player.seek(seconds)

    def step(self, seconds: float) -> None:
        """Go on by so long, or back [s]."""
        self.player.seek(self.player.now + seconds)

    def set_speed(self, speed: float) -> None:
        """How many times faster than in truth it plays [-]."""
        self.player.speed = speed

    def move_joints(self) -> None:
        """Move the joints of the object to where a person has put their sliders."""
        self.pause()
        self._page.shown.joints = self._page.panel.joint_values
        with self._page.drawing:
            self._page.answer.show_room()
            self._page.room.move(self._page.shown.joints)

    def _show(self, seconds: float, playing: bool) -> None:
        page = self._page
        with page.drawing, page.server.atomic():
            story = self.story
            if story is None:
                return
            moment = story.at(seconds)
            moment.show(page.room, page.robot)
            page.compare.show(seconds)
        if playing:
            page.moving.stirred()
        now = time.perf_counter()
        panel = page.panel
        panel.show_playing(self.player.playing)
        if playing and now - self._told <= TELLS:
            return
        self._told = now
        words = moment.words
        if moment.force is not None and moment.force.any():
            words += f", {np.linalg.norm(moment.force):.0f} N at the hand"
        if page.room.active == page.answer.asked_object:
            panel.show_joint_values(moment.object_q)
        panel.show_moment(seconds, words)
