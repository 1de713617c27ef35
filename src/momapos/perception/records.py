"""What a scan becomes on its way to a scene: its configuration, survey, decisions and model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.model.records import (
    ArticulationPredictor,
    Cloud,
    Detection,
    Detector,
    Frame,
    ImageDetection,
    OpenLeaf,
    Part,
    Segmenter,
)
from momapos.model.scene import SceneObject
from momapos.model.scene.library import Piece
from momapos.perception.detection import VoteConfig
from momapos.perception.fusion import (
    CompletionConfig,
    FusionConfig,
    GravityConfig,
    RegistrationConfig,
)
from momapos.perception.reconstruction import ModelConfig, SeenMotion, SeenMotionConfig
from momapos.perception.segmentation import (
    BoxConfig,
    OpenLeafConfig,
    PixelOf,
    PointAt,
    Room,
    RoomConfig,
)
from momapos.perception.views import RowConfig, Seen, View, ViewConfig

if TYPE_CHECKING:
    from jaxtyping import Float

Progress = Callable[[str, float], None]
"""Told what is at work, and the share of the whole that is done."""
Found = Mapping[str, Sequence[ImageDetection]]
"""What a 2-D detector found, by the frame's name."""
Target: TypeAlias = str | PointAt | PixelOf
"""The object of a task: its name, or where it is."""


@dataclass(frozen=True)
class ScanConfig:
    """How a scan becomes a scene."""

    voxel: float = 0.015
    """Edge of the voxels that depth images are fused in [m]."""
    least_sides: tuple[float, float] = (0.1, 0.2)
    """Things whose shortest or middle edge is shorter than this have no doors or drawers [m]."""
    fusion: FusionConfig = field(default_factory=FusionConfig)
    completion: CompletionConfig = field(default_factory=CompletionConfig)
    """Which holes in depth images are taken for black, mirrored or glass fronts."""
    gravity: GravityConfig = field(default_factory=GravityConfig)
    open_leaves: OpenLeafConfig = field(default_factory=OpenLeafConfig)
    """What is taken for a door that stands open."""
    room: RoomConfig = field(default_factory=RoomConfig)
    boxes: BoxConfig = field(default_factory=BoxConfig)
    rows: RowConfig = field(default_factory=RowConfig)
    votes: VoteConfig = field(default_factory=VoteConfig)
    """When the images are believed about what a thing is."""
    view: ViewConfig = field(default_factory=ViewConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    """How a second scan is brought to the first."""
    seen_motion: SeenMotionConfig = field(default_factory=SeenMotionConfig)
    """How parts are found that moved between them."""


@dataclass(frozen=True, eq=False)
class Tools:
    """The parts that can be exchanged."""

    segment: Segmenter
    look: ArticulationPredictor
    """Tells fronts from other faces, and where a row is to be cut."""
    predict: ArticulationPredictor
    """Finds the parts of an object; often the same as `look`."""
    guess: ArticulationPredictor | None = None
    """Asked where `predict` sees a front but no parts on it."""
    detect: Detector | None = None
    """Tells in the images what things are; without one their sizes do."""


class PartSource(StrEnum):
    """Where the parts of an object are from."""

    PREDICTED = "predicted"
    """Seen on the images."""
    GUESSED = "guessed"
    """From a template, for a front on which nothing was seen."""
    GIVEN = "given"
    """A URDF file of the user's."""


@dataclass(frozen=True, eq=False)
class Decision:
    """What was decided about one object, and why."""

    detection: Detection
    importance: float | None
    """Score against the target; None where no target was named."""
    view: View | None
    """Its front; None where it was not looked for, or none was seen."""
    parts: tuple[Part, ...]
    source: PartSource | None
    """Where the parts are from; None for a box."""
    reason: str
    """Why it stays a box; "" where it is modeled."""
    looked: bool = True
    """Whether it mattered enough to be looked at."""
    seconds: float = 0.0
    model: Piece | SceneObject | None = None
    """What stands in the scene; None for a box."""
    warnings: tuple[str, ...] = ()
    moved: Mapping[str, SeenMotion] = field(default_factory=dict)
    """Parts that stand elsewhere in the second scan, or stand open in the only one, by name."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What stands in a scanned room, before anything of it is modeled."""

    cloud: Cloud
    """The room, upright."""
    frames: tuple[Frame, ...]
    """The images, with poses in the upright world."""
    T_scene_scan: Float[np.ndarray, "4 4"]
    room: Room
    detections: tuple[Detection, ...]
    walls: tuple[Detection, ...]
    rows: tuple[Seen, ...]
    """What was seen on rows of furniture when they were cut, after the leaves that stand open."""
    leaves: tuple[OpenLeaf, ...]
    """Doors and flaps that stand open; in the cloud and the images they are shut."""
    found: Found | None
    """What another program found in the images; None where there is no such file."""
    timing: Mapping[str, float]
    """Seconds by stage."""


@dataclass(frozen=True, eq=False)
class Modeled:
    """A scene made from a scan, with all that was decided on the way."""

    scene: Path
    cloud: Cloud
    """The room, upright."""
    frames: tuple[Frame, ...]
    """The images, with poses in the upright world."""
    T_scene_scan: Float[np.ndarray, "4 4"]
    decisions: tuple[Decision, ...]
    timing: Mapping[str, float] = field(default_factory=dict)
    """Seconds by stage, and "total"."""
    target: str | None = None
    """Name of the object that the task is about, where one was given."""


def silent(what: str, share: float) -> None:
    """Progress that nobody wants to see."""
    del what, share
