"""Which frames of a long walk to read: spread over its motion, and the sharpest of their kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, InputError

from .images import read_small_gray
from .validation import evenly_spaced

if TYPE_CHECKING:
    from jaxtyping import Float

STEP, TURN = 0.15, np.radians(10.0)
"""A camera that moved by this, or turned by that, sees something else [m], [rad]."""
DENSE = 4
"""Frames for each such motion: several images of a place make better depth [-]."""
FEWEST = 30
"""A camera that hardly moves gives at least so many [-]."""
STILL = 0.1
"""Share of the frames that are spread over time rather than motion [-]."""
CANDIDATES = 4
"""Neighboring frames whose sharpness is compared [-]."""


def choose(
    poses: Float[np.ndarray, "n 4 4"],
    limit: int,
    sharpness: Callable[[int], float] | None = None,
) -> list[int]:
    """Choose frames of a walk.

    All of them where they are no more than the limit; else the walk is divided into stretches of
    equal motion, and of each the sharpest frame is taken: at 30 Hz neighbors show the same, but
    for how blurred they are.

    Args:
        poses: Of all frames in the order of recording, camera to world.
        limit: How many to choose at most.
        sharpness: Of a frame; called by several threads. The middle of each stretch where
            nothing tells, the first and the last frame at the ends.

    Raises:
        InputError: The limit is below 1.
    """
    if limit < 1:
        raise InputError(f"max_frames is {limit}; at least 1 frame is needed")
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
    """Frames of stretches of equal motion, in order, and the middle frame of each.

    Stretches without a frame are left out; the first begins, the last ends in its middle.
    """
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turned = np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3])
    angles = np.arccos(np.clip((turned - 1) / 2, -1, 1))
    motion = np.minimum(moved / STEP + angles / TURN, 1.0)  # a jump shows one new place, not many
    whole = float(motion.sum())
    count = int(np.clip(np.ceil(DENSE * whole), min(FEWEST, limit), limit))
    steps = (1 - STILL) * motion / max(whole, 1e-9) + STILL / len(motion)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    place = way / way[-1] * (count - 1)
    stretch = np.round(place).astype(int)
    members = [np.flatnonzero(stretch == k) for k in np.unique(stretch)]
    off = np.abs(place - stretch)
    return [one.tolist() for one in members], [int(one[np.argmin(off[one])]) for one in members]


def sharpness_of(colors: Sequence[Path]) -> Callable[[int], float]:
    """How sharp images are, by their place in a sequence of files."""

    def sharpness(index: int) -> float:
        try:
            gray = read_small_gray(colors[index])
        except FileFormatError:  # found damaged again, and counted, where it is chosen
            return -np.inf
        return laplacian_variance(gray)

    return sharpness


def laplacian_variance(gray: Float[np.ndarray, "h w"]) -> float:
    """Variance of the Laplacian of an image: small where it is blurred."""
    if min(gray.shape) < 3:
        return 0.0
    middle = gray[1:-1, 1:-1]
    around = gray[:-2, 1:-1] + gray[2:, 1:-1] + gray[1:-1, :-2] + gray[1:-1, 2:]
    return float((around - 4 * middle).var())
