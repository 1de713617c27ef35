"""Files: plans and scenes are saved in the working folder, images and films by the browser."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import Clock, InputError
from momapos.model import with_times
from momapos.model.plan_files import write_plan
from momapos.model.scene import Scene, copied, save_scene
from momapos.planning import PlacementResult
from momapos.simulation import GIF, MP4, encode_film

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


def save_plan(folder: Path, name: str, answer: PlacementResult | None) -> Path:
    """Write the plan that is shown.

    Raises:
        InputError: There is no answer, or the file cannot be written.
    """
    if answer is None:
        raise InputError("there is no answer yet; press Place first")
    path = file_in(folder, name)
    write_plan(with_times(answer.plan, answer.prepared.robot), path)
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
