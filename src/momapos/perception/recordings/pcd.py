"""Read PCD files (up to version 0.7): ASCII, binary, and LZF-compressed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, BinaryIO

import numpy as np

from momapos.core import FileFormatError, open_regular
from momapos.core.compiled import Array, entry

from .ply import MAX_POINTS, Columns, read_rows

MAX_HEADER_BYTES = 10_000
MAX_FIELDS = 64
MAX_RATIO = 100  # LZF encodes a copy of up to 264 bytes in 3
_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS")
_KINDS = {"F": "f", "U": "u", "I": "i"}
_PACKED = ("rgb", "rgba")


def read_pcd(path: Path) -> Columns:
    """Read the fields of a PCD file.

    Returns:
        The fields by name; `red`, `green`, `blue` (uint8) if it has a packed color. Fields with
        several values are dropped.

    Raises:
        FileFormatError: It is damaged, or has more than `MAX_POINTS`.
    """
    try:
        with open_regular(path) as file:
            header = _header(file, path)
            dtype, count = _layout(header, path)
            kind = header["DATA"][0].lower()
            if kind == "ascii":
                table = _ascii(file, path, dtype, count)
            elif kind == "binary":
                table = np.frombuffer(_exactly(file, dtype.itemsize * count, path), dtype)
            elif kind == "binary_compressed":
                table = _compressed(file, path, dtype, count)
            else:
                raise FileFormatError(f"{path}: unknown PCD data {kind[:30]!r}")
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from error
    columns = {name: table[name] for name in table.dtype.names or () if table[name].ndim == 1}
    for name in _PACKED:
        if name in columns:
            columns.update(_unpacked(columns.pop(name)))
    return columns


def _header(file: BinaryIO, path: Path) -> dict[str, list[str]]:
    header: dict[str, list[str]] = {}
    size = 0
    while "DATA" not in header:
        line = file.readline(MAX_HEADER_BYTES)
        size += len(line)
        if not line or size > MAX_HEADER_BYTES:
            raise FileFormatError(f"{path}: its PCD header has no DATA line")
        words = line.decode("ascii", errors="replace").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "DATA") if not header.get(key)]
    if missing:
        raise FileFormatError(f"{path}: its PCD header lacks {', '.join(missing)}")
    return header


def _layout(header: dict[str, list[str]], path: Path) -> tuple[np.dtype, int]:
    names = header["FIELDS"]
    try:
        sizes, kinds = [int(word) for word in header["SIZE"]], header["TYPE"]
        repeats = [int(word) for word in header.get("COUNT", ["1"] * len(names))]
        if "POINTS" in header:
            count = int(header["POINTS"][0])
        else:
            count = int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        columns = [
            (_own_name(name, i), f"<{_KINDS[kind]}{size}", (repeat,) if repeat > 1 else ())
            for i, (name, kind, size, repeat) in enumerate(
                zip(names, kinds, sizes, repeats, strict=True)
            )
        ]
        if len(names) > MAX_FIELDS or not all(0 < repeat <= 10_000 for repeat in repeats):
            raise ValueError("too many fields")
        dtype = np.dtype(columns)
    except (ValueError, KeyError, IndexError, TypeError) as error:
        raise FileFormatError(f"{path}: its PCD header is inconsistent ({error})") from error
    if not 0 <= count <= MAX_POINTS:
        raise FileFormatError(f"{path}: has {count} points; the limit is {MAX_POINTS}")
    return dtype, count


def _own_name(name: str, index: int) -> str:
    # PCL pads records with fields that are all named "_".
    return f"_{index}" if name == "_" else name


def _ascii(file: BinaryIO, path: Path, dtype: np.dtype, count: int) -> np.ndarray:
    widths = [int(np.prod(dtype[name].shape)) for name in dtype.names or ()]
    if not count:
        return np.empty(0, dtype)
    try:
        rows = read_rows(file, count)
        if len(rows) < count or rows.shape[1] != sum(widths):
            raise ValueError(f"{rows.shape[0]} rows of {rows.shape[1]} numbers")
    except ValueError as error:
        raise FileFormatError(f"{path}: its points are damaged ({error})") from error
    table = np.empty(count, dtype)
    starts = np.cumsum([0, *widths])
    for name, start, width in zip(dtype.names or (), starts, widths, strict=False):
        values = rows[:, start] if width == 1 else rows[:, start : start + width]
        with np.errstate(invalid="ignore", over="ignore"):
            table[name] = values
    return table


def _compressed(file: BinaryIO, path: Path, dtype: np.dtype, count: int) -> np.ndarray:
    packed, size = np.frombuffer(_exactly(file, 8, path), "<u4").tolist()
    if size != dtype.itemsize * count or size > MAX_RATIO * packed:
        raise FileFormatError(
            f"{path}: {packed} bytes cannot hold {count} points of {dtype.itemsize} bytes"
        )
    data = np.frombuffer(_exactly(file, packed, path), np.uint8)
    plain = np.zeros(size, np.uint8)
    if unpack_lzf(data, plain) != size:
        raise FileFormatError(f"{path}: its compressed points are damaged")
    table = np.empty(count, dtype)
    start = 0
    for name in dtype.names or ():
        # Compressed data are stored field by field, not point by point.
        stop = start + dtype[name].itemsize * count
        table[name] = plain[start:stop].view(dtype[name].base).reshape(count, *dtype[name].shape)
        start = stop
    return table


def _exactly(file: BinaryIO, size: int, path: Path) -> bytes:
    here = file.tell()
    left = file.seek(0, 2) - here
    file.seek(here)
    if left < size:
        raise FileFormatError(f"{path}: ends early, with {left} of {size} bytes of points")
    return file.read(size)


def _unpacked(packed: np.ndarray) -> Columns:
    """Split a color that PCL packs into the bits of one number, a float in old files."""
    if packed.dtype.itemsize != 4:
        return {}
    bits = np.ascontiguousarray(packed).view("<u4")
    return {
        name: ((bits >> shift) & 255).astype(np.uint8)
        for name, shift in (("red", 16), ("green", 8), ("blue", 0))
    }


@entry
def unpack_lzf(
    data: Annotated[np.ndarray, Array(np.dtype("u1"), 1, readonly=True)],
    out: Annotated[np.ndarray, Array(np.dtype("u1"), 1)],
) -> int:
    """Unpack LZF (LibLZF's format): runs of plain bytes, and copies of earlier bytes.

    Returns:
        Number of bytes written; -1 if either array is too short.
    """
    i, o = 0, 0
    while i < len(data):
        control = int(data[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(data) or o + length > len(out):
                return -1
            out[o : o + length] = data[i : i + length]
            i += length
            o += length
            continue
        length = control >> 5
        if length == 7:
            if i >= len(data):
                return -1
            length += int(data[i])
            i += 1
        if i >= len(data):
            return -1
        source = o - ((control & 31) << 8) - int(data[i]) - 1
        i += 1
        length += 2
        if source < 0 or o + length > len(out):
            return -1
        for _ in range(length):  # may overlap itself, so byte by byte
            out[o] = out[source]
            o += 1
            source += 1
    return o
