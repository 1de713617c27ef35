"""The members of a robot file: its checks, schema, list of members and known keys follow.

Robot files are TOML. The schema describes the same members in JSON.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import msgspec

from momapos.core import FileRecord

Number = Annotated[float, msgspec.Meta(gt=-1e6, lt=1e6)]
Triple = tuple[Number, Number, Number]
Positive = Annotated[float, msgspec.Meta(gt=0, lt=1e6)]
Corner = Annotated[float, msgspec.Meta(ge=-5, le=5)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
Edge = Annotated[float, msgspec.Meta(gt=0, le=5)]
Drive = Literal["differential", "omni", "car"]
ANY = "any"
"""Name that stands for all arms."""


class RobotBase(FileRecord):
    """The mobile base."""

    footprint: Annotated[
        tuple[tuple[Corner, Corner], ...], msgspec.Meta(min_length=3, max_length=1000)
    ]
    """Outline of everything that does not move with the arm, seen from above: x, y [m]."""
    drive: Drive
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

    def __post_init__(self) -> None:
        if self.drive != "car" and self.min_turning_radius is not None:
            raise ValueError('min_turning_radius is for drive = "car" only; remove it')
        if self.drive == "car" and self.min_turning_radius is None:
            raise ValueError(
                "min_turning_radius is missing; a car-like base needs the least radius on which "
                "base_link, at the middle of its fixed axle, can turn [m]"
            )


class RobotTool(FileRecord):
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

    def __post_init__(self) -> None:
        for name in ("approach_axis", "closing_axis"):
            if math.hypot(*getattr(self, name)) <= 1e-9:
                raise ValueError(f"{name} must be 3 numbers, not all 0")


class RobotFrame(FileRecord):
    """A frame that the URDF lacks."""

    parent: Name
    """Link that carries it."""
    xyz: Triple = (0.0, 0.0, 0.0)
    """[m]"""
    rpy: Triple = (0.0, 0.0, 0.0)
    """[rad]"""


class RobotMount(FileRecord):
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.box is None) == (self.urdf is None):
            raise ValueError("needs either box = [length, width, height] in m, or urdf")


class RobotCoupling(FileRecord):
    """A joint that follows another one, which the URDF does not say."""

    joint: Name
    """The joint that it follows."""
    ratio: Number = 1.0
    """[-]"""
    offset: Number = 0.0
    """[rad] or [m]"""


class RobotLimits(FileRecord, forbid_unknown_fields=True):
    """Limits that replace those of the URDF."""

    lower: Number | None = None
    """[rad] or [m]"""
    upper: Number | None = None
    """[rad] or [m]"""
    velocity: Positive | None = None
    """[rad/s] or [m/s]"""
    acceleration: Positive | None = None
    """[rad/s^2] or [m/s^2]"""


class RobotArm(FileRecord):
    """An arm with its gripper."""

    tool_link: Name
    """Link whose frame is the tool frame, between the fingertips."""
    arm_joints: list[str]
    """Joints from the base to the tool, in order."""
    gripper_links: list[str]
    """Links of the gripper, which may touch what it grasps."""
    home: list[Number]
    """Values of `arm_joints` while the base drives [rad] or [m]."""
    tool: RobotTool
    """The gripper at the end of the arm."""
    reach: Positive | None = None
    """Length from the first turning joint, for lists [m]."""
    payload: Positive | None = None
    """Largest mass that the arm carries, with its tool [kg]."""


class RobotFile(FileRecord):
    """A mobile base with one arm, or with several in `arms`.

    The members of a single arm stand at the top; reading puts them into `arms`, by the name "".
    """

    name: Name
    """Name of the robot."""
    urdf: Name
    """Path of the URDF, relative to the robot file."""
    base_link: Name
    """Link on the floor, x forward, z up."""
    base: RobotBase
    """The mobile base."""
    arms: Annotated[dict[str, RobotArm], msgspec.Meta(min_length=1, max_length=100)]
    """Arms by name; then the members of an arm do not stand at the top."""
    version: Literal[1] = 1
    """Version of the format."""
    srdf: Name | None = None
    """Path of an SRDF; by default the one next to the URDF with its name."""
    rest: dict[str, Number] = {}
    """Values of joints that no arm moves [rad] or [m]."""
    frames: Annotated[dict[str, RobotFrame], msgspec.Meta(max_length=50)] = {}
    """Added frames by name."""
    mount: RobotMount | None = None
    """A base for an arm that has none in its URDF."""
    packages: Annotated[dict[str, Name], msgspec.Meta(max_length=200)] = {}
    """Folders of ROS packages that the URDF names."""
    coupled: Annotated[dict[str, RobotCoupling], msgspec.Meta(max_length=100)] = {}
    """Followers by joint."""
    limits: Annotated[dict[str, RobotLimits], msgspec.Meta(max_length=100)] = {}
    """Replaced limits by joint."""
    schema: str | msgspec.UnsetType = msgspec.field(default=msgspec.UNSET, name="$schema")
    """Address of the file's JSON Schema, for editors."""
    visual_hulls: bool = False
    """Whether hulls of visual meshes stand in for missing collision elements."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if ANY in self.arms:
            raise ValueError(f"arms must not have the name {ANY!r}, which means all arms")
