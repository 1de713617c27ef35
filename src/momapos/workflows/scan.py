"""Build a scene with opening doors and drawers from a scan: perception plus importance."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.core import Clock, as_path, expect
from momapos.core.geometry import pose, rotation_about
from momapos.model.records import Detection, Scan
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Articulated, box_urdf
from momapos.perception import (
    Found,
    Modeled,
    Progress,
    ScanConfig,
    Survey,
    Target,
    Tools,
    default_tools,
    model_room,
    name_of,
    silent,
    survey,
)
from momapos.perception.reconstruction import GivenModel
from momapos.planning.importance import Importance, ImportanceConfig, rank


def scan_to_scene(
    scan: Scan,
    out: str | Path,
    tools: Tools | None = None,
    *,
    target: Target | None = None,
    found: Found | None = None,
    labels: Mapping[str, str] | None = None,
    given: Mapping[str, GivenModel] | None = None,
    config: ScanConfig | None = None,
    importance: ImportanceConfig | None = None,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
) -> Modeled:
    """Build a scene with opening doors and drawers from a scan of a room.

    Args:
        scan: Posed images, a cloud, or both.
        out: Scene file to write; URDF files go into a folder next to it.
        tools: Segmenter and predictors; `default_tools()` if None.
        target: Object of the task, by name or by a point on it. Only objects that matter for it
            are modeled. If None, every object with a front is modeled.
        found: 2-D detections in the images; if None, boxes are projected into the images.
        labels: Labels of objects, by their default names. Names follow labels.
        given: URDF files of objects, by name or label; these objects need no prediction.
        config: Configuration of all stages.
        importance: How objects are ranked against the target, and the importance below which
            they stay boxes.
        progress: Called with the current step and the completed share.
        clock: Measures the stages.

    Raises:
        InputError: The scan is empty, or the target does not exist.
    """
    expect("scan", scan, Scan, "read_scan reads one")
    out = as_path("out", out)
    tools, config, progress = tools or default_tools(), config or ScanConfig(), progress or silent
    importance = importance or ImportanceConfig()
    seen = survey(
        scan, tools, found=found, labels=labels, config=config, progress=progress, clock=clock
    )
    name = None if target is None else name_of(target, seen)
    scores = {} if name is None else rank_survey(seen, name, importance).by_name
    made = model_room(
        seen, out, tools, scores=scores, alpha=importance.alpha, given=given,
        config=config, progress=progress, clock=clock,
    )  # fmt: skip
    return replace(made, target=name)


def rank_survey(seen: Survey, target: str, config: ImportanceConfig, seed: int = 0) -> Importance:
    """Rank all objects of a survey against the target, using only their boxes.

    The path of the hand is not known yet, so `size` stands in for the scorer `reach`.

    Raises:
        UnknownNameError: No object has that name.
    """
    if config.scorer in (None, "reach"):
        config = replace(config, scorer="size")
    return rank(Scene("scan", tuple(map(_boxed, seen.detections))), target, config, seed=seed)


def _boxed(item: Detection) -> SceneObject:
    x, y, z = map(float, item.box.size)
    model = Articulated(box_urdf(item.name, (x, y, z)))
    R = rotation_about(np.array([0.0, 0.0, 1.0]), item.box.yaw)
    return SceneObject(item.name, item.label, pose(item.box.center, R), model)
