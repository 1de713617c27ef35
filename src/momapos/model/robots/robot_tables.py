"""Tables of robot files: additions to the URDF, arms, rest values and the SRDF."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

from momapos.core import FileFormatError, RobotError, read_bytes_bounded, resolved, unknown_name
from momapos.model.urdf import Articulated, Mimic

from .amended_urdf import ZERO, AddedFrame, Amendments, Mount, Triple
from .file_values import TomlTable
from .srdf import srdf_next_to

VERSION = 1
"""Version of the robot file format; files without a version have version 1."""
ANY = "any"
"""Name that stands for all arms."""
_LIMITS = ("lower", "upper", "velocity", "acceleration")
"""Limits of a joint that a robot file can replace."""
MAX_FRAMES, MAX_PACKAGES = 50, 200
MAX_TOML_BYTES = 20_000
"""Maximum size of a robot file [bytes]; TOML parsing time grows with the square of dotted keys."""


def read_table(path: Path) -> TomlTable:
    """Read a robot file.

    Raises:
        FileFormatError: The file is not TOML, or too large.
    """
    data = read_bytes_bounded(path, MAX_TOML_BYTES)
    try:
        return TomlTable(tomllib.loads(data.decode("utf-8-sig")), path)
    except (ValueError, RecursionError) as error:  # includes invalid UTF-8 and too many digits
        raise FileFormatError(f"{path}: not a robot file in TOML ({error})") from error


def srdf_of(table: TomlTable, urdf: Path) -> Path | None:
    """Return the SRDF that a robot file names, or the one next to the URDF with its name.

    Raises:
        RobotError: The named file does not exist.
    """
    if "srdf" not in table.data:
        return srdf_next_to(urdf)
    named = resolve_path(table.path, table.text("srdf"), "srdf")
    if not named.is_file():
        raise RobotError(f"{table.path}: srdf names {named}, which does not exist")
    return named


def check_version(table: TomlTable) -> None:
    """Refuse a robot file of an unsupported version.

    Raises:
        RobotError: The version is not supported.
    """
    version = table.data.get("version", VERSION)
    if version != VERSION or isinstance(version, bool):
        raise RobotError(
            f"{table.path}: version of the robot file is {version!r:.60}; this momapos reads "
            f"version {VERSION}"
        )


def amendments_of(table: TomlTable) -> Amendments:
    """Return the additions to the URDF: visual_hulls, and the tables named here."""
    return Amendments(
        _frames(table), _mount(table), _packages(table), _couplings(table), _limits(table),
        table.flag("visual_hulls"),
    )  # fmt: skip


def _frames(table: TomlTable) -> tuple[AddedFrame, ...]:
    frames = table.tables("frames", MAX_FRAMES)
    return tuple(
        AddedFrame(name, frame.text("parent"), _triple(frame, "xyz"), _triple(frame, "rpy"))
        for name, frame in frames.items()
    )


def _mount(table: TomlTable) -> Mount | None:
    if "mount" not in table.data:
        return None
    mount = table.table("mount")
    if ("box" in mount.data) == ("urdf" in mount.data):
        raise RobotError(
            f"{table.path}: [mount] needs either box = [length, width, height] in m, or urdf"
        )
    rpy = _triple(mount, "rpy")
    if "urdf" in mount.data:
        urdf = resolve_path(table.path, mount.text("urdf"), "mount.urdf")
        link = mount.text("link") if "link" in mount.data else ""
        return Mount(_triple(mount, "xyz"), rpy, urdf=urdf, link=link)
    box = _triple(mount, "box")
    if min(box) <= 0 or max(box) > 5:
        raise RobotError(f"{table.path}: mount.box must be 3 edge lengths in m, > 0 and <= 5")
    xyz = _triple(mount, "xyz") if "xyz" in mount.data else (0.0, 0.0, box[2])
    return Mount(xyz, rpy, box=box)


def _packages(table: TomlTable) -> dict[str, Path]:
    if "packages" not in table.data:
        return {}
    packages = table.table("packages")
    if len(packages.data) > MAX_PACKAGES:
        raise RobotError(f"{table.path}: [packages] names more than {MAX_PACKAGES} folders")
    found = {}
    for name in packages.data:
        folder = resolve_path(table.path, packages.text(name), f"packages.{name}")
        if not folder.is_dir():
            raise RobotError(f"{table.path}: packages.{name} names {folder}, which is no folder")
        found[name] = folder
    return found


def _couplings(table: TomlTable) -> dict[str, Mimic]:
    return {
        name: Mimic(follows.text("joint"), follows.number("ratio", 1.0), follows.number("offset"))
        for name, follows in table.tables("coupled").items()
    }


def _limits(table: TomlTable) -> dict[str, dict[str, float]]:
    found = {}
    for name, limits in table.tables("limits").items():
        unknown = next((key for key in limits.data if key not in _LIMITS), None)
        if unknown is not None:
            raise RobotError(
                f"{table.path}: {limits.prefix}{unknown} is unknown; limits are "
                f"{', '.join(_LIMITS)}"
            )
        ends = {key: limits.number(key) for key in _LIMITS[:2] if key in limits.data}
        rates = {key: limits.positive(key, 1.0) for key in _LIMITS[2:] if key in limits.data}
        found[name] = {**ends, **rates}
    return found


def arm_tables(table: TomlTable) -> dict[str, TomlTable]:
    """Return the tables of the arms by name; the file itself as "" for a robot with one arm."""
    if "arms" not in table.data:
        return {"": table}
    arms = table.tables("arms")
    if not arms:
        raise RobotError(f"{table.path}: [arms] is empty; add tables such as [arms.left]")
    if ANY in arms:
        raise RobotError(f"{table.path}: an arm must not be named {ANY!r}, which means all arms")
    doubled = [key for key in ("arm_joints", "tool_link", "home", "tool") if key in table.data]
    if doubled:
        raise RobotError(
            f"{table.path}: {doubled[0]} must be in the tables of the arms, such as "
            f"[arms.{next(iter(arms))}]"
        )
    return arms


def choose_arms(arms: dict[str, TomlTable], arm: str | None, path: Path) -> tuple[str, ...]:
    """Return the names of the requested arms: all for `ANY`, the first one for None.

    Raises:
        UnknownNameError, RobotError: The robot has no arm of that name.
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
    model: Articulated, table: TomlTable, arms: Mapping[str, TomlTable], chosen: str
) -> Articulated:
    """Return the robot with the values of its table `rest`, and its other arms at home.

    Raises:
        RobotError: A value is not a number within the limits, or belongs to an arm joint.
        UnknownNameError: A joint does not exist.
    """
    held: dict[str, float] = {}
    rest = table.table("rest") if "rest" in table.data else TomlTable({}, table.path, "rest.")
    joints = [joint for arm in arms.values() for joint in arm.texts("arm_joints")]
    for name in rest.data:
        if name in joints:
            raise RobotError(
                f"{table.path}: rest.{name} is a joint of the arm, whose rest value is in home"
            )
        held[name] = _rest_value(model, name, rest.data[name], rest)
    for other in (arm for name, arm in arms.items() if name != chosen):
        names, home = other.texts("arm_joints"), other.vector("home")
        if len(names) != len(home):
            raise RobotError(
                f"{table.path}: {other.prefix}home must have one value per joint of arm_joints, "
                f"{len(names)}, not {len(home)}"
            )
        for name, value in zip(names, home, strict=True):
            if name not in arms[chosen].texts("arm_joints"):
                held[name] = _rest_value(model, name, float(value), other)
    return Articulated(model.urdf, held, model.cache) if held else model


def _rest_value(model: Articulated, name: str, value: object, table: TomlTable) -> float:
    joint = model.joint(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RobotError(f"{table.path}: {table.prefix}{name} must be a number")
    if not joint.lower - 1e-6 <= value <= joint.upper + 1e-6:
        raise RobotError(
            f"{table.path}: {table.prefix}{name} is {value:g}; its limits are {joint.lower:g} to "
            f"{joint.upper:g}"
        )
    return float(value)


def resolve_path(path: Path, name: str, key: str = "urdf") -> Path:
    """Return the path of a file that a robot file names.

    Raises:
        RobotError: The name is not a valid path.
    """
    try:
        return resolved(path.parent / name)
    except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
        raise RobotError(f"{path}: {key} {name!r:.80} is not a valid path") from error


def _triple(table: TomlTable, key: str) -> Triple:
    if key not in table.data:
        return ZERO
    value = table.vector(key)
    if value.shape != (3,):
        raise RobotError(f"{table.path}: {table.prefix}{key} must be 3 numbers")
    return (float(value[0]), float(value[1]), float(value[2]))
