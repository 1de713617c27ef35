"""Read files of camera poses: one timed pose per row (TUM), or 4 x 4 matrices (Open3D)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, read_text_bounded

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_BYTES = 50_000_000
MAX_GAP = 0.1
"""Poses are interpolated over gaps up to this [s]."""
MAX_NORM_ERROR = 0.05
"""Deviation of a quaternion's length from 1 [-]."""


def read_rows(path: Path, columns: int) -> list[tuple[str, list[str]]]:
    """Return the rows of words of a text file, without comments, each with its place.

    Args:
        path: The file.
        columns: Number of words per row.

    Raises:
        FileFormatError: A row has another number, or there is none.
    """
    rows = []
    for number, line in enumerate(read_text_bounded(path, MAX_BYTES).splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if words and len(words) != columns:
            raise FileFormatError(f"{path}:{number}: must have {columns} columns, not {len(words)}")
        if words:
            rows.append((f"{path}:{number}", words))
    if not rows:
        raise FileFormatError(f"{path}: has no rows")
    return rows


def numbers_of(words: list[str], where: str) -> list[float]:
    """Convert words to finite numbers.

    Raises:
        FileFormatError: One is not a finite number.
    """
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FileFormatError(f"{where}: {' '.join(words)[:60]!r} must be numbers") from error
    if not np.isfinite(values).all():
        raise FileFormatError(f"{where}: has a number that is not finite")
    return values


def read_tum(path: Path) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 4 4"]]:
    """Read rows of time [s], tx ty tz [m] and qx qy qz qw: from camera to world.

    Returns:
        Times, ascending, and poses.

    Raises:
        FileFormatError: It has something else, or nothing.
    """
    from scipy.spatial.transform import Rotation

    values = np.array([numbers_of(words, where) for where, words in read_rows(path, 8)])
    values = values[np.argsort(values[:, 0], kind="stable")]
    off = np.abs(np.linalg.norm(values[:, 4:], axis=1) - 1.0)
    if off.max() > MAX_NORM_ERROR:
        raise FileFormatError(f"{path}: has quaternions whose length is not 1")
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(values[:, 4:]).as_matrix()
    poses[:, :3, 3] = values[:, 1:4]
    return values[:, 0], poses


def read_log(path: Path) -> dict[int, Float[np.ndarray, "4 4"]]:
    """Read Open3D's .log: per frame a row of three integers, then four rows of a matrix.

    Returns:
        Matrices from camera to world by frame number, in file order.

    Raises:
        FileFormatError: It has something else, or a frame twice.
    """
    lines = [line for line in read_text_bounded(path, MAX_BYTES).splitlines() if line.strip()]
    if not lines or len(lines) % 5:
        raise FileFormatError(
            f"{path}: has {len(lines)} rows; a trajectory has five per frame, its number and "
            "a 4 x 4 matrix"
        )
    found: dict[int, Float[np.ndarray, "4 4"]] = {}
    for first in range(0, len(lines), 5):
        where = f"{path}: frame {first // 5}"
        head = numbers_of(lines[first].split(), where)
        rows = [numbers_of(line.split(), where) for line in lines[first + 1 : first + 5]]
        if {len(row) for row in rows} != {4} or not head or head[0] != int(head[0]):
            raise FileFormatError(f"{where}: must be a row of integers and a 4 x 4 matrix")
        if int(head[0]) in found:
            raise FileFormatError(f"{path}: has frame {int(head[0])} twice")
        found[int(head[0])] = np.array(rows)
    return found


def poses_at(
    times: Float[np.ndarray, " n"],
    poses: Float[np.ndarray, "n 4 4"],
    wanted: Float[np.ndarray, " m"],
    gap: float = MAX_GAP,
) -> tuple[Float[np.ndarray, "m 4 4"], Bool[np.ndarray, " m"]]:
    """Interpolate the poses of a camera at given times.

    Args:
        times: Times of the known poses, ascending [s].
        poses: From camera to world.
        wanted: Times to interpolate at [s].
        gap: Poses are not interpolated over longer gaps [s].

    Returns:
        The poses, and whether each is known.
    """
    from scipy.spatial.transform import Rotation

    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    before = np.where(times[after] == wanted, after, before)
    span = times[after] - times[before]
    share = np.clip((wanted - times[before]) / np.maximum(span, 1e-9), 0.0, 1.0)
    away = np.maximum(times[before] - wanted, wanted - times[after])
    known = np.where(away > 0.0, away <= gap / 2, span <= gap)
    start = Rotation.from_matrix(poses[before, :3, :3])
    turn = (Rotation.from_matrix(poses[after, :3, :3]) * start.inv()).as_rotvec()
    found = np.tile(np.eye(4), (len(wanted), 1, 1))
    found[:, :3, :3] = (Rotation.from_rotvec(share[:, None] * turn) * start).as_matrix()
    found[:, :3, 3] = poses[before, :3, 3] + share[:, None] * (
        poses[after, :3, 3] - poses[before, :3, 3]
    )
    return found, known
