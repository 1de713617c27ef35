"""Find doors, drawers and handles on a face with two small networks, trained on our own images.

The first network sees the whole face and proposes parts. The second sees each proposal in full
resolution and returns its edges, its kind, its handle, or rejects it. Both were trained on drawn
faces only; see `training/fronts`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, require
from momapos.model.records import FaceImage, Front, Part

from . import decode
from .bars import divided_by_bars, with_bar
from .drawer_handles import into_drawers
from .free_bars import parts_from_bars
from .stacks import weigh_stacks

if TYPE_CHECKING:
    from jaxtyping import Float, Float32

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
