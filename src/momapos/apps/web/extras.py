"""Saving files, images and films."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from momapos.core import Clock, escape_markdown

from .motion_view import MotionView
from .saving import save_plan, save_room, send_film, send_image
from .state import PageState
from .work import LatestWorker, Stopped


class FileActions:
    """Runs the actions of the Files tab in a thread of its own."""

    def __init__(
        self, state: PageState, motion: MotionView, folder: Path, busy: Callable[[], bool]
    ) -> None:
        """Connect the controls.

        Args:
            state: The state of the page.
            motion: The motion that is filmed.
            folder: Where plans and scenes are saved.
            busy: Whether a question is being answered.
        """
        self._state, self._motion, self.folder, self._busy = state, motion, folder, busy
        self.work = LatestWorker("page files", self._fail)
        panel = state.panel
        panel.on_click(panel.save_plan, lambda: self.save_plan(panel.plan_name.value))
        panel.on_click(panel.save_scene, lambda: self.save_scene(panel.scene_name.value))
        panel.image.on_click(lambda event: self.send_image(event.client))
        for ending, button in panel.films.items():
            button.on_click(lambda event, ending=ending: self.send_film(event.client, ending))

    def _show_text(self, text: str) -> None:
        self._state.panel.files.content = text

    def _fail(self, reason: str) -> None:
        self._show_text(f"**Error:** {escape_markdown(reason)}")

    def _put(self, work: Callable[[Clock], str]) -> None:
        self.work.put(lambda clock: self._show_text(work(clock)))

    def save_plan(self, name: str) -> None:
        """Write the plan into the working folder."""
        shown = self._state.shown
        self._put(lambda _: _saved(save_plan(self.folder, name, shown.answer).name))

    def save_scene(self, name: str) -> None:
        """Write the scene into the working folder, and offer it among the scenes."""
        shown, panel = self._state.shown, self._state.panel
        target, joints = shown.target, dict(shown.joints)

        def work(_: Clock) -> str:
            path = save_room(self.folder, name, shown.scene, target, joints)
            source = path.name if self.folder.samefile(Path.cwd()) else str(path)
            panel.offer(panel.scene, (*panel.scene.options, source), panel.scene.value)
            return _saved(path.name)

        self._put(work)

    def send_image(self, client: Any) -> None:
        """Send a browser an image of its view."""

        def work(_: Clock) -> str:
            send_image(client)
            return "The image is in the browser's downloads."

        if client is not None:
            self._put(work)

    def send_film(self, client: Any, ending: str) -> None:
        """Send a browser a film of the motion, from its view."""
        panel = self._state.panel

        def work(clock: Clock) -> str:
            self._show_text("Recording. *Stop* (key X) cancels.")
            panel.show_busy(True)
            player = self._motion.player
            try:
                speed = send_film(client, ending, player.duration, player.seek, clock)
            except Stopped:
                self._show_text("Recording canceled.")
                raise
            finally:
                panel.show_busy(self._busy())
            return f"The film is in the browser's downloads. It plays at {speed:.1f}x speed."

        self._motion.pause()
        if client is not None:
            self._put(work)


def _saved(name: str) -> str:
    return f"Saved as {escape_markdown(name)}."
