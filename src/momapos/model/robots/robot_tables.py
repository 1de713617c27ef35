"""Robot files: the tables that change what the URDF says, those of the arms, and the SRDF."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

from momapos.core import FileFormatError, RobotError, read_bytes_bounded, unknown_name
from momapos.model.urdf import Articulated, Mimic

from .amended_urdf import ZERO, Amendments, Frame, Mount, Triple
from .file_values import Table
from .srdf import beside as srdf_beside

VERSION = 1
"""Of the robot file's format; a file that gives none is of version 1."""
ANY = "any"
"""Stands for every arm where one is asked for."""
MAX_FRAMES, MAX_PACKAGES = 50, 200
MAX_TOML_BYTES = 20_000
"""A robot file has a page; the time that a parser takes for dotted keys grows with their square."""


def read_table(path: Path) -> Table:
    """Read a robot file.

    Raises:
        FileFormatError: It is no TOML, or too large.
    """
    data = read_bytes_bounded(path, MAX_TOML_BYTES)
    try:
        return Table(tomllib.loads(data.decode()), path)
    except (ValueError, RecursionError) as error:  # also no UTF-8, and too many digits
        raise FileFormatError(f"{path}: not a robot file in TOML ({error})") from error


def srdf_of(table: Table, urdf: Path) -> Path | None:
    """The SRDF that a robot file names, or the one of the URDF's name beside it, if any.

    Raises:
        RobotError: The one that is named does not exist.
    """
    if "srdf" not in table.data:
        return srdf_beside(urdf)
    named = beside(table.path, table.text("srdf"), "srdf")
    if not named.is_file():
        raise RobotError(f"{table.path}: srdf names {named}, which does not exist")
    return named


def check_version(table: Table) -> None:
    """Refuse a robot file of another version.

    Raises:
        RobotError: It is of another one.
    """
    version = table.data.get("version", VERSION)
    if version != VERSION or isinstance(version, bool):
        raise RobotError(
            f"{table.path}: version {version!r:.60} of the robot file; this momapos reads version "
            f"{VERSION}"
        )


def amendments_of(table: Table) -> Amendments:
    """What a robot file changes about its URDF: the tables frames, mount, packages and coupled."""
    return Amendments(_frames(table), _mount(table), _packages(table), _couplings(table))


def _frames(table: Table) -> tuple[Frame, ...]:
    frames = table.tables("frames", MAX_FRAMES)
    return tuple(
        Frame(name, frame.text("parent"), _triple(frame, "xyz"), _triple(frame, "rpy"))
        for name, frame in frames.items()
    )


def _mount(table: Table) -> Mount | None:
    if "mount" not in table.data:
        return None
    mount = table.table("mount")
    if ("box" in mount.data) == ("urdf" in mount.data):
        raise RobotError(
            f"{table.path}: [mount] needs either box = [length, width, height] or urdf, the base's"
        )
    rpy = _triple(mount, "rpy")
    if "urdf" in mount.data:
        urdf = beside(table.path, mount.text("urdf"), "mount.urdf")
        link = mount.text("link") if "link" in mount.data else ""
        return Mount(_triple(mount, "xyz"), rpy, urdf=urdf, link=link)
    box = _triple(mount, "box")
    if min(box) <= 0 or max(box) > 5:
        raise RobotError(f"{table.path}: mount.box must be three edges in m, > 0 and at most 5")
    xyz = _triple(mount, "xyz") if "xyz" in mount.data else (0.0, 0.0, box[2])
    return Mount(xyz, rpy, box=box)


def _packages(table: Table) -> dict[str, Path]:
    if "packages" not in table.data:
        return {}
    packages = table.table("packages")
    if len(packages.data) > MAX_PACKAGES:
        raise RobotError(f"{table.path}: [packages] names more than {MAX_PACKAGES} folders")
    found = {}
    for name in packages.data:
        folder = beside(table.path, packages.text(name), f"packages.{name}")
        if not folder.is_dir():
            raise RobotError(f"{table.path}: packages.{name} names {folder}, which is no folder")
        found[name] = folder
    return found


def _couplings(table: Table) -> dict[str, Mimic]:
    return {
        name: Mimic(follows.text("joint"), follows.number("ratio", 1.0), follows.number("offset"))
        for name, follows in table.tables("coupled").items()
    }


def arm_tables(table: Table) -> dict[str, Table]:
    """The tables of a robot's arms by name; the file itself, named "", where it has one arm."""
    if "arms" not in table.data:
        return {"": table}
    arms = table.tables("arms")
    if not arms:
        raise RobotError(f"{table.path}: [arms] is empty; give tables such as [arms.left]")
    if ANY in arms:
        raise RobotError(f"{table.path}: no arm can be named {ANY!r}, which stands for all of them")
    doubled = [key for key in ("arm_joints", "tool_link", "home", "tool") if key in table.data]
    if doubled:
        raise RobotError(
            f"{table.path}: {doubled[0]} belongs into the tables of the arms, as "
            f"[arms.{next(iter(arms))}]"
        )
    return arms


def choose_arms(arms: dict[str, Table], arm: str | None, path: Path) -> tuple[str, ...]:
    """Names of the arms that one asks for; all of them for `ANY`, the first one for None.

    Raises:
        UnknownNameError, RobotError: There is none of that name.
    """
    if arm == ANY:
        return tuple(arms)
    if arm is None:
        return (next(iter(arms)),)
    if arm in arms and arm:
        return (arm,)
    if "" in arms:
        raise RobotError(f"{path}: the robot has one arm; leave out arm {arm!r:.40}")
    raise unknown_name("arm", arm, arms, str(path))


def at_rest(
    model: Articulated, table: Table, arms: Mapping[str, Table], chosen: str
) -> Articulated:
    """The robot with what its table `rest` names where it rests, and its other arms at home.

    Raises:
        RobotError: A value is no number within the limits, or one of a joint of an arm.
        UnknownNameError: There is no such joint.
    """
    held: dict[str, float] = {}
    rest = table.table("rest") if "rest" in table.data else Table({}, table.path, "rest.")
    joints = [joint for arm in arms.values() for joint in arm.texts("arm_joints")]
    for name in rest.data:
        if name in joints:
            raise RobotError(
                f"{table.path}: rest.{name} is a joint of the arm, which rests at home"
            )
        held[name] = _rest_value(model, name, rest.data[name], rest)
    for other in (arm for name, arm in arms.items() if name != chosen):
        names, home = other.texts("arm_joints"), other.vector("home")
        if len(names) != len(home):
            raise RobotError(
                f"{table.path}: {other.prefix}home has {len(home)} values, arm_joints has "
                f"{len(names)}"
            )
        for name, value in zip(names, home, strict=True):
            if name not in arms[chosen].texts("arm_joints"):
                held[name] = _rest_value(model, name, float(value), other)
    return Articulated(model.urdf, held, model.cache) if held else model


def _rest_value(model: Articulated, name: str, value: object, table: Table) -> float:
    joint = model.joint(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RobotError(f"{table.path}: {table.prefix}{name} must be a number")
    if not joint.lower - 1e-6 <= value <= joint.upper + 1e-6:
        raise RobotError(
            f"{table.path}: {table.prefix}{name} is {value:g}, its limits are {joint.lower:g} to "
            f"{joint.upper:g}"
        )
    return float(value)


def beside(path: Path, name: str, key: str = "urdf") -> Path:
    """A file that a robot file names.

    Raises:
        RobotError: No file can have that name.
    """
    try:
        return (path.parent / name).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # too long, links in a circle, a NUL
        raise RobotError(f"{path}: {key} {name!r:.80} cannot be looked up") from error


def _triple(table: Table, key: str) -> Triple:
    if key not in table.data:
        return ZERO
    value = table.vector(key)
    if value.shape != (3,):
        raise RobotError(f"{table.path}: {table.prefix}{key} must be 3 numbers")
    return (float(value[0]), float(value[1]), float(value[2]))
