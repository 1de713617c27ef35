"""From a scan to a scene whose doors and drawers open: perception, joined with importance."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.core import Clock
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
    cloud_after,
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
    out: Path,
    tools: Tools | None = None,
    *,
    target: Target | None = None,
    after: Scan | None = None,
    found: Found | None = None,
    labels: Mapping[str, str] | None = None,
    given: Mapping[str, GivenModel] | None = None,
    config: ScanConfig | None = None,
    importance: ImportanceConfig | None = None,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
) -> Modeled:
    """Make a scene whose doors and drawers open from a scan of a room.

    Args:
        scan: Posed images, a cloud, or both.
        out: The scene file to write; URDF files go into a folder beside it.
        tools: Segmenter and predictors; `default_tools` by default.
        target: Object that the task will be about, by its name or pointed at: only what matters
            for it is modeled. By default everything is that has a front.
        after: The same room after doors or drawers were opened, which are shut in `scan`: how these
            move is then seen, and the scene has them as open as they are here.
        found: What a 2-D detector found in the images; projected boxes by default.
        labels: What things are, by the names that they have without this; names follow labels.
        given: URDF files for objects by name or label, which need no prediction.
        config: How every stage works.
        importance: How objects are ranked against the target, and below which importance they stay
            boxes.
        progress: Told what goes on.
        clock: Measures the stages.

    Raises:
        InputError: The scan holds nothing, no object has the target's name or is there, or
            `after` is of another room.
    """
    tools, config, progress = tools or default_tools(), config or ScanConfig(), progress or silent
    importance = importance or ImportanceConfig()
    seen = survey(
        scan, tools, found=found, labels=labels, config=config, progress=progress, clock=clock
    )
    later = None if after is None else cloud_after(after, seen, config)
    name = None if target is None else name_of(target, seen)
    scores = {} if name is None else rank_survey(seen, name, importance).by_name
    made = model_room(
        seen, out, tools, scores=scores, alpha=importance.alpha, later=later, given=given,
        config=config, progress=progress, clock=clock,
    )  # fmt: skip
    return replace(made, target=name)


def rank_survey(seen: Survey, target: str, config: ImportanceConfig, seed: int = 0) -> Importance:
    """Rank all objects of a survey against the target, from their boxes alone.

    Raises:
        UnknownNameError: No object has that name.
    """
    return rank(Scene("scan", tuple(map(_boxed, seen.detections))), target, config, seed=seed)


def _boxed(item: Detection) -> SceneObject:
    x, y, z = map(float, item.box.size)
    model = Articulated(box_urdf(item.name, (x, y, z)))
    R = rotation_about(np.array([0.0, 0.0, 1.0]), item.box.yaw)
    return SceneObject(item.name, item.label, pose(item.box.center, R), model)
