"""One configuration a stage; the pipeline's is all of them."""

from __future__ import annotations

from dataclasses import dataclass, field

from momapos.importance.config import ImportanceConfig
from momapos.manipulation.motion import MotionConfig
from momapos.manipulation.planner import PlannerConfig
from momapos.placement.place import PlaceConfig


@dataclass(frozen=True)
class PipelineConfig:
    """How a question is answered."""

    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    near: float = 0.05
    """A plan that comes this near to a box has its object modeled, and is checked again [m]."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    arm_clearance: float = 0.003
    """Distance that the arm's spheres keep from everything [m]."""
    timeout: float = 120.0
    """Time to search for one answer [s]; what is read and compiled before does not count."""
