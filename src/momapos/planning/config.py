"""One configuration a stage; the pipeline's is all of them, and the options of `momapos place`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from momapos.core import InputError, refuse_below
from momapos.planning.arm_motion import PlannerConfig
from momapos.planning.grasps import MotionConfig
from momapos.planning.importance import ImportanceConfig, ScorerName, WeightsName
from momapos.planning.placement import PlaceConfig


@dataclass(frozen=True)
class PaperConfig:
    """MoMa-Pos as printed (`--method paper`), sections III-C and III-D; see docs/paper.md.

    k0 and alpha are those of importance.
    """

    samples: int = 100
    """M: Latin Hypercube samples in the first batch (paper) [-]; each further has twice as many."""
    batches: int = 4
    """Batches before alpha is lowered (paper) [-]."""
    group: int = 10
    """T: candidates in one open tour (paper) [-]."""
    k_distance: float = 5 / 6
    """k1: weight of distance in the open tour (paper) [-]."""
    k_potential: float = 1 / 6
    """k1': weight of potential in the open tour (paper) [-]."""
    heights: tuple[float, ...] = (0.4, 1.0, 1.4)
    """z: heights from which the field looks at the target (paper) [m]."""
    field: bool = True
    """Whether the field F counts in the potential (paper)."""
    inverse_map: bool = True
    """Whether inverse reachability counts in the potential, and drops samples (paper)."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "samples", "batches", "group")
        refuse_below(self, 0, "k_distance", "k_potential")
        if not self.heights:
            raise InputError("heights must hold at least one number")


@dataclass(frozen=True)
class PipelineConfig:
    """How a question is answered."""

    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    expand_distance: float = 0.05
    """A plan that comes this near to a box has its object modeled, and is checked again [m]."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    arm_clearance: float = 0.003
    """Distance that the arm's spheres keep from everything [m]."""
    timeout: float = 120.0
    """Time to search for one answer [s]; what is read and compiled before does not count."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "expand_distance", "arm_clearance")
        refuse_below(self, 0.001, "timeout")

    @property
    def arm_planner(self) -> PlannerConfig:
        """How the arm gets to the first waypoint: as asked for, else as the method does."""
        if self.planner.planner is None and self.place.method == "paper":
            return replace(self.planner, planner="RRTstar")
        return self.planner

    @property
    def ranking(self) -> ImportanceConfig:
        """How importance is measured: as asked for, else as the method does."""
        printed = self.place.method == "paper"
        scorer: ScorerName = self.importance.scorer or ("deepwalk" if printed else "reach")
        weights: WeightsName = self.importance.weights or ("printed" if printed else "scaled")
        return replace(self.importance, scorer=scorer, weights=weights)
