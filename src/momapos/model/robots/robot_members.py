"""The members of a robot file: its schema, its list of members and its known keys follow.

Robot files are TOML. The schema describes the same members in JSON.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

Triple = tuple[float, float, float]
Positive = Annotated[float, msgspec.Meta(gt=0, lt=1e6)]
Corner = Annotated[float, msgspec.Meta(ge=-5, le=5)]
Name = Annotated[str, msgspec.Meta(min_length=1)]
Edge = Annotated[float, msgspec.Meta(gt=0, le=5)]


class _Strict(msgspec.Struct, forbid_unknown_fields=True):
    """A record without further members."""


class RobotBase(_Strict):
    """The mobile base."""

    footprint: Annotated[
        tuple[tuple[Corner, Corner], ...], msgspec.Meta(min_length=3, max_length=1000)
    ]
    """Outline of everything that does not move with the arm, seen from above: x, y [m]."""
    drive: Literal["differential", "omni", "car"]
    """How it drives: turning in place (differential), sideways too (omni), or on curves (car)."""
    min_turning_radius: Positive | None = None
    """Least radius of a car-like base, which needs it [m]."""
    max_speed: Positive = 0.5
    """[m/s]"""
    max_yaw_rate: Positive = 1.0
    """[rad/s]"""
    max_acceleration: Positive = 0.5
    """[m/s^2]"""
    max_yaw_acceleration: Positive = 1.0
    """[rad/s^2]"""


class RobotTool(_Strict):
    """The gripper."""

    approach_axis: Triple
    """Direction in which the hand approaches, in the tool frame [-]."""
    closing_axis: Triple
    """Direction in which the fingers close, perpendicular to it [-]."""
    opening: Positive | None = None
    """Width between the pads when the finger joints are at zero [m]."""
    grips: Literal["fingers", "suction", "hook"] = "fingers"
    """How the tool holds; a hook or suction has no closing fingers."""
    force: Positive | None = None
    """Force of each finger, or of the suction [N]."""


class RobotFrame(_Strict):
    """A frame that the URDF lacks."""

    parent: Name
    """Link that carries it."""
    xyz: Triple = (0.0, 0.0, 0.0)
    """[m]"""
    rpy: Triple = (0.0, 0.0, 0.0)
    """[rad]"""


class RobotMount(_Strict):
    """A base that carries the arm, for the URDF of an arm alone: a box or a URDF."""

    box: tuple[Edge, Edge, Edge] | None = None
    """Length, width and height [m]."""
    urdf: str | None = None
    """URDF of the base."""
    link: str = ""
    """Link of that URDF that carries the arm."""
    xyz: Triple | None = None
    """Position of the arm [m]; by default on top of the box."""
    rpy: Triple = (0.0, 0.0, 0.0)
    """[rad]"""


class RobotCoupling(_Strict):
    """A joint that follows another one, which the URDF does not say."""

    joint: str
    """The joint that it follows."""
    ratio: float = 1.0
    """[-]"""
    offset: float = 0.0
    """[rad] or [m]"""


class RobotLimits(_Strict):
    """Limits that replace those of the URDF."""

    lower: float | None = None
    """[rad] or [m]"""
    upper: float | None = None
    """[rad] or [m]"""
    velocity: Positive | None = None
    """[rad/s] or [m/s]"""
    acceleration: Positive | None = None
    """[rad/s^2] or [m/s^2]"""


class _ArmMembers(_Strict):
    """An arm with its gripper."""

    tool_link: Name | None = None
    """Link whose frame is the tool frame, between the fingertips."""
    arm_joints: list[str] | None = None
    """Joints from the base to the tool, in order."""
    gripper_links: list[str] | None = None
    """Links of the gripper, which may touch what it grasps."""
    home: list[float] | None = None
    """Values of `arm_joints` while the base drives [rad] or [m]."""
    tool: RobotTool | None = None
    """The gripper at the end of the arm."""
    reach: Positive | None = None
    """Length from the first turning joint, for lists [m]."""
    payload: Positive | None = None
    """Largest mass that the arm carries, with its tool [kg]."""


class RobotArm(_ArmMembers):
    """One of several arms with its gripper."""


class RobotFile(_ArmMembers, kw_only=True):
    """A mobile base with one arm, or with several in `arms`."""

    name: Name
    """Name of the robot."""
    urdf: Name
    """Path of the URDF, relative to the robot file."""
    base_link: Name
    """Link on the floor, x forward, z up."""
    base: RobotBase
    """The mobile base."""
    version: Literal[1] = 1
    """Version of the format."""
    srdf: str | None = None
    """Path of an SRDF; by default the one next to the URDF with its name."""
    arms: dict[str, RobotArm] = {}
    """Arms by name; then the members of an arm do not stand at the top."""
    rest: dict[str, float] = {}
    """Values of joints that no arm moves [rad] or [m]."""
    frames: dict[str, RobotFrame] = {}
    """Added frames by name."""
    mount: RobotMount | None = None
    """A base for an arm that has none in its URDF."""
    packages: dict[str, str] = {}
    """Folders of ROS packages that the URDF names."""
    coupled: dict[str, RobotCoupling] = {}
    """Followers by joint."""
    limits: dict[str, RobotLimits] = {}
    """Replaced limits by joint."""
    schema: str | msgspec.UnsetType = msgspec.field(default=msgspec.UNSET, name="$schema")
    """Address of the file's JSON Schema, for editors."""
    visual_hulls: bool = False
    """Whether hulls of visual meshes stand in for missing collision elements."""
