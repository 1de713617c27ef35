"""Model one object from one image and its box in the image, as MoMa-Pos does in section III-B.

A photo has no scale. The size of the object is given, or follows from the usual height of objects
with this label and the proportions of the box.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, InputError
from momapos.core.geometry import UprightBox
from momapos.model.records import Cloud, Detection, FaceImage, Frame
from momapos.perception.reconstruction import GivenModel, build_scene
from momapos.perception.segmentation import RoomShell
from momapos.perception.views import Face, FaceSurroundings, FrontView, box_faces

from .modeling import model_front
from .records import Decision, Modeled, ScanConfig, Survey, Tools

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

USUAL_SIZES: Mapping[str, tuple[float, float]] = {
    "cabinet": (0.86, 0.6), "dishwasher": (0.85, 0.6), "drawer unit": (0.86, 0.6),
    "fridge": (1.8, 0.65), "microwave": (0.28, 0.36), "oven": (0.6, 0.56),
    "wall cabinet": (0.65, 0.35), "wardrobe": (2.0, 0.6),
}  # fmt: skip
"""Usual height and depth of objects [m]: of European kitchens, whose appliances fit one grid."""
MIN_PIXELS = 32
"""Minimum width and height of a box [px]."""
PROBABLE = 0.5
"""Below this probability that the box shows a front, a warning says so [-]."""
IN_FRONT = 1.5
"""Distance of the robot's start from the front [m]."""
FRONT = 3
"""Index of the face toward -y, which is the front."""


@dataclass(frozen=True, eq=False)
class Photo:
    """An image with one object in it."""

    name: str
    color: UInt8[np.ndarray, "h w 3"]
    box: tuple[float, float, float, float]
    """Left, top, right, bottom of the object's front [px]."""
    label: str
    size: tuple[float, float, float] | None = None
    """Width, depth, height of the object [m]; None: as usual for the label."""


def model_photo(
    photo: Photo,
    out: Path,
    tools: Tools,
    *,
    given: Mapping[str, GivenModel] | None = None,
    config: ScanConfig | None = None,
    clock: Clock = time.perf_counter,
) -> Modeled:
    """Model the object in a photo, and write a scene with it alone.

    The object stands at the origin with its front toward -y, the robot 1.5 m in front of it.

    Args:
        photo: The image, taken about straight from the front.
        out: Scene file to write; the URDF goes into a folder next to it.
        tools: Predictors.
        given: Models by label: of a URDF, or the output of URDFormer.
        config: How parts become joints.
        clock: Measures the time.

    Raises:
        InputError: The box is not in the image or too small, or the size is unknown.
    """
    begin = clock()
    left, top, right, bottom = _box(photo)
    width, depth, height = photo.size or _usual_size(photo, (right - left) / (bottom - top))
    name = f"{photo.label.replace(' ', '_')}_1"
    box = UprightBox(np.array([0.0, 0.0, height / 2]), np.array([width, depth, height]))
    item = Detection(name, photo.label, 1.0, box, np.zeros(0, int), "given")
    color = np.ascontiguousarray(photo.color[top:bottom, left:right])
    unknown = np.full(color.shape[:2], np.nan, np.float32)
    image = FaceImage(color, unknown, width, height)
    front, face = tools.look(image, photo.label), box_faces(box)[FRONT]
    view = FrontView(face, 0, 0.0, image, front, FaceSurroundings(face, (image,)), ())
    frame = _frame(photo, face, (left, top, right, bottom))
    nothing = Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    seen = Survey(
        nothing, (frame,), np.eye(4), RoomShell(), (item,), (), (), None, {},
        _doubts(photo, front.score),
    )  # fmt: skip
    blank = Decision(item, None, view, (), None, "")
    decision = model_front(blank, seen, tools, given or {}, config or ScanConfig())
    models = {} if decision.model is None else {name: decision.model}
    start = (0.0, -depth / 2 - IN_FRONT, float(np.pi / 2))
    build_scene([item], models, None, out, start=start)
    timing = {"model": clock() - begin, "total": clock() - begin}
    return Modeled(out, nothing, seen.frames, np.eye(4), (decision,), timing, None, seen.warnings)


def _box(photo: Photo) -> tuple[int, int, int, int]:
    height, width = photo.color.shape[:2]
    left, top, right, bottom = (round(v) for v in photo.box)
    if not (0 <= left < right <= width and 0 <= top < bottom <= height):
        raise InputError(
            f"{photo.name}: the box {left},{top},{right},{bottom} is not within the image of "
            f"{width} x {height} pixels; it is left,top,right,bottom"
        )
    if min(right - left, bottom - top) < MIN_PIXELS:
        raise InputError(
            f"{photo.name}: the box of {right - left} x {bottom - top} pixels is too small; it "
            f"needs {MIN_PIXELS} each way"
        )
    return left, top, right, bottom


def _usual_size(photo: Photo, aspect: float) -> tuple[float, float, float]:
    if photo.label not in USUAL_SIZES:
        raise InputError(
            f"{photo.name}: a photo has no scale, and the usual size of {photo.label!r:.40} is not "
            f"known; give --size WIDTH,DEPTH,HEIGHT, or a --label among {', '.join(USUAL_SIZES)}"
        )
    height, depth = USUAL_SIZES[photo.label]
    return height * aspect, depth, height


def _doubts(photo: Photo, score: float) -> tuple[str, ...]:
    doubts = []
    if photo.size is None:
        height = USUAL_SIZES[photo.label][0]
        doubts.append(f"{photo.name}: a {photo.label} is taken to be {height:g} m high")
    if score < PROBABLE:
        doubts.append(f"{photo.name}: the box shows a front with probability {score:.2f} only")
    return tuple(doubts)


def _frame(photo: Photo, face: Face, box: tuple[int, int, int, int]) -> Frame:
    """Return the image with a camera straight in front of a face that sees it in the box."""
    left, top, right, bottom = box
    distance = IN_FRONT
    K = np.array([
        [distance * (right - left) / face.width, 0.0, (left + right) / 2],
        [0.0, distance * (bottom - top) / face.height, (top + bottom) / 2],
        [0.0, 0.0, 1.0],
    ])  # fmt: skip
    T_face_camera: Float[np.ndarray, "4 4"] = np.diag([1.0, -1.0, -1.0, 1.0])
    T_face_camera[2, 3] = distance
    return Frame(photo.name, photo.color, None, K, face.T_world_face @ T_face_camera)
