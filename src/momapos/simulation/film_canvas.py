"""Pictures of a physics world: light that shows shapes, nothing in the way, words to be read."""

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

ELEVATION, MARGIN = -25.0, 0.95
"""The camera looks down by this [deg], from this many times the least distance [-]."""
BACKGROUND, SUN, SKY = (244, 246, 248), 0.55, 0.56
"""Color where nothing is; light from the side, and from everywhere [-]."""
ASIDE, STEEP = 60.0, 57.0
"""The light comes from so far beside the camera, and from above [deg]: so the faces of a box that
are seen differ, whichever they are."""
SEEN_THROUGH = 0.12
"""Opacity of what stands in the way [-]."""
CAPTION = 0.075
"""Height of the words under a picture, as a share of it [-]."""
WAY_COLOR, FORCE_COLOR = (0.13, 0.28, 0.55, 1.0), (204, 20, 107)
WAY_WIDTH = 0.012
"""Radius of the line on the floor [m]."""
FORCE_WIDTH = 0.009
"""Width of the arrow of a force, as a share of the height of a picture [-]."""
WAY_STEP = 0.05
"""Length of the pieces of the line [m]."""
PER_NEWTON, LONGEST = 0.03, 0.6
"""Length of the arrow of a force [m/N], and how long it is at most [m]."""
LEAST_FORCE = 1.0
"""Forces below this have no arrow [N]."""
_VIEWS = 24
"""Directions from which the camera may look [-]."""
_MOST_LINES = 400
"""Pieces of the line on the floor at most [-]."""
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


@dataclass(frozen=True)
class Overlay:
    """What is drawn over a world."""

    way: Float[np.ndarray, "k 2"]
    """Where the base drove [m]."""
    hand: Float[np.ndarray, "3"]
    """Where the hand is [m]."""
    force: Float[np.ndarray, "3"]
    """Of the hand on what it holds [N]."""


Draw: TypeAlias = "Callable[[Any, Any, frozenset[int], Overlay], UInt8[np.ndarray, 'h w 3']]"
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
    most = 2 * model.ngeom + _MOST_LINES + 100
    scene, option = mujoco.MjvScene(model, maxgeom=most), mujoco.MjvOption()
    # Shadows of a whole room are as coarse as the pictures are; light from the side shows shapes.
    for effect in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        scene.flags[effect] = 0
    frame = mujoco.MjrRect(0, 0, width, height)

    def draw(
        data: Any, camera: Any, through: frozenset[int], overlay: Overlay
    ) -> UInt8[np.ndarray, "h w 3"]:
        mujoco.mjv_updateScene(model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        _shine(scene, camera.azimuth)
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.objid in through:
                geom.rgba[3] = SEEN_THROUGH
        _lay_over(scene, overlay)
        mujoco.mjr_render(frame, scene, context)
        pixels, depth = (
            np.empty((height, width, 3), np.uint8),
            np.empty((height, width), np.float32),
        )
        mujoco.mjr_readPixels(pixels, depth, frame, context)
        pixels[depth >= 1.0] = BACKGROUND
        upright = np.ascontiguousarray(np.flipud(pixels))
        return _arrow_over(upright, scene.camera, overlay)

    try:
        yield draw
    finally:
        context.free()
        screen.free()


def _shine(scene: Any, azimuth: float) -> None:
    """Replace the light at the camera, which looks along an azimuth [deg], by one from everywhere
    and one from the side."""
    sky, sun = scene.lights[0], scene.lights[scene.nlight]
    sky.ambient[:], sky.diffuse[:], sky.specular[:] = SKY, 0.12, 0.0
    sun.type = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    sun.castshadow, sun.headlight = 0, 0
    a, e = np.radians(azimuth - ASIDE), np.radians(STEEP)
    sun.pos[:] = (0.0, 0.0, 6.0)
    sun.dir[:] = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), -np.sin(e)])
    sun.attenuation[:], sun.cutoff, sun.exponent = (1.0, 0.0, 0.0), 45.0, 10.0
    sun.ambient[:], sun.diffuse[:], sun.specular[:] = 0.0, SUN, 0.05
    scene.nlight += 1


def _lay_over(scene: Any, overlay: Overlay) -> None:
    """Add the way of the base to what is drawn."""
    way = _thinned(overlay.way)
    points = np.column_stack([way, np.full(len(way), WAY_WIDTH)])
    for begin, end in pairwise(points):
        _connect(scene, begin, end)


def _arrow_over(
    pixels: UInt8[np.ndarray, "h w 3"], cameras: Sequence[Any], overlay: Overlay
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture with the force as an arrow over all that would hide it."""
    size = float(np.linalg.norm(overlay.force))
    if size < LEAST_FORCE:
        return pixels
    from PIL import Image, ImageDraw

    height, width = pixels.shape[:2]
    ends = overlay.hand + np.outer([0.0, 1.0], overlay.force * min(PER_NEWTON, LONGEST / size))
    eye, ahead, up = (
        np.mean([getattr(camera, key) for camera in cameras], axis=0)
        for key in ("pos", "forward", "up")
    )
    away, right = ends - eye, np.cross(ahead, up)
    scale = height / 2 * cameras[0].frustum_near / cameras[0].frustum_top / (away @ ahead)
    begin, tip = np.stack([width / 2 + scale * (away @ right), height / 2 - scale * (away @ up)], 1)
    picture, line = Image.fromarray(pixels), FORCE_WIDTH * height
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
    """Points of a way at least a step apart, with its end."""
    if len(way) < 2:
        return way[:0]
    along = np.cumsum(np.hypot(*np.diff(way, axis=0, prepend=way[:1]).T))
    step = max(WAY_STEP, along[-1] / _MOST_LINES)
    picked = np.searchsorted(along, np.arange(0.0, along[-1], step))
    return way[np.unique([*picked, len(way) - 1])]


def _connect(scene: Any, begin: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> None:
    geom, kind = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
    color = np.array(WAY_COLOR, np.float32)
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), color)
    mujoco.mjv_connector(geom, kind, WAY_WIDTH, begin, end)
    scene.ngeom += 1


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
