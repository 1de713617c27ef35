"""Draw the materials of objects whose files have no colors.

A kitchen has one kind of cabinet front and one kind of steel, so the draw is per category and room,
with small differences between objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .surfaces import Paint

if TYPE_CHECKING:
    from jaxtyping import Float

Role = Literal["body", "front", "handle"]
"""Role of a shape in its object: fixed body, moving front, or handle."""
RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """Color and grain of a surface."""

    color: RGB
    """sRGB color, in [0, 1]."""
    strength: float = 0.03
    """Relative brightness amplitude of the grain [-]."""
    frequency: RGB = (40.0, 40.0, 40.0)
    """Frequency of the grain along x, y, z [1/m]."""


WOOD = (55.0, 55.0, 3.0)
BOARDS = (2.5, 40.0, 40.0)
FINE = (180.0, 180.0, 180.0)
BRUSHED = (4.0, 4.0, 220.0)

CABINET = (
    Material((0.93, 0.92, 0.90), 0.02),
    Material((0.88, 0.84, 0.74), 0.02),
    Material((0.76, 0.60, 0.42), 0.16, WOOD),
    Material((0.46, 0.31, 0.20), 0.20, WOOD),
    Material((0.60, 0.66, 0.58), 0.03),
    Material((0.30, 0.36, 0.46), 0.04),
    Material((0.66, 0.67, 0.68), 0.03),
)
APPLIANCE = (
    Material((0.72, 0.73, 0.74), 0.05, BRUSHED),
    Material((0.94, 0.94, 0.94), 0.01),
    Material((0.62, 0.63, 0.65), 0.06, BRUSHED),
    Material((0.16, 0.16, 0.17), 0.03),
)
STONE = (
    Material((0.42, 0.42, 0.43), 0.22, FINE),
    Material((0.85, 0.84, 0.82), 0.10, FINE),
    Material((0.22, 0.21, 0.21), 0.25, FINE),
    Material((0.66, 0.58, 0.48), 0.18, FINE),
    Material((0.62, 0.45, 0.29), 0.18, BOARDS),
)
WALL = (
    Material((0.92, 0.91, 0.88), 0.025, (9.0, 9.0, 9.0)),
    Material((0.86, 0.87, 0.84), 0.025, (9.0, 9.0, 9.0)),
    Material((0.84, 0.80, 0.74), 0.025, (9.0, 9.0, 9.0)),
)
FLOOR = (
    Material((0.62, 0.48, 0.35), 0.22, BOARDS),
    Material((0.52, 0.51, 0.50), 0.12, (25.0, 25.0, 25.0)),
    Material((0.70, 0.66, 0.60), 0.10, (25.0, 25.0, 25.0)),
)
BRIGHT = (
    Material((0.80, 0.16, 0.14)),
    Material((0.16, 0.36, 0.72)),
    Material((0.95, 0.75, 0.15)),
    Material((0.20, 0.55, 0.30)),
    Material((0.85, 0.42, 0.14)),
    Material((0.55, 0.22, 0.55)),
)
METAL = (
    Material((0.20, 0.20, 0.21), 0.03),
    Material((0.30, 0.29, 0.28), 0.05),
    Material((0.12, 0.12, 0.12), 0.02),
    Material((0.48, 0.48, 0.49), 0.06),
)
KINDS: tuple[tuple[tuple[str, ...], tuple[Material, ...]], ...] = (
    (("fridge", "oven", "microwave", "dishwasher", "hood", "range", "stove"), APPLIANCE),
    (("counter", "basin"), STONE),
    (("wall",), WALL),
    (("cabinet", "sink", "island", "drawer", "table", "chair", "shelf", "furniture"), CABINET),
)
"""Words in a category, and the materials of such objects; the first match counts."""


class Palette:
    """The materials of one room."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._seed = int(rng.integers(2**63))

    def floor(self) -> Material:
        """Draw the material of the floor."""
        return self._draw(FLOOR, "floor")

    def material(self, name: str, category: str, role: Role, paint: Paint) -> Material:
        """Draw the material of a part.

        Args:
            name: Name of the object.
            category: Category of the object.
            role: Role of the part in the object.
            paint: Color in the object's files; None if they have none.
        """
        kinds = KINDS if category != "wall_cabinet" else KINDS[3:]
        offered = next((m for words, m in kinds if any(w in category for w in words)), None)
        if paint is not None:
            base = Material(paint)
        elif offered is None:
            base = self._draw(BRIGHT, category, name)
        elif role == "handle":
            base = self._draw(METAL, "handle", "" if offered is CABINET else category)
        else:
            # The cabinets of a kitchen have one material; the appliances often differ.
            base = self._draw(offered, "" if offered is CABINET else category)
        shift = self._rng("tint", name).normal(0.0, 0.004, 3)
        shift += self._rng("shade", name, role).normal(0.0, 0.015)
        shade = 0.93 if role == "body" and offered in (CABINET, APPLIANCE) else 1.0
        r, g, b = np.clip(shade * np.array(base.color) + shift, 0.02, 0.98).tolist()
        return Material((r, g, b), base.strength, base.frequency)

    def _draw(self, offered: Sequence[Material], *words: str) -> Material:
        return offered[int(self._rng(*words).integers(len(offered)))]

    def _rng(self, *words: str) -> np.random.Generator:
        """Return a generator seeded by names, so that an added object changes no other."""
        return np.random.default_rng([self._seed, *"\0".join(words).encode()])


def linear(color: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Convert an sRGB color to linear light (gamma 2.2)."""
    return np.asarray(color, float) ** 2.2
