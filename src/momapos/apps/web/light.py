"""The light on the page: as of a room by day with shadows, or plain.

Without a graphics card most of the time of a picture goes by its pixels: shadows are looked up in
three maps, and what the sky gives to a surface in a picture of it. Plain light is computed of the
way that a surface faces alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from momapos.model.scene import Scene

from .room_view import large

if TYPE_CHECKING:
    from viser import SceneApi

    from .panel import Panel

NAME = "/light"
SKY, GROUND = (255, 255, 255), (150, 150, 150)
BRIGHT = 2.4
"""Of plain light; the room is then as bright as by day [-]."""
DAY = "city"
"""The picture of a sky that pages have at first."""


class Light:
    """Lights the room. What is set already is not sent again."""

    def __init__(self, api: SceneApi, panel: Panel) -> None:
        self._api, self._panel = api, panel
        self._sky: Any = None
        """What plain light comes from; None by day."""

    def of_room(self, scene: Scene) -> None:
        """Light another room: a large one plainly, until a person says otherwise."""
        self._panel.plain.value = large(scene)
        self.changed()

    def changed(self) -> None:
        """A person, or another room, wants other light."""
        plain = bool(self._panel.plain.value)
        if plain == (self._sky is not None):
            return
        self._api.configure_default_lights(cast_shadow=not plain)
        self._api.configure_environment_map(None if plain else DAY)
        if plain:
            self._sky = self._api.add_light_hemisphere(
                NAME, sky_color=SKY, ground_color=GROUND, intensity=BRIGHT
            )
        else:
            self._sky.remove()
            self._sky = None
