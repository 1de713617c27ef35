"""One configuration a stage; the pipeline's is all of them, and the options of `momapos place`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from momapos.errors import refuse_below
from momapos.importance.config import ImportanceConfig, ScorerName
from momapos.manipulation.config import MotionConfig, PlannerConfig
from momapos.placement.config import PlaceConfig


@dataclass(frozen=True)
class PipelineConfig:
    """How a question is answered."""

    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    expand_distance: float = 0.05
    """A plan that comes this near to a box has its object modeled, and is checked again [m]."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    arm_clearance: float = 0.003
    """Distance that the arm's spheres keep from everything [m]."""
    timeout: float = 120.0
    """Time to search for one answer [s]; what is read and compiled before does not count."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "expand_distance", "arm_clearance")
        refuse_below(self, 0.001, "timeout")

    @property
    def ranking(self) -> ImportanceConfig:
        """How importance is measured: as asked for, else as the method does."""
        usual: ScorerName = "deepwalk" if self.place.method == "paper" else "reach"
        return replace(self.importance, scorer=self.importance.scorer or usual)
