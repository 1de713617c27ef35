"""Choose the objects with a kinematic model: those that score, and those near a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from momapos.model.scene import upright_boxes, with_assumptions
from momapos.planning.arm_motion import boxes_near_base, boxes_near_swept_volume, near_boxes
from momapos.planning.grasps import TaskMotion
from momapos.planning.importance import Importance, Selection, everything, start_of
from momapos.verification import PlanVerifier

from .query import PlacementQuery
from .result import PlacementResult

MODELED_WHOLE = 50
"""Number of objects up to which all have a model from the start, unless alpha is given: in kitchens
of 4 to 21 objects one search with all models takes less time than two with fewer [-]."""


def initial_selection(query: PlacementQuery, ranked: Importance, motion: TaskMotion) -> Selection:
    """Return all objects of a small scene; else S, plus the boxes that part or robot overlap."""
    config = query.config
    few = config.importance.alpha is None and len(ranked.names) <= MODELED_WHOLE
    if few or config.place.method == "exhaustive":
        return everything(ranked)
    selection = start_of(ranked)
    names = selection.boxes
    boxes = upright_boxes([query.scene.object(name) for name in names])
    hit = boxes_near_swept_volume(motion, boxes, margin=0.0)
    start = query.scene.start if query.start is None else query.start
    if start is not None and np.isfinite(start).all() and len(start) == 3:
        hit |= boxes_near_base(query.robot, np.asarray(start, float), boxes, margin=0.0)
    return selection.join(names[i] for i in np.flatnonzero(hit))


def refine_model(
    query: PlacementQuery, selection: Selection, result: PlacementResult
) -> tuple[Selection, bool]:
    """Model the objects near a plan and check it again, until no other box is near.

    Returns:
        The selection, and whether the plan is valid with it.
    """
    found, pose = result.plan.motion, result.plan.base_pose
    assert found is not None
    assert pose is not None
    robot, motion = query.robot, result.prepared.motion
    while selection.boxes:
        with query.watch.stage("expand model"):
            names = selection.boxes
            boxes = upright_boxes([query.scene.object(name) for name in names])
            near = near_boxes(
                robot, motion, np.array(pose), found, boxes, margin=query.config.expand_distance
            )  # fmt: skip
        if not near.any():
            break
        joined = selection.join(names[i] for i in np.flatnonzero(near))
        selection = replace(joined, rounds=selection.rounds + 1)
        with query.watch.stage("exact check"):
            scene = query.scene.with_box_proxies(selection.names)
            verifier = PlanVerifier(with_assumptions(scene, result.plan), robot, query.task)
            violation = verifier.first_violation(pose, found)
        if violation is not None:
            return selection, False
    return selection, True
