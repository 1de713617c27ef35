"""Read the points of a PLY file, in the file's order, so that masks of its vertices fit."""

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


def read_rows(file: BinaryIO, count: int) -> Float[np.ndarray, "rows columns"]:
    """Read at most `count` lines of numbers; empty lines are skipped.

    Raises:
        ValueError: They are not numbers, or lines have different lengths.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about empty lines
        # comments=None: a "#" is not a comment here.
        return np.loadtxt(file, max_rows=count, ndmin=2, comments=None)


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
