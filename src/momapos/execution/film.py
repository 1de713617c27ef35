"""A run in pictures: a strip of a few, or a film of many."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.cache import write_atomic
from momapos.errors import InputError, require
from momapos.execution.config import Stage
from momapos.execution.film_canvas import Shot, canvas, captioned, frame_shot
from momapos.execution.simulation import Simulation
from momapos.geometry.planar import local_points

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped, UInt8

WIDTH, HEIGHT, COLUMNS = 640, 480, 4
"""A picture of a filmstrip [px], and how many stand in a row."""
FILM_WIDTH, FILM_HEIGHT = 1280, 670
"""A picture of a film without its caption, with which it is 720 high [px]."""
FILM_RATE, FASTER, MOST_PICTURES = 10.0, 3.0, 160
"""Pictures a second, how many times faster than in truth they are shown, and how many at most."""
SWEEP = 18.0
"""In a film the camera goes round from this far on one side to the other [deg]."""
ENDINGS = (".png", ".gif")
State = tuple[float, str, np.ndarray]
"""Time [s], stage, coordinates."""
INTERVAL = 0.05
"""Time between remembered states [s]."""
_BEFORE = (Stage.SETTLE, Stage.APPROACH)
"""Stages before the robot takes hold."""


@dataclass
class Film:
    """Remembers a run; give it to `execute` as `watch`, and `drive` every drive before."""

    states: list[State] = field(default_factory=list)
    world: Simulation | None = None
    times: list[Float[np.ndarray, " t"]] = field(default_factory=list)
    """Of each drive, from its beginning [s]."""
    poses: list[Float[np.ndarray, "t 3"]] = field(default_factory=list)
    """Of the base in each drive."""

    def __call__(self, world: Simulation, time: float, stage: str) -> None:
        """Remember a state, if the last one is long enough ago."""
        self.world = world
        if not self.states or time - self.states[-1][0] >= INTERVAL - 1e-9:
            self.states.append((time, stage, world.data.qpos.copy()))

    def drive(self, times: Float[np.ndarray, " t"], poses: Float[np.ndarray, "t 3"]) -> None:
        """Remember a drive.

        Args:
            times: From its beginning [s].
            poses: True poses of the base: x [m], y [m], yaw [rad].
        """
        self.times.append(times)
        self.poses.append(poses)

    def write(self, path: Path, frames: int = 8) -> None:
        """Draw a filmstrip (PNG) or a film (GIF, 720p), as the name ends.

        Args:
            path: The file.
            frames: Number of pictures of a filmstrip; a quarter of them of the drives, if there
                are any.

        Raises:
            InputError: Nothing was executed, this machine cannot draw off-screen, the name ends
                otherwise, or the file cannot be written.
            MissingExtraError: Pillow is not installed.
        """
        if path.suffix.lower() not in ENDINGS:
            raise InputError(
                f"{path}: a film ends in .png (a strip of pictures) or .gif; name it so"
            )
        if self.world is None or not self.states:
            raise InputError(f"{path}: nothing was executed; there is nothing to draw")
        with require("physics"):
            from PIL import Image
        content = io.BytesIO()
        if path.suffix.lower() == ".png":
            Image.fromarray(self._strip(frames)).save(content, "PNG")
        else:
            pictures = [Image.fromarray(picture).quantize(128) for picture in self._pictures()]
            pictures[0].save(
                content, "GIF", save_all=True, append_images=pictures[1:], loop=0,
                duration=round(1000 / FILM_RATE),
            )  # fmt: skip
        try:
            write_atomic(path, content.getvalue())
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from error

    def _strip(self, frames: int) -> Shaped[np.ndarray, "H W 3"]:
        """Some pictures of the drives and of what was done then, in rows."""
        driven = self.driven(frames // 4)
        done = [(self._drove + t, stage, q) for t, stage, q in self._chosen(frames - len(driven))]
        assert self.world is not None
        data, pictures = mujoco.MjData(self.world.model), []
        with canvas(self.world.model, WIDTH, HEIGHT) as draw:
            for strip, seen in ((driven, [*driven, done[0]]), (done, done)):
                shot = frame_shot(self.world, data, [q for _, _, q in seen])
                for state in strip:
                    self._set(data, state)
                    picture = draw(data, shot.camera, shot.through)
                    pictures.append(captioned(picture, _words(state)))
        return _sheet(pictures)

    def _pictures(self) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
        """The pictures of a film, whose camera goes slowly round."""
        assert self.world is not None
        done = [(self._drove + t, stage, q) for t, stage, q in self.states]
        step = max(FASTER / FILM_RATE, (done[-1][0]) / MOST_PICTURES)
        driven = self.driven(int(self._drove / step))
        times = np.array([t for t, _, _ in done])
        picked = np.unique(np.searchsorted(times, np.arange(times[0], times[-1], step)))
        acted = [done[i] for i in [*picked.tolist(), len(done) - 1]]
        data = mujoco.MjData(self.world.model)
        with canvas(self.world.model, FILM_WIDTH, FILM_HEIGHT) as draw:
            for part in (driven, acted):
                if part:
                    shot: Shot = frame_shot(self.world, data, [q for _, _, q in part], sweep=SWEEP)
                for k, state in enumerate(part):
                    self._set(data, state)
                    camera = shot.turned(SWEEP * (2 * k / max(1, len(part) - 1) - 1))
                    yield captioned(draw(data, camera, shot.through), _words(state))

    @property
    def _drove(self) -> float:
        """How long all drives took [s]."""
        return sum(float(times[-1]) for times in self.times)

    def _set(self, data: Any, state: State) -> None:
        assert self.world is not None
        data.qpos[:] = state[2]
        mujoco.mj_forward(self.world.model, data)

    def driven(self, frames: int) -> list[State]:
        """States of all drives together, evenly spread over the way; the end is in what follows."""
        assert self.world is not None
        if not self.poses or not frames:
            return []
        ends = np.cumsum([0.0, *(times[-1] for times in self.times)])
        times = np.concatenate([t + end for t, end in zip(self.times, ends[:-1], strict=True)])
        poses = np.concatenate(self.poses)
        way = np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0, prepend=poses[:1, :2]).T))
        picked = np.searchsorted(way, np.linspace(0.0, way[-1], frames + 1)[:-1])
        # The base's joints count from where it stands in the physics: the end of the last drive.
        stands = poses[-1]
        states = []
        for i in picked:
            q = self.states[0][2].copy()
            xy = local_points(stands, poses[i : i + 1, :2])[0]
            q[self.world.base_q] = [*xy, poses[i, 2] - stands[2]]
            states.append((float(times[i]), "drive", q))
        return states

    def _chosen(self, frames: int) -> list[State]:
        """A quarter of the pictures from the way to the object, the others from then on."""
        before = [s for s in self.states if s[1] in _BEFORE]
        after = [s for s in self.states if s[1] not in _BEFORE]
        early = min(len(before), max(1, frames // 4) if after else frames)
        picked = [before[i] for i in np.linspace(0, len(before) - 1, early + 1).astype(int)[:early]]
        late = min(len(after), frames - len(picked))
        return picked + [after[i] for i in np.linspace(0, len(after) - 1, late).astype(int)]


def _words(state: State) -> str:
    return f"{state[0]:.1f} s   {state[1]}"


def _sheet(pictures: list[UInt8[np.ndarray, "h w 3"]]) -> Shaped[np.ndarray, "H W 3"]:
    """Pictures in rows, with a thin white border."""
    border = [np.pad(p, ((2, 2), (2, 2), (0, 0)), constant_values=255) for p in pictures]
    blank = np.full_like(border[0], 255)
    columns = min(COLUMNS, len(border))
    border += [blank] * (-len(border) % columns)
    rows = [np.concatenate(border[i : i + columns], 1) for i in range(0, len(border), columns)]
    return np.concatenate(rows)
