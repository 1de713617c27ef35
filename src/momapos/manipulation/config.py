"""How a task becomes a motion; nothing heavy is imported, so that commands can show it at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Optional

from momapos.errors import InputError, refuse_below

Planner = Literal["RRTConnect", "RRTstar", "BITstar"]


@dataclass(frozen=True)
class GraspConfig:
    """Which ways of holding a thing are tried."""

    turns: tuple[float, ...] = (0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0)
    """Turns about the handle's long axis [deg]."""
    tilts: tuple[float, ...] = (0.0, 25.0, -25.0)
    """Tilts along the handle [deg]."""
    points: tuple[float, ...] = (0.0, 0.6, -0.6)
    """Points along the handle, as shares of its half length [-]."""
    standoffs: tuple[float, ...] = (0.0, 0.7)
    """How far the tool's origin stays before the handle, as shares of the fingers' depth [-]."""
    tip_gap: float = 0.005
    """A last stand-off: the fingertips this far before the handle's center, for handles that lie
    flat on what they open [m]."""
    rolls: int = 8
    """Rolls about the approach for knobs and rigid objects [-]."""
    pregrasp: float = 0.08
    """Length of the straight approach [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "rolls")
        refuse_below(self, 0, "tip_gap")
        refuse_below(self, 0.01, "pregrasp")
        for name in ("turns", "tilts", "points", "standoffs"):
            if not getattr(self, name):
                raise InputError(f"{name} must hold at least one number")


@dataclass(frozen=True)
class MotionConfig:
    """How finely a motion is cut."""

    waypoint_angle: float = 7.5
    """Turn of a hinge between waypoints [deg]."""
    waypoint_slide: float = 0.05
    """Slide between waypoints [m]."""
    waypoints: Optional[int] = None  # noqa: UP045 (see cli.options)
    """Number of waypoints, whatever the motion [-]; None to follow the two above."""
    substeps: int = 4
    """States between waypoints, all of which are checked [-]."""
    grasps: GraspConfig = field(default_factory=GraspConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 0.1, "waypoint_angle")
        refuse_below(self, 0.001, "waypoint_slide")
        refuse_below(self, 1, "substeps")
        if self.waypoints is not None:
            refuse_below(self, 2, "waypoints")


@dataclass(frozen=True)
class PlannerConfig:
    """How the arm gets from home to the first waypoint."""

    planner: Planner = "RRTConnect"
    """OMPL's planner; RRTstar is the paper's and uses its whole budget."""
    budget: float = 0.25
    """Time for one motion [s]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0.001, "budget")
