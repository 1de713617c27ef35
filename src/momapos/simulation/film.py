"""Images of a run: a filmstrip, or a film."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import mujoco
import numpy as np

from momapos.core import InputError, require, write_file

from .config import Stage
from .geoms import ROBOT, Kind
from .run_record import DRIVE
from .run_trace import Act, RunTrace, State
from .simulated_robot import TOOL_POINT
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float, Shaped, UInt8


ELEVATION, DISTANCE_FACTOR = -22.0, 0.95
"""Camera elevation [deg], and its distance relative to the one that just fits the scene [-]."""
FAR, NEAR = 1.3, 0.35
"""Distances from the hand to the part: the camera begins to move in, and is close [m]."""
CLOSE_RADIUS, CLOSE_SHARE = 0.8, 0.6
"""Radius of a close view, at least [m], and relative to that of the whole [-]."""
HAND_SHARE = 0.55
"""How much a close view looks at the hand instead of the middle of robot and part [-]."""
HAND_SIZE, HAND_WEIGHT = 0.12, 1.5
"""What is nearer to the tool belongs to the hand [m]; weight of seeing it [-]."""
SWEEP = 14.0
"""Rotation of a film's camera to each side [deg]."""
_VIEW_COUNT = 24
"""Number of camera azimuths that are compared [-]."""
_MAX_HIDING_GEOMS = 6
"""Maximum number of geoms along a ray that are made transparent [-]."""
_LOOKS = 9
"""Images of a film for which the hiding geoms are found [-]."""
_SUBJECT = (*ROBOT, Kind.PART)
"""Kinds of geoms that must be visible."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A camera, and the geoms it looks through."""

    camera: Any
    through: frozenset[int]
    """Geoms of the room that hide the subject."""
    seen: Float[np.ndarray, " v"]
    """Shares of the subject that are seen from all azimuths [-]."""


@dataclass(frozen=True, eq=False)
class FollowingCamera:
    """A camera for each image of a film."""

    look_at: Float[np.ndarray, "n 3"]
    """Targets [m]."""
    distance: Float[np.ndarray, " n"]
    """Distances to them [m]."""
    azimuth: Float[np.ndarray, " n"]
    """Azimuths [deg]."""
    through: frozenset[int]
    """Geoms of the room that hide the subject."""

    def at(self, k: int) -> Any:
        """Return the camera of an image."""
        return _camera(self.look_at[k], float(self.distance[k]), float(self.azimuth[k]))


def follow(
    world: Simulation, data: Any, states: Sequence[np.ndarray], *, smooth: float
) -> FollowingCamera:
    """Return cameras that follow robot and part, and move in on the hand when it grasps.

    Args:
        world: The world.
        data: Scratch state of the world.
        states: The states of the images.
        smooth: Standard deviation of the smoothing of the camera's path, in images [-].
    """
    from scipy.ndimage import gaussian_filter1d

    subject = np.isin(world.kinds, _SUBJECT)
    part = np.isin(world.kinds, (Kind.PART,))
    rows = []
    for q in states:
        data.qpos[:] = q
        mujoco.mj_forward(world.model, data)
        points = data.geom_xpos[subject]
        low, high = points.min(0), points.max(0)
        hand = data.geom(TOOL_POINT).xpos
        gap = float(np.linalg.norm(data.geom_xpos[part] - hand, axis=1).min(initial=FAR))
        rows.append([*(low + high) / 2, np.linalg.norm(high - low) / 2 + 0.25, *hand, gap])
    row = np.array(rows)
    middle, radius, hand, gaps = row[:, :3], row[:, 3], row[:, 4:7], row[:, 7]
    # Once close, the camera stays: a hand that opens a door wide is far from the part's middle.
    near = np.maximum.accumulate(np.clip((FAR - gaps) / (FAR - NEAR), 0.0, 1.0))
    share = (near**2 * (3.0 - 2.0 * near))[:, None]
    look_at = middle + HAND_SHARE * share * (hand - middle)
    close = np.maximum(CLOSE_RADIUS, CLOSE_SHARE * radius)
    size = radius + share[:, 0] * (close - radius)
    size = size / np.sin(np.radians(world.model.vis.global_.fovy / 2))
    look_at = gaussian_filter1d(look_at, smooth, axis=0, mode="nearest")
    distance = DISTANCE_FACTOR * gaussian_filter1d(size, smooth, mode="nearest")
    clear = frame_shot(world, data, states)
    close_states = [q for q, one in zip(states, near, strict=True) if one > 0.5] or list(states)
    best = _shows_hand(world, data, clear, close_states)
    azimuth = best + np.linspace(-SWEEP, SWEEP, len(states))
    through: set[int] = set()
    for k in np.unique(np.linspace(0, len(states) - 1, _LOOKS).astype(int)):
        data.qpos[:] = states[k]
        mujoco.mj_forward(world.model, data)
        camera = _camera(look_at[k], float(distance[k]), float(azimuth[k]))
        eye, seen = _eye(camera, float(azimuth[k])), data.geom_xpos[subject]
        through |= set(_between(world, data, eye, seen, _MAX_HIDING_GEOMS))
    return FollowingCamera(look_at, distance, azimuth, _whole(world, through))


def _shows_hand(world: Simulation, data: Any, shot: Shot, states: Sequence[np.ndarray]) -> float:
    """Return the azimuth from which the hand is seen longest, and next to that robot and part.

    Args:
        world: The world.
        data: Scratch state of the world.
        shot: The camera that shows robot and part.
        states: States in which the hand is near the part.
    """
    score, hit = shot.seen.copy(), np.zeros(1, np.int32)
    picked = np.unique(np.linspace(0, len(states) - 1, _LOOKS).astype(int))
    for k in picked:
        data.qpos[:] = states[k]
        mujoco.mj_forward(world.model, data)
        hand = data.geom(TOOL_POINT).xpos
        for index, view in enumerate(_views()):
            camera = _camera(hand, float(shot.camera.distance), float(view))
            eye = _eye(camera, float(view))
            away = (hand - eye) / camera.distance
            distance = mujoco.mj_ray(world.model, data, eye, away, None, 1, -1, hit)
            free = distance < 0 or distance > camera.distance - HAND_SIZE
            score[index] += HAND_WEIGHT * free / len(picked)
    return float(_views()[int(np.argmax(_smoothed(score)))])


def _views() -> Float[np.ndarray, " v"]:
    """Return the azimuths that are compared [deg]."""
    return np.linspace(-180.0, 180.0, _VIEW_COUNT, endpoint=False)


def _smoothed(seen: Float[np.ndarray, " v"]) -> Float[np.ndarray, " v"]:
    """Average with the neighbors: a view through a narrow gap is not robust."""
    return np.convolve(np.r_[seen[-1], seen, seen[0]], [0.5, 1.0, 0.5], "valid")


def _camera(look_at: Float[np.ndarray, "3"], distance: float, azimuth: float) -> Any:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = look_at
    camera.elevation, camera.distance, camera.azimuth = ELEVATION, distance, azimuth
    return camera


def frame_shot(world: Simulation, data: Any, states: Sequence[np.ndarray]) -> Shot:
    """Return a camera that sees robot and part from the least hidden side.

    Args:
        world: The world.
        data: Scratch state of the world.
        states: States that must be visible.
    """
    model, points = world.model, []
    some = [states[0], states[len(states) // 2], states[-1]]
    for q in some:
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        points.append(data.geom_xpos[np.isin(world.kinds, _SUBJECT)])
    cloud = np.concatenate(points)
    low, high = cloud.min(0), cloud.max(0)
    half = float(np.linalg.norm(high - low)) / 2 + 0.25
    distance = DISTANCE_FACTOR * half / np.sin(np.radians(model.vis.global_.fovy / 2))
    camera = _camera((low + high) / 2, distance, 0.0)
    views = _views()
    targets = np.stack([cloud[i] for i in np.linspace(0, len(cloud) - 1, 24).astype(int)])
    hiding = [len(_between(world, data, _eye(camera, float(v)), targets, 1)) for v in views]
    seen = 1.0 - np.array(hiding) / len(targets)
    best = float(views[int(np.argmax(_smoothed(seen)))])
    through = set(_between(world, data, _eye(camera, best), cloud, _MAX_HIDING_GEOMS))
    camera.azimuth = best
    return Shot(camera, _whole(world, through), seen)


def _whole(world: Simulation, geoms: Iterable[int]) -> frozenset[int]:
    """Add the other geoms of the same objects, such as handles, which would float.

    The geoms of the object with the part stay, as it is what the film shows.
    """
    owners = [world.model.geom(k).name.partition("/")[0] for k in range(world.model.ngeom)]
    kept = {owners[k] for k in np.flatnonzero(world.kinds == Kind.PART)}
    hidden = {owners[k] for k in geoms} - kept
    room = np.flatnonzero(world.kinds == Kind.ROOM).tolist()
    return frozenset(geoms) | {k for k in room if owners[k] in hidden and owners[k]}


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


STRIP, GIF, MP4 = ".png", ".gif", ".mp4"
"""Suffixes of filmstrips and films."""
COLORS = 128
"""Number of colors of a GIF [-]."""
QUALITY = {"crf": "23", "preset": "veryfast"}
"""H.264 options: sharp edges at about 50 kB/s for a still scene."""


def check_film(path: Path) -> None:
    """Check that a filmstrip or film can be written to a file.

    Raises:
        InputError: The suffix is unknown.
        MissingExtraError: The encoder is not installed.
    """
    if path.suffix.lower() not in (STRIP, GIF, MP4):
        raise InputError(
            f"{path}: unknown suffix {path.suffix!r}; use .png for a filmstrip, "
            ".gif or .mp4 for a film"
        )
    if path.suffix.lower() == MP4:
        with require("film"):
            import av  # noqa: F401


def encode_film(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], ending: str, rate: float) -> bytes:
    """Encode images as the content of a film.

    Args:
        pictures: At least one image, all of the same size, which is even for an MP4.
        ending: `GIF` or `MP4`.
        rate: Frame rate [1/s].

    Raises:
        MissingExtraError: The encoder is not installed.
    """
    return _mp4(pictures, rate) if ending == MP4 else _gif(pictures, rate)


def _gif(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], rate: float) -> bytes:
    with require("physics"):
        from PIL import Image
    first, *others = (Image.fromarray(picture).quantize(COLORS) for picture in pictures)
    content = io.BytesIO()
    first.save(
        content, "GIF", save_all=True, append_images=others, loop=0, duration=round(1000 / rate)
    )
    return content.getvalue()


def _mp4(pictures: Iterable[UInt8[np.ndarray, "h w 3"]], rate: float) -> bytes:
    with require("film"):
        import av
    content, stream = io.BytesIO(), None
    with av.open(content, "w", format="mp4") as file:
        for picture in pictures:
            if stream is None:
                stream = file.add_stream("libx264", Fraction(rate), options=QUALITY)
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"  # supported by every player
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            file.mux(stream.encode())
    return content.getvalue()


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
    write_file(path, film)


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
