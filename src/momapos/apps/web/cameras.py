"""Poses of the browsers' cameras."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.apps.plots import room_bounds
from momapos.model.scene import Scene
from momapos.planning.grasps import in_front_of_parts

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import ViserServer


def look_at(
    server: ViserServer, scene: Scene, shifts: Sequence[Float[np.ndarray, "3"]] = ()
) -> None:
    """Turn the cameras of all browsers, also of later ones, to a room.

    Args:
        server: The server of the page.
        scene: The room.
        shifts: Offsets of copies of the room [m].
    """
    eye, target = viewpoint(scene, shifts)
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = eye, target, np.array([0.0, 0.0, 1.0])
    for client in server.get_clients().values():
        client.camera.position, client.camera.look_at = eye, target


def viewpoint(
    scene: Scene, shifts: Sequence[Float[np.ndarray, "3"]] = ()
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the camera's position and target, seen from the side to which doors open [m]."""
    corners = room_bounds(scene)
    every = np.concatenate([corners, *(corners + np.asarray(shift)[:2] for shift in shifts)])
    low, high = every.min(0), every.max(0)
    size = float(np.linalg.norm(high - low))
    movable = [o.bounds.mean(0)[:2] for o in scene.objects if o.model.joints]
    middle = (low + high) / 2
    ahead = np.array([0.4, -1.0])
    if movable:
        front = in_front_of_parts(scene) - np.mean(movable, axis=0)
        if np.linalg.norm(front) > 0.1:
            ahead = front / np.linalg.norm(front) + 0.35 * np.array([-front[1], front[0]])
    ahead /= np.linalg.norm(ahead)
    eye = np.append(0.6 * ahead, 0.48) * size
    # The controls cover the right; the room is in the middle of the rest.
    aside = 0.1 * size * np.array([-ahead[1], ahead[0], 0.0])
    target = np.append(middle, 0.5) + aside
    return target + eye, target
