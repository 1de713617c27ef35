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

from .geoms import ROBOT, Kind
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

ELEVATION, DISTANCE_FACTOR = -25.0, 0.95
"""Camera elevation [deg], and its distance relative to the one that just fits the scene [-]."""
BACKGROUND, DIRECTIONAL_LIGHT, AMBIENT_LIGHT = (244, 246, 248), 0.55, 0.56
"""Background color; intensity of the directional and of the ambient light [-]."""
LIGHT_AZIMUTH, LIGHT_ELEVATION = 60.0, 57.0
"""Azimuth of the light relative to the camera, and its elevation [deg]; chosen so that the visible
faces of a box differ."""
HIDING_OPACITY = 0.12
"""Opacity of geoms that hide the robot or the part [-]."""
CAPTION_HEIGHT = 0.075
"""Height of the caption, as a share of the image height [-]."""
PATH_COLOR, FORCE_COLOR = (0.13, 0.28, 0.55, 1.0), (204, 20, 107)
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
_VIEW_COUNT = 24
"""Number of camera azimuths that are compared [-]."""
_MAX_PATH_SEGMENTS = 400
"""Maximum number of segments of the base path [-]."""
_MAX_HIDING_GEOMS = 6
"""Maximum number of geoms along a ray that are made transparent [-]."""
_SUBJECT = (*ROBOT, Kind.PART)
"""Kinds of geoms that must be visible."""


@dataclass(frozen=True)
class Shot:
    """A camera, and the geoms it looks through."""

    camera: Any
    through: frozenset[int]
    """Geoms of the room that hide the subject."""

    def rotated(self, angle: float) -> Any:
        """Return the camera, rotated about its target by an angle [deg]."""
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = self.camera.lookat
        camera.elevation, camera.distance = self.camera.elevation, self.camera.distance
        camera.azimuth = self.camera.azimuth + angle
        return camera


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


def frame_shot(
    world: Simulation, data: Any, states: Sequence[np.ndarray], *, sweep: float = 0.0
) -> Shot:
    """Return a camera that sees robot and part from the least hidden side.

    Args:
        world: The world.
        data: Scratch state of the world.
        states: States that must be visible.
        sweep: Rotation of the camera to each side [deg].
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
    camera.distance = DISTANCE_FACTOR * half / np.sin(np.radians(model.vis.global_.fovy / 2))
    views = np.linspace(-180.0, 180.0, _VIEW_COUNT, endpoint=False)
    targets = np.stack([cloud[i] for i in np.linspace(0, len(cloud) - 1, 24).astype(int)])
    seen = [1 - len(_between(world, data, _eye(camera, v), targets, 1)) / 24 for v in views]
    # Average with the neighbors: a view through a narrow gap is not robust.
    smooth = np.convolve(np.r_[seen[-1], seen, seen[0]], [0.5, 1.0, 0.5], "valid")
    best = float(views[int(np.argmax(smooth))])
    through: set[int] = set()
    for angle in np.unique([-sweep, 0.0, sweep]):
        through |= set(_between(world, data, _eye(camera, best + angle), cloud, _MAX_HIDING_GEOMS))
    camera.azimuth = best
    return Shot(camera, frozenset(through))


def _eye(camera: Any, azimuth: float) -> Float[np.ndarray, "3"]:
    """Return the position of a free camera that looks along an azimuth [deg]."""
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
    """Return the geoms of the room that hide some points from an eye, up to `layers` per point."""
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
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    except Exception as error:  # each backend raises its own type
        raise InputError(
            f"this machine cannot render off-screen ({type(error).__name__}): install EGL "
            "(Debian: libegl1 and libgl1-mesa-dri) or use a display"
        ) from error
    most = 2 * model.ngeom + _MAX_PATH_SEGMENTS + 100
    scene, option = mujoco.MjvScene(model, maxgeom=most), mujoco.MjvOption()
    # Shadows of a whole room are too coarse; a directional light shows shapes.
    for effect in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        scene.flags[effect] = 0
    frame = mujoco.MjrRect(0, 0, width, height)

    def draw(
        data: Any, camera: Any, through: frozenset[int], overlay: Overlay
    ) -> UInt8[np.ndarray, "h w 3"]:
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        _set_lights(scene, camera.azimuth)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in through:
                geom.rgba[3] = HIDING_OPACITY
        _draw_path(scene, overlay)
        mujoco.mjr_render(frame, scene, context)
        pixels, depth = (
            np.empty((height, width, 3), np.uint8),
            np.empty((height, width), np.float32),
        )
        mujoco.mjr_readPixels(pixels, depth, frame, context)
        pixels[depth >= 1.0] = BACKGROUND
        upright = np.ascontiguousarray(np.flipud(pixels))
        return _draw_force(upright, scene.camera, overlay)

    try:
        yield draw
    finally:
        context.free()
        screen.free()


def _set_lights(scene: Any, azimuth: float) -> None:
    """Replace the headlight by an ambient and a directional light; `azimuth` [deg] is the
    camera's."""
    sky, sun = scene.lights[0], scene.lights[scene.nlight]
    sky.ambient[:], sky.diffuse[:], sky.specular[:] = AMBIENT_LIGHT, 0.12, 0.0
    sun.type = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    sun.castshadow, sun.headlight = 0, 0
    a, e = np.radians(azimuth - LIGHT_AZIMUTH), np.radians(LIGHT_ELEVATION)
    sun.pos[:] = (0.0, 0.0, 6.0)
    sun.dir[:] = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])
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


def add_caption(picture: UInt8[np.ndarray, "h w 3"], words: str) -> UInt8[np.ndarray, "H w 3"]:
    """Append a white strip with a caption to an image.

    Raises:
        MissingExtraError: Pillow is not installed.
    """
    with require("physics"):
        from PIL import Image, ImageDraw, ImageFont
    height, width = picture.shape[:2]
    strip = Image.new("RGB", (width, round(CAPTION_HEIGHT * height)), "white")
    font = ImageFont.load_default(size=0.66 * strip.height)
    ImageDraw.Draw(strip).text((0.4 * strip.height, strip.height / 2), words, fill=(29, 39, 49),
                               font=font, anchor="lm")  # fmt: skip
    return np.concatenate([picture, np.asarray(strip)])
