"""Find doors, drawers and handles on a face with two small networks, trained on our own images.

The first network sees the whole face and proposes parts. The second sees each proposal in full
resolution and returns its edges, its kind, its handle, or rejects it. Both were trained on drawn
faces only; see `training/fronts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, require
from momapos.model.records import FaceImage, Front, Part, PartKind

from . import decode
from .bars import divided_by_bars, into_drawers, parts_from_bars, with_bar
from .height_maps import Area, area_of

if TYPE_CHECKING:
    from jaxtyping import Float, Float32


LEVEL_KINDS: tuple[PartKind, ...] = ("drawer", "door_down")
"""Kinds with a level bar near the top."""
MAX_MISALIGNMENT = 0.04
"""Sides of one stack are in line, and its parts meet, within this [m]."""
MAX_PLACE_DIFFERENCE = 0.05
"""Between the distances of handles from the tops of their parts [m]."""
MAX_LENGTH_RATIO = 1.25
"""Between the lengths of handles [-]."""
DRAWER_PRIOR = 100.0
"""Prior odds of drawers to flaps in a stack [-]."""
MAX_ODDS_RATIO = 1000.0
"""Parts whose odds of being a drawer differ by more are not similar [-]."""
MIN_PROBABILITY = 1e-4
"""Lower bound of the probability of a kind [-]."""
MAX_HEIGHT = 0.42
"""The prior applies if one part is lower than this: doors of two ovens are stacked, too [m]."""


def weigh_stacks(face: FaceImage, parts: Sequence[Part]) -> tuple[Part, ...]:
    """Weigh the odds of similar stacked parts together: all drawers, or all flaps.

    A single flap looks like a drawer with a handle at its top. In a stack it is rarely a flap,
    unless the networks are confident about each part, as for two ovens. The odds of similar parts
    are the same evidence, so they count once, as their geometric mean.

    Args:
        face: The face.
        parts: Parts on it; parts without odds stay unchanged.
    """
    found = list(parts)
    for stack in _stacks(face, parts):
        odds = [dict(parts[k].odds) for k in stack]
        if len(stack) < 2 or _is_mixed(odds):
            continue
        drawers, flaps = (
            float(np.prod([each.get(kind, 0.0) for each in odds]) ** (1.0 / len(stack)))
            for kind in LEVEL_KINDS
        )
        low = min(area_of(parts[k].box, face).height for k in stack) < MAX_HEIGHT
        drawers *= DRAWER_PRIOR if low else 1.0
        if drawers + flaps <= 0.0:
            continue
        share = drawers / (drawers + flaps)
        for k, each in zip(stack, odds, strict=True):
            both = each.get("drawer", 0.0) + each.get("door_down", 0.0)
            new = {**each, "drawer": share * both, "door_down": (1.0 - share) * both}
            ranked = decode.ranked(new)
            found[k] = replace(parts[k], kind=ranked[0][0], odds=ranked)
    return tuple(found)


def _is_mixed(odds: Sequence[Mapping[PartKind, float]]) -> bool:
    """Check whether one part is clearly a drawer and another clearly a flap, like an oven above its
    drawer, which have similar handles."""
    ratios = [
        max(each.get("drawer", 0.0), MIN_PROBABILITY)
        / max(each.get("door_down", 0.0), MIN_PROBABILITY)
        for each in odds
    ]
    return max(ratios) > MAX_ODDS_RATIO * min(ratios)


def _stacks(face: FaceImage, parts: Sequence[Part]) -> list[list[int]]:
    areas = [area_of(part.box, face) for part in parts]
    grips = [None if part.handle is None else area_of(part.handle, face) for part in parts]
    stacks: list[list[int]] = []
    for k in np.argsort([area.bottom for area in areas], kind="stable").tolist():
        if parts[k].kind not in LEVEL_KINDS or grips[k] is None:
            continue
        for stack in stacks:
            last = stack[-1]
            if _is_similar(areas[last], grips[last], areas[k], grips[k]):
                stack.append(k)
                break
        else:
            stacks.append([k])
    return stacks


def _is_similar(low: Area, one: Area | None, high: Area, other: Area | None) -> bool:
    if one is None or other is None:
        return False
    in_line = max(abs(low.left - high.left), abs(low.right - high.right)) < MAX_MISALIGNMENT
    below_top = [area.top - (bar.bottom + bar.top) / 2 for area, bar in ((low, one), (high, other))]
    lengths = sorted((one.width, other.width))
    return (
        in_line
        and abs(low.top - high.bottom) < MAX_MISALIGNMENT
        and abs(below_top[0] - below_top[1]) < MAX_PLACE_DIFFERENCE
        and lengths[1] < MAX_LENGTH_RATIO * lengths[0]
    )


FIRST_SHARE = 0.75
"""Weight of the first network in a part's score, a weighted geometric mean [-]."""
MAX_PROPOSALS = 20
"""Maximum number of proposals for the second network [-]."""
MIN_PART_SCORE = 0.27
"""Minimum score of a part [-]; chosen on drawn faces."""
MIN_FRONT_PROBABILITY = 0.5
"""Minimum probability of a front for parts to be added from handles alone [-]."""
MIN_HANDLE_PROBABILITY = 0.5
"""Minimum probability of a handle [-]."""
MAX_OVERLAP = 0.4
"""From this common area, relative to the smaller part, the weaker part is dropped [-]."""


class FrontNetwork:
    """An `ArticulationPredictor` that needs no download and no graphics card.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self) -> None:
        for name in ("face", "part"):
            _session(name)

    def __call__(self, face: FaceImage, label: str) -> Front:  # noqa: ARG002
        """Find the parts of a face.

        Args:
            face: The face, seen straight on. A height map helps if there is one.
            label: Ignored; the result depends on the image alone.

        Returns:
            Parts, the most confident first, disjoint except for a rim; and the front score.

        Raises:
            InputError: The image is empty, or height map and color differ in size.
        """
        height, width = face.color.shape[:2]
        if min(height, width) < 2 or face.height_map.shape != (height, width):
            raise InputError(
                f"the face has {width} x {height} px and a height map of shape "
                f"{face.height_map.shape}; color and height map must have one size of at least "
                "2 x 2 px"
            )
        stack = decode.planes(face)
        whole = decode.resample(stack, np.array([0.0, 0.0, 1.0, 1.0]), decode.FACE_PIXELS)
        heat, reach, front = _run_on_face(whole[None])
        # A weaker cell cannot become a part, whatever the second network returns.
        floor = MIN_PART_SCORE ** (1 / FIRST_SHARE)
        boxes, kinds = decode.peaks(heat[0], reach[0], floor, MAX_PROPOSALS)
        if len(boxes):
            kept = decode.distinct(boxes, kinds.max(axis=1), 0.7, nested=False)
            boxes, kinds = boxes[kept], kinds[kept]
        parts = self._parts(face, stack, boxes, kinds)
        if front[0] >= MIN_FRONT_PROBABILITY:
            parts = (*parts, *parts_from_bars(face, parts))
        return Front(float(front[0]), _by_handles(face, stack, parts))

    def _parts(
        self,
        face: FaceImage,
        stack: np.ndarray,
        boxes: Float[np.ndarray, "n 4"],
        kinds: Float[np.ndarray, "n k"],
    ) -> tuple[Part, ...]:
        """Run the second network on each proposal."""
        if not len(boxes):
            return ()
        outer = decode.widened(boxes, decode.PART_MARGIN)
        crops = np.stack([decode.resample(stack, box, decode.PART_PIXELS) for box in outer])
        size = outer[:, 2:] - outer[:, :2]
        aspect = np.log(size[:, 0] * face.width / (size[:, 1] * face.height))
        sure, edges, held, heat, reach = _run_on_parts(crops, aspect[:, None].astype(np.float32))
        found = np.clip(decode.in_face(edges.astype(float), outer), 0.0, 1.0)
        handles = np.stack([decode.handle_box(*pair) for pair in zip(heat, reach, strict=True)])
        handles = decode.in_face(handles, outer)
        # The first network sees the neighbors, the second the handle: their votes are combined.
        share = sure[:, :-1] / np.maximum(sure[:, :-1].sum(axis=1, keepdims=True), 1e-9)
        vote = np.log(share + 1e-3) + np.log(kinds + 1e-3)
        # Each network alone is often overconfident, rarely both at once. The second mostly doubts
        # plain doors without a handle.
        score = (1.0 - sure[:, -1]) ** (1 - FIRST_SHARE) * kinds.max(axis=1) ** FIRST_SHARE
        broad = (found[:, 2:] - found[:, :2] > decode.MIN_SIDE).all(axis=1)
        good = np.nonzero(broad & (score > MIN_PART_SCORE))[0]
        if not len(good):
            return ()
        # Overlaps are resolved by both equally: the second network tells a door from its panel.
        rank = (1.0 - sure[good, -1]) * kinds[good].max(axis=1)
        good = good[decode.distinct(found[good], rank, MAX_OVERLAP, nested=True)]
        good = good[np.argsort(-score[good], kind="stable")]
        return tuple(
            decode.part(
                vote[i].astype(float),
                found[i],
                float(score[i]),
                handles[i] if held[i] > MIN_HANDLE_PROBABILITY else None,
            )
            for i in good
        )


def _by_handles(
    face: FaceImage, stack: Float32[np.ndarray, "h w 7"], parts: Sequence[Part]
) -> tuple[Part, ...]:
    upright, level = stack[..., decode.UPRIGHT], stack[..., decode.LEVEL]
    drawers = into_drawers(face, parts, level)
    divided = divided_by_bars(face, drawers, upright, level)
    alike = weigh_stacks(face, [with_bar(face, part) for part in divided])
    return tuple(decode.with_doubt(part) for part in alike)


def _run_on_face(face: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run the first network on faces and their mirror images, and average the results.

    Left and right doors look alike except for their handles. A network that favors one side would
    be wrong half of the time; the average favors none.
    """
    run = _session("face").run
    heat, reach, front = run(None, {"face": face})
    other = run(None, {"face": np.ascontiguousarray(face[..., ::-1])})
    heat = (heat + other[0][:, decode.MIRRORED_KINDS[:-1], :, ::-1]) / 2
    reach = (reach + other[1][:, decode.MIRRORED_SIDES, :, ::-1]) / 2
    return heat, reach, (front + other[2]) / 2


def _run_on_parts(crops: np.ndarray, aspect: np.ndarray) -> tuple[np.ndarray, ...]:
    """Run the second network on crops and their mirror images, and average the results."""
    run = _session("part").run
    sure, edges, held, heat, reach = run(None, {"crop": crops, "aspect": aspect})
    other = run(None, {"crop": np.ascontiguousarray(crops[..., ::-1]), "aspect": aspect})
    sure = (sure + other[0][:, decode.MIRRORED_KINDS]) / 2
    edges = (edges + decode.mirrored(other[1])) / 2
    heat = (heat + other[3][..., ::-1]) / 2
    reach = (reach + other[4][:, decode.MIRRORED_SIDES, :, ::-1]) / 2
    return sure, edges, (held + other[2]) / 2, heat, reach


@cache
def _session(name: str) -> Any:
    with require("scan"):
        import onnxruntime
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    weights = (
        resources.files("momapos.perception.reconstruction") / "weights" / f"front_{name}.onnx"
    )
    return onnxruntime.InferenceSession(
        weights.read_bytes(), options, providers=["CPUExecutionProvider"]
    )
