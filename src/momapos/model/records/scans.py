"""Records of perception: frames, clouds, detections and the parts of a front.

All values are in SI units, in the world frame unless a field names another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import compare_by_content
from momapos.core.geometry import UprightBox

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8


PartKind = Literal["door_left", "door_right", "door_down", "door_up", "drawer"]
"""How a part opens, as seen from the front: a `door_left` has its hinge on the left."""
LabelSource = Literal["size", "segmenter", "detector", "given"]
"""Source of an object's label: rules about its size, the segmenter, an image detector, the user."""
MIN_PROBABLE = 0.5
"""Probability of a joint motion from which on a plan for it is solved instead of assumed [-]."""
UNKNOWN: tuple[str, float] = ("object", 0.2)
"""Label and confidence of an unidentified object."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of a scan with its camera pose."""

    name: str
    color: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"] | None
    """Distance along the optical axis [m], 0 where not measured; None without a depth sensor."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Intrinsics of color and depth, which are registered [px]."""
    T_world_camera: Float[np.ndarray, "4 4"]
    """Camera axes as in OpenCV: x right, y down, z forward."""
    index: int | None = None
    """Index of the image in its recording, from which others may be left out; None if unknown."""

    def __repr__(self) -> str:
        height, width = self.color.shape[:2]
        depth = "no depth" if self.depth is None else "depth"
        return f"<Frame {self.name!r}: {width} x {height} pixels, {depth}>"


@dataclass(frozen=True, eq=False)
class Cloud:
    """Surface points."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit normals toward the observed side."""
    colors: UInt8[np.ndarray, "n 3"]
    rows: Int[np.ndarray, " file"] | None = None
    """Index of the point here for each point of its file, -1 if it has none: it is not finite, or
    was removed. Points of a large file share one. None if the cloud was not read."""
    origin: Float[np.ndarray, "3"] | None = None
    """Point of the file's frame that is the origin here, if the file's points are far away [m]."""

    def __repr__(self) -> str:
        return f"<Cloud: {len(self.points)} points>"


@dataclass(frozen=True, eq=False)
class Scan:
    """A recording of a room: images, or a cloud, or both."""

    name: str
    frames: tuple[Frame, ...]
    cloud: Cloud | None = None
    """The recorded cloud; if None, it is fused from the frames."""
    warnings: tuple[str, ...] = ()
    """Skipped input and assumptions, one line each."""
    notes: tuple[str, ...] = ()
    """Measurements of the recording, one line each."""
    up: Float[np.ndarray, "3"] | None = None
    """Up in its frame, if the user states it; else it is found."""
    origin: Float[np.ndarray, "3"] | None = None
    """Point of the recording's frame that is the origin here, if the recording is far away [m]."""

    def __repr__(self) -> str:
        cloud = "no cloud" if self.cloud is None else f"a cloud of {len(self.cloud.points)} points"
        return f"<Scan {self.name!r}: {len(self.frames)} frames, {cloud}>"


@dataclass(frozen=True, eq=False)
class Instance:
    """One object of a segmenter."""

    label: str
    """Its class, or "" if unknown."""
    score: float
    """Confidence in [0, 1]."""
    members: Int[np.ndarray, " k"] | None = None
    """Indices into the cloud."""
    box: UprightBox | None = None
    """Box, from segmenters that return boxes."""
    guesses: tuple[tuple[str, float], ...] = ()
    """If the label is a guess by size: all plausible labels with confidences, best first."""


@dataclass(frozen=True, eq=False)
class Detection:
    """One object in the room, with its box."""

    name: str
    label: str
    score: float
    box: UprightBox
    members: Int[np.ndarray, " k"]
    """Indices into the cloud, outliers removed."""
    label_from: LabelSource = "segmenter"
    guesses: tuple[tuple[str, float], ...] = ()
    """See `Instance.guesses`."""
    seen: float | None = None
    """Share of the visible surface that was measured, in [0, 1]."""
    completed: float = 0.0
    """Share of its points without depth measurements, completed from their surroundings: a black,
    mirrored or glass front [-]."""


@dataclass(frozen=True)
class ImageDetection:
    """One object that a 2-D detector found in one image."""

    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""
    label: str
    score: float
    corners: tuple[tuple[float, float, float], ...] | None = None
    """Corners of its 3-D box in the camera's frame [m], in Omni3D's order: 1, 3 and 4 are adjacent
    to 0; None from detectors without 3-D boxes."""


@dataclass(frozen=True, eq=False)
class FaceImage:
    """An orthographic image of a vertical face of a box; row 0 is the top, column 0 the left."""

    color: UInt8[np.ndarray, "h w 3"]
    height_map: Float32[np.ndarray, "h w"]
    """Height of the surface above the face's plane [m]; NaN where not measured."""
    width: float
    """Size of the face [m]."""
    height: float
    camera_position: Float[np.ndarray, "3"] | None = None
    """Position of the camera that took the colors [m]: x right and y up from the face's center, z
    outward; None if unknown. Protruding parts appear displaced away from it."""


@dataclass(frozen=True)
class Part:
    """A door or drawer on a face; rectangles are (left, top, right, bottom) as fractions of it."""

    kind: PartKind
    box: tuple[float, float, float, float]
    score: float
    """Confidence in [0, 1]."""
    handle: tuple[float, float, float, float] | None = None
    odds: tuple[tuple[PartKind, float], ...] = ()
    """Possible kinds with probabilities that sum to one, most probable (`kind`) first; empty if
    unknown."""


@compare_by_content
@dataclass(frozen=True, eq=False)
class Confidence:
    """Confidence of a scanned object; all numbers are in [0, 1]."""

    object: float
    """Share of the visible surface that was measured."""
    label: float
    """Confidence of the category."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """Confidence of each joint's part and motion, by joint."""
    handles: Mapping[str, float] = field(default_factory=dict)
    """Confidence of each modeled handle, by the joint of its part."""


@dataclass(frozen=True)
class Hypothesis:
    """One possible motion of a part, in the frame of its object; closed at 0."""

    kind: PartKind
    probability: float
    point: tuple[float, float, float]
    """Point on the axis [m]."""
    axis: tuple[float, float, float]
    """Unit axis of the rotation or translation."""
    upper: float
    """Upper limit [rad] or [m]."""

    @property
    def is_probable(self) -> bool:
        """Whether the part moves in this way rather than not."""
        return self.probability >= MIN_PROBABLE


@dataclass(frozen=True)
class Front:
    """The prediction for one face."""

    score: float
    """Probability that the face is a front, in [0, 1]."""
    parts: tuple[Part, ...]
