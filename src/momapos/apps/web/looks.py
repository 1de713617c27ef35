"""Materials, floor, walls and sky of the page, in light and dark.

Materials are pale and have no meaning; strong colors do, see `colors`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.scene import SceneObject

from .colors import rgb

if TYPE_CHECKING:
    from jaxtyping import UInt8

WOOD, METAL, PAINT, HANDLE = "#c8ae8e", "#c3cad1", "#e6e8ea", "#59626b"
SMALL_OBJECT = "#b99f7d"
MATERIALS = {
    WOOD: ("table", "chair", "counter", "desk", "shelf", "bench", "stool", "worktop", "bookcase"),
    METAL: ("fridge", "oven", "microwave", "dishwasher", "hood", "stove", "sink", "washer",
            "refrigerator", "cooktop", "toaster", "kettle"),
}  # fmt: skip
"""Words in the category of an object; any other is painted."""
SMALL_VOLUME = 0.02
"""Objects with a smaller bounding box are drawn like cups and fruit [m^3]."""
SKY_ROWS = 128
"""Height of the image of the sky [px]."""


@dataclass(frozen=True)
class Look:
    """Colors that depend on whether the page is dark."""

    zenith: str
    horizon: str
    ground: str
    """The sky from top to bottom."""
    floor: str
    wall: str
    sun: float
    """Intensity of the light with shadows [-]."""
    ambient: float
    """Intensity of the light from all directions [-]."""


LIGHT = Look("#bcd4ea", "#f2f6fa", "#e4e8ec", "#d3c7b5", "#f7f6f3", 1.9, 1.5)
DARK = Look("#0e141b", "#26323f", "#151b21", "#6a645c", "#59636e", 1.7, 0.9)


def sky(look: Look) -> UInt8[np.ndarray, "rows 2 3"]:
    """Return an image of the sky, whose horizon is in its middle."""
    stops = np.array([rgb(c) for c in (look.zenith, look.horizon, look.ground)], float)
    height = np.linspace(0.0, 1.0, SKY_ROWS)
    channels = [np.interp(height, [0.0, 0.55, 1.0], stops[:, k]) for k in range(3)]
    return np.repeat(np.stack(channels, -1)[:, None], 2, axis=1).round().astype(np.uint8)


def material(item: SceneObject) -> str:
    """Return the color of an object that has no part in the task."""
    if np.prod(np.ptp(item.bounds, axis=0)) < SMALL_VOLUME:
        return SMALL_OBJECT
    words = item.category.lower()
    return next(
        (color for color, kinds in MATERIALS.items() if any(kind in words for kind in kinds)), PAINT
    )
