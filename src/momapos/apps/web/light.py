"""The light of the page: daylight with shadows, or plain light.

Without a graphics card most of a frame's time is spent per pixel: on three shadow maps and on the
environment map. Plain light depends on the direction of a surface only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from momapos.model.scene import Scene

from .panel import Panel
from .room_view import large

if TYPE_CHECKING:
    from viser import SceneApi

NAME = "/light"
SKY, GROUND = (255, 255, 255), (150, 150, 150)
PLAIN_INTENSITY = 2.4
"""Makes the room as bright as daylight does [-]."""
DAY = "city"
"""The environment map that viser starts with."""


class Light:
    """Lights the room, and sends only changes."""

    def __init__(self, api: SceneApi, panel: Panel) -> None:
        self._api, self._panel = api, panel
        self._plain: Any = None
        """The source of plain light; None in daylight."""
        panel.on_change(panel.plain, self.changed)

    def of_room(self, scene: Scene) -> None:
        """Choose the light of another room: plain light for a large one."""
        self._panel.plain.value = large(scene)
        self.changed()

    def changed(self) -> None:
        """Apply the light that the panel selects."""
        plain = bool(self._panel.plain.value)
        if plain == (self._plain is not None):
            return
        self._api.configure_default_lights(cast_shadow=not plain)
        self._api.configure_environment_map(None if plain else DAY)
        if plain:
            self._plain = self._api.add_light_hemisphere(
                NAME, sky_color=SKY, ground_color=GROUND, intensity=PLAIN_INTENSITY
            )
        else:
            self._plain.remove()
            self._plain = None
