"""Assumptions about the invisible dimensions of furniture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from momapos.core import refuse_below

DOOR_THICKNESS = (0.02, 0.06)
"""Thickness of a door in the face's plane, and maximum thickness of a protruding one [m]."""
PART_GAP = 0.002
"""Gap between a moving part and what is next to and behind it [m]."""
MAX_PASSED = 0.5
"""If the object next to a hinge protrudes beyond the face by more than this share of the door's
width, like a wall, the hinge lies in the front [-]."""
TRAY_SHARE = 0.85
"""Depth of a drawer relative to the space for it [-]."""


@dataclass(frozen=True)
class ModelConfig:
    """Dimensions of furniture that cannot be seen."""

    grid: int | None = None
    """Grid steps across the face to which parts snap, 12 as in URDFormer; None: no grid."""
    panel: float = 0.018
    """Thickness of the body's walls [m]."""
    hinge_depth: float = 0.01
    """Distance of a door's hinge behind its front, about half the thickness of a leaf [m]."""
    tight_hinge_depth: float = 0.005
    """The same if another object is next to the hinge: half of the doors with neighbors turn about
    their front, half about an axis 1 to 2 cm deep [m]."""
    turn: float = np.pi / 2
    """Opening angle of doors [rad]."""
    travel: float = 0.4
    """Maximum travel of drawers [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "panel", "hinge_depth", "tight_hinge_depth", "turn", "travel")
        if self.grid is not None:
            refuse_below(self, 1, "grid")
