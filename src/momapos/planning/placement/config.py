"""Configure the search for base poses. Imports nothing heavy: the command line shows it as help."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from momapos.core import InputError, refuse_above, refuse_below, refuse_values_below

Method = Literal[
    "ours", "exhaustive",
    "paper", "authors", "habitat", "m3", "reuleaux", "rm4d", "pycram", "behavior", "momagen",
]  # fmt: skip
OURS: tuple[Method, ...] = ("ours", "exhaustive")
"""Methods of the pipeline, which end with a grid. The others are baselines without one."""


MAX_SAMPLES, MAX_STEPS, MAX_ROUNDS = 100_000, 1_000, 6
"""Bounds of the counts; each round has twice as many samples as the one before [-]."""


@dataclass(frozen=True)
class PlaceConfig:
    """How base poses are sampled, ordered and checked."""

    method: Method = "ours"
    """Search method: ours (by expected cost), exhaustive (a grid), paper (MoMa-Pos as printed),
    authors (as in its authors' public code), or another baseline, see docs/baselines.md."""
    count: int = 512
    """Latin Hypercube samples in the first round [-]; each further round doubles it."""
    rounds: int = 3
    """Rounds of samples before the grid [-]."""
    grasps: int = 24
    """Maximum number of grasps tried at one base pose, best reached first [-]."""
    batch: int = 2
    """Number of base poses whose arm paths are planned together (ours); the cheapest wins [-]."""
    polish: int = 16
    """Maximum number of steps to cheaper base poses nearby (ours) [-]. 0: the first base pose that
    works is taken at once, without a comparison of robustness."""
    margin: float = 0.03
    """Base position error in x and y from which an arm path should still exist (ours) [m]."""
    margin_turn: float = 1.0
    """Base yaw error from which an arm path should still exist (ours) [deg]."""
    compared: int = 3
    """Maximum number of base poses whose robustness is tested; the most robust is taken (ours).
    0: the first that works [-]."""
    robust_radius: float = 0.0
    """Radius of the disc around the base pose in which replanning must succeed [m]."""
    robust_turn: float = 0.0
    """Maximum yaw error in that disc, to either side [deg]."""
    weight_driving: float = 1.0
    """Cost of one meter of driving (ours, exhaustive) [1/m]."""
    weight_robustness: float = math.inf
    """Cost of a base pose of no robustness; scales with the missing share. inf: the search compares
    the robustness of `compared` poses first, then the cost [-]."""
    weight_clearance: float = 0.0
    """Cost of each meter that the base's clearance falls short of 20 cm [1/m]."""
    weight_manipulability: float = 0.0
    """Cost of a singular arm configuration; others in proportion [-]."""
    weight_effort: float = 0.0
    """Cost of each radian of total joint travel [1/rad]."""
    departure: bool = True
    """Prefer base poses from which the robot can drive on after the task (ours)."""
    sweep_clearance: float = 0.1
    """Preferred clearance between the moving part and the base, for errors of the modeled joint
    (ours) [m]."""
    miss_cost: float = 2.0
    """Cost of a certain miss, as a driving length [m]."""
    grid_cell: float = 0.05
    """Cell size of the exhaustive grid [m]."""
    grid_turn: float = 10.0
    """Yaw step of the exhaustive grid [deg]."""
    grid: bool = True
    """Search the grid if no sample works."""
    whole_grid: bool = False
    """Screen the whole grid, even after the cheapest pose is found."""
    clearance: float = 0.01
    """Minimum distance of the base to everything [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "count", "grasps", "batch")
        refuse_above(self, MAX_SAMPLES, "count", "grasps")
        refuse_above(self, MAX_STEPS, "batch", "polish", "compared")
        refuse_above(self, MAX_ROUNDS, "rounds")
        refuse_values_below(
            self, 0, "rounds", "polish", "miss_cost", "clearance", "compared", "margin",
            "margin_turn", "sweep_clearance", "robust_radius", "robust_turn", "weight_driving",
            "weight_clearance", "weight_manipulability", "weight_effort",
        )  # fmt: skip
        if not self.weight_robustness >= 0:
            raise InputError(
                f"weight_robustness must be at least 0, or inf, not {self.weight_robustness:g}"
            )
        refuse_values_below(self, 0.01, "grid_cell")
        refuse_values_below(self, 1.0, "grid_turn")
