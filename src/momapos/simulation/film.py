"""A run in pictures: a strip of a few, or a film of many."""

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
from .film_canvas import Overlay, Shot, canvas, captioned, frame_shot
from .film_files import GIF, MP4, STRIP, check_film, encoded
from .run_motion import DRIVE
from .run_trace import Act, RunTrace, State
from .simulated_robot import TOOL_POINT

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped, UInt8

WIDTH, HEIGHT, COLUMNS = 640, 480, 4
"""A picture of a filmstrip [px], and how many stand in a row."""
FILM_WIDTH, FILM_HEIGHT = 1280, 670
"""A picture of a film without its caption, with which it is 720 high [px]."""
FASTER = 3.0
"""How many times faster than in truth a film plays [-]."""
RATES, MOST_PICTURES = {GIF: 10.0, MP4: 20.0}, {GIF: 160, MP4: 900}
"""Pictures a second, and how many at most: a GIF of more is too large for a page."""
LAST = 1.5
"""The last picture of a film stays for so long [s]."""
SWEEP = 18.0
"""In a film the camera goes round from this far on one side to the other [deg]."""
_BEFORE = (Stage.SETTLE, Stage.APPROACH)
"""Stages before the robot takes hold."""


def write_film(trace: RunTrace, path: Path, *, frames: int = 8, ending: str = "") -> None:
    """Draw a filmstrip (PNG) or a film (GIF or MP4, 720p), as the name ends.

    A filmstrip shows the last motion and the way there, a film all of them.

    Args:
        trace: What was seen of the run.
        path: The file.
        frames: Number of pictures of a filmstrip; a quarter of them of the drives, if there
            are any.
        ending: How the run ended, for the last picture.

    Raises:
        InputError: Nothing was executed, this machine cannot draw off-screen, the name ends
            otherwise, or the file cannot be written.
        MissingExtraError: Pillow is not installed, or for an MP4 PyAV.
    """
    check_film(path)
    if not trace.played:
        raise InputError(f"{path}: nothing was executed; there is nothing to draw")
    with require("physics"):
        from PIL import Image
    kind = path.suffix.lower()
    if kind == STRIP:
        content = io.BytesIO()
        Image.fromarray(_strip(trace, frames, ending)).save(content, "PNG")
        film = content.getvalue()
    else:
        rate = RATES[kind]
        film = encoded(_film(trace, rate, MOST_PICTURES[kind], ending), kind, rate)
    try:
        write_atomic(path, film)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


@dataclass(frozen=True)
class _Picture:
    """A moment of a run that is drawn."""

    state: State
    """Its time counts from the beginning of the run."""
    way: Float[np.ndarray, "k 3"]
    """Poses of the base on its drives, as far as they are driven."""

    @property
    def words(self) -> str:
        """What is said under it."""
        time, stage, _, force = self.state
        held = float(np.linalg.norm(force))
        return f"{time:.1f} s   {stage}" + (f"   {held:.0f} N at the hand" if held else "")


def _strip(trace: RunTrace, frames: int, ending: str) -> Shaped[np.ndarray, "H W 3"]:
    """Some pictures of the drives and of what was done then, in rows."""
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
                drawn = draw(data, shot.camera, shot.through, _set(act, data, one))
                pictures.append(captioned(drawn, words))
    return _sheet(pictures)


def _film(
    trace: RunTrace, rate: float, most: int, ending: str
) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """The pictures of a film, whose camera goes slowly round."""
    whole = sum(act.duration for act in trace.acts)
    step, began, picture, words = max(FASTER / rate, whole / most), 0.0, None, ""
    for act in trace.acts:
        if act.world is not None:
            driven = _driven(act, began, np.arange(0.0, act.drove, step))
            times = np.array([state.time for state in act.states])
            picked = np.unique(np.searchsorted(times, np.arange(times[0], times[-1], step)))
            done = _done(act, began, [act.states[i] for i in [*picked.tolist(), len(times) - 1]])
            with canvas(act.world.model, FILM_WIDTH, FILM_HEIGHT) as draw:
                data = mujoco.MjData(act.world.model)
                for part in filter(None, (driven, done)):
                    states = [one.state.q for one in part]
                    shot: Shot = frame_shot(act.world, data, states, sweep=SWEEP)
                    for k, one in enumerate(part):
                        camera = shot.turned(SWEEP * (2 * k / max(1, len(part) - 1) - 1))
                        picture = draw(data, camera, shot.through, _set(act, data, one))
                        words = one.words
                        yield captioned(picture, f"{words}   ({FASTER:g} x)")
        began += act.duration
    assert picture is not None
    last = captioned(picture, _ended(words, ending))
    for _ in range(round(LAST * rate)):
        yield last


def _ended(words: str, ending: str) -> str:
    """The words of the last picture: how it ended where that is known."""
    return f"{words.partition('   ')[0]}   {ending}" if ending else words


def _set(act: Act, data: Any, one: _Picture) -> Overlay:
    """Put a world into the state of a picture; what is drawn over it."""
    assert act.world is not None
    data.qpos[:] = one.state.q
    mujoco.mj_forward(act.world.model, data)
    return Overlay(one.way[:, :2], data.geom(TOOL_POINT).xpos.copy(), -one.state.force)


def _driven(act: Act, began: float, when: Float[np.ndarray, " n"]) -> list[_Picture]:
    """Pictures of the drives of an act at some times [s]."""
    times, poses = act.way
    return [
        _Picture(
            State(began + float(times[i]), DRIVE, act.standing_at(poses[i]), np.zeros(3)),
            poses[: i + 1],
        )
        for i in np.searchsorted(times, when).tolist()
    ]


def _done(act: Act, began: float, states: Sequence[State]) -> list[_Picture]:
    """Pictures of what physics did in an act."""
    before = began + act.drove
    return [_Picture(one._replace(time=before + one.time), act.way[1]) for one in states]


def _along(act: Act, frames: int) -> Float[np.ndarray, " n"]:
    """Times evenly spread over the way of all drives; its end is in what follows [s]."""
    times, poses = act.way
    if not len(poses) or not frames:
        return np.zeros(0)
    way = np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T))
    return np.asarray(times[np.searchsorted(way, np.linspace(0.0, way[-1], frames + 1)[:-1])])


def _chosen(states: Sequence[State], frames: int) -> list[State]:
    """A quarter of the pictures from the way to the object, the others from then on."""
    before = [s for s in states if s.stage in _BEFORE]
    after = [s for s in states if s.stage not in _BEFORE]
    early = min(len(before), max(1, frames // 4) if after else frames)
    picked = [before[i] for i in np.linspace(0, len(before) - 1, early + 1).astype(int)[:early]]
    late = min(len(after), frames - len(picked))
    return picked + [after[i] for i in np.linspace(0, len(after) - 1, late).astype(int)]


def _sheet(pictures: list[UInt8[np.ndarray, "h w 3"]]) -> Shaped[np.ndarray, "H W 3"]:
    """Pictures in rows, with a thin white border."""
    border = [np.pad(p, ((2, 2), (2, 2), (0, 0)), constant_values=255) for p in pictures]
    blank = np.full_like(border[0], 255)
    columns = min(COLUMNS, len(border))
    border += [blank] * (-len(border) % columns)
    rows = [np.concatenate(border[i : i + columns], 1) for i in range(0, len(border), columns)]
    return np.concatenate(rows)
