"""Compute how the points of a moving part move with its joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import apply
from momapos.model.scene import SceneObject
from momapos.model.urdf import opening_of

from .handle_shapes import CarriedPart, model_of

if TYPE_CHECKING:
    from jaxtyping import Float

_SAMPLES = 7
"""Joint values at which the motion of a link that follows is evaluated, without the closed part,
where some linkages are singular [-]."""
_STEP = 1e-5
"""Difference of joint values for the derivative of a pose [rad] or [m]."""
_PATH_POINTS = 9
"""Points on the path of a handle [-]."""
MIN_SPEED = 1e-6
"""Speed per unit of the joint below which a point counts as at rest [m/rad] or [m/m]."""


def velocities(
    part: CarriedPart,
    points: Float[np.ndarray, "n 3"],
    values: Float[np.ndarray, " v"] | None = None,
) -> Float[np.ndarray, "w n 3"]:
    """Return how fast points of a part's carrier move per unit of its joint.

    The velocity of the joint's own child is the same at every value, in the child's frame. That of
    a link that follows changes.

    Args:
        part: The part.
        points: Points in the carrier's frame [m].
        values: Joint values [rad] or [m]; by default from closed to wide open.

    Returns:
        Velocities in that frame [m/rad] or [m/m]: one for all values, or one for each.
    """
    record = part.model.joint(part.joint)
    if part.leads:
        if record.kind == "prismatic":
            return np.tile(record.axis, (1, len(points), 1))
        return np.cross(record.axis, points)[None]
    turn, slide = _usual_twists(part) if values is None else _twists(part, values)
    return np.asarray(np.cross(turn[:, None], points) + slide[:, None])


@owner_cache(owner=model_of)
def _usual_twists(
    part: CarriedPart,
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """Return the velocities of a carrier that follows, from closed to wide open."""
    opening = opening_of(part.model, part.joint)
    end = opening.wide if np.isfinite(opening.wide) else opening.closed + opening.sign * np.pi / 2
    return _twists(part, np.linspace(opening.closed, end, _SAMPLES + 1)[1:])


def _twists(
    part: CarriedPart, values: Float[np.ndarray, " v"]
) -> tuple[Float[np.ndarray, "v 3"], Float[np.ndarray, "v 3"]]:
    """Return angular and linear velocity of a carrier that follows, in its frame, by value."""
    poses = part.model.rest_poses

    def at(values: Float[np.ndarray, " v"]) -> Float[np.ndarray, "v 4 4"]:
        return part.model.moving_poses(part.joint, values, {}, poses)[part.carrier]

    T, dT = at(values), (at(values + _STEP) - at(values - _STEP)) / (2 * _STEP)
    R_back = np.swapaxes(T[:, :3, :3], 1, 2)
    W = R_back @ dT[:, :3, :3]
    turn = np.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], axis=1)
    return turn, (R_back @ dT[:, :3, 3:])[:, :, 0]


def motion_directions(
    part: CarriedPart, sign: float, points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "v n 3"]:
    """Return the unit directions in which points move when the joint opens; see `velocities`.

    Points that hardly move get the direction of the axis.
    """
    axis = part.model.joint(part.joint).axis
    velocity = sign * velocities(part, points)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    return np.where(speed > MIN_SPEED, velocity / np.maximum(speed, MIN_SPEED), sign * axis)


def motion_direction(
    part: CarriedPart, sign: float, point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction in which a point starts to move when the joint opens."""
    return motion_directions(part, sign, point[None])[0, 0]


def lever_arms(part: CarriedPart, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the travel of points per unit of the joint: for a hinge the distance from its axis.

    For a link that follows, the travel is the smallest one along the motion.

    Args:
        part: The part.
        points: Points in the carrier's frame [m].

    Returns:
        Travel [m/rad]; 1 for a slide [m/m].
    """
    return np.asarray(np.linalg.norm(velocities(part, points), axis=-1).min(0))


def levers_along(
    part: CarriedPart, points: Float[np.ndarray, "n 3"], values: Float[np.ndarray, " v"]
) -> Float[np.ndarray, "v n"]:
    """Return the same travel at joint values."""
    levers = np.linalg.norm(velocities(part, points, values), axis=-1)
    return np.broadcast_to(levers, (len(values), len(points)))


def part_path(
    item: SceneObject, part: CarriedPart, point: Float[np.ndarray, "3"], to: float
) -> Float[np.ndarray, "k 3"]:
    """Return the path of a point in the world [m] from the joint's present value to another."""
    values = np.linspace(item.values()[part.joint], to, _PATH_POINTS)
    Ts = item.moving_poses(part.joint, values)[part.carrier]
    return apply(Ts, point[None])[:, 0]
