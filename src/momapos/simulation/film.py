"""Images of a run: a filmstrip, or a film."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.core import InputError, require, write_atomic

from .config import Stage
from .film_camera import follow, frame_shot
from .film_canvas import Overlay, add_caption, canvas
from .film_files import GIF, MP4, STRIP, check_film, encode_film
from .run_motion import DRIVE
from .run_trace import Act, RunTrace, State
from .simulated_robot import TOOL_POINT

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped, UInt8

WIDTH, HEIGHT, COLUMNS = 640, 480, 4
"""Size of a filmstrip image [px], and images per row [-]."""
FILM_WIDTH, FILM_HEIGHT = 1280, 670
"""Size of a film image without its caption; 720 px high with it [px]."""
PLAYBACK_SPEED = 3.0
"""Playback speed of a film, relative to real time [-]."""
FRAME_RATES, MAX_IMAGES = {GIF: 16.0, MP4: 30.0}, {GIF: 300, MP4: 1800}
"""Frame rate [1/s] and maximum number of images [-]; a longer GIF is too large for a page."""
LAST_IMAGE_TIME = 1.5
"""Time for which a film shows its last image [s]."""
CAMERA_TIME = 0.7
"""Standard deviation of the smoothing of a film's camera, in time of the film [s]."""
CAPTIONS: dict[str, str] = {
    DRIVE: "Drive", Stage.SETTLE: "Stand", Stage.APPROACH: "Move the hand to the grasp",
    Stage.GRIP: "Close the gripper", Stage.MANIPULATE: "Move the part", Stage.DWELL: "Hold it",
    Stage.RETREAT: "Move the hand away",
}  # fmt: skip
"""Captions of the stages of a run."""
MIN_FORCE = 1.0
"""Smallest force in a caption [N]."""
_BEFORE_GRASP = (Stage.SETTLE, Stage.APPROACH)
"""Stages before the grasp."""


def write_film(
    trace: RunTrace, path: Path, *, frames: int = 8, ending: str = "", title: str = ""
) -> None:
    """Draw a filmstrip (PNG) or a film (GIF or MP4, 720p), depending on the suffix of `path`.

    A filmstrip shows the last motion and the drives before it, a film all motions and drives.

    Args:
        trace: Trace of the run.
        path: Output file.
        frames: Number of images of a filmstrip; a quarter of them show the drives, if any.
        ending: How the run ended, for the caption of the last image.
        title: What the run does, for the captions of a film.

    Raises:
        InputError: Nothing was executed, off-screen rendering is unavailable, the suffix is
            unknown, or the file cannot be written.
        MissingExtraError: Pillow is not installed, or PyAV for an MP4.
    """
    check_film(path)
    if not trace.played:
        raise InputError(f"{path}: nothing to draw, because no motion was executed")
    with require("physics"):
        from PIL import Image
    kind = path.suffix.lower()
    if kind == STRIP:
        content = io.BytesIO()
        Image.fromarray(_strip(trace, frames, ending)).save(content, "PNG")
        film = content.getvalue()
    else:
        rate = FRAME_RATES[kind]
        film = encode_film(_film(trace, rate, MAX_IMAGES[kind], ending, title), kind, rate)
    try:
        write_atomic(path, film)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


@dataclass(frozen=True, eq=False)
class _FilmImage:
    """A moment of a run to draw."""

    state: State
    """Its time counts from the start of the run."""
    way: Float[np.ndarray, "k 3"]
    """Poses of the base on its drives so far."""

    @property
    def words(self) -> str:
        """Text of the caption."""
        time, stage, _, force = self.state
        held = float(np.linalg.norm(force))
        words = CAPTIONS.get(stage, stage)
        return f"{time:.1f} s   {words}" + (
            f"   {held:.0f} N at the hand" if held >= MIN_FORCE else ""
        )


def _strip(trace: RunTrace, frames: int, ending: str) -> Shaped[np.ndarray, "H W 3"]:
    """Draw the drives and the motion of the last act as rows of images."""
    act = trace.played[-1]
    began = sum(one.duration for one in trace.acts[: trace.acts.index(act)])
    driven = _driven(act, began, _along(act, frames // 4))
    done = _done(act, began, _chosen(act.states, frames - len(driven)))
    assert act.world is not None
    pictures = []
    with canvas(act.world.model, WIDTH, HEIGHT) as draw:
        data = mujoco.MjData(act.world.model)
        for strip, seen in ((driven, [*driven, done[0]]), (done, done)):
            shot = frame_shot(act.world, data, [one.state.q for one in seen])
            for one in strip:
                words = one.words if one is not done[-1] else _ended(one.words, ending)
                drawn = draw(data, shot.camera, shot.through, _set_state(act, data, one))
                pictures.append(add_caption(drawn, words))
    return _sheet(pictures)


def _film(
    trace: RunTrace, rate: float, most: int, ending: str, title: str
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Draw the images of a film, with a camera that follows."""
    whole = sum(act.duration for act in trace.acts)
    step, began, picture, words = max(PLAYBACK_SPEED / rate, whole / most), 0.0, None, ""
    pace = f"{step * rate:.0f} x"
    for act in trace.acts:
        if act.world is not None:
            times = np.array([state.time for state in act.states])
            picked = np.unique(np.searchsorted(times, np.arange(times[0], times[-1], step)))
            images = _driven(act, began, np.arange(0.0, act.drove, step))
            images += _done(act, began, [act.states[i] for i in [*picked.tolist(), len(times) - 1]])
            with canvas(act.world.model, FILM_WIDTH, FILM_HEIGHT) as draw:
                data = mujoco.MjData(act.world.model)
                states = [one.state.q for one in images]
                view = follow(act.world, data, states, smooth=CAMERA_TIME * rate)
                for k, one in enumerate(images):
                    picture = draw(data, view.at(k), view.through, _set_state(act, data, one))
                    words, done = one.words, one.state.time / whole
                    yield add_caption(picture, words, right=f"{title}   {pace}", done=done)
        began += act.duration
    assert picture is not None
    last = add_caption(picture, _ended(words, ending), right=title, done=1.0)
    for _ in range(round(LAST_IMAGE_TIME * rate)):
        yield last


def _ended(words: str, ending: str) -> str:
    """Return the last caption, with the ending if it is known."""
    return f"{words.partition('   ')[0]}   {ending[:1].upper()}{ending[1:]}" if ending else words


def _set_state(act: Act, data: Any, one: _FilmImage) -> Overlay:
    """Set a world to the state of an image and return its overlay."""
    assert act.world is not None
    data.qpos[:] = one.state.q
    mujoco.mj_forward(act.world.model, data)
    return Overlay(one.way[:, :2], data.geom(TOOL_POINT).xpos.copy(), -one.state.force)


def _driven(act: Act, began: float, when: Float[np.ndarray, " n"]) -> list[_FilmImage]:
    """Return images of an act's drives at some times [s]."""
    times, poses = act.way
    return [
        _FilmImage(
            State(began + float(times[i]), DRIVE, act.standing_at(poses[i]), np.zeros(3)),
            poses[: i + 1],
        )
        for i in np.searchsorted(times, when).tolist()
    ]


def _done(act: Act, began: float, states: Sequence[State]) -> list[_FilmImage]:
    before = began + act.drove
    return [_FilmImage(one._replace(time=before + one.time), act.way[1]) for one in states]


def _along(act: Act, frames: int) -> Float[np.ndarray, " n"]:
    """Return times evenly spaced along the path of all drives, without its end [s]."""
    times, poses = act.way
    if not len(poses) or not frames:
        return np.zeros(0)
    way = np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T))
    return np.asarray(times[np.searchsorted(way, np.linspace(0.0, way[-1], frames + 1)[:-1])])


def _chosen(states: Sequence[State], frames: int) -> list[State]:
    """Choose a quarter of the images from before the grasp, and the others after it."""
    before = [s for s in states if s.stage in _BEFORE_GRASP]
    after = [s for s in states if s.stage not in _BEFORE_GRASP]
    early = min(len(before), max(1, frames // 4) if after else frames)
    picked = [before[i] for i in np.linspace(0, len(before) - 1, early + 1).astype(int)[:early]]
    late = min(len(after), frames - len(picked))
    return picked + [after[i] for i in np.linspace(0, len(after) - 1, late).astype(int)]


def _sheet(pictures: list[UInt8[np.ndarray, "h w 3"]]) -> Shaped[np.ndarray, "H W 3"]:
    border = [np.pad(p, ((2, 2), (2, 2), (0, 0)), constant_values=255) for p in pictures]
    blank = np.full_like(border[0], 255)
    columns = min(COLUMNS, len(border))
    border += [blank] * (-len(border) % columns)
    rows = [np.concatenate(border[i : i + columns], 1) for i in range(0, len(border), columns)]
    return np.concatenate(rows)
