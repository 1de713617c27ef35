"""What the physical world is made of where no file says so, and how a motion is executed."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from momapos.trajectory import SpeedConfig

Hold = Literal["weld", "contact"]


class Stage(StrEnum):
    """What the robot is doing; the words stand in records."""

    SETTLE = "settle"
    APPROACH = "approach"
    GRIP = "grip"
    MANIPULATE = "manipulate"
    DWELL = "dwell"


@dataclass(frozen=True)
class FurnitureConfig:
    """What doors and drawers weigh, and how they resist.

    Of the order that people and robots measured at doors and drawers at home (Jain and Kemp,
    Autonomous Robots 35, 2013): most of the force is needed in the beginning, more at
    refrigerators than at cabinets.
    """

    density: float = 300.0
    """Of moving parts with what is in them, over the volume of their hulls [kg/m^3]."""
    least_mass: float = 0.5
    """A part weighs at least this [kg]."""
    most_mass: float = 25.0
    """A part weighs at most this [kg]; a solid hull of a hollow drawer would weigh more."""
    hinge_friction: float = 0.4
    """Dry friction of hinges [Nm]."""
    hinge_damping: float = 0.5
    """Of hinges [Nms/rad]."""
    slide_friction: float = 4.0
    """Dry friction of slides [N]."""
    slide_damping: float = 8.0
    """Of slides [Ns/m]."""
    seal_force: float = 30.0
    """Pull at the handle that frees a door with a seal [N]."""
    latch_force: float = 6.0
    """Pull at the handle that frees any other door or drawer, with a catch or a spring [N]."""
    seal_range: float = 0.01
    """Way of the handle over which that pull fades [m]."""
    sealed: tuple[str, ...] = ("fridge", "refrigerator", "freezer", "oven", "dishwasher")
    """Words in the category or name of objects whose doors have a seal."""
    spread: float = 0.0
    """Masses, friction and pulls are drawn within this share of the values above [-]."""


@dataclass(frozen=True)
class ControlConfig:
    """How the robot's motors follow a motion."""

    bandwidth: float = 60.0
    """Natural frequency of the critically damped position loops [rad/s]."""
    stop_force: float = 30.0
    """The arm stops where the part, near the end of its way, resists it by this more [N]."""
    armature: float = 0.1
    """Inertia of a motor seen through its gear [kg m^2]; ten times as many kg for slides."""
    base_bandwidth: float = 60.0
    """Natural frequency of the base on its tyres with the brakes on [rad/s]."""
    base_friction: float = 0.6
    """Between wheels and floor; a harder push makes the base slide [-]."""


@dataclass(frozen=True)
class GripConfig:
    """How the gripper holds."""

    force: float = 60.0
    """Of each finger [N]."""
    stiffness: float = 30_000.0
    """Of a finger's position loop, below that force [N/m]."""
    friction: float = 1.0
    """Between a finger's rubber and a handle [-]."""
    reach: float = 0.02
    """The weld takes hold of what is this near to the gripper or to the tool's origin [m]."""
    time_constant: float = 0.01
    """Of the compliant weld [s]; smaller is stiffer."""
    weld_force: float = 120.0
    """The weld breaks above this: two fingers with friction 1 at the force above [N]."""
    weld_torque: float = 20.0
    """The weld breaks above this [Nm]."""


@dataclass(frozen=True)
class ExecutionConfig:
    """How a motion is executed and judged."""

    hold: Hold = "weld"
    """weld: compliant and breakable, at the grasp; contact: fingers and friction alone."""
    timestep: float = 0.002
    """Of the physics [s]."""
    substeps: int = 2
    """Physics steps for one of the controller and the observer [-]."""
    settle: float = 0.3
    """Time before the arm moves [s]."""
    grip: float = 0.3
    """Time to close the gripper [s]."""
    dwell: float = 0.4
    """Time from the end of the motion to the verdict [s]."""
    tolerance: float = 0.05
    """How far a joint may stay from what is asked, as a share of the asked travel [-]."""
    slip: float = 0.03
    """A lifted object has left the hand when it moved this far in it [m]."""
    touch: float = 1e-3
    """Parts of furniture this near each other at the beginning touch by design [m]."""
    near: float = 0.03
    """Up to here the distance from the robot to its surroundings is observed [m]."""
    furniture: FurnitureConfig = field(default_factory=FurnitureConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    gripper: GripConfig = field(default_factory=GripConfig)
