"""Configuration of the classical segmenter."""

from __future__ import annotations

from dataclasses import dataclass, field

from .cabinet_extent import CabinetExtentConfig
from .front_planes import FrontPlaneConfig
from .room_shell import RoomConfig
from .supports import SupportConfig

BACK_THICKNESS = 0.2
"""Maximum thickness of a back, including its inclination [m]."""
MIN_SMALL_POINTS = 14
"""The same for objects on a surface [-]."""
MAX_OVERHANG = 0.09
"""Fronts and handles protrude by up to this from under a top or from a front [m]."""
SEAT = (0.6, 0.35)
"""Tops lower [m] and smaller [m2] than this are seats, and objects on them are backs."""
MIN_SLAB_LENGTH = 1.2
"""Tops at least this long are countertops across several pieces of furniture [m]."""
TOUCHING = 0.05
"""Furniture closer than this is one piece, unless planes divide it [m]."""
TOUCHING_SMALL = 0.025
"""The same for objects on a surface [m]."""


@dataclass(frozen=True)
class SegmentConfig:
    """How a room is segmented."""

    room: RoomConfig = field(default_factory=RoomConfig)
    support: SupportConfig = field(default_factory=SupportConfig)
    front: FrontPlaneConfig = field(default_factory=FrontPlaneConfig)
    extent: CabinetExtentConfig = field(default_factory=CabinetExtentConfig)
    least_points: int = 25
    """Smaller groups of points are noise [-]."""
    reach: float = 0.5
    """Maximum height of objects on a surface [m]; cabinets hang above it."""
    lift: float = 0.015
    """Points this far above a surface do not belong to it [m]."""
    lip: float = 0.07
    """Fronts end at most this far below their top [m]."""
    slab: float = 0.04
    """Thickness of a countertop [m]. It is an object of its own."""
    closed: float = 0.45
    """Furniture is open, like a table, if surfaces cover less than this share of each side [-]."""
    open: float = 0.1
    """A corner is empty if the floor is seen on more than this share of it [-]."""
    tall: float = 1.2
    """Tops above this are hardly visible: fronts define such furniture [m]."""
    flat: float = 0.08
    """Objects that protrude less from a wall belong to it [m]."""
    corner: float = 0.35
    """A row is divided where its front ends this far from its own end: the rest is a corner behind
    other furniture [m]."""
    back: float = 0.7
    """Maximum height of a back above its seat [m]."""
    shelf: float = 0.4
    """Open furniture at a wall that is less deep is a shelf, not a table [m]."""
