"""Choose frames of a long recording: spread over its motion, and the sharpest of their place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, whole_number

from .images import read_small_gray
from .validation import evenly_spaced

if TYPE_CHECKING:
    from jaxtyping import Float

STEP, TURN = 0.15, np.radians(10.0)
"""A camera that moved or turned by this sees something else [m], [rad]."""
FRAMES_PER_STEP = 4
"""Frames per such motion: several images of a place improve depth [-]."""
MIN_FRAMES = 30
"""Frames of a camera that hardly moves [-]."""
TIME_SHARE = 0.1
"""Share of the frames that are spread over time instead of motion [-]."""
CANDIDATES = 4
"""Neighboring frames whose sharpness is compared [-]."""


def choose(
    poses: Float[np.ndarray, "n 4 4"],
    limit: int,
    sharpness: Callable[[int], float] | None = None,
) -> list[int]:
    """Choose frames of a recording.

    If there are more than `limit`, the recording is divided into stretches of equal motion, and the
    sharpest frame of each is chosen: at 30 Hz, neighbors differ only in blur.

    Args:
        poses: Poses of all frames in recording order, camera to world.
        limit: Maximum number of frames.
        sharpness: Sharpness of a frame, called by several threads. If None, the middle frame of
            each stretch is chosen, and the first and the last frame at the ends.

    Raises:
        InputError: The limit is below 1.
    """
    whole_number("max_frames", limit, 1)
    if len(poses) <= limit:
        return list(range(len(poses)))
    stretches, middles = _stretches(poses, limit)
    if sharpness is None:
        return middles
    few = [[one[k] for k in evenly_spaced(len(one), CANDIDATES)] for one in stretches]
    among = [index for stretch in few for index in stretch]
    with ThreadPoolExecutor(max_workers=2) as pool:
        sharp = dict(zip(among, pool.map(sharpness, among), strict=True))
    return [max(stretch, key=lambda index: sharp[index]) for stretch in few]


def _stretches(poses: Float[np.ndarray, "n 4 4"], limit: int) -> tuple[list[list[int]], list[int]]:
    """Return the frames of stretches of equal motion, in order, and the middle frame of each.

    Empty stretches are dropped; the first starts and the last ends in its middle.
    """
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turned = np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3])
    angles = np.arccos(np.clip((turned - 1) / 2, -1, 1))
    motion = np.minimum(moved / STEP + angles / TURN, 1.0)  # a jump counts as one new place
    whole = float(motion.sum())
    count = int(np.clip(np.ceil(FRAMES_PER_STEP * whole), min(MIN_FRAMES, limit), limit))
    steps = (1 - TIME_SHARE) * motion / max(whole, 1e-9) + TIME_SHARE / len(motion)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    place = path / path[-1] * (count - 1)
    stretch = np.round(place).astype(int)
    members = [np.flatnonzero(stretch == k) for k in np.unique(stretch)]
    off = np.abs(place - stretch)
    return [one.tolist() for one in members], [int(one[np.argmin(off[one])]) for one in members]


def sharpness_of(colors: Sequence[Path]) -> Callable[[int], float]:
    """Return a function that measures the sharpness of images by their index."""

    def sharpness(index: int) -> float:
        try:
            gray = read_small_gray(colors[index])
        except FileFormatError:  # reported when it is read
            return -np.inf
        return laplacian_variance(gray)

    return sharpness


def laplacian_variance(gray: Float[np.ndarray, "h w"]) -> float:
    """Return the variance of the Laplacian of an image, which is small if it is blurred."""
    if min(gray.shape) < 3:
        return 0.0
    middle = gray[1:-1, 1:-1]
    around = gray[:-2, 1:-1] + gray[2:, 1:-1] + gray[1:-1, :-2] + gray[1:-1, 2:]
    return float((around - 4 * middle).var())
