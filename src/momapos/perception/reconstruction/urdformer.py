"""Predict parts of a front with URDFormer (Chen et al., 2024), given its weights and part boxes.

URDFormer does not detect parts. It takes their boxes in the image, and returns for each box the
part's class, its parent, and its place on a grid of 13 marks over the front. Its frame has x out of
the front, y to the right along the width and z up, from the lower left corner.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, require
from momapos.model.records import ArticulationPredictor, FaceImage, Front, Part

from .checkpoint import load_weights, read_checkpoint
from .urdformer_format import (
    BASES,
    HANDLES,
    IMAGE,
    KINDS,
    PARTS,
    SLOTS,
    STEPS,
    Logits,
    Network,
    Rectangle,
    around,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8

_LOG = logging.getLogger(__name__)
OVEN_HANDLE = (6, 10)
"""Place of an oven door's handle in the authors' code, whatever the network returns."""
_ON_BASE, _NOWHERE = -1, -2
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)


@dataclass(frozen=True, eq=False)
class Prediction:
    """The most probable reading of the network's output, one entry per part box."""

    names: tuple[str, ...]
    """Out of PARTS."""
    start: Int[np.ndarray, "n 2"]
    """Marks along width and height at the start of the part, its hinge side first."""
    end: Int[np.ndarray, "n 2"]
    parents: Int[np.ndarray, " n"]
    """Index of the part it belongs to; -1 is the base, -2 an empty slot."""
    scores: Float[np.ndarray, " n"]
    """Probability of the class, in [0, 1]."""
    base: str
    """Out of BASES."""


class UrdformerPredictor:
    """URDFormer as an `ArticulationPredictor`, for part boxes from another source."""

    def __init__(
        self, network: Network, boxes: ArticulationPredictor | Float[np.ndarray, "n 4"]
    ) -> None:
        """Combine the network with a source of part boxes.

        Args:
            network: From `load_urdformer`.
            boxes: Predictor of parts and handles; or boxes (top, left, height, width) as fractions
                of the only face, from `read_part_boxes`.
        """
        self.network = network
        self.boxes = boxes

    def __call__(self, face: FaceImage, label: str) -> Front:
        """Predict the parts of a face; the front score comes from the source of the boxes."""
        score, boxes = self._find(face, label)
        if len(boxes) == 0:
            return Front(score, ())
        slots = np.zeros((SLOTS, 4), np.float32)
        slots[: len(boxes)] = boxes
        logits = self.network(prepare_image(face.color), slots)
        return Front(score, to_parts(decode(logits, len(boxes)), boxes))

    def _find(self, face: FaceImage, label: str) -> tuple[float, Float[np.ndarray, "n 4"]]:
        if isinstance(self.boxes, np.ndarray):
            if len(self.boxes) > SLOTS:
                raise InputError(f"URDFormer takes {SLOTS} part boxes, not {len(self.boxes)}")
            return 1.0, self.boxes
        front = self.boxes(face, label)
        boxes = boxes_of(front)
        if len(boxes) > SLOTS:
            _LOG.warning("%d part boxes; URDFormer uses the best %d", len(boxes), SLOTS)
        return front.score, boxes[:SLOTS]


def load_urdformer(path: Path) -> Network:
    """Load the network with the weights that its authors published as `part.pth`.

    Raises:
        FileFormatError: The file is not usable.
        MissingExtraError: torch is not installed.
    """
    weights = read_checkpoint(path)
    import torch

    from .urdformer_model import Urdformer

    net = Urdformer().eval()
    load_weights(net, weights, path)

    def network(
        image: Float32[np.ndarray, "3 h w"], boxes: Float32[np.ndarray, "slots 4"]
    ) -> Logits:
        with torch.inference_mode():
            outputs = net(torch.from_numpy(image), torch.from_numpy(boxes))
        return Logits(*(tensor.numpy() for tensor in outputs))

    return network


def prepare_image(color: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "3 224 224"]:
    """Resize an image to the square that the network was trained on.

    The aspect ratio may change. Pillow's bicubic filter is the one the authors used.

    Raises:
        MissingExtraError: Pillow is not installed.
    """
    with require("scan"):
        from PIL import Image
    small = Image.fromarray(color).resize((IMAGE, IMAGE), Image.Resampling.BICUBIC)
    normal = (np.asarray(small, np.float32) / 255.0 - _MEAN) / _DEVIATION
    return np.ascontiguousarray(normal.transpose(2, 0, 1))


def boxes_of(front: Front) -> Float[np.ndarray, "n 4"]:
    """Return parts and handles as (top, left, height, width), best parts first."""
    best = sorted(front.parts, key=lambda part: -part.score)
    found = [box for part in best for box in (part.box, part.handle) if box is not None]
    left, top, right, bottom = np.array(found, float).reshape(-1, 4).T
    return np.stack((top, left, bottom - top, right - left), axis=-1)


def decode(logits: Logits, count: int) -> Prediction:
    """Take the most probable entry of every output, for the first `count` slots."""
    part = logits.part[:count]
    odds = np.exp(part - part.max(axis=-1, keepdims=True))
    relations = logits.parent.shape[-1]
    parents = logits.parent[:count].reshape(count, -1).argmax(axis=-1) // relations - 1
    return Prediction(
        names=tuple(PARTS[index] for index in part.argmax(axis=-1)),
        start=logits.start[:count, 1:].argmax(axis=-1),
        end=logits.end[:count, 1:].argmax(axis=-1),
        parents=np.where(parents < count, parents, _NOWHERE),
        scores=(odds / odds.sum(axis=-1, keepdims=True)).max(axis=-1).astype(float),
        base=BASES[int(logits.base.argmax())],
    )


def to_parts(prediction: Prediction, boxes_yxhw: Float[np.ndarray, "n 4"]) -> tuple[Part, ...]:
    """Convert a prediction to parts of the face.

    Doors and drawers lie on the grid. Parts on other parts, and parts without width or height, are
    dropped. A handle or knob belongs to the part that the network names, at a mark of *that part's*
    grid; otherwise to the smallest part around its box. URDFormer's own handles all have one size;
    here a handle has the size of its box.

    Args:
        prediction: One entry per box.
        boxes_yxhw: Top, left, height, width of each box, as fractions of the face.
    """
    parts: dict[int, Part] = {}
    for index, name in enumerate(prediction.names):
        box = grid_rectangle(prediction.start[index], prediction.end[index])
        solid = box[0] < box[2] and box[1] < box[3]
        if name in KINDS and solid and prediction.parents[index] == _ON_BASE:
            parts[index] = Part(KINDS[name], box, float(prediction.scores[index]))
    held: dict[int, float] = {}
    for index, name in enumerate(prediction.names):
        if name not in HANDLES:
            continue
        center, size = _center_and_size(boxes_yxhw[index])
        owner = int(prediction.parents[index])
        if owner in parts:
            center = _handle_center(prediction, index, parts[owner])
        else:
            owner = _smallest_around(center, parts)
        score = float(prediction.scores[index])
        if owner in parts and score > held.get(owner, 0.0):
            held[owner] = score
            part = parts[owner]
            parts[owner] = Part(part.kind, part.box, part.score, around(center, size, part.box))
    return tuple(parts.values())


def grid_rectangle(start: Int[np.ndarray, "2"], end: Int[np.ndarray, "2"]) -> Rectangle:
    """Return the rectangle between two marks of the front's grid; heights count from below."""
    low, high = np.minimum(start, end) / (STEPS - 1), np.maximum(start, end) / (STEPS - 1)
    return float(low[0]), 1.0 - float(high[1]), float(high[0]), 1.0 - float(low[1])


def _handle_center(prediction: Prediction, index: int, part: Part) -> tuple[float, float]:
    """Return a handle's center on its part: marks along the width count from the hinge."""
    marks = prediction.start[index]
    if prediction.names[prediction.parents[index]] == "oven_door":
        marks = np.array(OVEN_HANDLE)
    across, up = (marks / (STEPS - 1)).tolist()
    left, top, right, bottom = part.box
    if part.kind == "door_right":
        across = 1.0 - across
    return left + across * (right - left), bottom - up * (bottom - top)


def _center_and_size(
    box_yxhw: Float[np.ndarray, "4"],
) -> tuple[tuple[float, float], tuple[float, float]]:
    top, left, height, width = box_yxhw.tolist()
    return (left + width / 2, top + height / 2), (width, height)


def _smallest_around(point: tuple[float, float], parts: Mapping[int, Part]) -> int:
    x, y = point
    areas = {
        index: (right - left) * (bottom - top)
        for index, (left, top, right, bottom) in ((i, part.box) for i, part in parts.items())
        if left <= x <= right and top <= y <= bottom
    }
    return min(areas, key=areas.__getitem__, default=_NOWHERE)
