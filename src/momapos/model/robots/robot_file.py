"""Read a robot file: its arms, its base, what it adds to the URDF, and unknown keys."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    FileRecord,
    Parents,
    RobotError,
    dotted,
    keys_of,
    read_bytes_bounded,
    read_record,
    resolved,
    unknown_keys,
    unknown_name,
    write_file,
)
from momapos.model.urdf import Articulated, Mimic, once

from .amended_urdf import AddedFrame, Amendments, Mount
from .srdf import srdf_next_to

if TYPE_CHECKING:
    from jaxtyping import Float


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
    effort: Positive | None = None
    """[N m] or [N]"""


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


VERSION = 1
"""Version of the robot file format; files without a version have version 1."""
MAX_IGNORED_KEYS = 20
"""Unknown keys of a file that are reported one by one [-]."""
MAX_TOML_BYTES = 20_000
"""Maximum size of a robot file [bytes]; TOML parsing time grows with the square of dotted keys."""


def ignored_keys(data: Mapping[str, Any], name: str) -> tuple[str, ...]:
    """Return a line for each unknown key of a robot file, and one for those beyond a number.

    Args:
        data: Content of the file.
        name: The file, for the lines.
    """
    lines = []
    for parents, key, known in unknown_keys(data, {**keys_of(RobotArm), **keys_of(RobotFile)}):
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        path = ".".join(map(str, (*parents, key)))
        lines.append(f"{path!r:.80} of {name} is not known and was ignored{hint}")
    if len(lines) > MAX_IGNORED_KEYS:
        rest = f"{len(lines) - MAX_IGNORED_KEYS} more keys of {name} are not known"
        return (*lines[:MAX_IGNORED_KEYS], rest)
    return tuple(lines)


@dataclass(frozen=True)
class ReadRobot:
    """The content of a robot file."""

    path: Path
    file: RobotFile
    ignored: tuple[str, ...]
    """Lines about unknown keys."""

    def path_of(self, name: str, key: str = "urdf") -> Path:
        """Return the path of a file that the robot file names.

        Raises:
            RobotError: The name is not a valid path.
        """
        try:
            return resolved(self.path.parent / name)
        except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
            raise RobotError(f"{self.path}: {key} {name!r:.80} is not a valid path") from error


def read_robot_file(path: Path) -> ReadRobot:
    """Read a robot file; the one arm of a file without `arms` is named "".

    Raises:
        FileFormatError: The file is not TOML, or too large.
        RobotError: A value is missing or unusable.
    """
    content = read_bytes_bounded(path, MAX_TOML_BYTES)
    try:
        data = tomllib.loads(content.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # includes invalid UTF-8 and too many digits
        raise FileFormatError(f"{path}: not a robot file in TOML ({error})") from error
    doubled = [key for key in ("arm_joints", "tool_link", "home", "tool") if key in data]
    if "arms" in data and doubled:
        raise RobotError(f"{path}: {doubled[0]} must be in the tables of arms, as in [arms.left]")
    return ReadRobot(
        path,
        read_record({"arms": {"": data}, **data}, RobotFile, _place(path), RobotError),
        ignored_keys(data, path.name),
    )


_HOME = re.compile(r"^([ \t]*home[ \t]*=[ \t]*)\[[^]]*\]", re.MULTILINE)
"""A home in a robot file, which may span lines."""


def save_homes(path: Path, homes: Mapping[str, Sequence[float]]) -> None:
    """Replace the homes in a robot file; all else stays as it is, also comments.

    Args:
        path: The robot file.
        homes: The values of `arm_joints` of each arm, "" for a single one [rad] or [m].

    Raises:
        RobotError: The file has other arms by now, cannot be written, or its homes are not in lines
            of their own.
    """
    file = resolved(path)  # a link stays one
    arms = read_robot_file(file).file.arms
    if {name: len(arm.arm_joints) for name, arm in arms.items()} != {
        name: len(home) for name, home in homes.items()
    }:
        raise RobotError(f"{path}: has other arms or joints than those shown; open it again")
    text = read_bytes_bounded(file, MAX_TOML_BYTES).decode("utf-8-sig")
    wanted = tomllib.loads(text)
    for name, home in homes.items():
        (wanted["arms"][name] if name else wanted)["home"] = [round(float(q), 6) for q in home]
    lines = [
        str(arm["home"]) for arm in (wanted["arms"].values() if "arms" in wanted else [wanted])
    ]
    left = iter(lines)
    new = _HOME.sub(lambda found: found[1] + next(left, ""), text)
    try:
        same = tomllib.loads(new) == wanted
    except ValueError:
        same = False
    if not same:
        raise RobotError(
            f"{path}: home is not in a line of its own; replace it by home = {' and '.join(lines)}"
        )
    write_file(file, new, error=RobotError)


def _place(path: Path) -> Callable[[Parents], str]:
    def place(parents: Parents) -> str:
        return f"{path}: {dotted(parents[2:] if parents[:2] == ('arms', '') else parents)}"

    return place


def srdf_of(read: ReadRobot, urdf: Path) -> Path | None:
    """Return the SRDF that a robot file names, or the one next to the URDF with its name.

    Raises:
        RobotError: The named file does not exist.
    """
    if read.file.srdf is None:
        return srdf_next_to(urdf)
    named = read.path_of(read.file.srdf, "srdf")
    if not named.is_file():
        raise RobotError(f"{read.path}: srdf names {named}, which does not exist")
    return named


def amendments_of(read: ReadRobot) -> Amendments:
    """Return the additions to the URDF."""
    file = read.file
    return Amendments(
        tuple(AddedFrame(name, one.parent, one.xyz, one.rpy) for name, one in file.frames.items()),
        _mount(read),
        {name: _package(read, name, folder) for name, folder in file.packages.items()},
        {name: Mimic(one.joint, one.ratio, one.offset) for name, one in file.coupled.items()},
        {name: _given(limits) for name, limits in file.limits.items()},
        file.visual_hulls,
    )


def _given(limits: msgspec.Struct) -> dict[str, float]:
    members = msgspec.structs.asdict(limits)
    return {name: value for name, value in members.items() if value is not None}


def _mount(read: ReadRobot) -> Mount | None:
    mount = read.file.mount
    if mount is None:
        return None
    urdf = None if mount.urdf is None else read.path_of(mount.urdf, "mount.urdf")
    xyz = mount.xyz or (0.0, 0.0, 0.0 if mount.box is None else mount.box[2])
    return Mount(xyz, mount.rpy, mount.box, urdf, mount.link)


def _package(read: ReadRobot, name: str, folder: str) -> Path:
    found = read.path_of(folder, f"packages.{name}")
    if not found.is_dir():
        raise RobotError(f"{read.path}: packages.{name} names {found}, which is no folder")
    return found


def choose_arms(read: ReadRobot, arm: str | None) -> tuple[str, ...]:
    """Return the names of the requested arms: all for `ANY`, the first one for None.

    Raises:
        UnknownNameError, RobotError: The robot has no arm of that name.
    """
    arms = read.file.arms
    if arm == ANY:
        return tuple(arms)
    if arm is None:
        return (next(iter(arms)),)
    if arm in arms and arm:
        return (arm,)
    if "" in arms:
        raise RobotError(f"{read.path}: the robot has one arm; leave out arm {arm!r:.40}")
    raise unknown_name("arm", arm, arms, str(read.path))


def at_rest(model: Articulated, read: ReadRobot, chosen: str) -> Articulated:
    """Return the robot with the values of its table `rest`, and its other arms at home.

    Raises:
        RobotError: A value is not within the limits, or belongs to an arm joint.
        UnknownNameError: A joint does not exist.
    """
    held: dict[str, float] = {}
    arms = read.file.arms
    joints = [joint for arm in arms.values() for joint in arm.arm_joints]
    for name, value in read.file.rest.items():
        if name in joints:
            raise RobotError(
                f"{read.path}: rest.{name} is a joint of the arm, whose rest value is in home"
            )
        held[name] = _within_limits(model, name, value, f"{read.path}: rest.{name}")
    for other, arm in arms.items():
        if other == chosen:
            continue
        if len(arm.arm_joints) != len(arm.home):
            raise RobotError(
                f"{read.path}: arms.{other}.home must have one value per joint of arm_joints, "
                f"{len(arm.arm_joints)}, not {len(arm.home)}"
            )
        for name, value in zip(arm.arm_joints, arm.home, strict=True):
            if name not in arms[chosen].arm_joints:
                where = f"{read.path}: arms.{other}.{name}"
                held[name] = _within_limits(model, name, value, where)
    return Articulated(model.urdf, held, model.cache) if held else model


def _within_limits(model: Articulated, name: str, value: float, where: str) -> float:
    joint = model.joint(name)
    if not joint.lower - 1e-6 <= value <= joint.upper + 1e-6:
        raise RobotError(f"{where} is {value:g}; its limits are {joint.lower:g} to {joint.upper:g}")
    return value


def read_footprint(read: ReadRobot, cache: Cache | None) -> Float[np.ndarray, "k 2"]:
    """Return the convex outline of the base, counterclockwise [m].

    Args:
        read: The robot file.
        cache: Keeps the outline; None to compute it.

    Raises:
        RobotError: The outline has no area.
    """
    points = np.array(read.file.base.footprint)
    return once(cache, "footprint", (points,), lambda: _outline(points, read.path))


def _outline(points: Float[np.ndarray, "n 2"], path: Path) -> Float[np.ndarray, "k 2"]:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise RobotError(
            f"{path}: base.footprint must enclose an area, as [[x, y], ...]"
        ) from error
