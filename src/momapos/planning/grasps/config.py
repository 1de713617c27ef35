"""Configure grasps and task motions. Imports nothing heavy: the command line shows it as help."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Optional

from momapos.core import InputError, refuse_above, refuse_below
from momapos.model.scene import ResistanceConfig

GraspFamily = Literal["pinch", "hook", "push", "suction"]
OwnUse = Literal["too", "only", "first"]


HANDLE_POINTS = (0.0, 0.6, -0.6)
"""Points along the handle, as shares of its half length [-]."""
STANDOFFS = (0.0, 0.5, 1.0)
"""Grasp depths, from the deepest reachable one (0) to that of the fingertips alone (1) [-]."""
ROLLS = 8
"""Number of rolls about the approach direction, for knobs and rigid objects [-]."""


@dataclass(frozen=True)
class GraspConfig:
    """Which grasps are tried, and what they must transmit."""

    families: tuple[GraspFamily, ...] = ("pinch", "hook", "push", "suction")
    """Grasp families to try; without push, no door is opened with a regrasp."""
    count: Optional[int] = None  # noqa: UP045 (see cli.options)
    """Maximum number of grasps to try, the firmest and simplest first, of those in which the
    fully open hand is free; None for all [-]."""
    turning: bool = True
    """Whether the hand may turn about bars."""
    sliding: bool = True
    """Whether hooks may slide along the handle while the part rests."""
    turns: tuple[float, ...] = (0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 90.0, -90.0)
    """Turns about the handle's long axis [deg]."""
    tilts: tuple[float, ...] = (0.0, 25.0, -25.0)
    """Tilts along the handle [deg]."""
    own: OwnUse = "too"
    """How grasps of the user's own are used, if there are some for the task: together with ours
    (too), alone (only), or alone and then, without an answer, with ours (first)."""
    pregrasp: float = 0.08
    """Length of the straight approach [m]."""
    hand_clearance: float = 0.004
    """Clearance of the open hand to everything that it does not hold [m]."""
    friction: float = 0.6
    """Friction coefficient between pads and handles [-]."""
    pad_contact: float = 0.35
    """Minimum contact area of each pad [cm^2]."""
    grasp_margin: float = 1.3
    """Minimum ratio of the force that a grasp transmits to the force that the part needs [-]."""
    swing: float = 0.2
    """Additional load of a lifted or carried object by acceleration, as a share of its weight
    [-]."""
    resistance: ResistanceConfig = field(default_factory=ResistanceConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 0, "hand_clearance", "friction", "pad_contact", "grasp_margin", "swing")
        refuse_below(self, 0.01, "pregrasp")
        if self.count is not None:
            refuse_below(self, 1, "count")
        refuse_above(self, MAX_GRASPS, "count")
        for name in ("families", "turns", "tilts"):
            if not getattr(self, name):
                raise InputError(f"{name} must hold at least one value")


MAX_GRASPS, MAX_WAYPOINTS = 100_000, 2_000
"""Bounds of the counts; 2,000 waypoints with their steps are half the states of a plan [-]."""
MAX_LIFT = 1.0
"""Largest height by which an object is lifted [m]."""
MIN_LEVEL, MAX_LEVEL = 1.0, 180.0
"""Bounds of the tilt: arms deviate from their paths by tenths of a degree [deg]."""
SUBSTEPS = 4
"""Number of steps per waypoint; all are checked [-]."""


@dataclass(frozen=True)
class MotionConfig:
    """The resolution of a task motion."""

    waypoint_angle: float = 7.5
    """Rotation of a hinge between waypoints [deg]."""
    waypoint_slide: float = 0.05
    """Travel of a slide between waypoints [m]."""
    waypoints: Optional[int] = None  # noqa: UP045 (see cli.options)
    """Number of waypoints; None to derive it from the two above [-]."""
    lift: Optional[float] = None  # noqa: UP045 (see cli.options)
    """Height by which a rigid object is lifted, or let down; None for 5 cm, or less where it would
    hit something [m]."""
    retreat: Optional[Literal["up", "back", "out"]] = None  # noqa: UP045
    """How a rigid object leaves where it stands, and reversed gets there: lifted up, drawn back
    along the hand's approach, or drawn out horizontally by the shortest path, and then lifted. None
    for up, or else out."""
    slide: Optional[tuple[float, float, float]] = None  # noqa: UP045
    """By which vector it is drawn before it is lifted; None to choose it [m]."""
    level: Optional[float] = None  # noqa: UP045
    """Largest tilt of an object in the hand from how it stands, as of a full cup: on every path of
    the arm, and while the base drives; None for any [deg]."""
    home_again: bool = False
    """Whether the hand releases the part at the end and the arm returns home, as before another
    task; with a picked object that does not fit there, to a state nearby."""
    grasps: GraspConfig = field(default_factory=GraspConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 0.1, "waypoint_angle")
        refuse_below(self, 0.001, "waypoint_slide")
        if self.waypoints is not None:
            refuse_below(self, 2, "waypoints")
        if self.lift is not None:
            refuse_below(self, 0.0, "lift")
        refuse_above(self, MAX_LIFT, "lift")
        if self.level is not None:
            refuse_below(self, MIN_LEVEL, "level")
        refuse_above(self, MAX_LEVEL, "level")
        refuse_above(self, MAX_WAYPOINTS, "waypoints")
