"""What is chosen on the page, and what is shown on it."""

from __future__ import annotations

from dataclasses import dataclass, field

from momapos.model.scene import Scene
from momapos.planning import PlacementResult

from .probe import Probe
from .question import Machine, Question


@dataclass(frozen=True)
class Choice:
    """What is chosen on the page."""

    scene: str
    robot: str
    arm: str
    question: Question


@dataclass
class Shown:
    """What is loaded and drawn; the thread that answers changes it, and what is measured of an
    answer afterward is added to it."""

    scene_name: str = ""
    scene: Scene | None = None
    machine_name: tuple[str, str] = ("", "")
    machine: Machine | None = None
    question: Question | None = None
    answer: PlacementResult | None = None
    probe: Probe | None = None
    joints: dict[str, float] = field(default_factory=dict)
    """Joints of the object that were moved by hand, and how the others stood then [rad] or [m]."""
