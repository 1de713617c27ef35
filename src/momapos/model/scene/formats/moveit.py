"""Read MoveIt planning scenes: `.scene` files, and messages in YAML.

`.scene` files have the format of MoveIt's `PlanningScene::saveGeometryToStream`. Since 2020 each
object has its own pose and subframes; older files have neither.

Messages are in YAML, as `ros2 topic echo` prints them and as collections of planning problems store
them.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from momapos.core import FileFormatError, parse_yaml, read_text_bounded
from momapos.core.geometry import pose_wxyz
from momapos.model.scene.scene_names import MAX_BYTES
from momapos.model.urdf import Geometry, Link, Mesh, Urdf

from .imported_room import (
    MIN_FLOOR_NORMAL_Z,
    ImportedRoom,
    ImportReport,
    Message,
    Names,
    RoomObject,
    as_numbers,
    prism,
)

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_NUMBER = 1e6
"""Maximum magnitude of a number, and maximum number of vertices or triangles of a mesh [-]."""

_SIZES = {"box": 3, "cylinder": 2, "sphere": 1, "cone": 2, "plane": 4}
"""Number of values of each shape."""
_KINDS: dict[str, Literal["box", "cylinder", "sphere"]] = {
    "box": "box", "cylinder": "cylinder", "sphere": "sphere", "cone": "cylinder",
}  # fmt: skip
"""Replacement of each shape in our scenes."""


def read_room(path: Path, root: Path) -> ImportedRoom:  # noqa: ARG001
    """Read a planning scene.

    Args:
        path: The file.
        root: Unused, because a planning scene names no files.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and in which line.
    """
    reader = _SceneReader(path, read_text_bounded(path, MAX_BYTES).splitlines())
    reader.line("a name")  # of the planning scene, usually "(noname)+"
    while (marker := reader.line("'*' or '.'")) != ".":
        if not marker.startswith("*"):
            raise reader.error(f"{marker!r:.60} instead of an object '* NAME' or the end '.'")
        reader.read_object(marker[1:].strip())
    return ImportedRoom(path.stem, tuple(reader.objects), reader.meshes, reader.report)


class _SceneReader:
    """Reads a planning scene line by line."""

    def __init__(self, path: Path, lines: list[str]) -> None:
        self.path, self.lines, self.number = path, lines, 0
        self.objects: list[RoomObject] = []
        self.meshes: dict[Path, Mesh] = {}
        self.report = ImportReport()
        self.names = Names()

    def error(self, text: str) -> FileFormatError:
        """Return an error about the last line read."""
        return FileFormatError(f"{self.path}: line {self.number}: {text}")

    def line(self, what: str) -> str:
        """Return the next nonempty line."""
        while self.number < len(self.lines):
            self.number += 1
            if text := self.lines[self.number - 1].strip():
                return text
        raise self.error(f"the file ends before {what}")

    def values(self, count: int, what: str) -> list[float]:
        """Return the numbers of the next line."""
        return self._numbers(self.line(what), count, what)

    def _numbers(self, text: str, count: int, what: str) -> list[float]:
        words = text.split()
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise self.error(f"{text!r:.60} instead of {what}") from error
        if len(values) != count or not all(abs(value) <= MAX_NUMBER for value in values):
            raise self.error(f"{text!r:.60} is not {what}: {count} finite numbers")
        return values

    def whole(self, what: str, text: str | None = None) -> int:
        """Return a line (by default the next one) as a nonnegative integer."""
        (value,) = self._numbers(self.line(what) if text is None else text, 1, what)
        if value != int(value) or value < 0:
            raise self.error(f"{value:g} instead of {what}")
        return int(value)

    def _pose(self, first: str | None = None) -> Float[np.ndarray, "4 4"]:
        """Read a pose: position, and orientation as xyzw, in two lines."""
        text = self.line("a position") if first is None else first
        x, y, z = self._numbers(text, 3, "a position")
        qx, qy, qz, qw = self.values(4, "an orientation")
        length = math.hypot(qx, qy, qz, qw)
        if not 0.9 < length < 1.1:
            raise self.error(f"an orientation has length {length:g}; it must be 1")
        return pose_wxyz((x, y, z), (qw, qx, qy, qz))

    def read_object(self, name: str) -> None:
        """Read an object; skip it if it has no supported shape."""
        text, T = self.line("a pose or a number of shapes"), np.eye(4)
        newer = len(text.split()) > 1
        if newer:
            T = self._pose(text)
            count = self.whole("a number of shapes")
        else:
            count = self.whole("a number of shapes", text)
        shapes = [shape for _ in range(count) for shape in self._shape(T)]
        subframes = self.whole("a number of subframes") if newer else 0
        for _ in range(subframes):
            self.line("the name of a subframe")
            self._pose()
        self.report.dropped["subframes"] += subframes
        if shapes:
            name = self.names(name, "object")
            urdf = Urdf(name, None, "body", {"body": Link("body", tuple(shapes), ())}, ())
            self.objects.append(RoomObject(name, T, urdf))

    def _shape(self, T_world_object: Float[np.ndarray, "4 4"]) -> list[Geometry]:
        """Read a shape with its pose and color; return none for a plane."""
        kind = self.line("a shape")
        if kind == "mesh":
            mesh = self._mesh()
        elif kind in _SIZES:
            size = self.values(_SIZES[kind], f"the size of a {kind}")
        else:
            raise self.error(f"unknown shape {kind!r:.60}; use one of mesh, {', '.join(_SIZES)}")
        T = self._pose()
        # All zeros mean no color.
        self.report.dropped["colors"] += any(self.values(4, "a color"))
        if kind == "plane":
            normal = T_world_object[:3, :3] @ T[:3, :3] @ size[:3]
            level = abs(normal[2]) >= MIN_FLOOR_NORMAL_Z * float(np.linalg.norm(normal))
            self.report.dropped["floors" if level else "unbounded planes"] += 1
            return []
        if kind == "mesh":
            file = Path(f"mesh{len(self.meshes)}.obj")
            self.meshes[file] = mesh
            return [Geometry("mesh", (1.0, 1.0, 1.0), T, "", file)]
        if min(size) <= 0:
            raise self.error(f"the size of a {kind} must be > 0, not {size}")
        self.report.approximated["cones as cylinders"] += kind == "cone"
        return [Geometry(_KINDS[kind], tuple(size), T)]

    def _mesh(self) -> Mesh:
        corners, triangles = self.values(2, "numbers of vertices and triangles")
        points = self._rows(int(corners), "a vertex")
        faces = self._rows(int(triangles), "a triangle")
        if len(points) == 0:
            raise self.error("a mesh is empty")
        wrong = (faces < 0) | (faces >= len(points)) | (faces != np.floor(faces))
        if wrong.any():
            raise self.error(f"a triangle names vertex {faces[wrong][0]:g} of {len(points)}")
        return Mesh(points, faces.astype(np.int64))

    def _rows(self, count: int, what: str) -> Float[np.ndarray, "n 3"]:
        if not 0 <= count <= len(self.lines) - self.number:
            raise self.error(f"the file has no {count} lines with {what} each")
        return np.array([self.values(3, what) for _ in range(count)], float).reshape(-1, 3)


_PRIMITIVES = {
    1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism",
}  # fmt: skip
"""Types of `shape_msgs/SolidPrimitive`, which files give as numbers or words."""
_COUNTS = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "prism": 1}
"""Number of dimensions of each type."""
_OPERATIONS = ("add", "remove", "append", "move")
"""Operations of `moveit_msgs/CollisionObject` by their number."""
_MIN_UPRIGHT = 0.9999
"""Minimum z of the base's z axis for a start on the floor [-]."""


def read_message(path: Path, root: Path) -> ImportedRoom:  # noqa: ARG001
    """Read a planning scene.

    Args:
        path: The file.
        root: Unused, because a planning scene names no files.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
    """
    scene = Message(parse_yaml(read_text_bounded(path, MAX_BYTES), path), f"{path}")
    world = scene.part("world") if "world" in scene else scene
    if "collision_objects" not in world:
        raise scene.error("not a planning scene: it has no world with collision_objects")
    reader = _MessageReader(path, _Frames.of(scene))
    for item in world.parts("collision_objects"):
        reader.apply(item)
    reader.count_dropped(scene, world)
    name = scene.text("name").strip() or path.stem
    start = _start(scene.part("robot_state"), reader)
    extras = {} if start is None else {"start": start}
    plain = "".join(c if c.isprintable() else "_" for c in name)
    return ImportedRoom(plain, reader.finished(), reader.meshes, reader.report, extras)


@dataclass(frozen=True, eq=False)
class _Frames:
    """Poses of the frames that a file defines, in its planning frame."""

    known: dict[str, Float[np.ndarray, "4 4"]]
    unknown: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of(cls, scene: Message) -> _Frames:
        """Read `fixed_frame_transforms`."""
        known: dict[str, np.ndarray] = {}
        rows = [
            (
                _frame(row.part("header").text("frame_id")),
                _frame(row.text("child_frame_id")),
                row.part("transform").pose("translation", "rotation"),
            )
            for row in scene.parts("fixed_frame_transforms")
        ]
        # A frame that is nobody's child is the planning frame; children may come before parents.
        children = {child for parent, child, _ in rows if child != parent}
        known = {parent: np.eye(4) for parent, _, _ in rows if parent not in children}
        waiting = [row for row in rows if row[0] != row[1]]
        while waiting:
            ready = [row for row in waiting if row[0] in known]
            if not ready:
                raise scene.error(f"fixed_frame_transforms: {waiting[0][1]!r} is its own parent")
            for parent, child, T in ready:
                known[child] = known[parent] @ T
            waiting = [row for row in waiting if row[1] not in known]
        return cls(known)

    def pose(self, name: str) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a frame; the planning frame's if the file does not define it."""
        frame = _frame(name)
        if frame and frame not in self.known:
            self.unknown[frame] += 1
        return self.known.get(frame, np.eye(4))


def _frame(name: str) -> str:
    return name.strip().lstrip("/")


@dataclass(eq=False)
class _Object:
    """A collision object so far."""

    T_world_object: Float[np.ndarray, "4 4"]
    shapes: list[Geometry] = field(default_factory=list)
    subframes: dict[str, Float[np.ndarray, "4 4"]] = field(default_factory=dict)


class _MessageReader:
    """Applies the collision objects of a message in order."""

    def __init__(self, path: Path, frames: _Frames) -> None:
        self.path, self.frames = path, frames
        self.objects: dict[str, _Object] = {}
        self.meshes: dict[Path, Mesh] = {}
        self.report = ImportReport()

    def apply(self, item: Message) -> None:
        """Add, remove, extend or move an object."""
        name, operation = item.text("id"), self._operation(item)
        if operation == "remove":
            if name and name not in self.objects:
                self.report.dropped["removals of unknown objects"] += 1
            for key in [name] if name else list(self.objects):
                self.objects.pop(key, None)
            return
        if operation == "move" and name not in self.objects:
            raise item.error(f"moves {name!r:.60}, which does not exist")
        T = self.frames.pose(item.part("header").text("frame_id")) @ item.part("pose").pose()
        if operation == "move":
            found = self.objects[name]
            self._refresh(found, name, T)
            return
        if operation == "add" or name not in self.objects:
            self.objects.pop(name, None)
            self._refresh(self.objects.setdefault(name, _Object(T)), name, T)
        found = self.objects[name]
        into = np.linalg.inv(found.T_world_object) @ T
        for shape in self._shapes(item, T):
            found.shapes.append(_placed(shape, into))
        names, poses = item.values("subframe_names"), list(item.parts("subframe_poses"))
        if len(names) != len(poses):
            raise item.error(f"{len(poses)} subframe_poses for {len(names)} subframe_names")
        for frame, row in zip(names, poses, strict=True):
            found.subframes[str(frame)] = into @ row.pose()
        self._refresh(found, name, found.T_world_object)

    def _refresh(self, found: _Object, name: str, T: Float[np.ndarray, "4 4"]) -> None:
        """Move an object and the frames that other objects may name: its own and its subframes."""
        found.T_world_object = T
        self.frames.known[_frame(name)] = T
        for key, T_object_frame in found.subframes.items():
            self.frames.known[f"{_frame(name)}/{key}"] = T @ T_object_frame

    def _operation(self, item: Message) -> str:
        value: Any = item.value.get("operation")
        word = "add" if value is None else str(value).strip().strip("\x00") or "0"
        if word.isdigit() and int(word) < len(_OPERATIONS):
            return _OPERATIONS[int(word)]
        if word.lower() in _OPERATIONS:
            return word.lower()
        raise item.error(f"operation {word!r:.60} is none of {', '.join(_OPERATIONS)}")

    def _shapes(self, item: Message, T_world_object: Float[np.ndarray, "4 4"]) -> list[Geometry]:
        shapes = [
            self._primitive(one, T) for one, T in _with_poses(item, "primitives", "primitive_poses")
        ]
        for one, T in _with_poses(item, "meshes", "mesh_poses"):
            shapes.append(self._mesh(_mesh(one), T))
        for one, T in _with_poses(item, "planes", "plane_poses"):
            normal = T_world_object[:3, :3] @ T[:3, :3] @ one.numbers("coef", 4)[:3]
            length = float(np.linalg.norm(normal))
            level = length > 0 and abs(normal[2]) >= MIN_FLOOR_NORMAL_Z * length
            self.report.dropped["floors" if level else "unbounded planes"] += 1
        return shapes

    def _mesh(self, mesh: Mesh, T: Float[np.ndarray, "4 4"]) -> Geometry:
        file = Path(f"mesh{len(self.meshes)}.obj")
        self.meshes[file] = mesh
        return Geometry("mesh", (1.0, 1.0, 1.0), T, "", file)

    def _primitive(self, one: Message, T: Float[np.ndarray, "4 4"]) -> Geometry:
        value = one.value.get("type")
        kind = _PRIMITIVES.get(value, "") if isinstance(value, int) else str(value).lower()
        if kind not in _COUNTS:
            raise one.error(f"type {value!r:.60} is none of {', '.join(_COUNTS)}")
        size = one.numbers("dimensions", None)[: _COUNTS[kind]]
        if len(size) < _COUNTS[kind] or size.min() <= 0:
            raise one.error(
                f"dimensions of a {kind} must be {_COUNTS[kind]} numbers > 0, not {size.tolist()}"
            )
        if kind == "prism":
            polygon = one.part("polygon")
            where = f"{polygon.where}: a point"
            corners = [as_numbers(p, 3, where, "xyz") for p in polygon.values("points")]
            if len(corners) < 3:
                raise one.error("the polygon of a prism must have at least 3 points")
            self.report.approximated["prisms as their convex hulls"] += 1
            return self._mesh(prism(np.array(corners)[:, :2], float(size[0]), one.error), T)
        self.report.approximated["cones as cylinders"] += kind == "cone"
        if kind in ("cylinder", "cone"):
            height, radius = size.tolist()
            return Geometry("cylinder", (radius, height), T)
        return Geometry("box" if kind == "box" else "sphere", tuple(size.tolist()), T)

    def count_dropped(self, scene: Message, world: Message) -> None:
        """Count what has no place in our scenes."""
        dropped, state = self.report.dropped, scene.part("robot_state")
        dropped["attached objects"] += len(state.values("attached_collision_objects"))
        names = state.part("joint_state").values("name")
        dropped["joint values of the robot"] += len(names)
        octomap = world.part("octomap")
        octomap = octomap.part("octomap") if "octomap" in octomap else octomap
        dropped["octomaps"] += bool(octomap.values("data"))
        dropped["colors"] += len(scene.values("object_colors"))

    def finished(self) -> tuple[RoomObject, ...]:
        """Return the objects that have shapes."""
        names, found = Names(), []
        for key, one in self.objects.items():
            self.report.dropped["subframes"] += len(one.subframes)
            if one.shapes:
                name = names(key, "object")
                urdf = Urdf(name, None, "body", {"body": Link("body", tuple(one.shapes), ())}, ())
                found.append(RoomObject(name, one.T_world_object, urdf))
        for frame, count in self.frames.unknown.items():
            self.report.notes.append(
                f"frame {frame!r} of {count} object{'' if count == 1 else 's'} is not in "
                "fixed_frame_transforms; it is taken as the planning frame"
            )
        return tuple(found)


def _placed(shape: Geometry, T: Float[np.ndarray, "4 4"]) -> Geometry:
    return Geometry(shape.kind, shape.size, T @ shape.T_link_geometry, shape.name, shape.mesh)


def _with_poses(
    item: Message, what: str, poses: str
) -> list[tuple[Message, Float[np.ndarray, "4 4"]]]:
    """Return shapes with their poses in the object; a missing pose is that of the object."""
    shapes, placed = list(item.parts(what)), list(item.parts(poses))
    if len(placed) > len(shapes):
        raise item.error(f"{len(placed)} {poses} for {len(shapes)} {what}")
    Ts = [one.pose() for one in placed] + [np.eye(4)] * (len(shapes) - len(placed))
    return list(zip(shapes, Ts, strict=True))


def _mesh(one: Message) -> Mesh:
    points = [
        as_numbers(v, 3, f"{one.where}: vertex {k}", "xyz")
        for k, v in enumerate(one.values("vertices"))
    ]
    rows = [
        as_numbers(
            t.get("vertex_indices") if isinstance(t, dict) else t,
            3, f"{one.where}: vertex_indices of triangle {k}",
        )
        for k, t in enumerate(one.values("triangles"))
    ]  # fmt: skip
    if not points or not rows:
        raise one.error("a mesh has no vertices or no triangles")
    faces = np.array(rows)
    wrong = (faces < 0) | (faces >= len(points)) | (faces != np.floor(faces))
    if wrong.any():
        raise one.error(f"a triangle names vertex {faces[wrong][0]:g} of {len(points)}")
    return Mesh(np.array(points), faces.astype(np.int64))


def _start(state: Message, reader: _MessageReader) -> dict[str, float] | None:
    """Return where the robot stands, if its state says so and it stands upright on z = 0."""
    joints = state.part("multi_dof_joint_state")
    rows = list(joints.parts("transforms"))
    if len(rows) != 1:
        return None
    T = reader.frames.pose(joints.part("header").text("frame_id"))
    T = T @ rows[0].pose("translation", "rotation")
    if T[2, 2] < _MIN_UPRIGHT or abs(T[2, 3]) > 1e-3:
        reader.report.dropped["poses of the robot, which is not upright on the floor"] += 1
        return None
    return {"x": float(T[0, 3]), "y": float(T[1, 3]), "yaw": float(np.arctan2(T[1, 0], T[0, 0]))}
