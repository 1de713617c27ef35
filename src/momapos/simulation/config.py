"""Configuration of the physics, the robot's control and the execution of a motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np

from momapos.core import refuse_below
from momapos.model import SpeedConfig
from momapos.model.scene import ResistanceConfig

HoldMethod = Literal["weld", "contact"]


class Ending(StrEnum):
    """How a run ends. Run records contain these strings."""

    DONE = "the motion was completed"
    STOPPED_AT_END = "the part stopped the arm near the end of the motion"
    ASTRAY = "the arm did not reach the grasp"
    OUT_OF_REACH = "the part is not at the hand"
    NOTHING_HELD = "nothing is between the fingers"
    ONE_SIDED = "only one finger touches"
    TOO_HARD = "contact force above the limit"
    BLOCKED = "something blocks the arm"
    BEHIND = "the arm did not complete its path"
    MEETS_ROBOT = "the part hits the robot"
    NOTHING_MET = "the hand pushed without contact"
    SLIPPED = "the grasp slipped"
    SLIPPED_AT_END = "the grasp slipped near the end of the motion"
    BROKE = "the weld broke"
    TIPS_OVER = "the base tips over"
    OTHERWISE = "the part moves differently than modeled"
    DIVERGED = "the simulation diverged"


AT_END = (Ending.STOPPED_AT_END, Ending.SLIPPED_AT_END)
GOOD = (Ending.DONE, *AT_END)
"""Endings of completed motions."""
RECOVERABLE = (
    Ending.ASTRAY, Ending.OUT_OF_REACH, Ending.NOTHING_HELD, Ending.ONE_SIDED, Ending.TOO_HARD,
    Ending.BLOCKED, Ending.BEHIND, Ending.MEETS_ROBOT, Ending.NOTHING_MET, Ending.SLIPPED,
    Ending.BROKE, Ending.OTHERWISE,
)  # fmt: skip
"""Endings after which the robot may try again."""


class Stage(StrEnum):
    """Stage of a run. Run records contain these strings."""

    DRIVE = "drive"
    SETTLE = "settle"
    APPROACH = "approach"
    GRIP = "grip"
    MANIPULATE = "manipulate"
    DWELL = "dwell"
    RETREAT = "retreat"


ARMATURE = 0.1
"""Motor inertia reflected through the gear [kg m^2]; ten times as many kg for slides."""
BANDWIDTH = 60.0
"""Natural frequency of the critically damped position loops [rad/s]."""
BASE_BANDWIDTH = 60.0
"""Natural frequency of the base on its tires with the brakes on [rad/s]."""
BASE_FRICTION = 0.6
"""Friction between wheels and floor; a larger force makes the base slide [-]."""
BASE_FOLLOW_RATE = 2.0
"""Rate at which a base that moves with the arm corrects its offset from its path [1/s]."""
BASE_STEERING = 8.0
"""Turn per distance driven and per offset to the side, of a base that cannot drive sideways
[rad/m^2]."""
BASE_YIELD = 0.25
"""Share of what the arm lacks of the hand's velocity that a moving base makes up for [-]. With the
delay of a drive, all of it would oscillate."""
BASE_ASIDE = 0.02
"""How far from its path a moving base relieves the hand [m]."""
SLIP_TIME = 0.5
"""Time constant of the slip of the wheels [s]."""
PAD_TIME = 0.005
"""Time constant of the contact between a pad and a grasped object [s]. The engine softens
contacts with light bodies: with its default, pads sink 6 mm into an apple or the bar of a light
door, which then creeps out of the hand."""
MIN_LOADED = 0.4
"""Share of the grip force that the pads of both sides must bear for a grasp to hold [-]."""
GRIP_PATIENCE = 0.6
"""Time to wait for `MIN_LOADED` after the fingers should be closed [s]."""
LOST_TIME = 0.15
"""The grasp is lost when neither side bears a load for this long [s]."""
WELD_REACH = 0.02
"""Maximum distance from the gripper or the tool's origin at which the weld attaches [m]."""
WELD_TIME = 0.01
"""Time constant of the compliant weld; smaller is stiffer [s]."""
WELD_FORCE = 150.0
"""Force above which the weld breaks [N]."""
WELD_TORQUE = 25.0
"""Torque above which the weld breaks [Nm]."""
NEAR_GRASP = 0.1
"""Distance to the grasp within which the hand moves slowly [m]."""
ARRIVING = 0.2
"""Distance to a further grasp within which the hand no longer follows the joints' plan but its own
pose, which makes up for where the base has stopped [m]."""
STRAIGHT_IN = 0.085
"""Distance to the grasp within which the hand may pass obstacles as closely as planned, because it
moves straight in around its target [m]."""
NEAR_SPEED = 0.05
"""Speed of the hand within `NEAR_GRASP` of the grasp, and where the arm would touch the model
[m/s]."""
BESIDE_SPEED = 0.25
"""Speed of the hand where the arm is `OBSERVED_DISTANCE` from its surroundings [m/s]."""
PUSH_SPEED = 0.1
"""Maximum tool speed while pushing; a faster push would throw the part ahead [m/s]."""
PACE_RATE = 4.0
"""Maximum change of the speed per second, as a share of the planned speed [1/s]."""
MIN_PACE = 0.2
"""Minimum share of the speed that remains under large contact forces [-]."""
BUMP_FORCE = 25.0
"""Force against the approach at which the hand backs off and comes in with an offset [N]."""
MIN_BUMP_PATH = 0.012
"""It does so only if at least this much of its path is left [m]."""
RETRY_OFFSETS = (0.012, 0.024, 0.0)
"""Offsets of successive retries; after the last one the hand pushes on [m]."""
SEARCH_AHEAD = 0.03
"""If nothing is between the fingers, the hand searches this much farther ahead [m]."""
SEARCH_BACK = 0.003
"""It grasps this much before the contact that the search found [m]."""
FOLLOW_RATE = 6.0
"""Rate at which the hand corrects an offset along the path [1/s]."""
RETURN_RATE = 1.0
"""Rate at which the hand corrects an offset across the path [1/s]."""
TURN_RETURN_RATE = 5.0
"""Rate at which the hand corrects a rotation [1/s]."""
TURN_DAMPING = 15.0
"""Torque per angular speed of the hand [Nms/rad]."""
TURN_SPEED = 0.4
"""Maximum angular speed of compliance and correction [rad/s]."""
HOME_TIME = 1.5
"""Time in which a hand that let go returns to the plan [s]."""
FILTER_TIME = 0.02
"""Time constant of the low-pass filter of the force at the hand [s]."""
WEIGHT_TIME = 0.15
"""Time constant of the low-pass filter of the carried weight [s]."""
PATH_FORCE = 60.0
"""Force at the hand that means an obstacle, before the hand is near its target [N]."""
ARM_TORQUE = 12.0
"""Load of a turning joint that the hand does not explain and that means an obstacle [Nm]."""
ARM_FORCE = 60.0
"""The same for a sliding joint [N]."""
NOTICED_FORCE = 1.0
"""A pushing hand that never felt more than this has met nothing [N]."""
PRESS_SPEED, PRESS_TIME = 0.01, 0.1
"""Speed at which fingertips press [m/s], and how long they feel the part stop [s]."""
PRESS_FORCE = 6.0
"""Push, beyond what the part needs, at which fingertips take a pressed part to be at its end [N]:
at 1.1 m, 21 N in all tip a Stretch over."""
PRESS_TRAVEL = 0.05
"""Travel after which fingertips that meet no stop give up: longer than buttons travel [m]."""
STOP_FORCE = 20.0
"""Extra resistance of the part near the end of its path that stops the arm [N]."""
BASE_CLEARANCE = 0.015
"""Minimum clearance between the part and the robot's base, unless the plan has less [m]."""
AVOID_RATE = 20.0
"""Approach speed per distance left to `ComplianceConfig.apart` [1/s]."""
AXIS_ERROR = 0.03
"""Standard deviation of a hinge's position in the joint estimate's prior [m]."""
TILT_ERROR = float(np.radians(5.0))
"""Standard deviation of the direction of a hinge axis or slide in that prior [rad]."""
SUBSTEPS = 2
"""Physics steps per step of the controller and the observer [-]."""
SETTLE_TIME = 0.3
"""Time before the arm moves [s]."""
GRIP_TIME = 0.3
"""Time for the hand to open, or for a weld to attach [s]."""
DWELL_TIME = 0.4
"""Time to come to rest at the end of the motion, and again until the verdict [s]."""
TOUCH_DISTANCE = 1e-3
"""Distance at the start below which furniture parts touch by design [m]."""
OBSERVED_DISTANCE = 0.03
"""Maximum observed distance from the robot to its surroundings [m]."""


@dataclass(frozen=True)
class FurnitureConfig(ResistanceConfig):
    """Mass and resistance of doors and drawers where file, scene and plan give none."""

    spread: float = 0.0
    """Relative spread of masses, friction and opening forces around their values [-]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_below(self, 0, "spread")


@dataclass(frozen=True)
class GripConfig:
    """How the gripper grasps."""

    stiffness: float = 30_000.0
    """Stiffness of a finger's position loop at its pad, up to the robot's grip force [N/m]."""
    friction: float = 0.6
    """Friction between a finger pad and a handle [-]."""
    speed: float = 0.03
    """Speed of each pad while the hand closes [m/s]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "stiffness")
        refuse_below(self, 0, "friction")
        refuse_below(self, 0.001, "speed")


@dataclass(frozen=True)
class ComplianceConfig:
    """How the arm complies with the force at its hand: as a damper with a slow return to the plan.

    It is stiff along the part's path, and compliant across it and in rotation.
    """

    damping: float = 400.0
    """Force per speed of the hand [Ns/m]."""
    speed: float = 0.08
    """Maximum speed of compliance and correction [m/s]."""
    joint_speed: float = 2.0
    """Maximum joint speed under compliance [rad/s] or [m/s]; near singularities and between
    conflicting bounds the control would ask for more."""
    force: float = 120.0
    """Force at the hand above which the run stops [N]."""
    torque: float = 20.0
    """Torque at the hand above which the run stops [Nm]."""
    avoid: float = 0.02
    """Distance below which obstacles slow the arm's approach toward them [m]."""
    apart: float = 0.003
    """Minimum distance from the arm to obstacles [m]."""
    hand_error: float = 0.003
    """Standard deviation of the hand's position on the part in the joint estimate [m]."""

    def __post_init__(self) -> None:
        refuse_below(self, 1, "damping")
        refuse_below(self, 0, "speed", "joint_speed", "force", "torque", "avoid", "apart")
        refuse_below(self, 1e-6, "hand_error")


@dataclass(frozen=True)
class ModelErrorConfig:
    """Errors of the scene model that the plan is based on.

    Each error has the given size and a random direction. With any error the part collides with the
    robot alone, because its true frame leaves it free to move.
    """

    handle: float = 0.0
    """Position of the whole object, and with it of its handle [m]."""
    axis: float = 0.0
    """Position of a hinge, across its axis [m]."""
    tilt: float = 0.0
    """Direction of the axis of a hinge or slide [rad]."""
    resistance: float = 0.0
    """Relative error of mass, friction, damping and pull, each up or down [-]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "handle", "axis", "tilt", "resistance")

    @property
    def any(self) -> bool:
        """Whether the configuration has any error."""
        return bool(self.handle or self.axis or self.tilt or self.resistance)


@dataclass(frozen=True)
class BaseTrackingConfig:
    """How a base follows its path while the arm moves."""

    slip: float = 0.03
    """Standard deviation of its true velocity from its odometry's, as a share of it; as that of the
    odometry of a drive [-]."""
    delay: float = 0.05
    """Time after which a command moves the wheels [s]."""

    def __post_init__(self) -> None:
        refuse_below(self, 0, "slip", "delay")


@dataclass(frozen=True)
class ExecutionConfig:
    """How a motion is executed and judged."""

    hold: HoldMethod = "contact"
    """contact: fingers and friction alone; weld: a compliant, breakable weld at the grasp."""
    timestep: float = 0.002
    """Time step of the physics [s]."""
    tolerance: float = 0.05
    """Maximum remaining travel of a joint, as a share of the requested travel [-]."""
    slip: float = 0.03
    """Motion of a lifted object in the hand above which it counts as lost [m]."""
    touch_force: float = 150.0
    """Contact force outside the grasp above which the run fails [N]."""
    furniture: FurnitureConfig = field(default_factory=FurnitureConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    gripper: GripConfig = field(default_factory=GripConfig)
    compliance: ComplianceConfig = field(default_factory=ComplianceConfig)
    errors: ModelErrorConfig = field(default_factory=ModelErrorConfig)
    base: BaseTrackingConfig = field(default_factory=BaseTrackingConfig)

    def __post_init__(self) -> None:
        refuse_below(self, 1e-5, "timestep")
        refuse_below(self, 0, "tolerance", "slip", "touch_force")
