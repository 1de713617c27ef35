"""The members of a scene file: its schema, its list of members and its known keys follow."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from momapos.model.records import JointResistance, PartKind

Coordinate = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]
Local = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]
Pair = tuple[float, float]
Point = tuple[Coordinate, Coordinate]
Triple = tuple[float, float, float]
Position = tuple[Coordinate, Coordinate, Coordinate]
LocalTriple = tuple[Local, Local, Local]
Edge = Annotated[float, msgspec.Meta(gt=0, le=1e3)]
Quaternion = tuple[float, float, float, float]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Positive = Annotated[float, msgspec.Meta(gt=0)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
Outline = Annotated[tuple[Point, ...], msgspec.Meta(min_length=3, max_length=1000)]
Unset = msgspec.UnsetType
UNSET = msgspec.UNSET
"""Default of a member that a file may leave out, and that is not null."""


class _Strict(msgspec.Struct, forbid_unknown_fields=True):
    """A record without further members: the reader ignores those, with a warning."""


class ScenePose(_Strict):
    """Pose of an object's frame in the world."""

    xyz: Position
    """Position [m]."""
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion [-]."""


class SceneStart(_Strict):
    """Initial pose of the robot's base on the floor."""

    x: Coordinate
    """[m]"""
    y: Coordinate
    """[m]"""
    yaw: Coordinate
    """[rad]"""


class SceneWall(_Strict):
    """A wall on the floor."""

    start: Point = msgspec.field(name="from")
    """One end of its center line: x, y [m]."""
    to: Point
    """The other end [m]."""
    height: Annotated[float, msgspec.Meta(ge=1e-3, le=100)] = 2.5
    """[m]"""
    thickness: Annotated[float, msgspec.Meta(ge=1e-3, le=10)] = 0.1
    """Half of it on either side of the center line [m]."""


class SceneLatch(_Strict):
    """What must be turned before a part opens."""

    joint: str
    """Joint of the latch."""
    to: float | str
    """Value from which on the part is free [rad] or [m], or a text with a unit such as "40deg"."""
    holds: str | None = None
    """Joint that it holds while closed within 0.01 rad or m; needed if several move the latch."""


class SceneHypothesis(_Strict):
    """One motion that a part may have."""

    kind: PartKind
    """Kind of the part, such as "door_left" (its hinge is at the left) or "drawer"."""
    probability: Share
    """[-]"""
    point: LocalTriple
    """A point on the axis, in the object's frame [m]."""
    axis: LocalTriple
    """Unit vector along the axis, in the object's frame [-]."""
    upper: Annotated[float, msgspec.Meta(ge=0, le=1e3)]
    """How far it opens [rad] or [m]."""


class SceneConfidence(_Strict):
    """How sure a scan is."""

    object: Share
    """That the object exists [-]."""
    label: Share
    """That its category is right [-]."""
    joints: dict[str, Share] = {}
    """That a joint is as modeled, by joint [-]."""
    handles: dict[str, Share] = {}
    """That a handle was seen, by joint [-]."""


class SceneEntry(_Strict):
    """An object; it has either `urdf` or `box`."""

    name: Name
    """Unique in the scene."""
    pose: ScenePose
    """Pose of the model's frame, or of the middle of the box."""
    category: str = ""
    """What it is, such as "fridge"."""
    urdf: Name | Unset = UNSET
    """Path of its model, relative to the scene file and inside of its folder."""
    scale: Annotated[float, msgspec.Meta(ge=1e-3, le=1e3)] = 1.0
    """Factor on all lengths of the model, limits of sliding joints included, not on masses [-]."""
    box: tuple[Edge, Edge, Edge] | Unset = UNSET
    """Edge lengths of a rigid box about its frame [m]."""
    joints: dict[str, float] = {}
    """Joint values within the limits [rad] or [m]; others are zero, or at the nearest limit."""
    closed: dict[str, float] = {}
    """Values at which joints are closed [rad] or [m]; others are found from the geometry."""
    mass: Annotated[float, msgspec.Meta(gt=0, le=1e5)] | Unset = UNSET
    """Mass of a rigid object [kg]."""
    resistance: dict[str, JointResistance] = {}
    """What is known about seal, friction and weight, by joint."""
    latch: SceneLatch | None = None
    """What holds one of its parts while that is closed."""
    hypotheses: dict[
        str, Annotated[list[SceneHypothesis], msgspec.Meta(min_length=1, max_length=16)]
    ] = {}
    """Motions that a part may have, by joint; the first is the most probable and in the URDF."""
    confidence: SceneConfidence | None = None
    """Confidence of the scan that the model was made from."""


class SceneFile(_Strict):
    """A room."""

    format: Literal["momapos-scene"]
    """Name of the format."""
    version: Literal[1]
    """Version of the format."""
    objects: list[SceneEntry]
    """Everything in the room but its walls."""
    name: Name | None = None
    """By default that of the file."""
    floor: Outline | None = None
    """Corners of the floor: x, y [m]; without it the floor has no end."""
    walls: Literal["floor"] | list[SceneWall] | None = None
    """"floor" for walls around the floor."""
    map: str | None = None
    """Path of a Nav2 map (YAML), whose occupied cells become walls."""
    start: SceneStart | None = None
    """Where the robot's base is before a task."""
    schema: str | Unset = msgspec.field(default=UNSET, name="$schema")
    """Address of the file's JSON Schema, for editors."""
    areas: dict[str, Outline] = {}
    """Simple polygons for --keep-in and --keep-out, by name."""
