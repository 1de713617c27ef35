"""Cameras of films and filmstrips: where robot and part are least hidden, and how to follow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from .geoms import ROBOT, Kind
from .simulated_robot import TOOL_POINT
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

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
