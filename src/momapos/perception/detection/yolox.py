"""A detector of COCO's classes from an ONNX file, in the layout of YOLOX (Ge et al., 2021).

Input (1, 3, height, width): BGR from 0 to 255, the image scaled to fit and padded with grey at its
right and bottom. Output (1, cells, 5 + classes): of each cell of three grids the box's middle
relative to the cell, the logarithm of its size, whether there is anything, and what.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import FileFormatError, InputError, read_bytes_bounded, require
from momapos.model.records import ImageDetection

from .coco import COCO80, LABELS, label_of_class

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8

MAX_BYTES = 500_000_000
"""Files larger than this are refused [B]."""
STRIDES = (8, 16, 32)
"""Edges of the cells of the three grids [px]."""
PADDING = 114
"""Grey around an image of other proportions."""
LARGEST_INPUT = 2048
"""Of a network's input [px]."""


class YoloxDetector:
    """A `Detector` from an ONNX file.

    Args:
        path: The file.
        score: Detections that are less sure are left out [-].
        overlap: Of two boxes of one class that overlap more than this (IoU) the weaker goes [-].

    Raises:
        FileFormatError: It is no ONNX file, or the network of another layout or other classes.
        InputError: A threshold is out of range.
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self, path: Path, *, score: float = 0.2, overlap: float = 0.45) -> None:
        if not (0 < score < 1 and 0 < overlap <= 1):
            raise InputError(f"thresholds must be between 0 and 1, not {score:g} and {overlap:g}")
        self.path, self.score, self.overlap = Path(path), score, overlap
        self._session = _open(self.path)
        self._input, self.size = _check(self._session, self.path)
        self._centers, self._strides = _cells(self.size)

    @property
    def labels(self) -> frozenset[str]:
        return LABELS

    def __call__(self, color: UInt8[np.ndarray, "h w 3"]) -> list[ImageDetection]:
        """Find the things of a room in an upright image; may be called by several threads."""
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
    """An image as the network takes it, and by what it was scaled.

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
    """Boxes (left, top, right, bottom) in the network's pixels, scores, and classes.

    Args:
        rows: What the network says of each cell.
        centers: Corners of the cells, counted in cells.
        strides: Edges of the cells [px].
        least: Smallest score that counts [-].
    """
    possible = rows[:, 4] > least  # a product is no larger than its factors
    rows, centers, strides = rows[possible], centers[possible], strides[possible]
    scores = rows[:, 4:5] * rows[:, 5:]
    classes = scores.argmax(axis=1)
    best = scores[np.arange(len(scores)), classes]
    sure = best > least
    middle = (rows[sure, :2] + centers[sure]) * strides[sure]
    # Sizes beyond the largest input are no boxes; what damaged weights say must not overflow.
    half = np.exp(np.minimum(rows[sure, 2:4], np.log(LARGEST_INPUT))) * strides[sure] / 2
    boxes = np.hstack([middle - half, middle + half])
    return boxes.astype(float), best[sure].astype(float), classes[sure]


def suppress(
    boxes: Float[np.ndarray, "n 4"],
    scores: Float[np.ndarray, " n"],
    classes: Int[np.ndarray, " n"],
    most: float,
) -> Int[np.ndarray, " k"]:
    """Indices of the boxes to keep, the surest first: non-maximum suppression in each class."""
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
    """Corners and edges of the cells of all grids, in the network's order."""
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
    options.log_severity_level = 4  # what is wrong is told in one line of ours
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common class of its errors
        raise FileFormatError(f"{path}: is no ONNX network that can be read ({error})") from error


def _check(session: Any, path: Path) -> tuple[str, tuple[int, int]]:
    """The name of the input, and its height and width.

    Raises:
        FileFormatError: It takes or gives something else.
    """
    inputs, outputs = session.get_inputs(), session.get_outputs()
    wanted = (
        "a detector in the layout of YOLOX takes one float image (1, 3, height, width) and "
        f"gives (1, cells, {5 + len(COCO80)}) for the {len(COCO80)} classes of COCO"
    )
    shapes = [tuple(one.shape) for one in (*inputs, *outputs)]
    said = f"{path}: takes and gives {', '.join(map(str, shapes[:6]))}; {wanted}"
    if len(inputs) != 1 or len(outputs) != 1 or inputs[0].type != "tensor(float)":
        raise FileFormatError(said)
    taken, given = shapes
    fixed = len(taken) == 4 and all(isinstance(edge, int) for edge in taken)
    if not fixed or taken[:2] != (1, 3):
        raise FileFormatError(said)
    height, width = taken[2:]
    if not all(0 < edge <= LARGEST_INPUT and edge % STRIDES[-1] == 0 for edge in (height, width)):
        raise FileFormatError(f"{said}; edges are multiples of 32 up to {LARGEST_INPUT}")
    cells = sum((height // stride) * (width // stride) for stride in STRIDES)
    if given != (1, cells, 5 + len(COCO80)):
        raise FileFormatError(said)
    return inputs[0].name, (height, width)
