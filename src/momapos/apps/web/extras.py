"""What goes beside the question: files, pictures, films."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from momapos.core import Clock

from .saving import save_plan, save_room, send_film, send_picture
from .words import escaped
from .work import Latest, Stopped

if TYPE_CHECKING:
    from .page import Page


class Extras:
    """Does what the lower controls ask for; its work has a thread of its own."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.work = Latest("page files", self._fail)

    def _fail(self, reason: str) -> None:
        self._page.panel.files.content = f"**Not done.** {escaped(reason)}"

    def _do(self, work: Callable[[Clock], str]) -> None:
        def tell(clock: Clock) -> None:
            self._page.panel.files.content = work(clock)

        self.work.put(tell)

    def save_plan(self, name: str) -> None:
        """Write the plan into the working folder."""
        page = self._page
        self._do(lambda _: _saved(save_plan(page.folder, name, page.shown.answer).name))

    def save_scene(self, name: str) -> None:
        """Write the scene into the working folder."""
        page, shown = self._page, self._page.shown
        target = "" if shown.question is None else shown.question.target.partition("/")[0]
        joints = dict(shown.joints)
        self._do(lambda _: _saved(save_room(page.folder, name, shown.scene, target, joints).name))

    def picture(self, client: Any) -> None:
        """Give a browser a picture of what it sees."""

        def work(_: Clock) -> str:
            send_picture(client)
            return "The picture is in the browser's downloads."

        if client is not None:
            self._do(work)

    def film(self, client: Any, ending: str) -> None:
        """Give a browser a film of the motion from where it looks."""
        page = self._page

        def work(clock: Clock) -> str:
            page.panel.files.content = "Filming. *Stop* (key X) ends it."
            page.panel.show_busy(True)
            player = page.motion.player
            try:
                faster = send_film(client, ending, player.duration, player.seek, clock)
            except Stopped:
                page.panel.files.content = "The film was stopped."
                raise
            finally:
                page.panel.show_busy(page.work.busy)
            return f"The film is in the browser's downloads; it plays {faster:.1f} times as fast."

        page.motion.pause()
        if client is not None:
            self._do(work)

    def close(self) -> None:
        """End all work."""
        self.work.close()


def _saved(name: str) -> str:
    return f"Saved as {escaped(name)}."
