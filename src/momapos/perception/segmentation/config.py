"""How a room is divided into things: every length and share in one record."""

from __future__ import annotations

from dataclasses import dataclass, field

from .cabinet_extent import CabinetExtentConfig
from .front_planes import FrontPlaneConfig
from .room_shell import RoomConfig
from .supports import SupportConfig


@dataclass(frozen=True)
class SegmentConfig:
    """How a room is divided."""

    room: RoomConfig = field(default_factory=RoomConfig)
    support: SupportConfig = field(default_factory=SupportConfig)
    front: FrontPlaneConfig = field(default_factory=FrontPlaneConfig)
    extent: CabinetExtentConfig = field(default_factory=CabinetExtentConfig)
    touching: float = 0.05
    """Pieces of furniture nearer than this to each other are one, unless planes divide them [m]."""
    touching_small: float = 0.025
    """The same for things on a surface [m]."""
    least_points: int = 25
    """Groups of fewer points are noise [-]."""
    least_small: int = 14
    """The same for things on a surface [-]."""
    reach: float = 0.5
    """Things on a surface are this high at most [m]; cabinets hang above it."""
    lift: float = 0.015
    """Points this far above a surface do not belong to it [m]."""
    overhang: float = 0.09
    """Fronts and handles stand out from under a top, or in front of a front, by this [m]."""
    lip: float = 0.07
    """Fronts end this far below the top that they belong to, at most [m]."""
    slab: float = 0.04
    """Thickness of a counter's top [m]; it is a thing of its own, above cabinets and machines."""
    slab_length: float = 1.2
    """Tops at least this long are a slab across several pieces of furniture [m]."""
    closed: float = 0.45
    """Share of its fullest side that is seen to be closed, below which furniture is open: a table
    stands on legs [-]."""
    open: float = 0.1
    """Share of a corner on which the floor is seen, above which nothing stands in it [-]."""
    tall: float = 1.2
    """Tops above this are seen in part, if at all: fronts say more about the furniture [m]."""
    flat: float = 0.08
    """What stands out from a wall by less is left to the wall [m]."""
    corner: float = 0.35
    """Furniture is divided where its front ends this far from its own end: the rest is a corner,
    behind other furniture [m]."""
    seat: tuple[float, float] = (0.6, 0.35)
    """Tops lower [m] and smaller [m2] than this are seats: what rises from them is a back."""
    back: float = 0.7
    """Backs rise from seats by this, at most [m]."""
    back_thick: float = 0.2
    """And are this thick, at most, leaning backward included [m]."""
    shelf: float = 0.4
    """Open furniture at a wall that is less deep than this is a shelf, not a table [m]."""
