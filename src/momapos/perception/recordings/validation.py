"""Checks that apply to recorded scans of every format."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, InputError, whole_number
from momapos.model.records import Frame

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_TOTAL_PIXELS = 400_000_000
"""Of all frames in memory; a depth and a color pixel take 7 bytes."""
NEAREST_MEDIAN, FARTHEST_MEDIAN = 0.05, 40.0  # [m]
MAX_ODD_SIZES = 0.2
_RIGID = 1e-2


class Skips:
    """Counts unusable frames by reason."""

    def __init__(self, total: int) -> None:
        self.total = total
        self._count: Counter[str] = Counter()
        self._first: dict[str, str] = {}

    def add(self, kind: str, reason: str) -> None:
        """Count one frame; the first reason of each kind is stored."""
        self._count[kind] += 1
        self._first.setdefault(kind, reason)

    def warnings(self) -> tuple[str, ...]:
        """Return one line per kind."""
        return tuple(
            f"skipped {count} of {self.total} frames because of their {kind}; the first: "
            f"{self._first[kind]}"
            for kind, count in self._count.items()
        )

    def refuse_none_left(self, left: int, where: str) -> None:
        """Raise FileFormatError if no frame is left."""
        if left:
            return
        reasons = "; ".join(f"{kind}: {reason}" for kind, reason in self._first.items())
        raise FileFormatError(f"{where}: none of its {self.total} frames is usable; {reasons}")


def rigid_pose(values: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Check that a matrix is a rigid transform, and return it with its rotation orthonormalized.

    Raises:
        ValueError: It has numbers that are not finite, or it scales, shears or mirrors.
    """
    T = np.asarray(values, float)
    if T.shape != (4, 4):
        raise ValueError(f"a pose is a 4 x 4 matrix, not {' x '.join(map(str, T.shape))}")
    if not np.isfinite(T).all():
        raise ValueError("the pose has numbers that are not finite")
    if np.abs(T).max() > 1e8:
        raise ValueError("the pose is farther than 100,000 km from the origin")
    R = T[:3, :3]
    off = max(np.abs(R.T @ R - np.eye(3)).max(), np.abs(T[3] - [0, 0, 0, 1]).max())
    if off > _RIGID or np.linalg.det(R) < 0:
        raise ValueError("the pose is not a rigid transform (rotation and meters)")
    u, _, vt = np.linalg.svd(R)
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = u @ vt, T[:3, 3]
    return exact


def check_intrinsics(K: Float[np.ndarray, "3 3"], where: str) -> Float[np.ndarray, "3 3"]:
    """Check that a matrix is that of a pinhole camera.

    Raises:
        FileFormatError: It is not.
    """
    good = K.shape == (3, 3) and np.isfinite(K).all() and K[0, 0] > 1 and K[1, 1] > 1
    if not good or np.abs(K[2] - [0, 0, 1]).max() > 1e-6 or np.abs(K).max() > 1e6:
        raise FileFormatError(
            f"{where}: not a pinhole camera; expected [fx 0 cx; 0 fy cy; 0 0 1] in pixels"
        )
    return K


def evenly_spaced(count: int, limit: int) -> list[int]:
    """Return at most `limit` of `count` indices, including the first and the last."""
    whole_number("max_frames", limit, 1)
    if count <= limit:
        return list(range(count))
    return np.round(np.linspace(0, count - 1, limit)).astype(int).tolist()


def keep_common_size(sizes: Mapping[int, Hashable], skips: Skips, where: str) -> list[int]:
    """Return the frames that have the most common size.

    Args:
        sizes: Size of each frame, by its index.
        skips: Counts the other frames.
        where: Name of the scan in errors.

    Returns:
        Indices of the frames, in order.

    Raises:
        FileFormatError: A fifth or more have another size.
    """
    counted = Counter(sizes.values()).most_common()
    if not counted:
        return []
    common, count = counted[0]
    odd = len(sizes) - count
    if odd >= MAX_ODD_SIZES * len(sizes) and odd > 0:
        listed = ", ".join(f"{n} of {size}" for size, n in counted[:4])
        raise FileFormatError(
            f"{where}: its frames have different sizes ({listed}); record them with one size"
        )
    for size in sizes.values():
        if size != common:
            skips.add("size", f"{size} pixels, where most frames have {common}")
    return [index for index, size in sizes.items() if size == common]


def check_memory(frames: int, pixels: int, where: str) -> None:
    """Raise InputError if the frames do not fit into memory."""
    if frames * pixels > MAX_TOTAL_PIXELS:
        raise InputError(
            f"{where}: {frames} frames of {pixels / 1e6:.1f} million pixels do not fit into "
            f"memory; use max_frames={max(1, MAX_TOTAL_PIXELS // pixels)} or smaller images"
        )


def check_depth_unit(frames: Sequence[Frame], scale: float, where: str) -> None:
    """Check that depth is in the range of a room.

    Raises:
        FileFormatError: All depth is 0, or the median is not within 0.05 m and 40 m.
    """
    samples = [f.depth[::8, ::8] for f in frames if f.depth is not None]
    if not samples:
        return
    flat = np.concatenate([depth.ravel() for depth in samples])
    seen = flat[flat > 0]
    if not len(seen):
        raise FileFormatError(f"{where}: the depth images are empty (0 everywhere)")
    median = float(np.median(seen))
    if NEAREST_MEDIAN <= median <= FARTHEST_MEDIAN:
        return
    guess = "meters or centimeters" if median < NEAREST_MEDIAN else "a unit finer than expected"
    raise FileFormatError(
        f"{where}: the median depth is {median:.3g} m at {scale:g} units a meter, so depth looks "
        f"as if it were in {guess}; expected 16-bit millimeters, or set depth_scale"
    )
