"""Finds doors, drawers and handles on a face with two small networks, trained on our own images.

The first looks at the whole face and proposes parts; the second looks at each of them again, in
full resolution, and says where its edges are, how it opens, where its handle is, or that it is
none. Both were trained on drawn faces only; `training/fronts` holds everything to repeat it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, require
from momapos.model.records import FaceImage, Front, Part

from . import decode
from .bars import by_bars, with_bar
from .drawer_handles import into_drawers
from .free_bars import told_by_bars
from .stacks import opening_alike

if TYPE_CHECKING:
    from jaxtyping import Float, Float32

FIRST_SHARE = 0.75
"""Weight of the first look in a part's score, a weighted geometric mean [-]."""


@dataclass(frozen=True)
class FrontNetworkConfig:
    """When the networks are believed."""

    most: int = 20
    """Largest number of proposals that are looked at again [-]."""
    part: float = 0.27
    """Confidence from which on a proposal is a part [-]; chosen on drawn faces."""
    front: float = 0.5
    """Probability that a face is a front from which on handles alone tell parts of it [-]."""
    handle: float = 0.5
    """Probability from which on a part has a handle [-]."""
    overlap: float = 0.4
    """Common area, as a share of the smaller, from which on the weaker of two parts goes [-]."""


class FrontNetwork:
    """An `ArticulationPredictor` that needs no download and no graphics card.

    Raises:
        MissingExtraError: onnxruntime is not installed.
    """

    def __init__(self, config: FrontNetworkConfig | None = None) -> None:
        for name in ("face", "part"):
            _session(name)
        self.config = config or FrontNetworkConfig()

    def __call__(self, face: FaceImage, label: str) -> Front:  # noqa: ARG002
        """Find the parts of a face.

        Args:
            face: The face, seen straight on. A height map helps where there is one.
            label: Class of the object; what is seen counts, so that a wrong label does no harm.

        Returns:
            Parts, the surest first, disjoint but for a rim, and whether the face is a front.

        Raises:
            InputError: The image is empty, or height map and color differ in size.
        """
        height, width = face.color.shape[:2]
        if min(height, width) < 2 or face.height_map.shape != (height, width):
            raise InputError(
                f"a face of {width} x {height} px with a height map of "
                f"{face.height_map.shape} cannot be looked at; "
                "give color and height map of one size, at least 2 x 2 px"
            )
        stack = decode.planes(face)
        whole = decode.resample(stack, np.array([0.0, 0.0, 1.0, 1.0]), decode.FACE_PIXELS)
        heat, reach, front = _look_at_face(whole[None])
        # A cooler cell cannot become a part, however sure the second look is.
        floor = self.config.part ** (1 / FIRST_SHARE)
        boxes, kinds = decode.peaks(heat[0], reach[0], floor, self.config.most)
        if len(boxes):
            kept = decode.distinct(boxes, kinds.max(axis=1), 0.7, nested=False)
            boxes, kinds = boxes[kept], kinds[kept]
        parts = self._parts(face, stack, boxes, kinds)
        if front[0] >= self.config.front:
            parts = (*parts, *told_by_bars(face, parts))
        return Front(float(front[0]), _by_handles(face, stack, parts))

    def _parts(
        self,
        face: FaceImage,
        stack: np.ndarray,
        boxes: Float[np.ndarray, "n 4"],
        kinds: Float[np.ndarray, "n k"],
    ) -> tuple[Part, ...]:
        """Look at each proposal again."""
        if not len(boxes):
            return ()
        outer = decode.widened(boxes, decode.PART_MARGIN)
        crops = np.stack([decode.resample(stack, box, decode.PART_PIXELS) for box in outer])
        size = outer[:, 2:] - outer[:, :2]
        aspect = np.log(size[:, 0] * face.width / (size[:, 1] * face.height))
        sure, edges, held, heat, reach = _look_at_parts(crops, aspect[:, None].astype(np.float32))
        found = np.clip(decode.in_face(edges.astype(float), outer), 0.0, 1.0)
        handles = np.stack([decode.handle_box(*pair) for pair in zip(heat, reach, strict=True)])
        handles = decode.in_face(handles, outer)
        # The whole face knows the neighbors, the crop knows the handle: both have a say.
        share = sure[:, :-1] / np.maximum(sure[:, :-1].sum(axis=1, keepdims=True), 1e-9)
        vote = np.log(share + 1e-3) + np.log(kinds + 1e-3)
        # Each look alone is often wrongly sure, hardly ever both at once. The first knows the
        # neighbors; what the second doubts is mostly a plain door without a handle.
        score = (1.0 - sure[:, -1]) ** (1 - FIRST_SHARE) * kinds.max(axis=1) ** FIRST_SHARE
        broad = (found[:, 2:] - found[:, :2] > decode.LEAST_SIDE).all(axis=1)
        good = np.nonzero(broad & (score > self.config.part))[0]
        if not len(good):
            return ()
        # Of two that overlap, both looks decide alike: the second tells a door from its panel.
        rank = (1.0 - sure[good, -1]) * kinds[good].max(axis=1)
        good = good[decode.distinct(found[good], rank, self.config.overlap, nested=True)]
        good = good[np.argsort(-score[good], kind="stable")]
        return tuple(
            decode.part(
                vote[i].astype(float),
                found[i],
                float(score[i]),
                handles[i] if held[i] > self.config.handle else None,
            )
            for i in good
        )


def _by_handles(
    face: FaceImage, stack: Float32[np.ndarray, "h w 7"], parts: Sequence[Part]
) -> tuple[Part, ...]:
    """Parts, divided and told apart by the handles on them."""
    upright, level = stack[..., decode.UPRIGHT], stack[..., decode.LEVEL]
    drawers = into_drawers(face, parts, level)
    divided = by_bars(face, drawers, upright, level)
    alike = opening_alike(face, [with_bar(face, part) for part in divided])
    return tuple(decode.doubted(part) for part in alike)


def _look_at_face(face: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the first network says of faces, on average with what it says of them in a mirror.

    Left and right doors look alike but for their handles: a network that favors one side would
    be wrong half of the time, the mean of both looks favors none.
    """
    run = _session("face").run
    heat, reach, front = run(None, {"face": face})
    other = run(None, {"face": np.ascontiguousarray(face[..., ::-1])})
    heat = (heat + other[0][:, decode.MIRRORED_KINDS[:-1], :, ::-1]) / 2
    reach = (reach + other[1][:, decode.MIRRORED_SIDES, :, ::-1]) / 2
    return heat, reach, (front + other[2]) / 2


def _look_at_parts(crops: np.ndarray, aspect: np.ndarray) -> tuple[np.ndarray, ...]:
    """What the second network says of crops, on average with what it says in a mirror."""
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
    """One of the two networks, read once in a process."""
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
