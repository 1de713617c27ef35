"""Pictures of a physics world: light that shows shapes, nothing in the way, words to be read."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import mujoco
import numpy as np

from momapos.errors import InputError, require
from momapos.execution.shapes import ROBOT, Kind
from momapos.execution.simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

ELEVATION, MARGIN = -25.0, 0.95
"""The camera looks down by this [deg], from this many times the least distance [-]."""
BACKGROUND, SUN, SKY = (244, 246, 248), 0.4, 0.62
"""Color where nothing is; light from the side, and from everywhere [-]."""
SEEN_THROUGH = 0.12
"""Opacity of what stands in the way [-]."""
CAPTION = 0.075
"""Height of the words under a picture, as a share of it [-]."""
_VIEWS = 24
"""Directions from which the camera may look [-]."""
_LAYERS = 6
"""So many things one behind the other are looked through [-]."""
_SUBJECT = (*ROBOT, Kind.PART)
"""What the pictures are of."""


@dataclass(frozen=True)
class Shot:
    """A camera, and what it looks through."""

    camera: Any
    through: frozenset[int]
    """Geoms of the room between the camera and what the picture is of."""

    def turned(self, angle: float) -> Any:
        """The same camera, farther round [deg]."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.camera.lookat
        camera.elevation, camera.distance = self.camera.elevation, self.camera.distance
        camera.azimuth = self.camera.azimuth + angle
        return camera


Draw: TypeAlias = "Callable[[Any, Any, frozenset[int]], UInt8[np.ndarray, 'h w 3']]"
"""Draws a state as a camera sees it, some geoms see-through."""


def frame_shot(
    world: Simulation, data: Any, states: Sequence[np.ndarray], *, sweep: float = 0.0
) -> Shot:
    """A camera that sees robot and part from the side that least stands in the way.

    Args:
        world: The world.
        data: Room for states of it.
        states: What is to be seen.
        sweep: How far the camera goes round to each side [deg].
    """
    model, points = world.model, []
    some = [states[0], states[len(states) // 2], states[-1]]
    for q in some:
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
    seen = [1 - len(_between(world, data, _eye(camera, v), targets, 1)) / 24 for v in views]
    # Neighbors count too: a view through a narrow gap is not worth much.
    smooth = np.convolve(np.r_[seen[-1], seen, seen[0]], [0.5, 1.0, 0.5], "valid")
    best = float(views[int(np.argmax(smooth))])
    through: set[int] = set()
    for angle in np.unique([-sweep, 0.0, sweep]):
        through |= set(_between(world, data, _eye(camera, best + angle), cloud, _LAYERS))
    camera.azimuth = best
    return Shot(camera, frozenset(through))


def _eye(camera: Any, azimuth: float) -> Float[np.ndarray, "3"]:
    """Where a free camera is when it looks along an azimuth [deg]."""
    a, e = np.radians(azimuth), np.radians(camera.elevation)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    return np.asarray(camera.lookat - camera.distance * forward)


def _between(
    world: Simulation,
    data: Any,
    eye: Float[np.ndarray, "3"],
    targets: Float[np.ndarray, "n 3"],
    layers: int,
) -> list[int]:
    """Geoms of the room between an eye and some points; for each, the first few that hide it."""
    found, hit = [], np.zeros(1, np.int32)
    for target in targets:
        away = (target - eye) / np.linalg.norm(target - eye)
        far, at = float(np.linalg.norm(target - eye)) * 0.99, 0.0
        for _ in range(layers):
            distance = mujoco.mj_ray(world.model, data, eye + at * away, away, None, 1, -1, hit)
            at += distance + 1e-3
            if distance < 0 or at >= far:
                break
            if world.kinds[hit[0]] == Kind.ROOM:
                found.append(int(hit[0]))
    return found


@contextmanager
def canvas(model: Any, width: int, height: int) -> Iterator[Draw]:
    """An off-screen canvas; a machine without a display draws through EGL.

    Args:
        model: The world.
        width, height: Of the pictures [px].

    Raises:
        InputError: There is none.
    """
    try:
        if sys.platform == "linux" and "DISPLAY" not in os.environ:
            from mujoco.egl import GLContext
        else:
            GLContext = mujoco.GLContext
        screen = GLContext(width, height)
        screen.make_current()
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    except Exception as error:  # every backend raises its own kind
        raise InputError(
            f"--record: this machine cannot draw off-screen ({type(error).__name__}); it needs "
            "EGL, as libegl1 and libgl1-mesa-dri of Debian have it, or a display"
        ) from error
    scene, option = mujoco.MjvScene(model, maxgeom=2 * model.ngeom + 100), mujoco.MjvOption()
    # Shadows of a whole room are as coarse as the pictures are; light from the side shows shapes.
    for effect in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        scene.flags[effect] = 0
    frame = mujoco.MjrRect(0, 0, width, height)

    def draw(data: Any, camera: Any, through: frozenset[int]) -> UInt8[np.ndarray, "h w 3"]:
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        _shine(scene)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in through:
                geom.rgba[3] = SEEN_THROUGH
        mujoco.mjr_render(frame, scene, context)
        pixels, depth = (
            np.empty((height, width, 3), np.uint8),
            np.empty((height, width), np.float32),
        )
        mujoco.mjr_readPixels(pixels, depth, frame, context)
        pixels[depth >= 1.0] = BACKGROUND
        return np.flipud(pixels)

    try:
        yield draw
    finally:
        context.free()
        screen.free()


def _shine(scene: Any) -> None:
    """Replace the light at the camera by one from everywhere, and one from the side."""
    sky, sun = scene.lights[0], scene.lights[scene.nlight]
    sky.ambient[:], sky.diffuse[:], sky.specular[:] = SKY, 0.12, 0.0
    sun.type = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    sun.castshadow, sun.headlight = 0, 0
    sun.pos[:], sun.dir[:] = (0.0, 0.0, 6.0), np.array([0.35, 0.3, -0.89])
    sun.attenuation[:], sun.cutoff, sun.exponent = (1.0, 0.0, 0.0), 45.0, 10.0
    sun.ambient[:], sun.diffuse[:], sun.specular[:] = 0.0, SUN, 0.05
    scene.nlight += 1


def captioned(picture: UInt8[np.ndarray, "h w 3"], words: str) -> UInt8[np.ndarray, "H w 3"]:
    """A picture with dark words on a white strip under it.

    Raises:
        MissingExtraError: Pillow is not installed.
    """
    with require("physics"):
        from PIL import Image, ImageDraw, ImageFont
    height, width = picture.shape[:2]
    strip = Image.new("RGB", (width, round(CAPTION * height)), "white")
    font = ImageFont.load_default(size=0.66 * strip.height)
    ImageDraw.Draw(strip).text((0.4 * strip.height, strip.height / 2), words, fill=(29, 39, 49),
                               font=font, anchor="lm")  # fmt: skip
    return np.concatenate([picture, np.asarray(strip)])
