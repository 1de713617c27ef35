"""Plan a motion from a scan of a room: the whole method (MoMa-Pos, section III).

The scan is surveyed once, and the objects that matter for the task are modeled. If no base pose is
found, alpha is lowered and more objects are modeled, until the task is solved or all are modeled.
Only then less probable motions of the part are tried; a plan for one of them is `assumed`.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from momapos.core import Clock, Stopwatch, TaskError, as_path, expect, processor_time
from momapos.core.geometry import pose, rotation_about
from momapos.model.records import Detection, JointVerb, ReachScorer, Scan, Task, Verb
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject, load_scene
from momapos.model.urdf import Articulated, box_urdf
from momapos.perception import (
    Decision,
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
from momapos.planning import PipelineConfig, PlacementResult, cheapest, plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.importance import Importance, ImportanceConfig, rank, start_of

from .joint_belief import MostProbable, PlanTask, joint_beliefs


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
    ranked = None if name is None else rank_survey(seen, name, importance)
    scores, alpha = ({}, 0.0) if ranked is None else (ranked.by_name, ranked.alpha)
    made = model_room(
        seen, out, tools, scores=scores, alpha=alpha, given=given,
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


@dataclass(frozen=True)
class ScanTask:
    """A task in a room whose joints are not known yet."""

    verb: Verb
    object: str
    joint: str | None = None
    """May be omitted if only one part has a handle."""
    to: float | str | None = None
    """As for `make_task`."""


@dataclass(frozen=True, eq=False)
class ScanAnswer:
    """The base pose and motion in a scanned room."""

    modeled: Modeled
    """The room as modeled last."""
    result: PlacementResult
    alphas: tuple[float, ...]
    """Importance thresholds at which the room was modeled, in order [-]."""
    timing: Mapping[str, float]
    """Seconds by stage: the stages of the scan, "importance", "place", and "total"."""
    scanning: ScanConfig
    """How the scan became a scene, with the choice of views that the method sets."""


def solve_scan(
    scan: Scan,
    arms: Sequence[tuple[Robot, ReachScorer]],
    task: ScanTask,
    out: str | Path,
    *,
    tools: Tools | None = None,
    found: Found | None = None,
    labels: Mapping[str, str] | None = None,
    given: Mapping[str, GivenModel] | None = None,
    scanning: ScanConfig | None = None,
    config: PipelineConfig | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = processor_time,
) -> ScanAnswer:
    """Find where the robot must stand, and how it moves, in a scanned room.

    Args:
        scan: Posed images, a cloud, or both.
        arms: The robot once per arm that may do the task, with the arm's reachability map.
        task: The task.
        out: Scene file to write, see `scan_to_scene`.
        tools: What segments, labels and models the scan; the default tools if None.
        found: What is already known of the scan, see `scan_to_scene`.
        labels: Labels of objects, by name, see `scan_to_scene`.
        given: Known models of objects, see `scan_to_scene`.
        scanning: How the scan becomes a scene; importance is configured by `config`. With the
            paper's placement method, one image chooses a front unless `views` says otherwise.
        config: How to rank and search.
        seed: The same seed gives the same answer.
        progress: Called with the current step and the completed share.
        clock: Measures the stages and the time limit of each search.

    Raises:
        InputError: The scan is empty.
        UnknownNameError: No object in the scan has the task's object name.
        TaskError: The object has no such part, or the scan shows none on it.
    """
    expect("scan", scan, Scan, "read_scan reads one")
    expect("task", task, ScanTask)
    out = as_path("out", out)
    config = config or PipelineConfig()
    scanning = _for_method(scanning or ScanConfig(), config)
    tools, report, watch = tools or default_tools(), progress or silent, Stopwatch(clock)
    seen = survey(
        scan, tools, found=found, labels=labels, config=scanning, progress=report, clock=clock
    )
    with watch.stage("importance"):
        selection = start_of(rank_survey(seen, task.object, config.ranking, seed))
    scores = selection.ranked.by_name

    def ask(scene: Scene, task: Task) -> list[PlacementResult]:
        return [
            plan_by_method(scene, robot, task, reach, config=config, seed=seed, clock=clock)
            for robot, reach in arms
        ]

    spent, alphas, before = dict(seen.timing), [], tuple[Decision, ...]()
    while True:
        modeled = model_room(
            seen, out, tools, scores=scores, alpha=selection.ranked.lowest_score(selection.alpha),
            known={one.detection.name: one for one in before}, given=given,
            config=scanning, progress=report, clock=clock,
        )  # fmt: skip
        for name in set(modeled.timing) - set(seen.timing) - {"total"}:
            spent[name] = spent.get(name, 0.0) + modeled.timing[name]
        alphas.append(selection.alpha)
        if not before or _moving(modeled.decisions) != _moving(before):
            report("placing", 1.0)
            with watch.stage("place"):
                first = _placed(modeled, task, ask)
        if not first.is_no or not selection.boxes:
            break
        selection, before = selection.relax_alpha(), modeled.decisions
    with watch.stage("place"):
        _, asked, answers = first.or_next(ask)
    result = cheapest(answers, farthest=asked.farthest)
    return ScanAnswer(modeled, result, tuple(alphas), {**spent, **watch.timing}, scanning)


def _for_method(scanning: ScanConfig, config: PipelineConfig) -> ScanConfig:
    """Return how to choose views, which the placement method sets by default."""
    if scanning.views is not None:
        return scanning
    return replace(scanning, views="first" if config.place.method == "paper" else "voting")


def _placed(modeled: Modeled, query: ScanTask, ask: PlanTask) -> MostProbable:
    """Return the answers of all arms in the modeled room, for the most probable joint.

    Raises:
        TaskError: No arm can do the task, and the scene has no other hypothesis of the joint.
    """
    _check_moves(modeled, query)
    scene = load_scene(modeled.scene)
    task = make_task(scene, query.verb, query.object, query.joint, query.to)
    found = MostProbable.of(scene, task, ask)
    if found.refused is not None and len(joint_beliefs(scene, task)) < 2:
        raise found.refused
    return found


def _check_moves(modeled: Modeled, query: ScanTask) -> None:
    """Check that the target has doors or drawers if the task moves a joint.

    Raises:
        TaskError: The scan shows none; the message says why.
    """
    (target,) = (one for one in modeled.decisions if one.detection.name == query.object)
    if query.verb in get_args(JointVerb) and target.model is None:
        raise TaskError(
            f"no door or drawer was found on {query.object!r} ({target.reason}); "
            f"scan its front from closer, or give its URDF"
        )


def _moving(decisions: Iterable[Decision]) -> set[str]:
    """Return the names of the objects that are not plain boxes."""
    return {one.detection.name for one in decisions if one.model is not None}
