"""Model one object of a scanned room: its front, the parts on it, and how they move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from momapos.core.geometry import bottom
from momapos.model.records import Detection, FaceImage, Front, Part
from momapos.perception.detection import WITHOUT_DOORS
from momapos.perception.reconstruction import (
    GivenModel,
    furniture_model,
    has_parts,
    is_predicted_urdf,
    place_model,
    read_predicted_urdf,
    weighted_by_height,
    weighted_by_label,
    weighted_by_size,
)
from momapos.perception.segmentation import at_wall
from momapos.perception.views import (
    FrontView,
    adjacent_parts,
    box_faces,
    choose_view,
    handle_evidence,
    neighbor_protrusion,
    observations,
    parts_with_evidence,
)

from .records import MIN_SIDES, Decision, PartSource, ScanConfig, Survey, Tools

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
