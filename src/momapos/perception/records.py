"""Records of the scan pipeline: configuration, survey, decisions and the modeled room."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import refuse_below
from momapos.model.records import (
    ArticulationPredictor,
    Cloud,
    Detection,
    Detector,
    Frame,
    ImageDetection,
    Part,
    Segmenter,
)
from momapos.model.scene import SceneObject
from momapos.model.scene.library import Piece
from momapos.perception.fusion import (
    FusionConfig,
)
from momapos.perception.reconstruction import ModelConfig
from momapos.perception.segmentation import (
    PixelOf,
    PointAt,
    RoomShell,
)
from momapos.perception.views import FrontView, KnownFront, ViewMethod

if TYPE_CHECKING:
    from jaxtyping import Float

Progress = Callable[[str, float], None]
"""Called with the current step and the completed share in [0, 1]."""
Found = Mapping[str, Sequence[ImageDetection]]
"""2-D detections by frame name."""
Target: TypeAlias = str | PointAt | PixelOf
"""The object of a task: its name, or a point or pixel on it."""
MIN_SIDES = (0.1, 0.2)
"""Objects with a shorter shortest or middle edge have no doors or drawers [m]."""


@dataclass(frozen=True)
class ScanConfig:
    """How a scan becomes a scene."""

    voxel: float = 0.015
    """Edge length of the fusion voxels [m]."""
    fusion: FusionConfig = field(default_factory=FusionConfig)
    views: ViewMethod | None = None
    """How the front of an object is chosen: by a vote of all images, or by the first image that
    passes, as in the paper. None: first in `solve_scan` with the paper's placement method, else
    voting."""
    model: ModelConfig = field(default_factory=ModelConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 0.001, "voxel")


@dataclass(frozen=True, eq=False)
class Tools:
    """The exchangeable components."""

    segment: Segmenter
    look: ArticulationPredictor
    """Tells fronts from other faces, and finds where to split a row."""
    predict: ArticulationPredictor
    """Finds the parts of an object; often the same as `look`."""
    guess: ArticulationPredictor | None = None
    """Used if `predict` finds no parts on a front."""
    detect: Detector | None = None
    """Labels objects in the images; without it, labels follow from sizes."""
    frontal: Mapping[str, float] | None = None
    """Scores of a frontal classifier by frame, from 0 to 1; None: camera poses and `look`. They
    count where the first frontal image decides, see `ScanConfig.views`."""


class PartSource(StrEnum):
    """Source of an object's parts."""

    PREDICTED = "predicted"
    """Detected in the images."""
    GUESSED = "guessed"
    """From a template, for a front without detected parts."""
    GIVEN = "given"
    """From a URDF file given by the user."""


@dataclass(frozen=True, eq=False)
class Decision:
    """How one object is modeled, and why."""

    detection: Detection
    importance: float | None
    """Score against the target; None without a target."""
    view: FrontView | None
    """Its front; None if not searched for or not found."""
    parts: tuple[Part, ...]
    source: PartSource | None
    """Source of the parts; None for a box."""
    reason: str
    """Why it stays a box; "" if it is modeled."""
    looked: bool = True
    """Whether it was important enough to be examined."""
    seconds: float = 0.0
    model: Piece | SceneObject | None = None
    """Its model in the scene; None for a box."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Survey:
    """The objects of a scanned room, before any is modeled."""

    cloud: Cloud
    """The room, upright."""
    frames: tuple[Frame, ...]
    """The images, with poses in the upright world."""
    T_scene_scan: Float[np.ndarray, "4 4"]
    room: RoomShell
    detections: tuple[Detection, ...]
    walls: tuple[Detection, ...]
    rows: tuple[KnownFront, ...]
    """Fronts of the rows that were split."""
    found: Found | None
    """2-D detections that locate objects in the images: those of another program, if there are any,
    or of the detector if one image chooses the front, as in the paper."""
    timing: Mapping[str, float]
    """Seconds by stage."""
    warnings: tuple[str, ...] = ()
    """What the scan lacks or what was dropped, one line each."""


@dataclass(frozen=True, eq=False)
class Modeled:
    """A scene made from a scan, with all decisions."""

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
    """Name of the task's object, if given."""
    warnings: tuple[str, ...] = ()
    """What the scan lacks or what was dropped, one line each."""


def silent(what: str, share: float) -> None:
    """Ignore progress."""
