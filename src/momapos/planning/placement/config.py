"""How base poses are searched; nothing heavy is imported, so that commands can show it at once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from momapos.core import InputError, refuse_below

Method = Literal[
    "ours", "exhaustive",
    "paper", "habitat", "m3", "reuleaux", "rm4d", "pycram", "behavior", "momagen",
]  # fmt: skip
OURS: tuple[Method, ...] = ("ours", "exhaustive")
"""Methods of the pipeline, which end with a grid; the others are baselines, which give up."""


@dataclass(frozen=True)
class PlaceConfig:
    """How base poses are sampled, ordered and checked."""

    method: Method = "ours"
    """ours: by expected cost; exhaustive: a grid; paper: MoMa-Pos as printed; the others: as their
    authors choose base poses, see docs/baselines.md."""
    count: int = 512
    """Latin Hypercube samples in the first round [-]; each further round has twice as many."""
    rounds: int = 3
    """Rounds before the grid decides [-]."""
    grasps: int = 24
    """Grasps tried at one base pose, best reached first [-]."""
    together: int = 2
    """Candidates whose arm paths are looked for together (ours); the cheapest wins [-]."""
    improve: int = 16
    """Most steps from the base pose that is chosen to cheaper ones beside it (ours) [-]."""
    margin: float = 0.03
    """How far off the base may end in x and in y, from where a motion should still be found (ours)
    [m]."""
    margin_turn: float = 1.0
    """The same of its yaw [deg]."""
    looks: int = 3
    """Base poses whose margin is looked at, until one has all of it; the one with most of it is
    taken (ours); 0: the first that works [-]."""
    robust_radius: float = 0.0
    """Radius of a disc around the base pose from all of which the motion has to be found [m]."""
    robust_turn: float = 0.0
    """How far the base may be turned there, to either side [deg]."""
    weight_driving: float = 1.0
    """What each meter of driving adds to a base pose's cost (ours, exhaustive) [1/m]."""
    weight_room: float = math.inf
    """What no room to be off by --margin adds to it, a part of the room in proportion; inf: room
    is compared first, among --looks poses, then the cost [-]."""
    weight_clearance: float = 0.0
    """What each meter adds by which the base is nearer than 20 cm to anything [1/m]."""
    weight_manipulability: float = 0.0
    """What an arm adds that comes to a singular state, any other in proportion [-]."""
    weight_effort: float = 0.0
    """What each radian adds by which the arm's joints turn, in sum [1/rad]."""
    way_on: bool = True
    """Whether base poses from which the robot can drive on after the task come first (ours)."""
    sweep_room: float = 0.1
    """What the moving part should pass the base by, where it can: joints are not quite where they
    are modeled (ours) [m]."""
    miss: float = 2.0
    """Driving length that a certain miss is worth [m]."""
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
        refuse_below(self, 1, "count", "grasps", "together")
        refuse_below(self, 0, "rounds", "improve", "miss", "clearance", "looks", "margin")
        refuse_below(self, 0, "margin_turn", "sweep_room", "robust_radius", "robust_turn")
        refuse_below(self, 0, "weight_driving", "weight_clearance")
        refuse_below(self, 0, "weight_manipulability", "weight_effort")
        if not self.weight_room >= 0:
            raise InputError(f"--weight-room must be at least 0, or inf, not {self.weight_room:g}")
        refuse_below(self, 0.005, "grid_cell")
        refuse_below(self, 0.5, "grid_turn")
