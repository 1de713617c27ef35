"""How a task becomes a motion; nothing heavy is imported, so that commands can show it at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Optional

from momapos.core import InputError, refuse_below

GraspFamily = Literal["pinch", "hook", "push", "suction"]


@dataclass(frozen=True)
class ResistanceConfig:
    """What doors and drawers weigh and how they resist, where no file says; see docs/execution.md.

    The grasps must transmit it. The physics has values of its own.
    """

    density: float = 300.0
    """Of moving parts with what is in them, over the volume of their hulls [kg/m^3]."""
    least_mass: float = 0.5
    """A part weighs at least this [kg]."""
    most_mass: float = 25.0
    """A part weighs at most this [kg]."""
    hinge_friction: float = 0.4
    """Dry friction of hinges [Nm]."""
    slide_friction: float = 4.0
    """Dry friction of slides [N]."""
    seal_force: float = 30.0
    """Pull at the handle that frees a door with a seal [N]."""
    latch_force: float = 6.0
    """Pull at the handle that frees any other door or drawer [N]."""
    sealed: tuple[str, ...] = ("fridge", "refrigerator", "freezer", "oven", "dishwasher")
    """Words in the category or name of objects whose doors have a seal."""


@dataclass(frozen=True)
class GraspConfig:
    """Which ways of holding a thing are tried, and when one holds."""

    families: tuple[GraspFamily, ...] = ("pinch", "hook", "push", "suction")
    """Families of grasps that are tried; without push no door is opened in two holds."""
    turning: bool = True
    """Whether hands turn about bars."""
    sliding: bool = True
    """Whether hooks slide along what they hold, from where the part rests on its way."""
    turns: tuple[float, ...] = (0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0, 90.0, -90.0)
    """Turns about the handle's long axis [deg]."""
    tilts: tuple[float, ...] = (0.0, 25.0, -25.0)
    """Tilts along the handle [deg]."""
    points: tuple[float, ...] = (0.0, 0.6, -0.6)
    """Points along the handle, as shares of its half length [-]."""
    standoffs: tuple[float, ...] = (0.0, 0.5, 1.0)
    """How far the hand stays before the deepest place it can reach, as shares of the way from
    there to where only its fingertips hold [-]."""
    rolls: int = 8
    """Rolls about the approach for knobs and rigid objects [-]."""
    pregrasp: float = 0.08
    """Length of the straight approach [m]."""
    hand_clearance: float = 0.004
    """Distance that the open hand keeps from what it does not hold [m]."""
    friction: float = 0.6
    """Between pads and handles [-]."""
    pad_contact: float = 0.35
    """Each pad touches what it holds over this area at least [cm^2]."""
    grasp_margin: float = 1.3
    """A grasp transmits this many times what the part needs [-]."""
    swing: float = 0.2
    """What a hand lifts or carries is so much heavier by its acceleration, as a share of its
    weight [-]."""
    resistance: ResistanceConfig = field(default_factory=ResistanceConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 1, "rolls")
        refuse_below(self, 0, "hand_clearance", "friction", "pad_contact", "grasp_margin", "swing")
        refuse_below(self, 0.01, "pregrasp")
        for name in ("families", "turns", "tilts", "points", "standoffs"):
            if not getattr(self, name):
                raise InputError(f"{name} must hold at least one value")


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
    home_again: bool = False
    """Whether the hand lets go at the end, and the arm comes home with what it picked, as before
    another task."""
    grasps: GraspConfig = field(default_factory=GraspConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 0.1, "waypoint_angle")
        refuse_below(self, 0.001, "waypoint_slide")
        refuse_below(self, 1, "substeps")
        if self.waypoints is not None:
            refuse_below(self, 2, "waypoints")
