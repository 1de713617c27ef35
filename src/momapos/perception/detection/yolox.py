"""Detect COCO's classes with an ONNX file in the layout of YOLOX (Ge et al., 2021).

Input (1, 3, height, width): BGR from 0 to 255, the image scaled to fit and padded with gray at its
right and bottom. Output (1, cells, 5 + classes): for each cell of three grids the box's center
relative to the cell, the logarithm of its size, the objectness, and the class scores.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError, InputError, in_threads, read_bytes_bounded, require
from momapos.model.records import Detector, Frame, ImageDetection

from .coco import COCO80, LABELS, label_of_class

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8


MAX_BYTES = 500_000_000
"""Larger files are refused [B]."""
STRIDES = (8, 16, 32)
"""Edge lengths of the cells of the three grids [px]."""
PADDING = 114
"""Gray value around an image of another aspect ratio."""
MAX_INPUT = 2048
"""Edge length of a network's input [px]."""


class YoloxDetector:
    """A `Detector` from an ONNX file.

    Args:
        path: The file.
        score: Minimum score of a detection [-].
        overlap: Of two boxes of one class with a larger IoU, the weaker is dropped [-].

    Raises:
        FileFormatError: It is not an ONNX file, or has another layout or other classes.
        InputError: A threshold is out of range.
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self, path: Path, *, score: float = 0.2, overlap: float = 0.45) -> None:
        if not (0 < score < 1 and 0 < overlap <= 1):
            raise InputError(
                f"score and overlap must be between 0 and 1, not {score:g} and {overlap:g}"
            )
        self.path, self.score, self.overlap = Path(path), score, overlap
        self._session = _open(self.path)
        self._input, self.size = _check(self._session, self.path)
        self._centers, self._strides = _cells(self.size)

    @property
    def labels(self) -> frozenset[str]:
        return LABELS

    def __call__(self, color: UInt8[np.ndarray, "h w 3"]) -> list[ImageDetection]:
        """Detect the objects of a room in an upright image; may be called by several threads."""
        padded, scale = letterbox(color, self.size)
        (rows,) = self._session.run(None, {self._input: padded})
        boxes, scores, classes = decode(rows[0], self._centers, self._strides, self.score)
        kept = suppress(boxes, scores, classes, self.overlap)
        height, width = color.shape[:2]
        limits = np.array([width, height, width, height], float)
        boxes = np.clip(boxes[kept] / scale, 0, limits)
        return [
            ImageDetection((float(box[0]), float(box[1]), float(box[2]), float(box[3])), label, one)
            for box, one, index in zip(
                boxes, scores[kept].tolist(), classes[kept].tolist(), strict=True
            )
            if (label := label_of_class(index)) and box[2] > box[0] and box[3] > box[1]
        ]


def letterbox(
    color: UInt8[np.ndarray, "h w 3"], size: tuple[int, int]
) -> tuple[Float[np.ndarray, "1 3 y x"], float]:
    """Return an image as the network's input, and its scale.

    Args:
        color: RGB.
        size: Height and width of the network's input [px].
    """
    from PIL import Image

    height, width = color.shape[:2]
    scale = min(size[0] / height, size[1] / width)
    to = max(1, int(width * scale)), max(1, int(height * scale))
    scaled = np.asarray(Image.fromarray(color).resize(to, Image.Resampling.BILINEAR))
    padded = np.full((1, 3, *size), PADDING, np.float32)
    padded[0, :, : to[1], : to[0]] = scaled[..., ::-1].transpose(2, 0, 1)
    return padded, scale


def decode(
    rows: Float[np.ndarray, "cells columns"],
    centers: Float[np.ndarray, "cells 2"],
    strides: Float[np.ndarray, "cells 1"],
    least: float,
) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return boxes (left, top, right, bottom) in the network's pixels, scores, and classes.

    Args:
        rows: Output of the network for each cell.
        centers: Corners of the cells, in cells.
        strides: Edge lengths of the cells [px].
        least: Minimum score [-].
    """
    possible = rows[:, 4] > least  # a product is no larger than its factors
    rows, centers, strides = rows[possible], centers[possible], strides[possible]
    scores = rows[:, 4:5] * rows[:, 5:]
    classes = scores.argmax(axis=1)
    best = scores[np.arange(len(scores)), classes]
    sure = best > least
    middle = (rows[sure, :2] + centers[sure]) * strides[sure]
    # Sizes beyond the largest input are not boxes; the output of damaged weights must not overflow.
    half = np.exp(np.minimum(rows[sure, 2:4], np.log(MAX_INPUT))) * strides[sure] / 2
    boxes = np.hstack([middle - half, middle + half])
    return boxes.astype(float), best[sure].astype(float), classes[sure]


def suppress(
    boxes: Float[np.ndarray, "n 4"],
    scores: Float[np.ndarray, " n"],
    classes: Int[np.ndarray, " n"],
    most: float,
) -> Int[np.ndarray, " k"]:
    """Return the indices of the kept boxes, best first: non-maximum suppression per class."""
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    order = np.argsort(-scores, kind="stable")
    kept = []
    while len(order):
        first, rest = order[0], order[1:]
        kept.append(int(first))
        low = np.maximum(boxes[first, :2], boxes[rest, :2])
        high = np.minimum(boxes[first, 2:], boxes[rest, 2:])
        both = np.prod(np.maximum(high - low, 0), axis=1)
        share = both / np.maximum(area[first] + area[rest] - both, 1e-9)
        order = rest[(share <= most) | (classes[rest] != classes[first])]
    return np.array(kept, int)


def _cells(
    size: tuple[int, int],
) -> tuple[Float[np.ndarray, "cells 2"], Float[np.ndarray, "cells 1"]]:
    """Return the corners and edge lengths of the cells of all grids, in the network's order."""
    corners, strides = [], []
    for stride in STRIDES:
        y, x = np.mgrid[: size[0] // stride, : size[1] // stride]
        corners.append(np.stack([x, y], -1).reshape(-1, 2))
        strides.append(np.full((x.size, 1), stride))
    return np.concatenate(corners).astype(np.float32), np.concatenate(strides).astype(np.float32)


def _open(path: Path) -> Any:
    with require("scan"):
        import onnxruntime
    data = read_bytes_bounded(path, MAX_BYTES)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # the error below is enough
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common error class
        raise FileFormatError(f"{path}: not a readable ONNX network ({error})") from error


def _check(session: Any, path: Path) -> tuple[str, tuple[int, int]]:
    """Return the name, height and width of the input.

    Raises:
        FileFormatError: Input or output have another shape.
    """
    inputs, outputs = session.get_inputs(), session.get_outputs()
    wanted = (
        "a detector in the layout of YOLOX takes one float image (1, 3, height, width) and "
        f"returns (1, cells, {5 + len(COCO80)}) for the {len(COCO80)} classes of COCO"
    )
    shapes = [tuple(one.shape) for one in (*inputs, *outputs)]
    message = f"{path}: input and output are {', '.join(map(str, shapes[:6]))}; {wanted}"
    if len(inputs) != 1 or len(outputs) != 1 or inputs[0].type != "tensor(float)":
        raise FileFormatError(message)
    taken, given = shapes
    fixed = len(taken) == 4 and all(isinstance(edge, int) for edge in taken)
    if not fixed or taken[:2] != (1, 3):
        raise FileFormatError(message)
    height, width = taken[2:]
    if not all(0 < edge <= MAX_INPUT and edge % STRIDES[-1] == 0 for edge in (height, width)):
        raise FileFormatError(f"{message}; edges are multiples of 32 up to {MAX_INPUT}")
    cells = sum((height // stride) * (width // stride) for stride in STRIDES)
    if given != (1, cells, 5 + len(COCO80)):
        raise FileFormatError(message)
    return inputs[0].name, (height, width)


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

    results = in_threads(look, frames)
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
