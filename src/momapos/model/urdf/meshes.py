"""Read untrusted mesh files.

trimesh parses them. This module limits their size and the number of placed parts, and prevents
that they open other files.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import math
import os
import struct
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import ParseError

import numpy as np

from momapos.core import UrdfError, fork_safe_lock, read_bytes_bounded

from .urdf_records import Mesh
from .urdf_tree import MAX_SIZE

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MAX_BYTES = 64_000_000
"""Memory that the vertices take, except those of one larger mesh; meshes of robots and furniture
have 10 kB to 1 MB of vertices [bytes]."""


class RecentPoints:
    """The vertices of mesh files, by path and time of the last change."""

    def __init__(self, size: int = MAX_BYTES) -> None:
        self.size = size
        self.held = 0
        """Memory that the vertices take [bytes]."""
        self._known: OrderedDict[tuple[Path, int], Float[np.ndarray, "n 3"]] = OrderedDict()
        self._lock = fork_safe_lock()

    def get(
        self, path: Path, stamp: int, read: Callable[[Path], Float[np.ndarray, "n 3"]]
    ) -> Float[np.ndarray, "n 3"]:
        """Return the vertices of a file, and read them if they are not known.

        Args:
            path: The file.
            stamp: Time of its last change.
            read: Returns the vertices.
        """
        key = path, stamp
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        points = read(path)
        with self._lock:
            if key not in self._known:
                self._known[key] = points
                self.held += points.nbytes
            found = self._known[key]
            while self.held > self.size and len(self._known) > 1:
                self.held -= self._known.popitem(last=False)[1].nbytes
        return found


ROTATIONS = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}
"""Rotations that turn an up axis to z (COLLADA 1.4.1, up_axis)."""


def meters_per_unit(root: Any) -> float:
    """Return the length of a unit of a COLLADA file [m]; 1 if it gives none.

    Raises:
        UrdfError: The length is not a usable number.
    """
    unit = root.find("{*}asset/{*}unit")
    text = "1" if unit is None else unit.get("meter", "1")
    try:
        meters = float(text)
    except ValueError:
        meters = math.nan
    if not 1 / MAX_SIZE <= meters <= MAX_SIZE:
        raise UrdfError(
            f"<unit meter={text!r:.40}> must be a number from {1 / MAX_SIZE:g} to {MAX_SIZE:g}"
        )
    return meters


def up_axis(path: Path, data: bytes) -> str:
    """Return the up axis of a COLLADA file: X_UP, Y_UP or Z_UP; Z_UP if it gives none.

    The format's default is Y_UP, but URDF tools write files without it whose z is up.
    """
    if path.suffix.lower() != ".dae":
        return "Z_UP"
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import iterparse

    # A damaged file is reported where its mesh is read.
    with contextlib.suppress(ParseError, DefusedXmlException, UnicodeDecodeError, LookupError):
        for _, element in iterparse(io.BytesIO(data), forbid_dtd=True):
            name = str(element.tag).rpartition("}")[2]
            if name == "up_axis" and (element.text or "").strip() in ROTATIONS:
                return (element.text or "").strip()
            if name == "asset":
                break
    return "Z_UP"


def turned_up(
    T_link_geometry: Float[np.ndarray, "4 4"], scale: tuple[float, ...], axis: str
) -> tuple[Float[np.ndarray, "4 4"], tuple[float, ...]]:
    """Return pose and scale of a mesh as if its file were turned so that z is up.

    The rotation permutes the axes, and with them the scale.
    """
    R = ROTATIONS[axis]
    T = np.eye(4)
    T[:3, :3] = R
    x, y, z = np.abs(R).T @ np.array(scale)
    return T_link_geometry @ T, (float(x), float(y), float(z))


MAX_MESH_BYTES = 50_000_000
"""Largest mesh file; collision meshes of robots and furniture have some megabytes [bytes]."""
MESH_SUFFIXES = (".obj", ".stl", ".dae", ".ply", ".off", ".glb")
MAX_PARTS = 1_000
"""Largest number of placed nodes in a mesh file [-]."""
MAX_POINTS = 10_000_000
"""Largest number of placed vertices and indices in a mesh file [-]."""
MAX_COORDINATE = 1e7
"""Largest coordinate in a mesh file, in its own unit."""


def mesh_points(path: Path | Mesh) -> Float[np.ndarray, "n 3"]:
    """Return the vertices of a mesh file, or of a mesh in memory.

    Raises:
        UrdfError: The mesh is unreadable, too large, empty, or contains NaN.
    """
    return path.vertices if isinstance(path, Mesh) else _known(path, _recent, _points)


def surface_vertices(path: Path | Mesh) -> Float[np.ndarray, "n 3"]:
    """Return the vertices that a mesh's faces use; all of a mesh without faces.

    Files list others, too: those of the whole object from which a part was cut.

    Raises:
        UrdfError: As for `mesh_points`.
    """
    return path.vertices if isinstance(path, Mesh) else _known(path, _recent_surfaces, _surface)


_recent, _recent_surfaces = RecentPoints(), RecentPoints()


def _known(
    path: Path, recent: RecentPoints, read: Callable[[Path], Float[np.ndarray, "n 3"]]
) -> Float[np.ndarray, "n 3"]:
    try:
        return recent.get(path, os.stat(path).st_mtime_ns, read)
    except OSError as error:
        raise UrdfError(f"{path}: cannot be read ({error.strerror})") from error


def _points(path: Path) -> Float[np.ndarray, "n 3"]:
    return _checked(path, _vertices(path, mesh_bytes(path)))


def _checked(path: Path, points: np.ndarray) -> Float[np.ndarray, "n 3"]:
    if len(points) == 0:
        raise UrdfError(f"{path}: the mesh is empty")
    if points.ndim != 2 or points.shape[1] != 3:
        raise UrdfError(f"{path}: not a usable mesh (its vertices do not have 3 coordinates)")
    if not np.isfinite(points).all():
        raise UrdfError(f"{path}: the mesh contains NaN or infinite vertices")
    far = np.abs(points).max()
    if far > MAX_COORDINATE:
        raise UrdfError(
            f"{path}: the mesh has a coordinate {far:g}; the limit is {MAX_COORDINATE:g}"
        )
    return points


def _surface(path: Path) -> Float[np.ndarray, "n 3"]:
    if path.suffix.lower() == ".obj":
        points = mesh_points(path)
        try:
            corners = _obj_faces(path, len(points)).ravel()
        except UrdfError:  # damaged faces matter only where triangles count
            return points
    else:
        mesh = parse_mesh(path, mesh_bytes(path))
        points = _checked(path, np.array(mesh.vertices, float))
        corners = np.asarray(mesh.faces, np.int64).ravel()
    used = np.zeros(len(points), bool)
    used[corners[(corners >= 0) & (corners < len(points))]] = True
    return points[used] if used.any() else points


def _vertices(path: Path, data: bytes) -> Float[np.ndarray, "n 3"]:
    if path.suffix.lower() != ".obj":
        return np.array(parse_mesh(path, data).vertices, float)
    # Read vertices only: materials and textures are neither needed nor trusted.
    lines = data.decode("utf-8-sig", errors="replace").splitlines()
    try:
        rows = [[*map(float, x.split()[1:4])] for x in lines if x.startswith("v ")]
        return np.array(rows, float).reshape(-1, 3)
    except ValueError as error:
        raise UrdfError(f"{path}: not a usable OBJ mesh ({error})") from error


def mesh_triangles(path: Path | Mesh) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles of a mesh file, or of a mesh in memory; polygons become fans.

    Raises:
        UrdfError: As for `mesh_points`, or a face uses a vertex that does not exist.
    """
    points = mesh_points(path)
    if isinstance(path, Mesh):
        return np.asarray(points[path.faces])
    if path.suffix.lower() == ".obj":
        faces = _obj_faces(path, len(points))
    else:
        faces = np.array(parse_mesh(path, mesh_bytes(path)).faces, np.int64).reshape(-1, 3)
    wrong = (faces < 0) | (faces >= len(points))
    if wrong.any():
        worst = int(faces[wrong][0]) + 1
        raise UrdfError(f"{path}: a face uses vertex {worst}, but the mesh has {len(points)}")
    return points[faces]


def _obj_faces(path: Path, count: int) -> Int[np.ndarray, "t 3"]:
    """Return the triangles of an OBJ file as vertex indices; negative ones count backwards."""
    seen, faces = 0, []
    try:
        for line in mesh_bytes(path).decode("utf-8-sig", errors="replace").splitlines():
            if line.startswith("v "):
                seen += 1
            elif line.startswith("f "):
                named = [int(word.split("/")[0]) for word in line.split()[1:]]
                corners = [k - 1 if k > 0 else seen + k for k in named]
                faces += [(corners[0], a, b) for a, b in pairwise(corners[1:])]
        _check_size(0, count + 3 * len(faces))
        return np.array(faces, np.int64).reshape(-1, 3)
    except (ValueError, OverflowError) as error:
        raise UrdfError(f"{path}: not a usable OBJ mesh ({error})") from error


def mesh_digest(path: Path | Mesh) -> bytes:
    """Return a hash of the content of a mesh."""
    if isinstance(path, Mesh):
        return hashlib.sha256(path.vertices.tobytes() + path.faces.tobytes()).digest()
    return hashlib.sha256(mesh_bytes(path)).digest()


def mesh_bytes(path: Path) -> bytes:
    """Read the content of a mesh file of a supported format.

    Raises:
        UrdfError: The format is not supported, or the file is too large or not regular.
    """
    check_format(path)
    return read_bytes_bounded(path, MAX_MESH_BYTES, error=UrdfError)


def check_format(path: Path) -> None:
    """Check that the format of a mesh file is supported, by its name.

    Raises:
        UrdfError: It is not.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise UrdfError(f"{path}: unsupported mesh format; use {', '.join(MESH_SUFFIXES)}")


def parse_mesh(path: Path, data: bytes) -> Any:
    """Parse the content of a mesh file other than OBJ, without opening files that it names.

    A COLLADA file's unit applies.

    Args:
        path: Name of the file, for messages and the format.
        data: Content of the file.

    Returns:
        One trimesh of all placed parts [m].

    Raises:
        UrdfError: The file is damaged, or has too many parts or points.
    """
    import trimesh

    kind = path.suffix.lower().lstrip(".")
    options: dict[str, Any] = {}
    meters = 1.0
    try:
        if kind == "glb":
            _check_glb(data)
            options["skip_materials"] = True
        if kind == "dae":
            data, meters = _checked_collada(data)
        with _silence():
            mesh = trimesh.load(
                io.BytesIO(data), file_type=kind, force="mesh", resolver=_NoFiles(), **options
            )
            return mesh if meters == 1.0 else mesh.apply_scale(meters)
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    except Exception as error:  # trimesh's readers raise errors of any class
        raise UrdfError(
            f"{path}: damaged, or not a {kind.upper()} mesh ({_reason(error)})"
        ) from error


class _NoFiles(Mapping[str, bytes]):
    def __getitem__(self, name: str) -> bytes:
        raise KeyError(f"names another file, {name!r:.80}")

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


def _reason(error: Exception) -> str:
    """Return a reader's message, or the type of an error in the reader's own code."""
    if isinstance(error, AttributeError | TypeError | KeyError | IndexError | MemoryError):
        return f"content is missing or of the wrong type: {type(error).__name__}"
    return str(error) or type(error).__name__


_reading = ContextVar("_reading", default=False)
"""Whether this thread reads a mesh."""
_LOGGERS = tuple(map(logging.getLogger, ("trimesh", "trimesh.util", "collada")))
for _logger in _LOGGERS:  # a filter, as the readers may log for a program around momapos, too
    _logger.addFilter(lambda _record: not _reading.get())
_warnings_lock = fork_safe_lock()


@contextmanager
def _silence() -> Iterator[None]:
    """Suppress the readers' own messages about damaged files, in this thread.

    One thread at a time: `catch_warnings` restores the filters of the whole process.
    """
    before = _reading.set(True)
    try:
        with _warnings_lock, warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            yield
    finally:
        _reading.reset(before)


def _check_size(parts: int, points: int) -> None:
    if parts > MAX_PARTS:
        raise UrdfError(f"has more than {MAX_PARTS} parts; merge them, or simplify the mesh")
    if points > MAX_POINTS:
        raise UrdfError(f"has more than {MAX_POINTS} points; simplify the mesh")


def _check_glb(data: bytes) -> None:
    """Reject a GLB whose declared counts or repeated parts are too large."""
    length, kind = struct.unpack_from("<I4s", data, 12)
    if data[:4] != b"glTF" or kind != b"JSON":
        raise UrdfError("not a GLB mesh")
    head = json.loads(data[20 : 20 + length])
    accessors = [int(item["count"]) for item in head.get("accessors", [])]
    if any(count < 0 for count in accessors):
        raise UrdfError("damaged: a negative count")
    meshes = head.get("meshes", [])
    nodes = head.get("nodes", [])
    pieces = [mesh["primitives"] for mesh in meshes]
    _check_size(max(len(nodes), sum(map(len, pieces))), sum(accessors))

    def size(piece: Mapping[str, Any]) -> int:
        used = [*piece["attributes"].values(), *([piece["indices"]] if "indices" in piece else [])]
        return sum(accessors[int(k)] for k in used)

    sizes = [sum(map(size, piece)) for piece in pieces]
    placed = [int(node["mesh"]) for node in nodes if "mesh" in node]
    _check_size(sum(len(pieces[k]) for k in placed), sum(sizes[k] for k in placed))


def _checked_collada(data: bytes) -> tuple[bytes, float]:
    """Reject COLLADA with entities or too many placed parts; return it as parsed, and its unit."""
    from defusedxml import DefusedXmlException, ElementTree

    try:
        root = ElementTree.fromstring(data, forbid_dtd=True)
    except DefusedXmlException as error:
        raise UrdfError("DTDs and entities are not allowed in a mesh") from error
    named: dict[str, Any] = {}
    sizes: dict[str, int] = {}
    for element in root.iter():
        if _tag(element) == "node":
            named.setdefault(element.get("id", ""), element)
        elif _tag(element) == "geometry":
            count = sum(len((e.text or "").split()) for e in element.iter() if _tag(e) == "p")
            sizes[element.get("id", "")] = count
    known: dict[int, tuple[int, int]] = {}
    for element in root.iter():
        if _tag(element) == "visual_scene":
            _placed(element, named, sizes, known, 0)
    return bytes(ElementTree.tostring(root)), meters_per_unit(root)


def _placed(
    element: Any, named: Mapping[str, Any], sizes: Mapping[str, int],
    known: dict[int, tuple[int, int]], depth: int,
) -> tuple[int, int]:  # fmt: skip
    """Return how many nodes and indices a COLLADA node places, following references."""
    if depth > 50:
        raise UrdfError("nodes are nested deeper than 50, or contain themselves")
    if id(element) not in known:
        parts = points = 0
        for child in element:
            kind, target = _tag(child), child.get("url", "").removeprefix("#")
            if kind in ("node", "instance_node"):
                inner = child if kind == "node" else named.get(target)
                if inner is not None:
                    found = _placed(inner, named, sizes, known, depth + 1)
                    parts, points = parts + found[0] + 1, points + found[1]
            elif kind == "instance_geometry":
                parts, points = parts + 1, points + sizes.get(target, 0)
        _check_size(parts, points)
        known[id(element)] = parts, points
    return known[id(element)]


def _tag(element: Any) -> str:
    return str(element.tag).rpartition("}")[2]
