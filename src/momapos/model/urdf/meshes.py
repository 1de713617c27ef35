"""Read the vertices of mesh files that come from strangers.

trimesh parses; this module bounds what goes in: size, number of parts once all references are
followed, and no file beside the mesh is opened.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import os
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import UrdfError, read_bytes_bounded

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_MESH_BYTES = 50_000_000
"""A collision mesh of a robot or of furniture has some megabytes."""
MESH_SUFFIXES = (".obj", ".stl", ".dae", ".ply", ".off", ".glb")
MAX_PARTS = 1_000
"""Nodes of a scene within a mesh file, each counted as often as it is placed [-]."""
MAX_POINTS = 10_000_000
"""Vertices and indices in a mesh file, each counted as often as it is placed [-]."""
MAX_COORDINATE = 1e7


def mesh_points(path: Path) -> Float[np.ndarray, "n 3"]:
    """Read the vertices of a mesh.

    Raises:
        UrdfError: It cannot be read, is too large, is empty, or holds NaN.
    """
    try:
        return _points(path, os.stat(path).st_mtime_ns)
    except OSError as error:
        raise UrdfError(f"{path}: cannot be read ({error.strerror})") from error


@lru_cache(maxsize=4096)
def _points(path: Path, _stamp: int) -> Float[np.ndarray, "n 3"]:
    points = _vertices(path, mesh_bytes(path))
    if len(points) == 0:
        raise UrdfError(f"{path}: the mesh is empty")
    if points.ndim != 2 or points.shape[1] != 3:
        raise UrdfError(f"{path}: not a usable mesh (its vertices do not have 3 coordinates)")
    if not np.isfinite(points).all():
        raise UrdfError(f"{path}: the mesh holds NaN or infinite vertices")
    far = np.abs(points).max()
    if far > MAX_COORDINATE:
        raise UrdfError(f"{path}: the mesh has a vertex at {far:g}; is it damaged?")
    return points


def _vertices(path: Path, data: bytes) -> Float[np.ndarray, "n 3"]:
    if path.suffix.lower() != ".obj":
        return np.array(parse_mesh(path, data).vertices, float)
    # Vertices alone: materials and textures are neither needed nor trusted.
    lines = data.decode(errors="replace").splitlines()
    try:
        rows = [[*map(float, x.split()[1:4])] for x in lines if x.startswith("v ")]
        return np.array(rows, float).reshape(-1, 3)
    except ValueError as error:
        raise UrdfError(f"{path}: not a usable OBJ mesh ({error})") from error


def mesh_triangles(path: Path) -> Float[np.ndarray, "t 3 3"]:
    """Read the surface of a mesh; polygons are divided into fans, and points alone have none.

    Raises:
        UrdfError: As for `mesh_points`, or a face names a corner that is not there.
    """
    points = mesh_points(path)
    if path.suffix.lower() == ".obj":
        faces = _obj_faces(path, len(points))
    else:
        faces = np.array(parse_mesh(path, mesh_bytes(path)).faces, np.int64).reshape(-1, 3)
    wrong = (faces < 0) | (faces >= len(points))
    if wrong.any():
        worst = int(faces[wrong][0]) + 1
        raise UrdfError(f"{path}: a face names corner {worst}, and the mesh has {len(points)}")
    return points[faces]


def _obj_faces(path: Path, count: int) -> Int[np.ndarray, "t 3"]:
    """Corners of the faces of an OBJ file, from 0; relative numbers count back from their line."""
    seen, faces = 0, []
    try:
        for line in mesh_bytes(path).decode(errors="replace").splitlines():
            if line.startswith("v "):
                seen += 1
            elif line.startswith("f "):
                named = [int(word.split("/")[0]) for word in line.split()[1:]]
                corners = [k - 1 if k > 0 else seen + k for k in named]
                faces += [(corners[0], a, b) for a, b in pairwise(corners[1:])]
    except ValueError as error:
        raise UrdfError(f"{path}: not a usable OBJ mesh ({error})") from error
    _refuse_more(0, count + 3 * len(faces))
    return np.array(faces, np.int64).reshape(-1, 3)


def mesh_digest(path: Path) -> bytes:
    """What stands for the content of a mesh.

    Raises:
        UrdfError: As for `mesh_bytes`.
    """
    return hashlib.sha256(mesh_bytes(path)).digest()


def mesh_bytes(path: Path) -> bytes:
    """Content of a mesh file of a kind that can be read.

    Raises:
        UrdfError: It is of another kind, too large, or no regular file.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise UrdfError(f"{path}: not a mesh that can be read; use {', '.join(MESH_SUFFIXES)}")
    return read_bytes_bounded(path, MAX_MESH_BYTES, error=UrdfError)


def parse_mesh(path: Path, data: bytes) -> Any:
    """Parse the content of a mesh file other than OBJ; files that it names are not opened.

    Args:
        path: Its name, for messages and the kind.
        data: Its content.

    Returns:
        One trimesh of all its parts, where they are placed.

    Raises:
        UrdfError: It is damaged, or too much.
    """
    import trimesh

    kind = path.suffix.lower().lstrip(".")
    options: dict[str, Any] = {}
    try:
        if kind == "glb":
            _check_glb(data)
            options["skip_materials"] = True
        if kind == "dae":
            data = _checked_collada(data)
        with _silence():
            return trimesh.load(
                io.BytesIO(data), file_type=kind, force="mesh", resolver=_Nothing(), **options
            )
    except UrdfError as error:
        raise UrdfError(f"{path}: {error}") from error
    except Exception as error:  # trimesh raises whatever its many readers met
        raise UrdfError(f"{path}: damaged, or no {kind.upper()} mesh ({_reason(error)})") from error


class _Nothing(Mapping[str, bytes]):
    """The files beside a mesh: none."""

    def __getitem__(self, name: str) -> bytes:
        raise KeyError(f"names another file, {name!r:.80}")

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


def _reason(error: Exception) -> str:
    """What a reader says, where it tells more than where its own code stopped."""
    if isinstance(error, AttributeError | TypeError | KeyError | IndexError | MemoryError):
        return f"what it should hold is missing or of another kind: {type(error).__name__}"
    return str(error) or type(error).__name__


@contextmanager
def _silence() -> Iterator[None]:
    """Keep readers' own remarks on a damaged file off the terminal."""
    loggers = [logging.getLogger(name) for name in ("trimesh", "collada")]
    before = [logger.disabled for logger in loggers]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.disabled = True
            yield
        finally:
            for logger, was in zip(loggers, before, strict=True):
                logger.disabled = was


def _refuse_more(parts: int, points: int) -> None:
    if parts > MAX_PARTS:
        raise UrdfError(f"places more than {MAX_PARTS} parts; join them, or simplify the mesh")
    if points > MAX_POINTS:
        raise UrdfError(f"holds more than {MAX_POINTS} points; simplify the mesh")


def _check_glb(data: bytes) -> None:
    """Refuse a GLB that is more than it looks: counts without data, parts placed very often."""
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
    _refuse_more(max(len(nodes), sum(map(len, pieces))), sum(accessors))

    def size(piece: Mapping[str, Any]) -> int:
        used = [*piece["attributes"].values(), *([piece["indices"]] if "indices" in piece else [])]
        return sum(accessors[int(k)] for k in used)

    sizes = [sum(map(size, piece)) for piece in pieces]
    placed = [int(node["mesh"]) for node in nodes if "mesh" in node]
    _refuse_more(sum(len(pieces[k]) for k in placed), sum(sizes[k] for k in placed))


def _checked_collada(data: bytes) -> bytes:
    """Refuse entities, and nodes that place each other very often; as it was parsed here."""
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
    return bytes(ElementTree.tostring(root))


def _placed(
    element: Any, named: Mapping[str, Any], sizes: Mapping[str, int],
    known: dict[int, tuple[int, int]], depth: int,
) -> tuple[int, int]:  # fmt: skip
    """How many nodes and how many indices a COLLADA node places, references followed."""
    if depth > 50:
        raise UrdfError("nodes are nested deeper than 50, or hold themselves")
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
        _refuse_more(parts, points)
        known[id(element)] = parts, points
    return known[id(element)]


def _tag(element: Any) -> str:
    return str(element.tag).rpartition("}")[2]
