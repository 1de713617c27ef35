"""What the physical world is made of where no file says so, and how a motion is executed."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np

from momapos.model import SpeedConfig

Hold = Literal["weld", "contact"]


class Ending(StrEnum):
    """How a run ends; the words stand in records."""

    DONE = "the motion was carried out"
    STOPPED_AT_END = "the part stopped the arm near the end of its way"
    ASTRAY = "the arm did not come to the grasp"
    OUT_OF_REACH = "what should be held is not at the hand"
    NOTHING_HELD = "nothing is between the fingers"
    ONE_SIDED = "only one finger touches"
    TOO_HARD = "the hand felt more than it may"
    BLOCKED = "something is in the arm's way"
    BEHIND = "the arm did not come to the end of its way"
    MEETS_ROBOT = "the part comes upon the robot"
    NOTHING_MET = "the hand pushed, and met nothing"
    SLIPPED = "the hand lost its hold"
    SLIPPED_AT_END = "the hand lost its hold near the end of its way"
    BROKE = "the weld broke"
    OTHERWISE = "the part moves otherwise than believed"
    DIVERGED = "the simulation diverged"


AT_END = (Ending.STOPPED_AT_END, Ending.SLIPPED_AT_END)
GOOD = (Ending.DONE, *AT_END)
"""Endings of motions that were carried out."""

RECOVERABLE = (
    Ending.ASTRAY, Ending.OUT_OF_REACH, Ending.NOTHING_HELD, Ending.ONE_SIDED, Ending.TOO_HARD,
    Ending.BLOCKED, Ending.BEHIND, Ending.MEETS_ROBOT, Ending.NOTHING_MET, Ending.SLIPPED,
    Ending.BROKE, Ending.OTHERWISE,
)  # fmt: skip
"""Endings after which the robot may try anew."""


class Stage(StrEnum):
    """What the robot is doing; the words stand in records."""

    SETTLE = "settle"
    APPROACH = "approach"
    GRIP = "grip"
    MANIPULATE = "manipulate"
    DWELL = "dwell"
    RETREAT = "retreat"


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
    """Pull at the free edge that frees a door with a seal [N]."""
    latch_force: float = 6.0
    """Pull there that frees any other door or drawer, with a catch or a spring [N]."""
    seal_range: float = 0.01
    """Way of the free edge over which that pull fades [m]."""
    sealed: tuple[str, ...] = ("fridge", "refrigerator", "freezer", "oven", "dishwasher")
    """Words in the category or name of objects whose doors have a seal."""
    spread: float = 0.0
    """Masses, friction and pulls are drawn within this share of the values above [-]."""


@dataclass(frozen=True)
class ControlConfig:
    """How the robot's motors follow a motion."""

    bandwidth: float = 60.0
    """Natural frequency of the critically damped position loops [rad/s]."""
    stop_force: float = 20.0
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

    stiffness: float = 30_000.0
    """Of a finger's position loop at its pad, below the force of the robot's file [N/m]."""
    friction: float = 0.6
    """Between a finger's rubber and a handle [-]."""
    speed: float = 0.03
    """Of each pad while the hand closes [m/s]."""
    loaded: float = 0.4
    """The hand holds when the pads of both sides bear this share of its force [-]."""
    patience: float = 0.6
    """How long the hand waits for that after its fingers should be shut [s]."""
    pad_time: float = 0.005
    """Time constant of the contact of a pad with what it holds [s]. The engine's contacts are the
    softer the lighter what they touch: by its own value pads sink 6 mm into an apple or into the
    bar of a light door, and these creep out of the hand."""
    lost: float = 0.15
    """The hold is lost when neither side bears anything for this long [s]."""
    reach: float = 0.02
    """The weld takes hold of what is this near to the gripper or to the tool's origin [m]."""
    time_constant: float = 0.01
    """Of the compliant weld [s]; smaller is stiffer."""
    weld_force: float = 150.0
    """The weld breaks above this [N]."""
    weld_torque: float = 25.0
    """The weld breaks above this [Nm]."""


@dataclass(frozen=True)
class ComplianceConfig:
    """How the arm gives way to the force at its hand: as a damper that creeps back.

    It is stiff along the way that the part must go, and soft across it and in turning.
    """

    near: float = 0.1
    """The hand comes to the grasp slowly over this way [m]."""
    straight: float = 0.085
    """Nearer to the grasp the hand may pass things as closely as planned: it comes in straight, and
    goes around what it will hold [m]."""
    near_speed: float = 0.05
    """Its speed there [m/s], and where the arm would touch what is as modeled."""
    beside_speed: float = 0.25
    """Its speed where the arm is as far from its surroundings as clearance is observed [m/s]."""
    pace_rate: float = 4.0
    """By how much its speed changes in a second, as a share of the planned one [1/s]."""
    slowest: float = 0.2
    """Share of its speed that is left when it feels much [-]."""
    bump: float = 25.0
    """A push against its approach at which the hand draws back and comes in beside [N] ..."""
    early: float = 0.012
    """... while this much of its way is left at least [m]."""
    aside: tuple[float, ...] = (0.012, 0.024, 0.0)
    """How far beside, one time after the other; after the last it pushes on [m]."""
    search: float = 0.03
    """Where nothing is between the fingers, the hand looks for it so much farther ahead [m] ..."""
    search_back: float = 0.003
    """... and takes hold so much before what it met there [m]."""
    damping: float = 400.0
    """Force that moves the hand at 1 m/s [Ns/m]."""
    turn_damping: float = 15.0
    """Torque that turns it at 1 rad/s [Nms/rad]."""
    return_rate: float = 1.0
    """Share of an offset across the way that the hand makes up in a second [1/s]."""
    turn_return_rate: float = 5.0
    """Likewise of a turn [1/s]."""
    follow_rate: float = 6.0
    """Likewise along the way [1/s]."""
    speed: float = 0.08
    """The hand gives way and makes up at this speed at most [m/s]."""
    turn_speed: float = 0.4
    """[rad/s]"""
    joint_speed: float = 2.0
    """No joint goes faster than this while the hand gives way, whatever is asked [rad/s] or [m/s]:
    near singular states, and between bounds that contradict each other, much is."""
    push_speed: float = 0.1
    """The tool pushes at this speed at most: what is pushed is not held back, and runs on [m/s]."""
    home: float = 1.5
    """Time in which a hand that let go returns to the plan [s]."""
    filter_time: float = 0.02
    """Of the low-pass filter of the force at the hand [s]."""
    weight_time: float = 0.15
    """Likewise of the weight that the hand carries [s]."""
    force: float = 120.0
    """The run stops where the hand feels more than this [N]."""
    torque: float = 20.0
    """Likewise [Nm]."""
    avoid: float = 0.02
    """Things nearer to the arm than this slow its way toward them [m]."""
    apart: float = 0.003
    """It comes no nearer to them than this [m]."""
    base_room: float = 0.015
    """The arm stops where the part comes nearer to the robot's base than this, unless it is planned
    to [m]."""
    avoid_rate: float = 20.0
    """Speed toward them for the distance that is left [1/s]."""
    way_force: float = 60.0
    """Something is in the way where the hand feels more than this before it comes near [N]."""
    arm_torque: float = 12.0
    """Something is in the arm's way where a joint bears more than the hand explains [Nm] ..."""
    arm_force: float = 60.0
    """... or, where it slides [N]."""
    noticed: float = 1.0
    """A hand that nowhere felt more than this while it pushed has met nothing [N]."""
    axis_error: float = 0.03
    """How far a hinge may be from where it is modeled; the estimate's prior [m]."""
    tilt_error: float = float(np.radians(5.0))
    """Likewise how far its axis, or the direction of a slide, may turn [rad]."""
    hand_error: float = 0.003
    """How far the hand may stray on its part; the estimate's noise [m]."""


@dataclass(frozen=True)
class ModelErrorConfig:
    """How far the world differs from the scene that the plan was made with.

    Each is of the size given and in a random direction. With any of them the part meets the robot
    alone: a door that hangs otherwise than modeled does so in a frame where it moves freely.
    """

    handle: float = 0.0
    """Of the whole object, and with it of its handle [m]."""
    axis: float = 0.0
    """Of a hinge, across its axis [m]."""
    tilt: float = 0.0
    """Of the axis of a hinge or slide [rad]."""
    resistance: float = 0.0
    """Of mass, friction, damping and pull, each up or down, as a share [-]."""

    @property
    def any(self) -> bool:
        """Whether the world differs at all."""
        return bool(self.handle or self.axis or self.tilt or self.resistance)


@dataclass(frozen=True)
class ExecutionConfig:
    """How a motion is executed and judged."""

    hold: Hold = "contact"
    """contact: fingers and friction alone; weld: compliant and breakable, at the grasp."""
    timestep: float = 0.002
    """Of the physics [s]."""
    substeps: int = 2
    """Physics steps for one of the controller and the observer [-]."""
    settle: float = 0.3
    """Time before the arm moves [s]."""
    grip: float = 0.3
    """Time in which the hand opens, or a weld takes hold [s]."""
    dwell: float = 0.4
    """Time to come to rest at the end of the motion, and from there to the verdict [s]."""
    tolerance: float = 0.05
    """How far a joint may stay from what is asked, as a share of the asked travel [-]."""
    slip: float = 0.03
    """A lifted object has left the hand when it moved this far in it [m]."""
    touch: float = 1e-3
    """Parts of furniture this near each other at the beginning touch by design [m]."""
    touch_force: float = 150.0
    """A touch that is not the hold is a failure above this [N]."""
    near: float = 0.03
    """Up to here the distance from the robot to its surroundings is observed [m]."""
    furniture: FurnitureConfig = field(default_factory=FurnitureConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    gripper: GripConfig = field(default_factory=GripConfig)
    compliance: ComplianceConfig = field(default_factory=ComplianceConfig)
    errors: ModelErrorConfig = field(default_factory=ModelErrorConfig)
