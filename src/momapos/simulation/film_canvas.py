"""Off-screen rendering of a physics world, with lighting, overlays and captions."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import mujoco
import numpy as np

from momapos.core import InputError, require

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

ZENITH, HORIZON = (188, 212, 234), (244, 247, 250)
"""The sky at the upper and the lower edge of an image."""
DIRECTIONAL_LIGHT, AMBIENT_LIGHT = 0.48, 0.6
"""Intensity of the directional and of the ambient light [-]."""
FLICKER = 8e-4
"""Cylinders are drawn larger by this, since a face in the plane of a box flickers [m]."""
SHADOW_PIXELS, SHADOW_RADIUS = 4096, 4.0
"""Edge of the shadow map [px], and radius around the camera's target that it covers [m]."""
LIGHT_AZIMUTH, LIGHT_ELEVATION = 60.0, 57.0
"""Azimuth of the light relative to the camera, and its elevation [deg]; chosen so that the visible
faces of a box differ."""
HIDING_OPACITY = 0.12
"""Opacity of geoms that hide the robot or the part [-]."""
CAPTION_HEIGHT = 0.075
"""Height of the caption, as a share of the image height [-]."""
CAPTION_COLOR, SOFT_COLOR = (29, 39, 49), (176, 186, 196)
"""Background of the caption, and its second text."""
PATH_COLOR, FORCE_COLOR = (0.06, 0.23, 0.55, 1.0), (224, 17, 95)
PATH_RADIUS = 0.012
"""Radius of the base path on the floor [m]."""
ARROW_WIDTH = 0.009
"""Width of the force arrow, as a share of the image height [-]."""
PATH_STEP = 0.05
"""Length of the segments of the base path [m]."""
ARROW_LENGTH_PER_NEWTON, MAX_ARROW_LENGTH = 0.03, 0.6
"""Length of the force arrow per force [m/N], and its maximum [m]."""
MIN_ARROW_FORCE = 1.0
"""Force below which no arrow is drawn [N]."""
_MAX_PATH_SEGMENTS = 400
"""Maximum number of segments of the base path [-]."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """Annotations drawn over a world."""

    way: Float[np.ndarray, "k 2"]
    """Path of the base [m]."""
    hand: Float[np.ndarray, "3"]
    """Position of the hand [m]."""
    force: Float[np.ndarray, "3"]
    """Force of the hand on the object it holds [N]."""


Draw: TypeAlias = "Callable[[Any, Any, frozenset[int], Overlay], UInt8[np.ndarray, 'h w 3']]"
"""Renders a state for a camera, with some geoms transparent."""


@contextmanager
def canvas(model: Any, width: int, height: int) -> Iterator[Draw]:
    """Open an off-screen canvas; without a display it renders through EGL.

    Args:
        model: The world.
        width, height: Size of the images [px].

    Raises:
        InputError: Off-screen rendering is unavailable.
    """
    try:
        if sys.platform == "linux" and "DISPLAY" not in os.environ:
            from mujoco.egl import GLContext
        else:
            GLContext = mujoco.GLContext
        screen = GLContext(width, height)
        screen.make_current()
        model.vis.quality.shadowsize = SHADOW_PIXELS
        model.vis.map.shadowclip = SHADOW_RADIUS / model.stat.extent
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    except Exception as error:  # each backend raises its own type
        raise InputError(
            f"this machine cannot render off-screen ({type(error).__name__}): install EGL "
            "(Debian: libegl1 and libgl1-mesa-dri) or use a display"
        ) from error
    most = 2 * model.ngeom + _MAX_PATH_SEGMENTS + 100
    scene, option = mujoco.MjvScene(model, maxgeom=most), mujoco.MjvOption()
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    frame = mujoco.MjrRect(0, 0, width, height)
    shade = np.linspace(0.0, 1.0, height)[:, None, None]  # images begin with their lowest row
    sky = (np.array(HORIZON) + shade * (np.array(ZENITH) - HORIZON)).astype(np.uint8)

    def draw(
        data: Any, camera: Any, through: frozenset[int], overlay: Overlay
    ) -> UInt8[np.ndarray, "h w 3"]:
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        _set_lights(scene, camera)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
                geom.size += FLICKER
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in through:
                geom.rgba[3] = HIDING_OPACITY
        _draw_path(scene, overlay)
        mujoco.mjr_render(frame, scene, context)
        pixels, depth = (
            np.empty((height, width, 3), np.uint8),
            np.empty((height, width), np.float32),
        )
        mujoco.mjr_readPixels(pixels, depth, frame, context)
        pixels = np.where((depth >= 1.0)[..., None], sky, pixels)
        upright = np.ascontiguousarray(np.flipud(pixels))
        return _draw_force(upright, scene.camera, overlay)

    try:
        yield draw
    finally:
        context.free()
        screen.free()


def _set_lights(scene: Any, camera: Any) -> None:
    """Replace the headlight by an ambient and a directional light, which goes with the camera."""
    sky, sun = scene.lights[0], scene.lights[scene.nlight]
    sky.ambient[:], sky.diffuse[:], sky.specular[:] = AMBIENT_LIGHT, 0.12, 0.0
    sun.type = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    sun.castshadow, sun.headlight = 1, 0
    a, e = np.radians(camera.azimuth - LIGHT_AZIMUTH), np.radians(LIGHT_ELEVATION)
    sun.dir[:] = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])
    sun.pos[:] = camera.lookat - 8.0 * sun.dir
    sun.attenuation[:], sun.cutoff, sun.exponent = (1.0, 0.0, 0.0), 45.0, 10.0
    sun.ambient[:], sun.diffuse[:], sun.specular[:] = 0.0, DIRECTIONAL_LIGHT, 0.05
    scene.nlight += 1


def _draw_path(scene: Any, overlay: Overlay) -> None:
    way = _thinned(overlay.way)
    points = np.column_stack([way, np.full(len(way), PATH_RADIUS)])
    for begin, end in pairwise(points):
        _draw_segment(scene, begin, end)


def _draw_force(
    pixels: UInt8[np.ndarray, "h w 3"], cameras: Sequence[Any], overlay: Overlay
) -> UInt8[np.ndarray, "h w 3"]:
    """Draw the force as an arrow that nothing hides."""
    size = float(np.linalg.norm(overlay.force))
    if size < MIN_ARROW_FORCE:
        return pixels
    from PIL import Image, ImageDraw

    height, width = pixels.shape[:2]
    ends = overlay.hand + np.outer(
        [0.0, 1.0], overlay.force * min(ARROW_LENGTH_PER_NEWTON, MAX_ARROW_LENGTH / size)
    )
    eye, ahead, up = (
        np.mean([getattr(camera, key) for camera in cameras], axis=0)
        for key in ("pos", "forward", "up")
    )
    away, right = ends - eye, np.cross(ahead, up)
    scale = height / 2 * cameras[0].frustum_near / cameras[0].frustum_top / (away @ ahead)
    begin, tip = np.stack([width / 2 + scale * (away @ right), height / 2 - scale * (away @ up)], 1)
    picture, line = Image.fromarray(pixels), ARROW_WIDTH * height
    length = float(np.linalg.norm(tip - begin))
    if length > 1.0:
        along = (tip - begin) / length
        head = tip - min(3 * line, length) * along
        side = 1.5 * line * np.array([-along[1], along[0]])
        draw = ImageDraw.Draw(picture)
        draw.line([*begin, *head], fill=FORCE_COLOR, width=round(line))
        draw.polygon([*tip, *(head + side), *(head - side)], fill=FORCE_COLOR)
    return np.asarray(picture)


def _thinned(way: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "n 2"]:
    """Return points of a path at least a segment apart, including its end."""
    if len(way) < 2:
        return way[:0]
    along = np.cumsum(np.hypot(*np.diff(way, axis=0, prepend=way[:1]).T))
    step = max(PATH_STEP, along[-1] / _MAX_PATH_SEGMENTS)
    picked = np.searchsorted(along, np.arange(0.0, along[-1], step))
    return way[np.unique([*picked, len(way) - 1])]


def _draw_segment(scene: Any, begin: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> None:
    geom, kind = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
    color = np.array(PATH_COLOR, np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), color)
    mujoco.mjv_connector(geom, kind, PATH_RADIUS, begin, end)
    scene.ngeom += 1


def add_caption(
    picture: UInt8[np.ndarray, "h w 3"], words: str, *, right: str = "", done: float = 0.0
) -> UInt8[np.ndarray, "H w 3"]:
    """Append a strip with a caption to an image.

    Args:
        picture: The image.
        words: Text at the left.
        right: Text at the right.
        done: Share of the film that is over, drawn as a line [-].

    Raises:
        MissingExtraError: Pillow is not installed.
    """
    with require("physics"):
        from PIL import Image, ImageDraw, ImageFont
    height, width = picture.shape[:2]
    strip = Image.new("RGB", (width, round(CAPTION_HEIGHT * height)), CAPTION_COLOR)
    font = ImageFont.load_default(size=0.56 * strip.height)
    draw, margin, middle = ImageDraw.Draw(strip), 0.5 * strip.height, 0.54 * strip.height
    draw.text((margin, middle), words, fill="white", font=font, anchor="lm")
    draw.text((width - margin, middle), right, fill=SOFT_COLOR, font=font, anchor="rm")
    draw.rectangle((0, 0, done * width, 0.07 * strip.height), fill=FORCE_COLOR)
    return np.concatenate([picture, np.asarray(strip)])
