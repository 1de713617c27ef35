"""Read and write point clouds as PLY or PCD.

Normals come from the file, else from its triangles, else from a plane fitted to each point's
neighbors. The sign of such a normal is ambiguous: it points toward the nearest camera or, without
cameras, toward the middle of the cloud, because whoever records a room stands in it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from momapos.core import FileFormatError, open_regular, write_file
from momapos.core.geometry import point_spacing
from momapos.model.records import Cloud

from .pcd import read_pcd
from .ply import AXES, Columns, origin_of, read_ply, thinned

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

NEIGHBORS = 16
MAX_EXTENT = 300.0  # [m] of a home
SPARSE = 0.03  # [m] between points; ScanNet's meshes have 3 to 5 cm, phones 1 to 2 cm
MAX_ROUNDING = 0.004  # [m] of coordinates
NORMALS, COLORS = ("nx", "ny", "nz"), ("red", "green", "blue")
"""Usual names of the columns in PLY files."""
_CHUNK = 200_000
_GRAY = 128


def read_cloud(
    path: Path, cameras: Float[np.ndarray, "c 3"] | None = None
) -> tuple[Cloud, tuple[str, ...]]:
    """Read a cloud.

    Args:
        path: A PLY or PCD file.
        cameras: Positions it was recorded from [m], to orient normals.

    Returns:
        The cloud in the file's order, without points that are not finite, and one line per dropped
        or assumed item. Large clouds are thinned, and clouds from far away are moved to the origin;
        `rows` and `origin` tell how.

    Raises:
        FileFormatError: It is damaged, empty, or not in meters.
    """
    columns, triangles = _read(path)
    if not set(AXES) <= set(columns):
        raise FileFormatError(f"{path}: its points have no x, y, z; they have {list(columns)[:8]}")
    if not len(columns["x"]):
        raise FileFormatError(f"{path}: the cloud is empty")
    origin = origin_of(columns)
    kept, rows, edge = thinned(columns, np.zeros(3) if origin is None else origin)
    if not len(kept):
        raise FileFormatError(f"{path}: none of its {len(rows)} points is finite")
    warnings = _notes(columns, origin, rows, len(kept), edge, path)
    columns = {name: column[kept] for name, column in columns.items()}
    points = np.stack([columns[name].astype(float) for name in AXES], axis=1)
    points = points if origin is None else points - origin
    _check_meters(points, path)
    colors = _colors(columns, len(points))
    if colors is None:
        warnings.append(f"{path}: has no colors; all points are gray")
        colors = np.full((len(points), 3), _GRAY, np.uint8)
    normals = _given_normals(columns, len(points))
    if triangles is not None and not np.any(normals):
        corners = rows[triangles]
        normals = _unit(_of_triangles(points, corners[(corners >= 0).all(axis=1)]))
    without = ~np.any(normals, axis=1)
    if without.any():
        cameras = cameras if cameras is None or origin is None else cameras - origin
        normals[without] = _toward(cameras, points, without, _estimated(points, without))
    apart = point_spacing(points)
    if apart > SPARSE:
        warnings.append(
            f"{path}: the cloud is sparse, its points are {100 * apart:.0f} cm apart; boxes are "
            f"rough, and objects smaller than {100 * 5 * apart:.0f} cm may be missing"
        )
    return Cloud(points, normals, colors, rows, origin), tuple(warnings)


def _notes(
    columns: Columns,
    origin: Float[np.ndarray, "3"] | None,
    rows: Int[np.ndarray, " file"],
    kept: int,
    edge: float,
    path: Path,
) -> list[str]:
    """Return one line per change of the points."""
    notes = []
    lost = int(np.count_nonzero(rows < 0))
    if lost:
        notes.append(f"{path}: dropped {lost} of {len(rows)} points that are not finite")
    if edge:
        notes.append(
            f"{path}: thinned from {len(rows):,} to {kept:,} points, one per {100 * edge:.1f} cm"
        )
    if origin is not None:
        place = ", ".join(f"{v:.0f}" for v in origin)
        notes.append(f"{path}: the cloud is far from the origin; ({place}) is its origin now")
        steps = [np.spacing(np.abs(columns[name][0])) for name in AXES]
        if max(steps) > MAX_ROUNDING:
            notes.append(
                f"{path}: its numbers are so large that they are rounded to {max(steps):.2f} m; "
                "save them as double, or move the cloud before saving"
            )
    return notes


def write_cloud(cloud: Cloud, path: Path) -> None:
    """Write a cloud as a binary PLY file, atomically.

    Raises:
        InputError: The file is not writable.
    """
    numbers = [(name, "<f4") for name in (*AXES, *NORMALS)]
    rows = np.empty(len(cloud.points), [*numbers, *((name, "u1") for name in COLORS)])
    values = np.column_stack([cloud.points, cloud.normals, cloud.colors])
    for name, column in zip((*AXES, *NORMALS, *COLORS), values.T, strict=True):
        rows[name] = column
    properties = [f"property float {name}" for name in (*AXES, *NORMALS)]
    properties += [f"property uchar {name}" for name in COLORS]
    count = f"element vertex {len(rows)}"
    head = ["ply", "format binary_little_endian 1.0", count, *properties, "end_header"]
    write_file(path, "\n".join(head).encode() + b"\n" + rows.tobytes())


def _read(path: Path) -> tuple[Columns, Int[np.ndarray, "m 3"] | None]:
    with open_regular(path) as file:
        head = file.read(4)
    if head.startswith(b"ply"):
        return read_ply(path)
    return read_pcd(path), None


def _check_meters(points: Float[np.ndarray, "n 3"], path: Path) -> None:
    low, high = np.percentile(points[:: max(1, len(points) // 100_000)], (2, 98), axis=0)
    extent = float((high - low).max())
    if extent > MAX_EXTENT:
        raise FileFormatError(
            f"{path}: the cloud is {extent:.0f} m across, so it looks as if it were in "
            "millimeters; expected meters"
        )


def _stacked(columns: Columns, names: tuple[str, ...]) -> Float[np.ndarray, "n k"] | None:
    if not set(names) <= set(columns):
        return None
    with np.errstate(invalid="ignore"):  # damaged floats are dropped later
        return np.stack([columns[name] for name in names], axis=1).astype(float)


def _colors(columns: Columns, count: int) -> UInt8[np.ndarray, "n 3"] | None:
    for names in (
        COLORS,
        ("r", "g", "b"),
        ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ):
        found = _stacked(columns, names)
        if found is None:
            continue
        kinds = {columns[name].dtype.kind for name in names}
        found = np.nan_to_num(found)
        if kinds == {"f"} and count and found.max() <= 1.0:
            found = 255.0 * found
        return np.clip(np.round(found), 0, 255).astype(np.uint8)
    return None


def _given_normals(columns: Columns, count: int) -> Float[np.ndarray, "n 3"]:
    for names in (NORMALS, ("normal_x", "normal_y", "normal_z")):
        found = _stacked(columns, names)
        if found is not None:
            return _unit(found)
    return np.zeros((count, 3))


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Normalize vectors; those that are zero or not finite become zero."""
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(vectors, axis=1)
    good = np.isfinite(length) & (length > 1e-12)
    return np.where(good[:, None], vectors, 0.0) / np.where(good, length, 1.0)[:, None]


def _of_triangles(
    points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n 3"]:
    a, b, c = (points[triangles[:, i]] for i in range(3))
    with np.errstate(over="ignore", invalid="ignore"):  # corners that are not finite
        normals = np.nan_to_num(np.cross(b - a, c - a), posinf=0.0, neginf=0.0)
    corners = triangles.ravel()
    return np.stack(
        [np.bincount(corners, np.repeat(axis, 3), len(points)) for axis in normals.T], axis=1
    )


def _estimated(
    points: Float[np.ndarray, "n 3"], which: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "k 3"]:
    """Return the normals of planes through the neighbors of some points, of either sign."""
    # A sensor may put all unmeasured points into one place, where a search would not end.
    places, place = np.unique(points, axis=0, return_inverse=True)
    tree = cKDTree(places)
    indices, back = np.unique(place.reshape(-1)[which], return_inverse=True)
    normals = np.empty((len(indices), 3))
    near = min(NEIGHBORS, len(places))
    for start in range(0, len(indices), _CHUNK):
        chosen = indices[start : start + _CHUNK]
        _, found = tree.query(places[chosen], k=[*range(1, near + 1)], workers=-1)
        offsets = places[found] - places[chosen, None]
        offsets -= offsets.mean(axis=1, keepdims=True)
        spread = offsets.transpose(0, 2, 1) @ offsets
        normals[start : start + _CHUNK] = np.linalg.eigh(spread)[1][:, :, 0]
    return normals[back.reshape(-1)]


def _toward(
    cameras: Float[np.ndarray, "c 3"] | None,
    points: Float[np.ndarray, "n 3"],
    which: Bool[np.ndarray, " n"],
    normals: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "k 3"]:
    seen_from = np.median(points, axis=0)[None] if cameras is None else cameras
    chosen = points[which]
    nearest = seen_from[cKDTree(seen_from).query(chosen)[1]]
    away = np.einsum("ni,ni->n", nearest - chosen, normals) < 0
    return np.where(away[:, None], -normals, normals)
