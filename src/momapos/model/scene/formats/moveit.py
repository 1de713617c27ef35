"""Read MoveIt planning scenes (`.scene` files): fixed shapes of a room.

The format is that of MoveIt's `PlanningScene::saveGeometryToStream`. Since 2020 each object has its
own pose and subframes; older files have neither.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import FileFormatError, read_text_bounded
from momapos.core.geometry import pose_wxyz
from momapos.model.scene.scene_names import MAX_BYTES
from momapos.model.urdf import Geometry, Link, Mesh, Urdf

from .composed_shapes import MIN_FLOOR_NORMAL_Z
from .imported_room import ImportedRoom, ImportReport, Names, RoomObject

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
    reader = _Reader(path, read_text_bounded(path, MAX_BYTES).splitlines())
    reader.line("a name")  # of the planning scene, usually "(noname)+"
    while (marker := reader.line("'*' or '.'")) != ".":
        if not marker.startswith("*"):
            raise reader.error(f"{marker!r:.60} instead of an object '* NAME' or the end '.'")
        reader.read_object(marker[1:].strip())
    return ImportedRoom(path.stem, tuple(reader.objects), reader.meshes, reader.report)


class _Reader:
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
