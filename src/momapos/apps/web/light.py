"""The light and the sky of the page: a sun with shadows, or plain light; bright or dark.

Without a graphics card most of a frame's time is spent per pixel: on shadow maps and on the
environment map. Plain light depends on the direction of a surface only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from momapos.model.scene import Scene

from .looks import DARK, LIGHT, Look, sky
from .panel import Panel, set_theme
from .room_view import RoomView, large

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

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
