"""Files: plans and scenes into the working folder, pictures and films to the browser."""

from __future__ import annotations

import io
import re
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
from momapos.simulation import GIF, MP4, encoded

if TYPE_CHECKING:
    from jaxtyping import UInt8

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}\.json")
PICTURE = (1280, 720)
"""Width and height [px]."""
PATIENCE = 30.0
"""A browser sends a picture within this time, however slowly it draws [s]."""
BEHIND = 255.0
"""White behind all that is drawn."""


@dataclass(frozen=True)
class FilmLook:
    """A kind of film."""

    size: tuple[int, int]
    """Width and height [px]."""
    rate: float
    """Pictures a second [1/s]."""
    most: int
    """Pictures at most [-]."""


FILMS = {GIF: FilmLook((640, 360), 12.0, 72), MP4: FilmLook((1280, 720), 25.0, 250)}
"""A browser sends each picture by itself, which takes most of the time."""


def file_in(folder: Path, name: str) -> Path:
    """A new file of a name that was typed on the page.

    Raises:
        InputError: It is no plain name that ends in .json, or there is such a file.
    """
    if not NAME.fullmatch(name):
        raise InputError(
            f"{name[:80]!r} cannot be the name of a file here; give letters, digits, '-', '_' and "
            "'.', with .json at the end, and no folder"
        )
    path = folder / name
    if path.exists() or path.is_symlink():
        raise InputError(f"{name}: exists already; give another name")
    return path


def save_plan(folder: Path, name: str, answer: PlacementResult | None) -> Path:
    """Write the plan that is shown.

    Raises:
        InputError: There is none, or it cannot be written.
    """
    if answer is None:
        raise InputError("there is no answer yet; press Place first")
    path = file_in(folder, name)
    write_plan(with_times(answer.plan, answer.prepared.robot), path)
    return path


def save_room(
    folder: Path, name: str, scene: Scene | None, target: str, joints: dict[str, float]
) -> Path:
    """Write the scene, and its models into a folder beside it, as it stands on the page.

    Args:
        folder: The working folder.
        name: Of the scene file.
        scene: The scene.
        target: The object whose joints were moved by hand.
        joints: Where they are [rad] or [m].

    Raises:
        InputError: There is none, or it cannot be written.
    """
    if scene is None:
        raise InputError("there is no scene")
    path = file_in(folder, name)
    moved = scene.with_joints({target: joints}) if joints else scene
    with copied(moved, path) as whole:
        save_scene(whole, path)
    return path


def render(
    client: Any, size: tuple[int, int], *, patience: float = PATIENCE
) -> UInt8[np.ndarray, "h w 3"]:
    """What a browser sees, as a picture of a size [px]; it is waited for so long at most [s].

    Raises:
        InputError: It sends none, as one that has gone or is hidden.
    """
    width, height = size
    try:
        picture: np.ndarray = client.get_render(
            height=height, width=width, transport_format="png", timeout=patience
        )
    except (RuntimeError, TimeoutError) as error:
        raise InputError(
            "the browser sent no picture; keep its page open and in front until it is done"
        ) from error
    # Where nothing is drawn a browser leaves it open what is behind, and says black.
    opacity = picture[..., 3:] / 255.0
    return (picture[..., :3] * opacity + BEHIND * (1.0 - opacity)).astype(np.uint8)


def send_picture(client: Any) -> None:
    """Give a browser what it sees as a PNG."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(render(client, PICTURE)).save(content, "PNG")
    client.send_file_download("momapos.png", content.getvalue(), save_immediately=True)


def send_film(
    client: Any, ending: str, duration: float, show: Callable[[float], None], clock: Clock
) -> float:
    """Give a browser what it sees of a motion as a film.

    Args:
        client: The browser.
        ending: `GIF` or `MP4`.
        duration: How long the motion takes [s].
        show: Shows a moment [s].
        clock: Looked at before each picture; what it raises ends the work.

    Returns:
        How many times faster than in truth it plays [-].

    Raises:
        InputError: There is no motion, or the browser has gone.
        MissingExtraError: What writes such a film is not installed.
    """
    if duration <= 0:
        raise InputError("there is no motion to film; press Place first")
    look = FILMS[ending]
    count = int(np.clip(duration * look.rate, 2, look.most))

    def pictures() -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        for seconds in np.linspace(0.0, duration, count).tolist():
            clock()
            show(seconds)
            yield render(client, look.size)

    film = encoded(pictures(), ending, look.rate)
    client.send_file_download(f"momapos{ending}", film, save_immediately=True)
    return duration * look.rate / count
