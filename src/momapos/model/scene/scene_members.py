"""The members of a scene file: its checks, schema, list of members and known keys follow."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Any, Literal

import msgspec

from momapos.core import ChosenName, FileRecord, Keys, Parents, is_name, unknown_keys
from momapos.model.records import JointResistance, PartKind

MAX_CORNERS = 1_000
"""Maximum number of corners of an area or a floor [-]."""
MAX_OBJECTS = 2_000
"""Maximum number of objects; relations between all pairs of them take about 5 s [-]."""
ROUNDING_TOLERANCE = 1e-3
"""Tolerance of rounded probabilities and of unit vectors [-]."""
Coordinate = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]
Local = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]
Point = tuple[Coordinate, Coordinate]
Position = tuple[Coordinate, Coordinate, Coordinate]
LocalTriple = tuple[Local, Local, Local]
Edge = Annotated[float, msgspec.Meta(gt=0, le=1e6)]
Quaternion = tuple[Local, Local, Local, Local]
Share = Annotated[float, msgspec.Meta(ge=0, le=1)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
Corners = Annotated[tuple[Point, ...], msgspec.Meta(min_length=3, max_length=MAX_CORNERS)]
Unset = msgspec.UnsetType
UNSET = msgspec.UNSET
"""Default of a member that a file may leave out, and that is not null."""


class ScenePose(FileRecord):
    """Pose of an object's frame in the world."""

    xyz: Position
    """Position [m]."""
    wxyz: Quaternion = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion [-]."""

    def __post_init__(self) -> None:
        length = math.hypot(*self.wxyz)
        if not 0.9 < length < 1.1:
            raise ValueError(f"wxyz has length {length:g}; it must be 1")


class SceneStart(FileRecord):
    """Initial pose of the robot's base on the floor."""

    x: Coordinate
    """[m]"""
    y: Coordinate
    """[m]"""
    yaw: Coordinate
    """[rad]"""


class SceneWall(FileRecord):
    """A wall on the floor."""

    start: Point = msgspec.field(name="from")
    """One end of its center line: x, y [m]."""
    to: Point
    """The other end [m]."""
    height: Annotated[float, msgspec.Meta(ge=1e-3, le=100)] = 2.5
    """[m]"""
    thickness: Annotated[float, msgspec.Meta(ge=1e-3, le=10)] = 0.1
    """Half of it on either side of the center line [m]."""


class SceneLatch(FileRecord):
    """What must be turned before a part opens."""

    joint: str
    """Joint of the latch."""
    to: float | str
    """Value from which on the part is free [rad] or [m], or a text with a unit such as "40deg"."""
    holds: str | None = None
    """Joint that it holds while closed within 0.01 rad or m; needed if several move the latch."""


class SceneHypothesis(FileRecord):
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

    def __post_init__(self) -> None:
        if abs(math.hypot(*self.axis) - 1.0) > ROUNDING_TOLERANCE:
            raise ValueError("axis must have length 1")


class SceneConfidence(FileRecord):
    """How sure a scan is."""

    object: Share
    """That the object exists [-]."""
    label: Share
    """That its category is right [-]."""
    joints: dict[str, Share] = {}
    """That a joint is as modeled, by joint [-]."""
    handles: dict[str, Share] = {}
    """That a handle was seen, by joint [-]."""


class SceneEntry(FileRecord):
    """An object; it has either `urdf` or `box`."""

    name: Name
    """Unique in the scene."""
    pose: ScenePose
    """Pose of the model's frame, or of the middle of the box."""
    category: Annotated[str, msgspec.Meta(max_length=1000)] = ""
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
    on: Name | Unset | None = UNSET
    """What a rigid object rests on, as OBJECT or OBJECT/PART; null for nothing that moves. Without
    it the face that carries its base decides."""
    inside: Name | Unset | None = msgspec.field(default=UNSET, name="in")
    """The same, for what is in something."""
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.urdf is UNSET) == (self.box is UNSET):
            raise ValueError("needs either 'urdf' or 'box'")
        if self.on is not UNSET and self.inside is not UNSET:
            raise ValueError("needs either 'on' or 'in'")


class SceneFile(FileRecord):
    """A room."""

    format: Literal["momapos-scene"]
    """Name of the format."""
    version: Literal[1]
    """Version of the format."""
    objects: Annotated[list[SceneEntry], msgspec.Meta(max_length=MAX_OBJECTS)]
    """Everything in the room but its walls."""
    name: Name | None = None
    """By default that of the file."""
    floor: Corners | None = None
    """Corners of the floor: x, y [m]; without it the floor has no end."""
    walls: Literal["floor"] | Annotated[list[SceneWall], msgspec.Meta(max_length=1000)] | None = (
        None
    )
    """"floor" for walls around the floor."""
    map: Name | None = None
    """Path of a Nav2 map (YAML), whose occupied cells become walls."""
    start: SceneStart | None = None
    """Where the robot's base is before a task."""
    schema: str | Unset = msgspec.field(default=UNSET, name="$schema")
    """Address of the file's JSON Schema, for editors."""
    areas: Annotated[dict[str, Corners], msgspec.Meta(max_length=1000)] = {}
    """Simple polygons for --keep-in and --keep-out, by name."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.areas:
            if not is_name(name):
                raise ValueError(f"areas has {name!r:.80}, which is no printable name")


MAX_IGNORED_KEYS = 100
"""Maximum number of unknown keys of a file that are reported one by one [-]."""
MAX_LISTED_KEYS = 5
"""The known keys are listed if no similar one exists and if they are at most this many [-]."""


BESTMAN_KEYS: Keys = dict.fromkeys((
    "obj_name", "model_path", "object_position", "object_orientation", "scale", "fixed_base",
    "note",
))  # fmt: skip
"""Keys of an object of a BestMan scene; `note` is a comment."""
_MEANT = {
    "rpy": "wxyz", "euler": "wxyz", "quat": "wxyz", "quaternion": "wxyz", "xyzw": "wxyz",
    "orientation": "wxyz", "rotation": "wxyz", "position": "xyz", "translation": "xyz",
    "size": "box", "dimensions": "box", "extents": "box", "file": "urdf", "model": "urdf",
    "mesh": "urdf", "uri": "urdf", "type": "category", "class": "category", "label": "category",
    "theta": "yaw", "heading": "yaw", "outline": "floor", "room": "floor", "polygon": "floor",
    "robot": "start", "obstacles": "objects", "furniture": "objects",
}  # fmt: skip
"""Words of other formats for our keys."""
_WHAT = {"wxyz": "a unit quaternion", "yaw": "in radians", "box": "edge lengths in meters"}
"""What a suggested key holds, where a word of another format may hold something else."""


@dataclass(frozen=True)
class IgnoredKey:
    """An unknown key of a scene file, which was ignored."""

    where: str
    """File, object and parent keys."""
    object: str
    """Name of the object; "" outside of objects."""
    key: str
    advice: str
    """Which key may be meant."""

    def __str__(self) -> str:
        advice = f"; {self.advice}" if self.advice else ""
        return f"{self.where}: {self.key!r:.80} is not known and was ignored{advice}"


def ignored_keys(data: Any, keys: Keys, where: str) -> tuple[IgnoredKey, ...]:
    """Return the unknown keys of a scene file, at most `MAX_IGNORED_KEYS` and one for the others.

    Args:
        data: Content of the file.
        keys: The keys that it may have.
        where: The file, for messages.
    """
    unknown = tuple(islice(unknown_keys(data, keys), MAX_IGNORED_KEYS + 1))
    found = tuple(
        IgnoredKey(*_at(data, parents, where), key, _advice(key, known))
        for parents, key, known in unknown[:MAX_IGNORED_KEYS]
    )
    if len(unknown) <= MAX_IGNORED_KEYS:
        return found
    rest = IgnoredKey(where, "", "...", f"more than {MAX_IGNORED_KEYS} unknown keys")
    return (*found, rest)


def place_of(data: Any, parents: Parents, where: str) -> str:
    """Return where a value of a scene file stands, in words that begin with the file."""
    return _at(data, parents, where)[0]


def _at(data: Any, parents: Parents, where: str) -> tuple[str, str]:
    """Return where a key stands, in words, and the name of the object that it belongs to."""
    owner, item = "", data
    for part in parents:
        item = item.get(part) if isinstance(item, dict) else item[part]
        if isinstance(part, int) and owner:
            where = f"{where} {part}"
        elif isinstance(part, int):
            owner = _name_of(item)
            what = {"walls": "wall", "objects": "object"}.get(f"{parents[0]}", "point")
            what = "object" if part is parents[0] else what
            where = f"{where}: {what} {part}" + (f" ({owner!r})" if owner else "")
        elif isinstance(part, ChosenName):
            where = f"{where}: {part!r:.80}"
        elif part != "objects" or owner or part is parents[-1]:
            where = f"{where}: {part}"
    return where, owner


def _name_of(item: Any) -> str:
    name = item.get("name", item.get("obj_name")) if isinstance(item, dict) else ""
    return name[:80] if isinstance(name, str) else ""


def _advice(key: str, known: Sequence[str]) -> str:
    meant = _MEANT.get(key.lower(), "")
    near = [meant] if meant in known else difflib.get_close_matches(key.lower(), known, n=1)
    if near:
        what = f", {_WHAT[near[0]]}" if near[0] in _WHAT and near[0] == meant else ""
        return f"did you mean {near[0]!r}{what}?"
    return f"known are {', '.join(known)}" if len(known) <= MAX_LISTED_KEYS else ""
