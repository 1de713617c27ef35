"""Run a detector on all images of a scan, each rotated upright."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Detector, Frame, ImageDetection

if TYPE_CHECKING:
    from jaxtyping import Float

Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom [px]."""


def detect(frames: Sequence[Frame], detector: Detector) -> dict[str, list[ImageDetection]]:
    """Return the detections in all images, by frame name.

    Detectors are trained on upright images, but a phone is often held on its side.

    Args:
        frames: With poses in a world whose z points up.
        detector: Called by several threads.
    """

    def look(frame: Frame) -> list[ImageDetection]:
        turns = turns_to_upright(frame.T_world_camera)
        height, width = frame.color.shape[:2]
        return [
            ImageDetection(turned_back(item.box, turns, (width, height)), item.label, item.score)
            for item in detector(np.ascontiguousarray(np.rot90(frame.color, turns)))
        ]

    with ThreadPoolExecutor(max_workers=2) as pool:
        results = list(pool.map(look, frames))
    return {frame.name: result for frame, result in zip(frames, results, strict=True)}


def turns_to_upright(T_world_camera: Float[np.ndarray, "4 4"]) -> int:
    """Return the counterclockwise quarter turns that rotate an image upright."""
    right, down, _ = T_world_camera[2, :3]  # upward component of the camera's axes
    if max(abs(right), abs(down)) < 0.1:  # looking straight up or down
        return 0
    return int(np.round(np.arctan2(right, -down) / (np.pi / 2))) % 4


def turned_back(box: Rectangle, turns: int, size: tuple[int, int]) -> Rectangle:
    """Map a rectangle of a rotated image back to the original image.

    Args:
        box: In the rotated image.
        turns: Counterclockwise quarter turns of the rotation.
        size: Width and height of the original image [px].
    """
    left, top, right, bottom = box
    width, height = size
    if turns == 1:
        return width - bottom, left, width - top, right
    if turns == 2:
        return width - right, height - bottom, width - left, height - top
    if turns == 3:
        return top, height - right, bottom, height - left
    return box
