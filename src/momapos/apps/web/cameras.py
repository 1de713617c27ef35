"""Poses of the browsers' cameras, and the light and sky of the page.

Without a graphics card most of a frame's time is spent per pixel: on shadow maps and on the
environment map. Plain light depends on the direction of a surface only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps.plots import room_bounds
from momapos.core.geometry import rotation
from momapos.model.scene import Scene
from momapos.planning.grasps import in_front_of_parts, opening_direction

from .panel import Panel, set_theme
from .room_view import DARK, LIGHT, Look, RoomView, large, sky

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from viser import SceneApi, ViserServer


FIELD = np.radians(50.0)
"""Vertical field of view [rad]."""
ASIDE = 0.2
"""Offset of the picture to the left, where the controls leave room, as a share of its height
[-]."""
MARGIN = 1.12
"""Distance of the camera relative to the one at which all fits [-]."""
TALL, WIDE = 1.5, 0.45
"""Height and half width around the base that a view of a task contains [m]."""
AZIMUTHS, ELEVATIONS = 36, np.radians((16.0, 22.0, 30.0, 42.0, 56.0))
"""Number of azimuths, and elevations, that are compared [-], [rad]."""
OBLIQUE, LEVEL = np.radians(42.0), np.radians(22.0)
"""A view from aside of the front and from above shows depth [rad]."""
BODY = np.array([[-0.35, -0.35, 0.0], [0.35, 0.35, 1.2]])
"""Box around a base and its arm [m]."""
FRONT_WEIGHT = 0.7
"""Visible share that a view may lose to show the front [-]."""
SKEW_WEIGHT, STEEP_WEIGHT = 0.35, 0.5
"""Visible shares that a view may lose to be better by 1 rad [1/rad]."""


def look_at(server: ViserServer, scene: Scene) -> None:
    """Turn the cameras of all browsers, also of later ones, to a room."""
    turn(server, *viewpoint(scene))


def turn(server: ViserServer, eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"]) -> None:
    """Set the cameras of all browsers, also of later ones [m]."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.up = eye, target, np.array([0.0, 0.0, 1.0])
    camera.fov = float(FIELD)
    for client in server.get_clients().values():
        client.camera.position, client.camera.look_at = eye, target


def frame(
    server: ViserServer,
    scene: Scene,
    target: str,
    bases: Float[np.ndarray, "n 3"],
    *,
    close: float = 1.0,
) -> None:
    """Turn the cameras of all browsers to a task; to the room if there is none.

    Args:
        server: The server of the page.
        scene: The room.
        target: The object, or "object/joint".
        bases: Poses of the base that the view contains: x [m], y [m], yaw [rad].
        close: As for `task_viewpoint`.
    """
    name = target.partition("/")[0]
    if all(item.name != name for item in scene.objects):
        look_at(server, scene)
    else:
        front = front_of(scene, target, bases[-1])
        turn(server, *task_viewpoint(scene, name, front, bases, close=close))


def front_of(scene: Scene, target: str, base: Float[np.ndarray, "3"]) -> Float[np.ndarray, "2"]:
    """Return the direction in which a part opens, or else the one from the object to the base."""
    name, _, joint = target.partition("/")
    item = scene.object(name)
    opens = opening_direction(item, joint)[1][:2] if joint else np.zeros(2)
    away = base[:2] - item.bounds.mean(0)[:2]
    return next((way for way in (opens, away) if np.hypot(*way) > 0.1), np.array([0.0, -1.0]))


def viewpoint(scene: Scene) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the camera's position and target, seen from the side to which doors open [m]."""
    low, high = room_bounds(scene)
    size = float(np.linalg.norm(high - low)) * 1.35
    movable = [o.bounds.mean(0)[:2] for o in scene.objects if o.model.joints]
    middle = (low + high) / 2
    ahead = np.array([0.4, -1.0])
    if movable:
        front = in_front_of_parts(scene) - np.mean(movable, axis=0)
        if np.linalg.norm(front) > 0.1:
            ahead = front / np.linalg.norm(front) + 0.35 * np.array([-front[1], front[0]])
    ahead /= np.linalg.norm(ahead)
    eye = np.append(0.6 * ahead, 0.48) * size
    return aside(np.append(middle, 0.5) + eye, np.append(middle, 0.5))


def task_viewpoint(
    scene: Scene,
    name: str,
    front: Float[np.ndarray, "2"],
    bases: Float[np.ndarray, "n 3"],
    *,
    close: float = 1.0,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return a camera that frames an object and a robot, from where nothing hides them [m].

    Args:
        scene: The room.
        name: The object of the task.
        front: Direction to which the object's front faces, not zero.
        bases: Poses of the base that the view contains: x [m], y [m], yaw [rad].
        close: Distance relative to the one that fits all [-].
    """
    low, high = scene.object(name).bounds
    corners = np.stack(np.meshgrid(*np.stack([low, high]).T, indexing="ij"), -1).reshape(-1, 3)
    box = np.array([[x, y, z] for x in (-WIDE, WIDE) for y in (-WIDE, WIDE) for z in (0.1, TALL)])
    around = (np.column_stack([bases[:, :2], np.zeros(len(bases))])[:, None] + box).reshape(-1, 3)
    points = np.concatenate([corners, around])
    middle = (points.min(0) + points.max(0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    distance = close * MARGIN * radius / np.sin(FIELD / 2)
    azimuth = 2 * np.pi / AZIMUTHS * np.arange(AZIMUTHS)
    a, e = (grid.ravel() for grid in np.meshgrid(azimuth, ELEVATIONS))
    back = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    eyes = middle + distance * back
    skew = np.abs(np.arccos(np.clip(back[:, :2] @ front / np.cos(e) / np.hypot(*front), -1, 1)))
    boxes = np.array(
        [o.bounds for o in scene.objects if o.name != name and o.category != "wall"]
    ).reshape(-1, 2, 3)
    seen = 1.0 - hidden(eyes, np.concatenate([around, [(low + high) / 2]]), boxes).mean(1)
    # The robot must not hide the front on which it works.
    body = np.append(bases[-1, :2], 0.0) + BODY
    reach = np.abs((high - low)[:2] @ front / np.hypot(*front)) / 2
    heights = np.linspace(low[2], high[2], 5)[1:-1]
    face = np.append((low + high)[:2] / 2 + reach * front / np.hypot(*front), 0.0)
    worked = face + np.stack([np.zeros(3), np.zeros(3), heights], -1)
    score = seen - FRONT_WEIGHT * hidden(eyes, worked, body[None]).mean(1)
    score -= SKEW_WEIGHT * np.abs(skew - OBLIQUE) + STEEP_WEIGHT * np.abs(e - LEVEL)
    return aside(eyes[int(np.argmax(score))], middle)


def aside(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Move a camera to the right, as the controls cover the right of its picture [m]."""
    ahead = target - eye
    right = np.append(rotation(-np.pi / 2) @ ahead[:2], 0.0)
    shift = ASIDE * 2 * np.tan(FIELD / 2) * np.linalg.norm(ahead) * right / np.linalg.norm(right)
    return eye + shift, target + shift


def hidden(
    eyes: Float[np.ndarray, "e 3"],
    points: Float[np.ndarray, "p 3"],
    boxes: Float[np.ndarray, "b 2 3"],
) -> Bool[np.ndarray, "e p"]:
    """Return which points a box hides from which eye, by the slabs of the box.

    Args:
        eyes: Positions of cameras [m].
        points: Points [m].
        boxes: Lower and upper corners [m].
    """
    found = np.zeros((len(eyes), len(points)), bool)
    if not len(boxes):
        return found
    for k, eye in enumerate(eyes):  # bounded: one row of views; all at once would take a gigabyte
        ways = points - eye
        with np.errstate(divide="ignore", invalid="ignore"):
            at = np.sort((boxes[None] - eye) / ways[:, None, None], axis=2)
        enters, leaves = np.nanmax(at[:, :, 0], axis=-1), np.nanmin(at[:, :, 1], axis=-1)
        found[k] = ((enters < leaves) & (leaves > 0.0) & (enters < 0.98)).any(1)
    return found


SKY_NODE, SUN_NODE = "/light/sky", "/light/sun"
SKY, GROUND = (255, 255, 255), (150, 146, 140)
PLAIN_INTENSITY = 2.4
"""Makes the room as bright as daylight does [-]."""
DAY, DAY_INTENSITY = "apartment", 0.35
"""The environment map, whose reflections show curved surfaces, and its intensity [-]."""
SUN = (0.45, -0.6, 1.0)
"""Direction of the sun; the visible faces of furniture against a wall differ in brightness."""


class Light:
    """Lights the room, and sends only changes."""

    def __init__(self, server: ViserServer, panel: Panel, room: RoomView) -> None:
        self._server, self._api, self._panel, self._room = server, server.scene, panel, room
        self._plain: bool | None = None
        self._look: Look | None = None
        self._lamps: list[Any] = []
        self._api.configure_default_lights(enabled=False, cast_shadow=False)
        panel.on_change(panel.plain, self.changed)
        panel.on_change(panel.dark, self.changed)
        self.changed()

    def of_room(self, scene: Scene) -> None:
        """Choose the light of another room: plain light for a large one."""
        self._panel.plain.value = large(scene)
        self.changed()

    def changed(self) -> None:
        """Apply the light that the panel selects."""
        plain, look = bool(self._panel.plain.value), DARK if self._panel.dark.value else LIGHT
        if (plain, look) == (self._plain, self._look):
            return
        if look is not self._look:
            set_theme(self._server.gui, dark=look is DARK)
            self._api.set_background_image(sky(look), format="png")
            self._room.set_look(look)
        for lamp in self._lamps:
            lamp.remove()
        self._lamps = lamps(self._api, look, plain=plain)
        if plain != self._plain:
            self._api.configure_environment_map(
                None if plain else DAY, environment_intensity=DAY_INTENSITY
            )
        self._plain, self._look = plain, look


def lamps(api: SceneApi, look: Look, *, plain: bool) -> list[Any]:
    """Add the lamps of a look.

    Args:
        api: Where to draw.
        look: The look.
        plain: Whether to leave out the sun, which casts shadows.
    """
    ambient = PLAIN_INTENSITY * look.ambient / LIGHT.ambient if plain else look.ambient
    lit = [
        api.add_light_hemisphere(SKY_NODE, sky_color=SKY, ground_color=GROUND, intensity=ambient)
    ]
    if not plain:
        lit.append(api.add_light_directional(
            SUN_NODE, intensity=look.sun, cast_shadow=True, position=SUN
        ))  # fmt: skip
    return lit
