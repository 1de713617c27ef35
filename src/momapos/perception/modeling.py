"""How one thing of a scanned room moves: its front, the parts on it, and the model made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from momapos.core.geometry import bottom
from momapos.model.records import Cloud, Detection, FaceImage, Front, Part
from momapos.model.scene.library import Piece
from momapos.perception.detection import WITHOUT_DOORS
from momapos.perception.reconstruction import (
    GivenModel,
    furniture_model,
    moved_piece,
    opened_piece,
    place_model,
    weighed,
    weighed_by_height,
)
from momapos.perception.segmentation import at_wall
from momapos.perception.views import (
    View,
    box_faces,
    choose_view,
    handle_evidence,
    sights,
    standing_beside,
)

from .records import Decision, PartSource, ScanConfig, Survey, Tools

TOLD = 0.1
"""From this share of its points on it is told that a thing is completed [-]."""
OPENS = 0.9
"""What has handles so surely has doors or drawers, whatever a detector takes it for [-]."""
DETECTED: Mapping[str, float] = {"microwave": 0.5, "oven": 0.5}
"""So often a detector's label is right, besides its own confidence [-]; others tell nothing of how
doors open. What yolox_nano takes for a fridge is a dishwasher or a cabinet as often: 6 of 11 of the
tuned simulator objects, and their parts open as any do."""


def decide(
    item: Detection,
    score: float | None,
    survey: Survey,
    tools: Tools,
    given: Mapping[str, GivenModel],
    config: ScanConfig,
) -> Decision:
    """Look at one object that matters, and model it if it has a front."""
    box = Decision(item, score, None, (), None, "")
    if item.completed >= TOLD:
        text = (
            f"{item.name}: {item.completed:.0%} of it has no depth and is completed from around it"
        )
        box = replace(box, warnings=(text,))
    if _small(item, config):
        return replace(box, reason="too small for doors or drawers")
    if item.label in WITHOUT_DOORS and item.label_from in ("detector", "given"):
        return replace(box, reason=f"a {item.label} has no doors or drawers")

    view = front_of(item, survey, tools, config)
    if view is None:
        return replace(box, reason="no image shows a front")
    facing = float(np.arctan2(view.face.outward[1], view.face.outward[0]))
    own = given.get(item.name, given.get(item.label))
    if own is not None:
        model, warnings = place_model(item, facing, own)
        warnings = (*box.warnings, *warnings)
        return replace(box, view=view, source=PartSource.GIVEN, model=model, warnings=warnings)
    parts, source = _parts(view, item, tools)
    if not parts:
        return replace(box, view=view, reason="a front without doors or drawers")
    faces = box_faces(item.box)
    others = [one.box for one in (*survey.detections, *survey.walls) if one is not item]
    left, right = (standing_beside(faces[k], view.face, others) for k in view.face.beside)
    beside = (left, right)
    piece = furniture_model(item, facing, view.image, parts, config.model, beside=beside)
    piece, moved = opened_piece(piece, survey.leaves)
    return replace(box, view=view, parts=parts, source=source, model=piece, moved=moved)


def front_of(item: Detection, survey: Survey, tools: Tools, config: ScanConfig) -> View | None:
    """The front of a thing, as the best image shows it; None where no image shows one."""

    def look(face: FaceImage) -> Front:
        return tools.look(face, item.label)

    seen = sights(item.box, survey.frames, survey.found) or sights(item.box, survey.frames)
    faces = box_faces(item.box)
    sides = [at_wall(survey.room, face.T_world_face[:3, 3], face.outward) for face in faces]
    backed = [sides[face.opposite] for face in faces]
    return choose_view(item.box, survey.frames, seen, look, config.view, survey.rows, backed)


def opens(item: Detection, survey: Survey, tools: Tools, config: ScanConfig) -> bool:
    """Whether doors or drawers with handles are surely seen on a thing."""
    view = None if _small(item, config) else front_of(item, survey, tools, config)
    return view is not None and handle_evidence(view.front, view.image) >= OPENS


def watched(decision: Decision, before: Cloud, later: Cloud, config: ScanConfig) -> Decision:
    """Give parts that were opened between two scans the joints that these show."""
    if not isinstance(decision.model, Piece):
        return decision
    piece, moved = moved_piece(decision.model, before, later, config.seen_motion)
    return replace(decision, model=piece, moved={**decision.moved, **moved})


def _parts(view: View, item: Detection, tools: Tools) -> tuple[tuple[Part, ...], PartSource]:
    """Doors and drawers of a front, and where they are from."""
    same = tools.predict is tools.look
    parts = view.front.parts if same else tools.predict(view.image, item.label).parts
    if parts or tools.guess is None:
        parts = weighed_by_height(parts, view.image, bottom(item.box))
        return weighed(parts, item.label, _sure_of_label(item)), PartSource.PREDICTED
    return tools.guess(view.image, item.label).parts, PartSource.GUESSED


def _small(item: Detection, config: ScanConfig) -> bool:
    """Whether a thing is too small for doors or drawers."""
    return bool((np.sort(item.box.size)[:2] < config.least_sides).any())


def _sure_of_label(item: Detection) -> float:
    """How probable it is that a thing is what it is called, as far as its size did not tell: how
    large parts are the networks see themselves."""
    if item.label_from == "size":
        return 0.0
    return item.score * (DETECTED.get(item.label, 0.0) if item.label_from == "detector" else 1.0)
