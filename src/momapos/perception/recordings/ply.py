"""Read the points of a PLY file, thin large clouds, and move far ones to the origin."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from momapos.core import FileFormatError, open_regular

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MAX_POINTS = 50_000_000
MAX_HEADER_BYTES = 100_000
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

Columns = dict[str, np.ndarray]


@dataclass
class _Element:
    name: str
    count: int
    columns: list[tuple[str, str]] = field(default_factory=list)
    """Name and type of each property; a list has the types of its length and items."""

    @property
    def has_lists(self) -> bool:
        return any(" " in kind for _, kind in self.columns)


def read_ply(path: Path) -> tuple[Columns, Int[np.ndarray, "m 3"] | None]:
    """Read the vertices of a PLY file, and its faces if all of them are triangles.

    Returns:
        The properties of the vertices by name, and the triangles or None.

    Raises:
        FileFormatError: It is damaged, has no vertices, or more than `MAX_POINTS`.
    """
    try:
        with open_regular(path) as file:
            order, elements = _header(file, path)
            return _body(file, path, order, elements)
    except OSError as error:
        raise FileFormatError(f"{path}: not readable ({error.strerror})") from error


def _header(file: BinaryIO, path: Path) -> tuple[str, list[_Element]]:
    order, elements, size = None, [], 0
    while True:
        line = file.readline(MAX_HEADER_BYTES)
        size += len(line)
        if not line or size > MAX_HEADER_BYTES:
            raise FileFormatError(f"{path}: its PLY header has no end")
        words = line.decode("ascii", errors="replace").split()
        if words == ["end_header"]:
            break
        try:
            if words[:1] == ["format"]:
                order = _ORDERS[words[1]]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], _count(words[2], path)))
            elif words[:2] == ["property", "list"]:
                kinds = f"{_TYPES[words[2]]} {_TYPES[words[3]]}"
                elements[-1].columns.append((words[4], kinds))
            elif words[:1] == ["property"]:
                elements[-1].columns.append((words[2], _TYPES[words[1]]))
        except (IndexError, KeyError, ValueError) as error:
            raise FileFormatError(f"{path}: bad line in its PLY header: {line[:60]!r}") from error
    if order is None:
        raise FileFormatError(f"{path}: its PLY header has no format line")
    return order, elements


def _count(word: str, path: Path) -> int:
    count = int(word)
    if not 0 <= count <= 4 * MAX_POINTS:
        raise FileFormatError(f"{path}: has {count} entries; the limit is {MAX_POINTS}")
    return count


def _body(
    file: BinaryIO, path: Path, order: str, elements: list[_Element]
) -> tuple[Columns, Int[np.ndarray, "m 3"] | None]:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise FileFormatError(f"{path}: has no vertices")
    index = names.index("vertex")
    for other in elements[:index]:
        if other.has_lists:
            raise FileFormatError(f"{path}: has lists before its vertices; save vertices first")
        _scalars(file, path, order, other)
    element = elements[index]
    if element.has_lists or len({name for name, _ in element.columns}) < len(element.columns):
        raise FileFormatError(f"{path}: its vertices have lists or duplicate properties")
    if element.count > MAX_POINTS:
        raise FileFormatError(f"{path}: has {element.count} points; the limit is {MAX_POINTS}")
    vertices = _scalars(file, path, order, element)
    rest = elements[index + 1 : index + 2]
    triangles = None
    if rest and rest[0].name == "face" and rest[0].count:
        triangles = _triangles(file, order, rest[0], element.count)
    return vertices, triangles


def _scalars(file: BinaryIO, path: Path, order: str, element: _Element) -> Columns:
    names = [name for name, _ in element.columns]
    if not element.count or not names:
        return {name: np.empty(0) for name in names}
    if order:
        dtype = np.dtype([(f"f{i}", order + kind) for i, (_, kind) in enumerate(element.columns)])
        table = np.fromfile(file, dtype, _available(file, dtype.itemsize, element.count))
        columns = [table[f"f{i}"] for i in range(len(names))]
    else:
        try:
            rows = read_rows(file, element.count)
        except ValueError as error:
            raise FileFormatError(f"{path}: {element.name} must be numbers ({error})") from error
        if rows.shape[1:] != (len(names),) and rows.size:
            raise FileFormatError(
                f"{path}: {element.name} has {rows.shape[1]} columns, not {names}"
            )
        with np.errstate(invalid="ignore", over="ignore"):
            columns = [
                (rows[:, i] if rows.size else np.empty(0)).astype(kind)
                for i, (_, kind) in enumerate(element.columns)
            ]
    if len(columns[0]) < element.count:
        raise FileFormatError(
            f"{path}: ends after {len(columns[0])} of {element.count} entries of {element.name!r}"
        )
    return dict(zip(names, columns, strict=True))


_LINES = 100_000
"""Lines that are read in one call, which takes 0.1 s [-]."""


def read_rows(file: BinaryIO, count: int) -> Float[np.ndarray, "rows columns"]:
    """Read at most `count` lines of numbers; empty lines are skipped.

    Raises:
        ValueError: They are not numbers, or lines have different lengths.
    """
    blocks = [np.empty((0, 1))]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about empty lines, and the end of the file
        while count > 0 and (len(blocks) == 1 or len(blocks[-1]) == _LINES):
            # comments=None: a "#" is not a comment here.
            rows = np.loadtxt(file, max_rows=min(count, _LINES), ndmin=2, comments=None)
            count -= len(rows)
            blocks.append(rows)
    return np.concatenate([rows for rows in blocks[1:] if len(rows)] or blocks[:1])


def _available(file: BinaryIO, itemsize: int, count: int) -> int:
    """Return the number of entries in the rest of the file, at most `count`."""
    here = file.tell()
    left = file.seek(0, 2) - here
    file.seek(here)
    return min(count, left // itemsize)


def _triangles(
    file: BinaryIO, order: str, element: _Element, vertices: int
) -> Int[np.ndarray, "m 3"] | None:
    """Return the faces; None if damaged or not all triangles, since only normals need them."""
    kinds = [kind.split() for _, kind in element.columns]
    if [len(kind) for kind in kinds] != [2] + [1] * (len(kinds) - 1):
        return None
    length, item = kinds[0]
    if "f" in length + item:
        return None
    if order:
        dtype = np.dtype(
            [("n", order + length), ("v", order + item, 3)]
            + [(f"f{i}", order + kind) for i, (kind,) in enumerate(kinds[1:])]
        )
        table = np.fromfile(file, dtype, _available(file, dtype.itemsize, element.count))
        lengths, corners = table["n"], table["v"].astype(np.int64)
    else:
        try:
            rows = read_rows(file, element.count)
            with np.errstate(invalid="ignore"):
                lengths, corners = rows[:, 0], rows[:, 1:4].astype(np.int64)
        except (ValueError, IndexError):
            return None
    good = len(corners) == element.count and corners.shape[1:] == (3,) and np.all(lengths == 3)
    if not good or corners.min() < 0 or corners.max() >= vertices:
        return None
    return corners


AXES = ("x", "y", "z")
"""Usual names of the columns of coordinates."""
MAX_KEPT_POINTS = 1_500_000
"""Larger clouds are thinned [-]: a kitchen fused in voxels of 15 mm has about 400,000 points."""
SPACING = 0.01
"""Edge of the cells of which a thinned cloud has one point each [m]."""
MAX_DISTANCE = 1e9
"""Larger coordinates are damaged [m]; coordinates of maps reach 1e7 m."""
FAR = 1000.0
"""Clouds whose middle is farther from the origin are moved to it [m]."""
_BITS = 21
"""Bits of a cell's number along each axis."""
_ROWS = 2_000_000


def origin_of(columns: Columns) -> Float[np.ndarray, "3"] | None:
    """Return the middle of a cloud in whole meters if it is far from the origin, else None."""
    step = max(1, len(columns["x"]) // 100_000)
    with np.errstate(invalid="ignore"):
        sample = np.stack([columns[name][::step].astype(float) for name in AXES], axis=1)
        sample = sample[(np.abs(sample) < MAX_DISTANCE).all(axis=1)]
    if not len(sample):
        return None
    middle = np.round(np.median(sample, axis=0))
    return middle if np.abs(middle).max() > FAR else None


def thinned(
    columns: Columns, origin: Float[np.ndarray, "3"]
) -> tuple[Int[np.ndarray, " kept"], Int[np.ndarray, " file"], float]:
    """Choose one point per cell of a large cloud, and all points of a small one.

    Args:
        columns: Coordinates by name.
        origin: Subtracted from the coordinates [m].

    Returns:
        Indices of the chosen points, ascending; the number of the chosen point for each point of
        the file, -1 if it is not finite; and the edge of the cells [m], 0 if none is left out.
    """
    count = len(columns["x"])
    finite = np.empty(count, bool)
    for start in range(0, count, _ROWS):
        finite[start : start + _ROWS] = np.isfinite(_part(columns, origin, start)).all(axis=1)
    rows = np.where(finite, np.cumsum(finite, dtype=np.int32) - 1, np.int32(-1))
    kept, spacing = np.flatnonzero(finite), 0.0
    while len(kept) > MAX_KEPT_POINTS:
        spacing = SPACING if spacing == 0.0 else 1.5 * spacing
        cells = np.concatenate([
            _cells(_part(columns, origin, start, kept), spacing)
            for start in range(0, len(kept), _ROWS)
        ])  # fmt: skip
        first, number = _first_of_each(cells)
        rows = np.where(finite, number[np.maximum(rows, 0)], np.int32(-1))
        kept = kept[first]
    return kept, rows, spacing


def _part(
    columns: Columns,
    origin: Float[np.ndarray, "3"],
    start: int,
    among: Int[np.ndarray, " kept"] | None = None,
) -> Float[np.ndarray, "n 3"]:
    """Return some points from `start` on, moved; NaN or infinite if damaged."""
    which = slice(start, start + _ROWS) if among is None else among[start : start + _ROWS]
    with np.errstate(invalid="ignore", over="ignore"):
        points = np.stack([columns[name][which].astype(float) for name in AXES], axis=1)
        points[~(np.abs(points) < MAX_DISTANCE)] = np.nan
    return points - origin


def _cells(points: Float[np.ndarray, "n 3"], spacing: float) -> Int[np.ndarray, " n"]:
    """Return one number per cell; cells many kilometers away share numbers."""
    index = np.floor(points / spacing).astype(np.int64) & (2**_BITS - 1)
    return (index[:, 0] << 2 * _BITS) | (index[:, 1] << _BITS) | index[:, 2]


def _first_of_each(
    cells: Int[np.ndarray, " n"],
) -> tuple[Int[np.ndarray, " kept"], Int[np.ndarray, " n"]]:
    """Return the first entry of each number, ascending, and which of them each entry belongs to."""
    order = np.argsort(cells, kind="stable").astype(np.int32)
    cells = cells[order]
    new = np.concatenate([[True], cells[1:] != cells[:-1]])
    del cells
    first = order[new]
    group = np.cumsum(new, dtype=np.int32) - 1
    ranks = np.empty(len(first), np.int32)
    ranks[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    number = np.empty(len(order), np.int32)
    number[order] = ranks[group]
    return np.sort(first), number
