"""How one thing of a scanned room moves: its front, the parts on it, and the model made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from momapos.detection.coco import WITHOUT_DOORS
from momapos.reconstruction.build import GivenModel, place_model
from momapos.reconstruction.model import furniture_model
from momapos.reconstruction.open_parts import opened_piece
from momapos.reconstruction.seen_motion import moved_piece
from momapos.scan_records import Decision, PartSource, ScanConfig, Survey, Tools
from momapos.scene.library.furniture import Piece
from momapos.segmentation.room import at_wall
from momapos.types import Cloud, Detection, FaceImage, Front, Part
from momapos.views.faces import box_faces, standing_beside
from momapos.views.front_view import View, choose_view
from momapos.views.projection import sights

TOLD = 0.1
"""From this share of its points on it is told that a thing is completed [-]."""


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
    if (np.sort(item.box.size)[:2] < config.least_sides).any():
        return replace(box, reason="too small for doors or drawers")
    if item.label in WITHOUT_DOORS and item.label_from in ("detector", "given"):
        return replace(box, reason=f"a {item.label} has no doors or drawers")

    def look(face: FaceImage) -> Front:
        return tools.look(face, item.label)

    seen = sights(item.box, survey.frames, survey.found) or sights(item.box, survey.frames)
    faces = box_faces(item.box)
    sides = [at_wall(survey.room, face.T_world_face[:3, 3], face.outward) for face in faces]
    backed = [sides[face.opposite] for face in faces]
    view = choose_view(item.box, survey.frames, seen, look, config.view, survey.rows, backed)
    if view is None:
        return replace(box, reason="no image shows a front")
    facing = float(np.arctan2(view.face.outward[1], view.face.outward[0]))
    own = given.get(item.name, given.get(item.label))
    if own is not None:
        model, warnings = place_model(item, facing, own)
        warnings = (*box.warnings, *warnings)
        return replace(box, view=view, source=PartSource.GIVEN, model=model, warnings=warnings)
    parts, source = _parts(view, item.label, tools)
    if not parts:
        return replace(box, view=view, reason="a front without doors or drawers")
    others = [one.box for one in (*survey.detections, *survey.walls) if one is not item]
    left, right = (standing_beside(faces[k], view.face, others) for k in view.face.beside)
    beside = (left, right)
    piece = furniture_model(item, facing, view.image, parts, config.model, beside=beside)
    piece, moved = opened_piece(piece, survey.leaves)
    return replace(box, view=view, parts=parts, source=source, model=piece, moved=moved)


def watched(decision: Decision, before: Cloud, later: Cloud, config: ScanConfig) -> Decision:
    """Give parts that were opened between two scans the joints that these show."""
    if not isinstance(decision.model, Piece):
        return decision
    piece, moved = moved_piece(decision.model, before, later, config.seen_motion)
    return replace(decision, model=piece, moved={**decision.moved, **moved})


def _parts(view: View, label: str, tools: Tools) -> tuple[tuple[Part, ...], PartSource]:
    """Doors and drawers of a front, and where they are from."""
    same = tools.predict is tools.look
    parts = view.front.parts if same else tools.predict(view.image, label).parts
    if parts or tools.guess is None:
        return parts, PartSource.PREDICTED
    return tools.guess(view.image, label).parts, PartSource.GUESSED
