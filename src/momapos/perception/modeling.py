"""Model one object of a room or of a single image: its front, its parts, how they move.

A photo has no scale. The size of the object is given, or follows from the usual height of objects
with this label and the proportions of the box.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Clock, InputError
from momapos.core.geometry import UprightBox, bottom
from momapos.model.records import Cloud, Detection, FaceImage, Frame, Front, Part

from .detection import WITHOUT_DOORS
from .reconstruction import (
    GivenModel,
    build_scene,
    furniture_model,
    has_parts,
    is_predicted_urdf,
    place_model,
    read_predicted_urdf,
    weighted_by_height,
    weighted_by_label,
    weighted_by_size,
)
from .records import MIN_SIDES, Decision, Modeled, PartSource, ScanConfig, Survey, Tools
from .segmentation import RoomShell, at_wall
from .views import (
    Face,
    FaceSurroundings,
    FrontView,
    adjacent_parts,
    box_faces,
    choose_view,
    handle_evidence,
    neighbor_protrusion,
    observations,
    parts_with_evidence,
)

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8


MIN_REPORTED_COMPLETION = 0.1
"""Completion is reported from this share of an object's points on [-]."""
MIN_HANDLE_EVIDENCE = 0.9
"""From this handle evidence on an object has doors or drawers, whatever a detector says [-]."""
MIN_DETECTION = 0.5
"""Minimum score of a detection that locates an object for the paper's choice of an image [-]: the
default of Detectron2's demo; the paper prints none."""
DETECTED: Mapping[str, float] = {"microwave": 0.5, "oven": 0.5}
"""Precision of a detector's labels, multiplied by its confidence [-]. Other labels do not tell how
doors open: 6 of the 11 objects that yolox_nano calls a fridge in the simulator's development
set are dishwashers or cabinets, and their parts open like any others."""


def decide(
    item: Detection,
    score: float | None,
    survey: Survey,
    tools: Tools,
    given: Mapping[str, GivenModel],
    config: ScanConfig,
) -> Decision:
    """Examine one object, and model it if it has a front."""
    box = Decision(item, score, None, (), None, "")
    if item.completed >= MIN_REPORTED_COMPLETION:
        text = (
            f"{item.name}: depth is missing on {item.completed:.0%} of its surface, "
            "which is interpolated"
        )
        box = replace(box, warnings=(text,))
    if _small(item):
        return replace(box, reason="too small for doors or drawers")
    if item.label in WITHOUT_DOORS and item.label_from in ("detector", "given"):
        return replace(box, reason=f"a {item.label} has no doors or drawers")

    view = front_of(item, survey, tools, config)
    if view is None:
        return replace(box, reason="no front found in the images")
    return model_front(replace(box, view=view), survey, tools, given, config)


def model_front(
    box: Decision,
    survey: Survey,
    tools: Tools,
    given: Mapping[str, GivenModel],
    config: ScanConfig,
) -> Decision:
    """Model an object whose front is known.

    Args:
        box: The decision so far, with the view of the front.
        survey: The room.
        tools: Predictors.
        given: Models by name or label; of URDFormer's output only the parts are used.
        config: How parts become joints.
    """
    item, view = box.detection, box.view
    assert view is not None
    facing = float(np.arctan2(view.face.outward[1], view.face.outward[0]))
    own = given.get(item.name, given.get(item.label))
    if own is not None and not is_predicted_urdf(own.path):
        model, warnings = place_model(item, facing, own)
        warnings = (*box.warnings, *warnings)
        return replace(box, source=PartSource.GIVEN, model=model, warnings=warnings)
    if own is None:
        parts, source = _parts(view, item, survey, tools, config)
    else:
        parts, source = read_predicted_urdf(own.path), PartSource.GIVEN
    if not parts:
        reason = "no doors or drawers found on its front"
        if own is None and view.front.parts:
            reason = "what looks like a door on its front has no seam and no handle"
        return replace(box, reason=reason)
    faces = box_faces(item.box)
    others = [one.box for one in (*survey.detections, *survey.walls) if one is not item]
    left, right = (neighbor_protrusion(faces[k], view.face, others) for k in view.face.neighbors)
    piece = furniture_model(item, facing, view.image, parts, config.model, neighbors=(left, right))
    return replace(box, parts=parts, source=source, model=piece)


def front_of(item: Detection, survey: Survey, tools: Tools, config: ScanConfig) -> FrontView | None:
    """Return the front of an object in its best image; None if no image shows one."""

    def look(face: FaceImage) -> Front:
        return tools.look(face, item.label)

    method = config.views or "voting"
    least = MIN_DETECTION if method == "first" else 0.0
    seen = observations(item.box, survey.frames, survey.found, least) or observations(
        item.box, survey.frames
    )
    faces = box_faces(item.box)
    sides = [at_wall(survey.room, face.T_world_face[:3, 3], face.outward) for face in faces]
    backed = [sides[face.opposite] for face in faces]
    return choose_view(
        item.box, survey.frames, seen, look, method, survey.rows, backed, tools.frontal
    )


def shows_handles(item: Detection, survey: Survey, tools: Tools, config: ScanConfig) -> bool:
    """Check whether an object clearly shows doors or drawers with handles."""
    view = None if _small(item) else front_of(item, survey, tools, config)
    return view is not None and handle_evidence(view.front, view.image) >= MIN_HANDLE_EVIDENCE


def _parts(
    view: FrontView, item: Detection, survey: Survey, tools: Tools, config: ScanConfig
) -> tuple[tuple[Part, ...], PartSource]:
    """Return the parts on a front, and where they come from.

    A part needs a seam, a handle, or a label that brings one. Another predictor than the one that
    looks at the faces is used where there is such a part. With `views="first"` no evidence is
    needed, as in the paper.
    """
    labeled = item.label_from != "size" and has_parts(item.label)
    sure = labeled or config.views == "first"
    parts = view.front.parts
    if not sure:
        parts = parts_with_evidence(parts, view.face, view.surroundings, view.front.score)
    if tools.predict is not tools.look and (parts or sure):
        parts = tools.predict(view.image, item.label).parts
    if not parts and sure and tools.guess is not None:
        return tools.guess(view.image, item.label).parts, PartSource.GUESSED
    if not labeled:
        adjacent = [
            p for row in survey.rows for p in adjacent_parts(row.parts, row.face, view.face)
        ]
        parts = weighted_by_size(parts, view.image, adjacent)
    parts = weighted_by_height(parts, view.image, bottom(item.box))
    return weighted_by_label(parts, item.label, _label_confidence(item)), PartSource.PREDICTED


def _small(item: Detection) -> bool:
    return bool((np.sort(item.box.size)[:2] < MIN_SIDES).any())


def _label_confidence(item: Detection) -> float:
    """Return the probability of an object's label; 0 for labels by size, because the networks see
    the size of parts themselves."""
    if item.label_from == "size":
        return 0.0
    return item.score * (DETECTED.get(item.label, 0.0) if item.label_from == "detector" else 1.0)


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
