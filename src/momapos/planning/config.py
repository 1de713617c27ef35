"""One configuration per stage, and the pipeline's, which contains all of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from momapos.core import InputError, refuse_above, refuse_below
from momapos.planning.arm_motion import Planner, PlannerConfig
from momapos.planning.grasps import MotionConfig
from momapos.planning.importance import ImportanceConfig, ScorerName
from momapos.planning.placement import Method, PlaceConfig

MAX_SAMPLES, MAX_BATCHES, MAX_GROUP = 100_000, 12, 1_000
"""Bounds of the counts of the paper's method [-]."""
BaseUse = Literal["fixed", "stops", "moving", "auto"]
RANKERS: dict[Method, ScorerName] = {"paper": "deepwalk", "authors": "node2vec"}
"""The scorer of each method that has one of its own."""
PLANNERS: dict[Method, Planner] = {"paper": "RRTstar", "authors": "RRTConnect"}
"""OMPL's planner of each method that has one of its own."""


@dataclass(frozen=True)
class PaperConfig:
    """MoMa-Pos as printed (method `paper`), sections III-C and III-D; see docs/paper.md.

    k0 and alpha are fields of `ImportanceConfig`.
    """

    samples: int = 100
    """M: Latin Hypercube samples in the first batch (paper) [-]; each further batch doubles it."""
    batches: int = 4
    """Batches before alpha is lowered (paper) [-]."""
    group: int = 10
    """T: candidates in one open tour (paper) [-]."""
    k_distance: float = 5 / 6
    """k1: weight of distance in the open tour (paper) [-]."""
    k_potential: float = 1 / 6
    """k1': weight of potential in the open tour (paper) [-]."""
    heights: tuple[float, ...] = (0.4, 1.0, 1.4)
    """z: heights at which the field F is sampled (paper) [m]."""
    field: bool = True
    """Whether the potential includes the field F (paper)."""
    inverse_map: bool = True
    """Whether the potential includes inverse reachability (paper)."""
    check_stops: bool = True
    """Whether RRT* checks the stops before the robot drives to one, as printed; else the first stop
    of the first tour is the proposal (paper)."""
    early_cull: bool = False
    """Whether samples from which the map doesn't reach the grasp are dropped (an addition)."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "samples", "batches", "group")
        refuse_above(self, MAX_SAMPLES, "samples")
        refuse_above(self, MAX_BATCHES, "batches")
        refuse_above(self, MAX_GROUP, "group")
        refuse_below(self, 0, "k_distance", "k_potential")
        if not self.heights:
            raise InputError("PaperConfig.heights must hold at least one number")


@dataclass(frozen=True)
class BaselineConfig:
    """What a method other than ours knows when it proposes base poses; the checks know all."""

    boxes: bool = False
    """Whether every object is its bounding box, as for MoMa-Pos's baselines."""
    one_grasp: bool = False
    """Whether there is only the simplest grasp, as for MoMa-Pos's baselines."""
    first_pose: bool = False
    """Whether the first base pose that a method proposes counts: the arm motion is planned there in
    the true scene, and no other base pose is tried. `paper` proposes a stop that RRT* accepts."""


@dataclass(frozen=True)
class PipelineConfig:
    """How a query is answered."""

    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    expand_distance: float = 0.05
    """If a plan comes this close to a box, its object is modeled and the plan checked again [m]."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    baselines: BaselineConfig = field(default_factory=BaselineConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    base: BaseUse = "fixed"
    """Whether the base stands at one pose, may stop up to three times where none serves the task
    (stops), may move while the hand holds (moving), or whichever works first (auto)."""
    arm_clearance: float = 0.003
    """Distance that the arm's spheres keep from everything [m]."""
    timeout: float = 120.0
    """Time limit for one answer, by default of processor time without compiling kernels [s]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "expand_distance", "arm_clearance")
        refuse_below(self, 0.001, "timeout")

    @property
    def arm_planner(self) -> PlannerConfig:
        """Return the arm planner's configuration; the method sets its default."""
        planner = PLANNERS.get(self.place.method)
        if self.planner.planner is None and planner is not None:
            return replace(self.planner, planner=planner)
        return self.planner

    @property
    def ranking(self) -> ImportanceConfig:
        """Return the configuration of importance; the method sets the scorer."""
        scorer = self.importance.scorer or RANKERS.get(self.place.method)
        return replace(self.importance, scorer=scorer).resolved
