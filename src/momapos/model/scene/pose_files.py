"""Read tool poses from a file: JSON, YAML, CSV or an array of numpy.

JSON and YAML hold a list of poses, or an object with `poses` and what holds for all of them. A pose
is an object with `xyz` and `wxyz`, a message of ROS (geometry_msgs: Pose, PoseStamped; PoseArray is
such an object of all), a 4 x 4 matrix, or the seven numbers x, y, z, qx, qy, qz, qw in the order of
ROS. A CSV file has a column for each of these, an array has one matrix or seven numbers per pose.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import (
    FileFormatError,
    InputError,
    MomaposError,
    as_path,
    expect,
    finite_array,
    open_regular,
    parse_json,
    parse_quantity,
    parse_speed,
    parse_yaml,
    read_text_bounded,
    shown,
)
from momapos.model.records import ToolPath, ToolPose

from .contents import link_named
from .scene import Scene

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_BYTES = 20_000_000
"""Largest file of poses [bytes]."""
MAX_POSES = 2_000
"""Maximum number of poses [-]; 2,000 take minutes."""
WORLD = ("", "world", "map", "odom")
"""Names of frames that mean the world; ROS has no other names for it."""
_TOLERANCE = ("position", "rotation", "axis", "spin", "cone")
_COMMON = ("frame", "contact", "tolerance")
_PLACE = ("xyz", "wxyz", "xyzw", "matrix", "position", "orientation")
_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
_MATRIX_ERROR = 1e-3
"""Largest deviation of a matrix from a rigid transform, in every entry [-]."""


def load_poses(path: str | Path, scene: Scene) -> tuple[ToolPose, ...]:
    """Read tool poses, and convert them to the world.

    Args:
        path: A .json, .yaml, .yml, .csv, .npy or .npz file; an archive has one array.
        scene: The scene, whose objects may be frames; a part is named as OBJECT/JOINT.

    Raises:
        FileFormatError: The file is missing, damaged, or of another kind.
        InputError: A pose is invalid; the message names the file and the pose.
        UnknownNameError: A frame or a touched object does not exist.
    """
    path = as_path("path", path)
    expect("scene", scene, Scene)
    return _poses(path, *_listed(path, read_poses(path)), scene)


def load_path(path: str | Path, scene: Scene) -> ToolPath:
    """Read a path of the tool: a file of poses that may also state `speed`, and `break` of a pose.

    Args:
        path: A file as of `load_poses`. A pose with `"break": true` is one at which the tool may
            leave the path, to come back from another base pose.
        scene: The scene, whose objects may be frames.

    Raises:
        FileFormatError: The file is missing, damaged, or of another kind.
        InputError: A pose is invalid, or there are fewer than two.
        UnknownNameError: A frame or a touched object does not exist.
    """
    path = as_path("path", path)
    expect("scene", scene, Scene)
    rows, common = _listed(path, read_poses(path), ("speed",))
    given = [row.get("break", False) if isinstance(row, dict) else False for row in rows]
    breaks = [k for k, value in enumerate(given) if _flag(f"{path}: pose {k + 1}", value)]
    rows = [
        {name: value for name, value in row.items() if name != "break"}
        if isinstance(row, dict)
        else row
        for row in rows
    ]
    speed = None
    if common.get("speed") is not None:
        given_speed = common["speed"]
        if isinstance(given_speed, str):
            given_speed = parse_speed(given_speed, f"{path}: speed")
        speed = _number(f"{path}: speed", given_speed)
    try:
        return ToolPath(_poses(path, rows, common, scene), tuple(breaks), speed)
    except InputError as error:
        words = str(error)
        raise type(error)(words if words.startswith(f"{path}") else f"{path}: {words}") from None


def _flag(where: str, value: object) -> bool:
    """Return a truth value, which a table gives as a word or a digit."""
    words = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
    if isinstance(value, str) and value.strip().lower() in words:
        return words[value.strip().lower()]
    if not isinstance(value, bool):
        raise InputError(f"{where}: break must be true or false, not {shown(value)}")
    return value


def _poses(
    path: Path, rows: Sequence[Any], common: Mapping[str, Any], scene: Scene
) -> tuple[ToolPose, ...]:
    """Return the poses of a file in the world."""
    if not rows:
        raise InputError(f"{path}: has no poses")
    if len(rows) > MAX_POSES:
        raise InputError(f"{path}: has {len(rows):,} poses; at most {MAX_POSES:,} are planned")
    return tuple(_pose(row, common, k, path, scene) for k, row in enumerate(rows, 1))


def _listed(
    path: Path, value: Any, more: Sequence[str] = ()
) -> tuple[Sequence[Any], Mapping[str, Any]]:
    """Return the poses of a file as they are, and what it states for all."""
    if isinstance(value, np.ndarray):
        if value.shape[1:] not in ((4, 4), (7,)):
            raise FileFormatError(
                f"{path}: must have the shape (n, 4, 4) or (n, 7), not {value.shape}"
            )
        return value.tolist(), {}
    common: Mapping[str, Any] = {}
    if isinstance(value, dict):
        if "poses" not in value:
            return [value], {}
        _refuse_unknown(value, ("poses", "header", *_COMMON, *more), str(path))
        value, common = value["poses"], value
    if not isinstance(value, list):
        raise FileFormatError(f"{path}: must hold a list of poses, not {shown(value)}")
    return value, common


def read_poses(path: Path) -> Any:
    """Read the content of a file of poses: an array of numpy, or lists, objects and numbers.

    Raises:
        FileFormatError: The file is missing, damaged, or of another kind.
    """
    kind = path.suffix.lower()
    if kind in (".npy", ".npz"):
        return _array(path)
    if kind == ".csv":
        return _table(path)
    text = read_text_bounded(path, MAX_BYTES) if kind in (".json", ".yaml", ".yml") else ""
    if kind == ".json":
        try:
            return parse_json(text)
        except (ValueError, RecursionError) as error:
            raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    if kind in (".yaml", ".yml"):
        return parse_yaml(text, path)
    raise FileFormatError(f"{path}: poses are .json, .yaml, .csv, .npy or .npz files")


def _array(path: Path) -> np.ndarray:
    with open_regular(path, MAX_BYTES) as file:
        try:
            found = np.load(file, allow_pickle=False)
            if not isinstance(found, np.ndarray):
                names = found.files
                if sum(member.file_size for member in found.zip.infolist()) > MAX_BYTES:
                    raise FileFormatError(f"{path}: is larger than {MAX_BYTES:,} bytes unpacked")
                if len(names) != 1:
                    raise FileFormatError(f"{path}: must hold one array, not {', '.join(names)}")
                found = found[names[0]]
        except MomaposError:
            raise
        except Exception as error:  # numpy raises many kinds for damaged files
            raise FileFormatError(f"{path}: not an array of numpy ({error})") from error
    if found.dtype.kind not in "fiu" or not found.ndim:
        raise FileFormatError(f"{path}: must hold numbers, not an array of {found.dtype}")
    return found


def _table(path: Path) -> Sequence[Any]:
    reader = csv.DictReader(io.StringIO(read_text_bounded(path, MAX_BYTES)), skipinitialspace=True)
    names = [name.strip() for name in reader.fieldnames or []]
    missing = [name for name in _COLUMNS if name not in names]
    if missing:
        raise FileFormatError(
            f"{path}: has no column {missing[0]}; the first line names the columns "
            f"{','.join(_COLUMNS)}"
        )
    reader.fieldnames = names
    _refuse_unknown(
        dict.fromkeys(names), (*_COLUMNS, "name", "break", *_COMMON[:2], *_TOLERANCE), str(path)
    )
    rows: list[Any] = []
    for k, row in enumerate(reader, 1):
        where = f"{path}: pose {k}"
        if None in row or None in row.values():
            raise InputError(f"{where}: must have {len(names)} values as the first line")
        values = {name: text.strip() for name, text in row.items() if text and text.strip()}
        xyz, xyzw = (
            [_number(f"{where}: {name}", values.get(name, "")) for name in some]
            for some in (_COLUMNS[:3], _COLUMNS[3:])
        )
        tolerance = {name: values[name] for name in _TOLERANCE if name in values}
        named = ("name", "frame", "contact", "break")
        given = {name: values[name] for name in named if name in values}
        rows.append({"xyz": xyz, "xyzw": xyzw, "tolerance": tolerance, **given})
    return rows


def _pose(row: Any, common: Mapping[str, Any], number: int, path: Path, scene: Scene) -> ToolPose:
    """Return a pose in the world."""
    where = f"{path}: pose {number}"
    own = row if isinstance(row, dict) else _bare(row, where)
    _refuse_unknown(own, (*_PLACE, "name", "header", "pose", *_COMMON), where)
    frame, contact = (_name_of(key, own, common, where) for key in ("frame", "contact"))
    tolerance = {**_tolerance(common, str(path)), **_tolerance(own, where)}
    if "axis" not in tolerance and {"spin", "cone"} & tolerance.keys():
        raise InputError(f"{where}: tolerance.spin and tolerance.cone need tolerance.axis")
    name = str(own.get("name", "")) or f"pose {number}"
    try:
        T = frame_named(frame, scene) @ transform_of(own, where)
        if contact:
            scene.object(contact)
        (x, y, z), wxyz = T[:3, 3].tolist(), _wxyz(T)
        return ToolPose((x, y, z), wxyz, name, contact=contact, **tolerance)
    except InputError as error:
        words = str(error)
        given = words if words.startswith(where) else f"{where}: {words.removeprefix(f'{name}: ')}"
        raise type(error)(given) from None


def _bare(row: Any, where: str) -> dict[str, Any]:
    """Return a pose that is a matrix or seven numbers, as an object."""
    if isinstance(row, list) and len(row) == 4:
        return {"matrix": row}
    if isinstance(row, list) and len(row) == 7:
        return {"xyz": row[:3], "xyzw": row[3:]}
    raise InputError(
        f"{where}: must be an object, a 4 x 4 matrix, or x, y, z, qx, qy, qz, qw, not {shown(row)}"
    )


def _name_of(key: str, own: Mapping[str, Any], common: Mapping[str, Any], where: str) -> str:
    """Return the frame or the touched object: of the pose, or else of the whole file."""
    for given in (own, common):
        value = given.get(key)
        if value is None and key == "frame" and isinstance(given.get("header"), dict):
            value = given["header"].get("frame_id")
        if value is not None:
            if not isinstance(value, str):
                raise InputError(f"{where}: {key} must be a name, not {shown(value)}")
            return value
    return ""


def frame_named(name: str, scene: Scene) -> Float[np.ndarray, "4 4"]:
    """Return the pose of a frame in the world: of the world, of an object, or of one of its parts.

    Raises:
        UnknownNameError: There is no such object or part.
    """
    if name in WORLD and name not in {item.name for item in scene.objects}:
        return np.eye(4)
    whole = name in {item.name for item in scene.objects}
    item_name, part = (name, "") if whole else name.partition("/")[::2]
    item = scene.object(item_name)
    return item.T_world_object if not part else item.link_poses()[link_named(item, part)]


def transform_of(row: Any, where: str) -> Float[np.ndarray, "4 4"]:
    """Return a pose in its frame.

    Args:
        row: A pose as a file has it: an object, a matrix, or seven numbers.
        where: The pose in words, for messages.

    Raises:
        InputError: It is no pose.
    """
    own = row if isinstance(row, dict) else _bare(row, where)
    nested = own.get("pose")
    if isinstance(nested, dict):
        _refuse_unknown(nested, _PLACE, f"{where}: pose")
        own = nested
    if "matrix" in own:
        T = finite_array(f"{where}: matrix", own["matrix"], (4, 4))
        off = np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max()
        if max(off, np.abs(T[3] - [0, 0, 0, 1]).max()) > _MATRIX_ERROR or np.linalg.det(T) < 0:
            raise InputError(f"{where}: the matrix is no rigid transform")
        return T
    xyz, wxyz = own.get("xyz"), own.get("wxyz")
    if "xyzw" in own:
        wxyz = np.roll(finite_array(f"{where}: xyzw", own["xyzw"], (4,)), 1)
    if isinstance(own.get("position"), dict):
        xyz = [own["position"].get(axis) for axis in "xyz"]
        turn = own.get("orientation")
        wxyz = [turn.get(axis) for axis in "wxyz"] if isinstance(turn, dict) else None
    if xyz is None or wxyz is None:
        raise InputError(f"{where}: needs xyz and wxyz, position and orientation, or a matrix")
    # A pose checks the length of its quaternion, and scales it.
    at = ToolPose(
        tuple(finite_array(f"{where}: position", xyz, (3,)).tolist()),
        tuple(finite_array(f"{where}: quaternion", wxyz, (4,)).tolist()),
        where,
    )
    return at.T_world_tool


def _tolerance(given: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the tolerance of a pose, or of all, as fields of `ToolPose`."""
    found = given.get("tolerance", {})
    if not isinstance(found, dict):
        raise InputError(f"{where}: tolerance must be an object with {', '.join(_TOLERANCE)}")
    _refuse_unknown(found, _TOLERANCE, f"{where}: tolerance")
    out: dict[str, Any] = {}
    for name, value in found.items():
        what = f"{where}: tolerance.{name}"
        if name == "axis":
            out[name] = _axis(what, value)
        elif name == "position":
            each = value if isinstance(value, list) else [value] * 3
            out[name] = tuple(_number(what, one) for one in each)
        else:
            out[name] = _number(what, value)
    return out


def _axis(what: str, value: Any) -> tuple[float, ...]:
    """Return an axis, given by its name or as a vector."""
    named = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    if isinstance(value, str) and value in named:
        return named[value]
    axis = finite_array(what, value, (3,))
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise InputError(f"{what} must be x, y, z or a vector, not {shown(value)}")
    return tuple((axis / length).tolist())


def _number(what: str, value: Any) -> float:
    """Return a number in SI units, which a text may give with its unit."""
    if isinstance(value, str):
        try:
            return parse_quantity(value).value
        except InputError as error:
            raise InputError(f"{what}: {error}") from None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{what} must be a number, not {shown(value)}")
    return float(value)


def _wxyz(T: Float[np.ndarray, "4 4"]) -> tuple[float, float, float, float]:
    from scipy.spatial.transform import Rotation

    w, x, y, z = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True).tolist()
    return w, x, y, z


def _refuse_unknown(given: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    unknown = [key for key in given if key not in known]
    if unknown:
        raise InputError(f"{where}: unknown {unknown[0]!r:.60}; known are {', '.join(known)}")
