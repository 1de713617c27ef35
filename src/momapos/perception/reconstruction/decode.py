"""Prepare a face for the networks of `front_network.py`, and convert their outputs to parts.

All boxes are (left, top, right, bottom) as fractions of the face, y down.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from momapos.core.geometry import dark_lines
from momapos.model.records import FaceImage, Part, PartKind

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int

KINDS: tuple[PartKind, ...] = ("door_left", "door_right", "door_down", "door_up", "drawer")
FACE_PIXELS = 192
"""Input size of the first network [px]."""
PART_PIXELS = 128
"""Input size of the second network [px]."""
MIRRORED_KINDS = (1, 0, 2, 3, 4, 5)
"""Index of each kind in a mirror image; the last is no part."""
MIRRORED_SIDES = (2, 1, 0, 3)
"""Left, top, right, bottom in a mirror image."""
PART_MARGIN = 0.15
"""Margin of a crop on each side of a part, as a fraction of its side [-]."""
UPRIGHT, LEVEL = 5, 6
"""Indices of the planes with upright and level dark lines."""
RULE_CONFIDENCE = 0.9
"""Probability that a rule tells correctly how a part opens [-]."""
DOUBT = 0.06
"""Share of parts that open otherwise than the networks predict: 5 of the 78 parts that were found
on the fronts of simulator objects [-]."""
MIN_SIDE = 0.01
"""Minimum width and height of a part, as a share of its face [-]."""
HEIGHT_MAP_RANGE = 0.08
"""Heights are clipped to this distance from their median [m]; handles are lower."""


def planes(face: FaceImage) -> Float32[np.ndarray, "h w 7"]:
    """Stack the input planes of the networks, each in about [-2, 2].

    Color; the height map about its median, since the plane of a box is not always that of its
    fronts; whether the height was measured; upright and level dark lines.
    """
    color = (face.color.astype(np.float32) - 127.5) / 64.0
    known = np.isfinite(face.height_map)
    middle = float(np.median(face.height_map[known])) if known.any() else 0.0
    off = np.clip(face.height_map - middle, -HEIGHT_MAP_RANGE, HEIGHT_MAP_RANGE)
    height_map = np.where(known, off, 0.0) / HEIGHT_MAP_RANGE
    lines = (dark_lines(face.color, axis) for axis in (1, 0))
    return np.stack(
        [*np.moveaxis(color, -1, 0), height_map, known, *lines], axis=-1, dtype=np.float32
    )


def resample(
    stack: Float32[np.ndarray, "h w c"], box: Float[np.ndarray, "4"], side: int
) -> Float32[np.ndarray, "c side side"]:
    """Crop a box from an image and resize it to a square, averaging where it shrinks.

    Pixels outside of the image repeat its border. The few weights per pixel are stored sparsely:
    a full matrix takes fifty times as long next to other work, for whose threads BLAS waits.
    """
    rows, weights_y = _taps(stack.shape[0], box[1], box[3], side)
    columns, weights_x = _taps(stack.shape[1], box[0], box[2], side)
    cut = stack[rows, columns]
    high = (weights_y @ cut.reshape(len(cut), -1)).reshape(side, cut.shape[1], -1)
    wide = weights_x @ high.transpose(1, 0, 2).reshape(cut.shape[1], -1)
    return np.ascontiguousarray(wide.reshape(side, side, -1).transpose(2, 1, 0))


def _taps(length: int, low: float, high: float, count: int) -> tuple[slice, csr_array]:
    """Return the weights of a triangle filter that samples [low, high] of a line of pixels."""
    step = max((high - low) * length / count, 1e-6)
    centers = low * length + (np.arange(count) + 0.5) * step - 0.5
    centers = np.clip(centers, 0.0, length - 1.0)
    reach = max(step, 1.0)
    first = int(np.clip(np.floor(centers[0] - reach), 0, length - 1))
    last = int(np.clip(np.ceil(centers[-1] + reach), first, length - 1))
    away = np.abs(np.arange(first, last + 1) - centers[:, None]) / reach
    weights = np.maximum(1.0 - away, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    return slice(first, last + 1), csr_array(weights.astype(np.float32))


def mirrored(boxes: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    """Return boxes mirrored left to right."""
    left, top, right, bottom = boxes.T
    return np.stack((1 - right, top, 1 - left, bottom), axis=1)


def widened(boxes: Float[np.ndarray, "n 4"], margin: float) -> Float[np.ndarray, "n 4"]:
    """Return boxes with a margin on each side, as a fraction of their sides."""
    size = boxes[:, 2:] - boxes[:, :2]
    return np.concatenate((boxes[:, :2] - margin * size, boxes[:, 2:] + margin * size), axis=1)


def peaks(
    heat: Float[np.ndarray, "k m m"],
    reach: Float[np.ndarray, "4 m m"],
    floor: float,
    most: int,
) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, "n k"]]:
    """Return the proposals of the first network, best first.

    Args:
        heat: Probability that a cell is the center of a part, by kind.
        reach: Distance from a cell's center to the left, top, right and bottom edge of its part.
        floor: Minimum probability of a center.
        most: Maximum number of proposals.

    Returns:
        Boxes, and the heat of each kind at their center.
    """
    best = heat.max(axis=0)
    padded = np.pad(best, 1)
    side = best.shape[0]
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
    row, column = np.nonzero((best >= around) & (best > floor))
    order = np.argsort(-best[row, column], kind="stable")[:most]
    row, column = row[order], column[order]
    center = np.stack((column, row), axis=1) / side + 0.5 / side
    edges = reach[:, row, column].T
    boxes = np.concatenate((center - edges[:, :2], center + edges[:, 2:]), axis=1)
    boxes = np.clip(boxes, 0.0, 1.0)
    sound = (boxes[:, 2:] - boxes[:, :2] > MIN_SIDE).all(axis=1)
    return boxes[sound], heat[:, row, column].T[sound]


def overlaps(
    a: Float[np.ndarray, "n 4"], b: Float[np.ndarray, "m 4"]
) -> tuple[Float[np.ndarray, "n m"], Float[np.ndarray, "n m"]]:
    """Return the intersection of all pairs over their union, and over the smaller of the two."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    common = np.clip(high - low, 0.0, None).prod(axis=-1)
    area_a = (a[:, 2:] - a[:, :2]).prod(axis=-1)[:, None]
    area_b = (b[:, 2:] - b[:, :2]).prod(axis=-1)[None, :]
    union = np.maximum(area_a + area_b - common, 1e-12)
    return common / union, common / np.maximum(np.minimum(area_a, area_b), 1e-12)


def distinct(
    boxes: Float[np.ndarray, "n 4"], scores: Float[np.ndarray, " n"], limit: float, *, nested: bool
) -> Int[np.ndarray, " m"]:
    """Keep the best of overlapping boxes.

    Args:
        boxes: The boxes.
        scores: Their scores.
        limit: From this overlap on, the weaker of two boxes is dropped.
        nested: Measure overlap relative to the smaller box instead of the union, so that a panel
            within a door is a duplicate.

    Returns:
        Indices of the kept boxes, best first.
    """
    common = overlaps(boxes, boxes)[1 if nested else 0]
    kept: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        if not kept or common[i, kept].max() < limit:
            kept.append(int(i))
    return np.array(kept, dtype=int)


def handle_box(
    heat: Float[np.ndarray, "m m"], reach: Float[np.ndarray, "4 m m"]
) -> Float[np.ndarray, "4"]:
    """Return the handle in a crop, as fractions of the crop: the best cell and its distances."""
    side = heat.shape[0]
    row, column = np.unravel_index(int(heat.argmax()), heat.shape)
    center = (np.array([column, row]) + 0.5) / side
    edges = reach[:, row, column]
    return np.concatenate((center - edges[:2], center + edges[2:]))


def in_face(inner: Float[np.ndarray, "n 4"], outer: Float[np.ndarray, "n 4"]) -> np.ndarray:
    """Convert boxes from fractions of other boxes to fractions of the face."""
    size = np.tile(outer[:, 2:] - outer[:, :2], 2)
    return np.tile(outer[:, :2], 2) + inner * size


def part(
    votes: Float[np.ndarray, " k"],
    box: Float[np.ndarray, "4"],
    score: float,
    handle: Float[np.ndarray, "4"] | None,
) -> Part:
    """Return a part, clipped to the face, with its handle clipped to the part.

    Args:
        votes: Log-odds of each kind.
        box: Box of the part.
        score: Score of the part.
        handle: Its handle.
    """
    held = None
    if handle is not None:
        low = np.clip(handle[:2], box[:2], box[2:])
        high = np.clip(handle[2:], box[:2], box[2:])
        if (high > low).all():
            held = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    left, top, right, bottom = (float(v) for v in box)
    share = np.exp(votes - votes.max())
    odds = ranked(dict(zip(KINDS, (share / share.sum()).tolist(), strict=True)))
    return Part(odds[0][0], (left, top, right, bottom), float(score), held, odds)


def with_kind(part: Part, kind: PartKind) -> Part:
    """Return a part with the kind that a rule gives; the previous odds share the rest."""
    if not part.odds:
        return replace(part, kind=kind)
    before = dict(part.odds)
    share = RULE_CONFIDENCE if kind != part.kind else max(RULE_CONFIDENCE, before[kind])
    rest = 1.0 - before.get(kind, 0.0)
    odds = {k: (1.0 - share) * p / rest if rest > 0 else 0.0 for k, p in before.items()}
    return replace(part, kind=kind, odds=ranked({**odds, kind: share}))


def with_doubt(part: Part) -> Part:
    """Return a part whose other kinds have a small probability, the same for each.

    The networks rule out what they have not seen, but after a failed attempt a robot needs other
    hypotheses.
    """
    if not part.odds:
        return part
    known = dict(part.odds)
    odds = {k: (1.0 - DOUBT) * known.get(k, 0.0) + DOUBT / len(KINDS) for k in KINDS}
    return replace(part, odds=ranked(odds))


def ranked(odds: dict[PartKind, float]) -> tuple[tuple[PartKind, float], ...]:
    """Return kinds and their probabilities, the most probable first."""
    return tuple(sorted(odds.items(), key=lambda pair: -pair[1]))
