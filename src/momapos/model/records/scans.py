"""Records of perception: frames, clouds, detections and the parts of a front.

All values are in SI units, in the world frame unless a field names another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core.geometry import UprightBox

if TYPE_CHECKING:
    from jaxtyping import Float, Float32, Int, UInt8


PartKind = Literal["door_left", "door_right", "door_down", "door_up", "drawer"]
"""How a part opens, seen from the front: a `door_left` has its hinge on the left."""
LabelSource = Literal["size", "segmenter", "detector", "given"]
"""Who says what a thing is: rules about its size, who divided the cloud, a detector in the images,
or the user."""
UNKNOWN: tuple[str, float] = ("object", 0.2)
"""Label and confidence of a thing of which nothing tells what it is."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a scan and where it was taken from."""

    name: str
    color: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"] | None
    """Distance along the optical axis [m], 0 where it was not measured; None without a sensor."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Of color and depth, which are registered [px]."""
    T_world_camera: Float[np.ndarray, "4 4"]
    """Camera axes as in OpenCV: x right, y down, z forward."""

    def __repr__(self) -> str:
        height, width = self.color.shape[:2]
        depth = "no depth" if self.depth is None else "depth"
        return f"<Frame {self.name!r}: {width} x {height} pixels, {depth}>"


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of surfaces."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit vectors toward the side that was seen."""
    colors: UInt8[np.ndarray, "n 3"]

    def __repr__(self) -> str:
        return f"<Cloud: {len(self.points)} points>"


@dataclass(frozen=True, eq=False)
class Scan:
    """What was recorded of a room: pictures, or a cloud, or both."""

    name: str
    frames: tuple[Frame, ...]
    cloud: Cloud | None = None
    """A cloud that came with the scan; without one it is fused from the frames."""
    warnings: tuple[str, ...] = ()
    """What was skipped or assumed, one line each."""
    notes: tuple[str, ...] = ()
    """What was measured of it, one line each."""

    def __repr__(self) -> str:
        cloud = "no cloud" if self.cloud is None else f"a cloud of {len(self.cloud.points)} points"
        return f"<Scan {self.name!r}: {len(self.frames)} frames, {cloud}>"


@dataclass(frozen=True, eq=False)
class Instance:
    """One thing that a segmenter found."""

    label: str
    """Its class, or "" where the segmenter does not know."""
    score: float
    """Confidence in [0, 1]."""
    members: Int[np.ndarray, " k"] | None = None
    """Indices into the cloud."""
    box: UprightBox | None = None
    """For segmenters that give boxes."""
    guesses: tuple[tuple[str, float], ...] = ()
    """Where the label is a guess by size: all that it allows, with confidences, best first."""


@dataclass(frozen=True, eq=False)
class Detection:
    """One thing in the room, with its box."""

    name: str
    label: str
    score: float
    box: UprightBox
    members: Int[np.ndarray, " k"]
    """Indices into the cloud, outliers removed."""
    label_from: LabelSource = "segmenter"
    guesses: tuple[tuple[str, float], ...] = ()
    """As of an `Instance`."""
    seen: float | None = None
    """Share of the surface that can be seen on which something was measured, in [0, 1]."""
    completed: float = 0.0
    """Share of its points that no depth image shows: a black, mirrored or glass front, completed
    from what is around it [-]."""


@dataclass(frozen=True)
class ImageDetection:
    """One thing that a 2-D detector found in one image."""

    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""
    label: str
    score: float


@dataclass(frozen=True, eq=False)
class FaceImage:
    """One upright face of a box, seen straight on; row 0 is its top, column 0 its left."""

    color: UInt8[np.ndarray, "h w 3"]
    height_map: Float32[np.ndarray, "h w"]
    """How far the surface stands out of the face's plane [m]; NaN where not measured."""
    width: float
    """Size of the face [m]."""
    height: float
    camera_position: Float[np.ndarray, "3"] | None = None
    """Where the camera was that took the colors [m]: x right and y up from the middle of the face,
    z outward. What stands out was seen displaced, away from there. None where it is not known."""


@dataclass(frozen=True)
class Part:
    """A door or drawer on a face; rectangles are (left, top, right, bottom) as fractions of it."""

    kind: PartKind
    box: tuple[float, float, float, float]
    score: float
    """Confidence in [0, 1]."""
    handle: tuple[float, float, float, float] | None = None
    odds: tuple[tuple[PartKind, float], ...] = ()
    """How it may open, each with its probability, the likeliest first, which is its kind; they sum
    to one. Empty where nobody says."""


@dataclass(frozen=True)
class Confidence:
    """How sure a scan is of an object; all numbers in [0, 1]."""

    object: float
    """Share of the surface that can be seen that was seen."""
    label: float
    """That it is what its category says."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """That there is such a part and that it moves so, by joint."""
    handles: Mapping[str, float] = field(default_factory=dict)
    """That there is a handle where the model has one, by the joint of its part."""


@dataclass(frozen=True)
class Hypothesis:
    """One way in which a part may move, in the frame of its object; shut at 0."""

    kind: PartKind
    probability: float
    point: tuple[float, float, float]
    """On its axis [m]."""
    axis: tuple[float, float, float]
    """Unit vector about or along which it moves."""
    upper: float
    """Where it ends [rad] or [m]."""


@dataclass(frozen=True)
class Front:
    """What a predictor sees on a face."""

    score: float
    """Probability that this face is a front, in [0, 1]."""
    parts: tuple[Part, ...]
