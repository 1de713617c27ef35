"""Saving files: plans and scenes in the working folder, images and films by the browser."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import Clock, InputError, escape_markdown
from momapos.model import with_times
from momapos.model.plan_files import write_plan
from momapos.model.scene import Scene, copied, save_scene
from momapos.planning import Tour
from momapos.simulation import GIF, MP4, encode_film

from .motion_view import MotionView
from .state import PageState
from .work import LatestWorker, Stopped

if TYPE_CHECKING:
    from jaxtyping import UInt8


NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}\.json")
IMAGE_SIZE = (1280, 720)
"""Width and height [px]."""
RENDER_TIMEOUT = 30.0
"""Time within which even a slow browser sends an image [s]."""
BACKGROUND = 255.0
"""White."""


@dataclass(frozen=True)
class FilmFormat:
    """Size and length of a film."""

    size: tuple[int, int]
    """Width and height [px]."""
    rate: float
    """Frame rate [1/s]."""
    max_frames: int
    """Maximum number of frames [-]."""


FILMS = {GIF: FilmFormat((640, 360), 12.0, 72), MP4: FilmFormat((1280, 720), 25.0, 250)}
"""Formats by file ending. The browser sends frame by frame, which takes most of the time."""


def file_in(folder: Path, name: str) -> Path:
    """Return the path of a new file with a name typed on the page.

    Raises:
        InputError: The name is not a plain one that ends in .json, or the file exists.
    """
    if not NAME.fullmatch(name):
        raise InputError(
            f"{name[:80]!r}: invalid file name; use letters, digits, '-', '_' and '.', no folder, "
            "and .json at the end"
        )
    path = folder / name
    if path.exists() or path.is_symlink():
        raise InputError(f"{name}: file exists; choose another name")
    return path


def save_plan(folder: Path, name: str, tour: Tour | None) -> Path:
    """Write the plan that is shown; of several tasks the tour with its plans and scenes.

    Raises:
        InputError: There is no answer, or a file cannot be written.
    """
    if tour is None:
        raise InputError("there is no answer yet; press Place first")
    path = file_in(folder, name)
    if len(tour.steps) == 1:
        write_plan(with_times(tour.steps[0].plan, tour.steps[0].prepared.robot), path)
        return path
    for number in range(1, 1 + len(tour.steps)):
        for other in (f"{path.stem}_{number}.json", f"{path.stem}_room_{number}.json"):
            file_in(folder, other)
    tour.save(path)
    return path


def save_room(
    folder: Path, name: str, scene: Scene | None, target: str, joints: dict[str, float]
) -> Path:
    """Write the scene as the page shows it, with its models in a folder next to it.

    Args:
        folder: The working folder.
        name: Name of the scene file.
        scene: The scene.
        target: The object whose joints a user has moved.
        joints: Values of these joints [rad] or [m].

    Raises:
        InputError: There is no scene, or the file cannot be written.
    """
    if scene is None:
        raise InputError("there is no scene yet")
    path = file_in(folder, name)
    moved = scene.with_joints({target: joints}) if joints else scene
    with copied(moved, path) as whole:
        save_scene(whole, path)
    return path


def render(
    client: Any, size: tuple[int, int], *, timeout: float = RENDER_TIMEOUT
) -> UInt8[np.ndarray, "h w 3"]:
    """Return an image of a browser's view.

    Args:
        client: The browser.
        size: Width and height [px].
        timeout: Maximum time to wait [s].

    Raises:
        InputError: The browser sends no image, as it is disconnected or hidden.
    """
    width, height = size
    try:
        with warnings.catch_warnings():  # viser warns of a browser that has disconnected
            warnings.simplefilter("ignore")
            image: np.ndarray = client.get_render(
                height=height, width=width, transport_format="png", timeout=timeout
            )
    except (RuntimeError, TimeoutError, OSError, ValueError, SyntaxError) as error:
        raise InputError(
            "the browser sent no image; keep the page open and in front until it is done"
        ) from error
    if image.shape != (height, width, 4):
        raise InputError(f"the browser sent an image of another size than {width} x {height}")
    # A browser sends transparent black where nothing is drawn.
    opacity = image[..., 3:] / 255.0
    return (image[..., :3] * opacity + BACKGROUND * (1.0 - opacity)).astype(np.uint8)


def send_image(client: Any) -> None:
    """Send a browser a PNG of its view."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(render(client, IMAGE_SIZE)).save(content, "PNG")
    client.send_file_download("momapos.png", content.getvalue(), save_immediately=True)


def send_film(
    client: Any, ending: str, duration: float, show: Callable[[float], None], clock: Clock
) -> float:
    """Send a browser a film of the motion in its view.

    Args:
        client: The browser.
        ending: `GIF` or `MP4`.
        duration: Duration of the motion [s].
        show: Shows the motion at a time [s].
        clock: Called before each frame; may raise to cancel.

    Returns:
        Playback speed of the film, where 1 is real time [-].

    Raises:
        InputError: There is no motion, or the browser has disconnected.
        MissingExtraError: The encoder of the film is not installed.
    """
    if duration <= 0:
        raise InputError("there is no motion to film; press Place first")
    film = FILMS[ending]
    count = int(np.clip(duration * film.rate, 2, film.max_frames))

    def frames() -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        for seconds in np.linspace(0.0, duration, count).tolist():
            clock()
            show(seconds)
            yield render(client, film.size)

    content = encode_film(frames(), ending, film.rate)
    client.send_file_download(f"momapos{ending}", content, save_immediately=True)
    return duration * film.rate / count


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
        self._put(lambda _: _saved(save_plan(self.folder, name, shown.tour).name))

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
