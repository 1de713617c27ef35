"""Files: plans and scenes into the working folder, pictures and films to the browser."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.errors import InputError
from momapos.placement_result import PlacementResult
from momapos.plans import write_plan
from momapos.scene.copies import copied
from momapos.scene.files import save_scene
from momapos.scene.scene import Scene
from momapos.trajectory import with_times

if TYPE_CHECKING:
    from jaxtyping import UInt8

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}\.json")
PICTURE, FILM = (1280, 720), (640, 360)
"""Width and height [px]."""
BEHIND = 255.0
"""White behind all that is drawn."""
FRAMES, FILM_RATE = 72, 12
"""Pictures in a film at most, and how many are shown a second."""


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


def render(client: Any, size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """What a browser sees, as a picture of a size [px]."""
    width, height = size
    picture: np.ndarray = client.get_render(height=height, width=width, transport_format="png")
    # Where nothing is drawn a browser leaves it open what is behind, and says black.
    opacity = picture[..., 3:] / 255.0
    return (picture[..., :3] * opacity + BEHIND * (1.0 - opacity)).astype(np.uint8)


def send_picture(client: Any) -> None:
    """Give a browser what it sees as a PNG."""
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(render(client, PICTURE)).save(content, "PNG")
    client.send_file_download("momapos.png", content.getvalue())


def send_film(client: Any, duration: float, show: Callable[[float], None]) -> None:
    """Give a browser what it sees of a motion as a GIF.

    Args:
        client: The browser.
        duration: How long the motion takes [s].
        show: Shows a moment [s].

    Raises:
        InputError: There is no motion.
    """
    if duration <= 0:
        raise InputError("there is no motion to film; press Place first")
    from PIL import Image

    count = int(np.clip(duration * FILM_RATE, 2, FRAMES))
    pictures = []
    for seconds in np.linspace(0.0, duration, count).tolist():
        show(seconds)
        pictures.append(Image.fromarray(render(client, FILM)).quantize(128))
    content = io.BytesIO()
    pictures[0].save(
        content, "GIF", save_all=True, append_images=pictures[1:], loop=0,
        duration=round(1000 / FILM_RATE),
    )  # fmt: skip
    client.send_file_download("momapos.gif", content.getvalue())
