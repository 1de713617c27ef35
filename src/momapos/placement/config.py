"""How base poses are searched; nothing heavy is imported, so that commands can show it at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from momapos.errors import refuse_below

Method = Literal["ours", "paper", "exhaustive"]


@dataclass(frozen=True)
class PlaceConfig:
    """How base poses are sampled, ordered and checked."""

    method: Method = "ours"
    """ours: by expected cost; paper: open tours over groups, as MoMa-Pos; exhaustive: a grid."""
    count: int = 512
    """Latin Hypercube samples in the first round [-]; each further round has twice as many."""
    rounds: int = 3
    """Rounds before the grid decides [-]."""
    grasps: int = 24
    """Grasps tried at one base pose, best reached first [-]."""
    together: int = 2
    """Candidates whose arm paths are looked for together (ours); the cheapest wins [-]."""
    improve: int = 6
    """Cheaper candidates that are looked at besides, once some have a path (ours) [-]."""
    miss: float = 2.0
    """Driving length that a certain miss is worth [m]."""
    group: int = 10
    """T: candidates in one open tour (paper) [-]."""
    k_distance: float = 5 / 6
    """k1: weight of distance in the open tour (paper) [-]."""
    k_potential: float = 1 / 6
    """k1': weight of potential in the open tour (paper) [-]."""
    grid_cell: float = 0.05
    """Cell of the exhaustive grid [m]."""
    grid_turn: float = 10.0
    """Turn between yaws of the exhaustive grid [deg]."""
    grid: bool = True
    """Whether the grid decides where no sample works [-]."""
    whole_grid: bool = False
    """Whether the grid is screened to its end, even after the cheapest pose is found."""
    clearance: float = 0.01
    """Distance that the base keeps from everything [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "count", "grasps", "together", "group")
        refuse_below(self, 0, "rounds", "improve", "miss", "k_distance", "k_potential", "clearance")
        refuse_below(self, 0.005, "grid_cell")
        refuse_below(self, 0.5, "grid_turn")
