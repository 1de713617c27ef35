"""Read the tables of a robot file: checked values, arms, the base, and unknown keys."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import (
    Cache,
    FileFormatError,
    RobotError,
    is_name,
    keys_of,
    read_bytes_bounded,
    resolved,
    unknown_keys,
    unknown_name,
)
from momapos.model.urdf import Articulated, Mimic, once

from .amended_urdf import ZERO, AddedFrame, Amendments, Mount, Triple
from .robot_members import RobotFile
from .srdf import srdf_next_to

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_IGNORED_KEYS = 20
"""Unknown keys of a file that are reported one by one [-]."""


def ignored_keys(data: Mapping[str, Any], name: str) -> tuple[str, ...]:
    """Return a line for each unknown key of a robot file, and one for those beyond a number.

    Args:
        data: Content of the file.
        name: The file, for the lines.
    """
    lines = []
    for parents, key, known in unknown_keys(data, keys_of(RobotFile)):
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        path = ".".join(map(str, (*parents, key)))
        lines.append(f"{path!r:.80} of {name} is not known and was ignored{hint}")
    if len(lines) > MAX_IGNORED_KEYS:
        rest = f"{len(lines) - MAX_IGNORED_KEYS} more keys of {name} are not known"
        return (*lines[:MAX_IGNORED_KEYS], rest)
    return tuple(lines)


class TomlTable:
    """A TOML table whose values are checked on access."""

    def __init__(self, data: Mapping[str, Any], path: Path, prefix: str = "") -> None:
        self.data, self.path, self.prefix = data, path, prefix

    def _take(self, key: str) -> Any:
        if key not in self.data:
            near = difflib.get_close_matches(key, self.data, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise RobotError(f"{self.path}: {self.prefix}{key} is missing{hint}")
        return self.data[key]

    def table(self, key: str) -> TomlTable:
        value = self._take(key)
        if not isinstance(value, dict):
            raise RobotError(f"{self.path}: [{self.prefix}{key}] must be a table")
        return TomlTable(value, self.path, f"{self.prefix}{key}.")

    def tables(self, key: str, most: int = 100) -> dict[str, TomlTable]:
        """Return the tables within a table by name; empty if the table is missing."""
        if key not in self.data:
            return {}
        outer = self.table(key)
        if len(outer.data) > most:
            raise RobotError(f"{self.path}: [{self.prefix}{key}] has more than {most} tables")
        return {name: outer.table(name) for name in outer.data}

    def text(self, key: str) -> str:
        value = self._take(key)
        if not is_name(value):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a printable text, not empty")
        return value

    def texts(self, key: str) -> Sequence[str]:
        value = self._take(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a list of names")
        return value

    def choice(self, key: str, options: Sequence[str], default: str | None = None) -> str:
        value = default if default is not None and key not in self.data else self.text(key)
        if value not in options:
            raise RobotError(
                f"{self.path}: {self.prefix}{key} is {value!r}; it must be {' or '.join(options)}"
            )
        return value

    def flag(self, key: str) -> bool:
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise RobotError(f"{self.path}: {self.prefix}{key} must be true or false")
        return value

    def positive(self, key: str, default: float) -> float:
        value = self.data.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e6:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a number > 0 and < 1e6")
        return float(value)

    def number(self, key: str, default: float = 0.0) -> float:
        value = self.data.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e6:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a number of magnitude < 1e6")
        return float(value)

    def _numbers(self, key: str) -> Float[np.ndarray, "..."]:
        given = self._take(key)
        try:
            if not _only_numbers(given):
                raise ValueError(key)
            value = np.array(given, float)
        except (TypeError, ValueError, OverflowError) as error:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be numbers") from error
        if not np.isfinite(value).all():
            raise RobotError(f"{self.path}: {self.prefix}{key} must not contain NaN or infinity")
        return value

    def vector(self, key: str) -> Float[np.ndarray, " n"]:
        value = self._numbers(key)
        if value.ndim != 1:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be a list of numbers")
        return value

    def matrix(self, key: str, columns: int) -> Float[np.ndarray, "n columns"]:
        value = self._numbers(key)
        if value.ndim != 2 or value.shape[1] != columns:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be rows of {columns} numbers")
        return value

    def unit(self, key: str) -> Float[np.ndarray, "3"]:
        value = self.vector(key)
        if value.shape != (3,) or not 1e-9 < (length := math.hypot(*value)) < 1e9:
            raise RobotError(f"{self.path}: {self.prefix}{key} must be 3 numbers, not all 0")
        return value / length


def _only_numbers(value: object) -> bool:
    """Return whether a value is a number, or rows of numbers; texts and bools are none."""
    if isinstance(value, list):
        return all(map(_only_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


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


MAX_FOOTPRINT_CORNERS = 1_000
"""Maximum number of footprint corners [-]."""
MAX_EXTENT = 5.0
"""Maximum distance of a corner from the base's origin along x and y [m]."""


def read_footprint(base: TomlTable, path: Path, cache: Cache | None) -> Float[np.ndarray, "k 2"]:
    """Return the convex outline, counterclockwise [m].

    Args:
        base: The file's table of the base.
        path: The file, for errors.
        cache: Keeps the outline; None to compute it.

    Raises:
        RobotError: The outline has no area, too many corners or corners too far away.
    """
    points = base.matrix("footprint", 2)
    return once(cache, "footprint", (points,), lambda: _outline(points, path))


def read_turning_radius(base: TomlTable) -> float:
    """Return the least turning radius, which only a car-like base has.

    Raises:
        RobotError: A car-like base lacks one, or another one has it.
    """
    key = "min_turning_radius"
    if base.data.get("drive") != "car":
        if key in base.data:
            raise RobotError(f'{base.path}: base.{key} is for base.drive = "car" only; remove it')
        return 0.0
    if key not in base.data:
        raise RobotError(
            f"{base.path}: base.{key} is missing; a car-like base needs the least radius on which "
            "base_link, at the middle of its fixed axle, can turn [m]"
        )
    return base.positive(key, 0.0)


def _outline(points: Float[np.ndarray, "n 2"], path: Path) -> Float[np.ndarray, "k 2"]:
    from scipy.spatial import ConvexHull, QhullError

    if len(points) > MAX_FOOTPRINT_CORNERS or np.abs(points).max(initial=0.0) > MAX_EXTENT:
        raise RobotError(
            f"{path}: base.footprint must have at most {MAX_FOOTPRINT_CORNERS} corners, within "
            f"{MAX_EXTENT:g} m of the origin"
        )
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise RobotError(
            f"{path}: base.footprint must enclose an area, as [[x, y], ...]"
        ) from error
