"""A filmstrip of a run: what happened, in a few pictures."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import mujoco
import numpy as np

from momapos.errors import InputError, require
from momapos.execution.config import Stage
from momapos.execution.shapes import ROBOT, Kind
from momapos.execution.simulation import Simulation
from momapos.geometry.planar import local_points

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped, UInt8

WIDTH, HEIGHT, COLUMNS = 480, 420, 4
Draw: TypeAlias = "Callable[[Any, Any], UInt8[np.ndarray, 'h w 3']]"
"""Draws a state as a camera sees it."""
INTERVAL = 0.05
"""Time between remembered states [s]."""
ELEVATION, MARGIN = -25.0, 0.95
"""The camera looks down by this [deg], from this many times the least distance [-]."""
_VIEWS = 24
"""Directions from which the camera may look [-]."""
_BEFORE = (Stage.SETTLE, Stage.APPROACH)
"""Stages before the robot takes hold."""
_SUBJECT = (*ROBOT, Kind.PART)
"""What the pictures are of."""


@dataclass
class Film:
    """Remembers a run; give it to `execute` as `watch`, and `drive` every drive before."""

    states: list[tuple[float, str, np.ndarray]] = field(default_factory=list)
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
        """Draw a filmstrip.

        Args:
            path: A PNG file.
            frames: Number of pictures; a quarter of them of the drives, if there are any.

        Raises:
            InputError: Nothing was executed, this machine cannot draw off-screen, or the file
                cannot be written.
            MissingExtraError: Pillow is not installed.
        """
        if self.world is None or not self.states:
            raise InputError(f"{path}: nothing was executed; there is nothing to draw")
        with require("physics"):
            from PIL import Image, ImageDraw
        began = sum(float(times[-1]) for times in self.times)
        driven = self.driven(frames // 4)
        done = [(began + t, stage, q) for t, stage, q in self._chosen(frames - len(driven))]
        data, pictures = mujoco.MjData(self.world.model), []
        with _canvas(self.world.model) as draw:
            for strip, seen in ((driven, [*driven, done[0]]), (done, done)):
                camera = self._camera(data, [q for _, _, q in seen])
                for time, stage, q in strip:
                    data.qpos[:] = q
                    mujoco.mj_forward(self.world.model, data)
                    picture = Image.fromarray(draw(data, camera))
                    label = f"{time:.1f} s  {stage}"
                    ImageDraw.Draw(picture).text((10, 8), label, fill=(20, 20, 20))
                    pictures.append(picture)
        sheet = _sheet([np.asarray(picture) for picture in pictures])
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(sheet).save(path, format="PNG")
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error})") from error

    def driven(self, frames: int) -> list[tuple[float, str, np.ndarray]]:
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

    def _chosen(self, frames: int) -> list[tuple[float, str, np.ndarray]]:
        """A quarter of the pictures from the way to the object, the others from then on."""
        before = [s for s in self.states if s[1] in _BEFORE]
        after = [s for s in self.states if s[1] not in _BEFORE]
        early = min(len(before), max(1, frames // 4) if after else frames)
        picked = [before[i] for i in np.linspace(0, len(before) - 1, early + 1).astype(int)[:early]]
        late = min(len(after), frames - len(picked))
        return picked + [after[i] for i in np.linspace(0, len(after) - 1, late).astype(int)]

    def _camera(self, data: Any, states: list[np.ndarray]) -> Any:
        """A camera that sees robot and part from the side that least stands in the way."""
        assert self.world is not None
        world, model = self.world, self.world.model
        points = []
        for q in (states[0], states[len(states) // 2], states[-1]):
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            points.append(data.geom_xpos[np.isin(world.kinds, _SUBJECT)])
        cloud = np.concatenate(points)
        low, high = cloud.min(0), cloud.max(0)
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = (low + high) / 2
        camera.elevation = ELEVATION
        half = float(np.linalg.norm(high - low)) / 2 + 0.25
        camera.distance = MARGIN * half / np.sin(np.radians(model.vis.global_.fovy / 2))
        views = np.linspace(-180.0, 180.0, _VIEWS, endpoint=False)
        targets = np.stack([cloud[i] for i in np.linspace(0, len(cloud) - 1, 24).astype(int)])
        seen = [_visible(world, data, _eye(camera, view), targets) for view in views]
        # Neighbors count too: a view through a narrow gap is not worth much.
        smooth = np.convolve(np.r_[seen[-1], seen, seen[0]], [0.5, 1.0, 0.5], "valid")
        camera.azimuth = float(views[int(np.argmax(smooth))])
        return camera


def _eye(camera: Any, azimuth: float) -> Float[np.ndarray, "3"]:
    """Where a free camera is when it looks along an azimuth [deg]."""
    a, e = np.radians(azimuth), np.radians(camera.elevation)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return np.asarray(camera.lookat - camera.distance * forward)


def _visible(
    world: Simulation, data: Any, eye: Float[np.ndarray, "3"], targets: Float[np.ndarray, "n 3"]
) -> float:
    """Share of points that no furniture hides."""
    seen, geom = 0, np.zeros(1, np.int32)
    for target in targets:
        away = target - eye
        distance = mujoco.mj_ray(world.model, data, eye, away, None, 1, -1, geom)
        hidden = 0 <= distance < 0.99 and world.kinds[geom[0]] == Kind.ROOM
        seen += not hidden
    return seen / len(targets)


@contextmanager
def _canvas(model: Any) -> Iterator[Draw]:
    """An off-screen canvas; a machine without a display draws through EGL.

    Raises:
        InputError: There is none.
    """
    try:
        if sys.platform == "linux" and "DISPLAY" not in os.environ:
            from mujoco.egl import GLContext
        else:
            GLContext = mujoco.GLContext
        screen = GLContext(WIDTH, HEIGHT)
        screen.make_current()
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    except Exception as error:  # every backend raises its own kind
        raise InputError(
            f"--record: this machine cannot draw off-screen ({type(error).__name__}); it needs "
            "EGL, as libegl1 and libgl1-mesa-dri of Debian have it, or a display"
        ) from error
    scene, option = mujoco.MjvScene(model, maxgeom=2 * model.ngeom + 100), mujoco.MjvOption()
    for effect in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        scene.flags[effect] = 0
    frame = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)

    def draw(data: Any, camera: Any) -> UInt8[np.ndarray, "h w 3"]:
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        mujoco.mjr_render(frame, scene, context)
        pixels = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, frame, context)
        return np.flipud(pixels)

    try:
        yield draw
    finally:
        context.free()
        screen.free()


def _sheet(pictures: list[UInt8[np.ndarray, "h w 3"]]) -> Shaped[np.ndarray, "H W 3"]:
    """Pictures in rows, with a thin white border."""
    border = [np.pad(p, ((2, 2), (2, 2), (0, 0)), constant_values=255) for p in pictures]
    blank = np.full_like(border[0], 255)
    columns = min(COLUMNS, len(border))
    border += [blank] * (-len(border) % columns)
    rows = [np.concatenate(border[i : i + columns], 1) for i in range(0, len(border), columns)]
    return np.concatenate(rows)
