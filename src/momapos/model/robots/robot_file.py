"""Read a robot file: its arms, its base, what it adds to the URDF, and unknown keys."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    Parents,
    RobotError,
    dotted,
    keys_of,
    read_bytes_bounded,
    read_record,
    resolved,
    unknown_keys,
    unknown_name,
)
from momapos.model.urdf import Articulated, Mimic, once

from .amended_urdf import AddedFrame, Amendments, Mount
from .robot_members import ANY, RobotArm, RobotFile
from .srdf import srdf_next_to

if TYPE_CHECKING:
    from jaxtyping import Float


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
