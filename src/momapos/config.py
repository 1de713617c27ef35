"""One configuration a stage; the pipeline's is all of them."""

from __future__ import annotations

from dataclasses import dataclass, field

from momapos.importance.scorers import ImportanceConfig
from momapos.manipulation.motion import MotionConfig
from momapos.manipulation.planner import PlannerConfig
from momapos.perception.boxes import BoxConfig
from momapos.perception.fusion import FusionConfig
from momapos.perception.gravity import GravityConfig
from momapos.perception.planes import RoomConfig
from momapos.perception.rows import RowConfig
from momapos.perception.views import ViewConfig
from momapos.placement.place import PlaceConfig
from momapos.reconstruction.model import ModelConfig


@dataclass(frozen=True)
class PipelineConfig:
    """How a question is answered."""

    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    near: float = 0.05
    """A plan that comes this near to a box has its object modelled, and is checked again [m]."""
    motion: MotionConfig = field(default_factory=MotionConfig)
    place: PlaceConfig = field(default_factory=PlaceConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    arm_clearance: float = 0.003
    """Distance that the arm's spheres keep from everything [m]."""
    timeout: float = 30.0
    """Time for one answer [s]."""


@dataclass(frozen=True)
class ScanConfig:
    """How a scan becomes a scene."""

    voxel: float = 0.015
    """Edge of the voxels that depth pictures are fused in [m]."""
    least_sides: tuple[float, float] = (0.1, 0.2)
    """Things whose shortest or middle edge is shorter than this have no doors or drawers [m]."""
    fusion: FusionConfig = field(default_factory=FusionConfig)
    gravity: GravityConfig = field(default_factory=GravityConfig)
    room: RoomConfig = field(default_factory=RoomConfig)
    boxes: BoxConfig = field(default_factory=BoxConfig)
    rows: RowConfig = field(default_factory=RowConfig)
    view: ViewConfig = field(default_factory=ViewConfig)
    importance: ImportanceConfig = field(default_factory=ImportanceConfig)
    """Which objects are modelled when a target is named."""
    model: ModelConfig = field(default_factory=ModelConfig)
