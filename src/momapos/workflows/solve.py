"""From a scan of a room to a motion: the method as a whole (MoMa-Pos, section III).

The scan is surveyed once. What matters for the task is modeled; where no base pose is found, alpha
falls and more of the scan is modeled, until the task is solved or all is modeled.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from momapos.core import Clock, Stopwatch, TaskError
from momapos.model.records import ReachScorer, Scan, Task, Verb
from momapos.model.robots import Robot
from momapos.model.scene import Scene, load_scene
from momapos.perception import (
    Decision,
    Found,
    Modeled,
    Progress,
    ScanConfig,
    Tools,
    default_tools,
    model_room,
    silent,
    survey,
)
from momapos.perception.reconstruction import GivenModel
from momapos.planning import PipelineConfig, PlacementResult, cheapest
from momapos.planning.baselines import plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.importance import start_of

from .joint_belief import ask_in_turn
from .scan import rank_survey

JOINTED = ("open", "close")


@dataclass(frozen=True)
class ScanTask:
    """What is to be done in a room whose joints are not known yet."""

    verb: Verb
    object: str
    joint: str | None = None
    """May be left out where only one part has a handle."""
    to: float | str | None = None
    """As for `make_task`."""


@dataclass(frozen=True, eq=False)
class ScanAnswer:
    """Where to stand and how to move in a scanned room."""

    modeled: Modeled
    """The room as it was modeled last."""
    result: PlacementResult
    alphas: tuple[float, ...]
    """Thresholds of importance at which the room was modeled, one after the other [-]."""
    timing: Mapping[str, float]
    """Seconds by stage: those of the scan, "importance", "place", and "total"."""


def solve_scan(
    scan: Scan,
    arms: Sequence[tuple[Robot, ReachScorer]],
    task: ScanTask,
    out: Path,
    *,
    tools: Tools | None = None,
    found: Found | None = None,
    labels: Mapping[str, str] | None = None,
    given: Mapping[str, GivenModel] | None = None,
    scanning: ScanConfig | None = None,
    config: PipelineConfig | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    clock: Clock = time.perf_counter,
) -> ScanAnswer:
    """Answer where the robot must stand, and how it moves, in a room that was scanned.

    Args:
        scan: Posed images, a cloud, or both.
        arms: The robot once for each arm that may do it, with its reachability map.
        task: What is to be done.
        out: The scene file to write, see `scan_to_scene`.
        tools: As for `scan_to_scene`, as are the next three.
        found: What a 2-D detector found in the images; projected boxes by default.
        labels: What things are, by the names that they have without this.
        given: URDF files for objects by name or label, which need no prediction.
        scanning: How the scan becomes a scene; importance is configured by `config`.
        config: How to rank and to search.
        seed: Same seed, same answer.
        progress: Told what goes on.
        clock: Measures the stages.

    Raises:
        InputError: The scan holds nothing.
        UnknownNameError: Nothing in the scan has the object's name.
        TaskError: The object has no such part, or none was seen on it.
    """
    scanning, config = scanning or ScanConfig(), config or PipelineConfig()
    tools, told, watch = tools or default_tools(), progress or silent, Stopwatch(clock)
    seen = survey(
        scan, tools, found=found, labels=labels, config=scanning, progress=told, clock=clock
    )
    with watch.stage("importance"):
        selection = start_of(rank_survey(seen, task.object, config.ranking, seed))
    scores = selection.ranked.by_name
    spent, alphas, before = dict(seen.timing), [], tuple[Decision, ...]()
    while True:
        modeled = model_room(
            seen, out, tools, scores=scores, alpha=selection.alpha,
            known={one.detection.name: one for one in before}, given=given,
            config=scanning, progress=told, clock=clock,
        )  # fmt: skip
        for name in set(modeled.timing) - set(seen.timing) - {"total"}:
            spent[name] = spent.get(name, 0.0) + modeled.timing[name]
        alphas.append(selection.alpha)
        if not before or _moving(modeled.decisions) != _moving(before):
            told("placing", 1.0)
            with watch.stage("place"):
                result = _placed(modeled, arms, task, config, seed, clock)
        if result.plan.status != "infeasible" or not selection.boxes:
            timing = {**spent, **watch.timing}
            return ScanAnswer(modeled, result, tuple(alphas), timing)
        selection, before = selection.relax_alpha(), modeled.decisions


def _placed(
    modeled: Modeled,
    arms: Sequence[tuple[Robot, ReachScorer]],
    asked: ScanTask,
    config: PipelineConfig,
    seed: int,
    clock: Clock,
) -> PlacementResult:
    """The cheapest answer of all arms in the room as it is modeled."""
    _check_moves(modeled, asked)
    scene = load_scene(modeled.scene)
    task = make_task(scene, asked.verb, asked.object, asked.joint, asked.to)

    def ask(scene: Scene, task: Task) -> list[PlacementResult]:
        return [
            plan_by_method(scene, robot, task, reach, config=config, seed=seed, clock=clock)
            for robot, reach in arms
        ]

    _, task, answers = ask_in_turn(scene, task, ask)
    return cheapest(answers, farthest=task.farthest)


def _check_moves(modeled: Modeled, asked: ScanTask) -> None:
    """Refuse to open what has no doors or drawers as far as was seen.

    Raises:
        TaskError: It says why none was seen.
    """
    (target,) = (one for one in modeled.decisions if one.detection.name == asked.object)
    if asked.verb in JOINTED and target.model is None:
        raise TaskError(
            f"{asked.object!r} has no door or drawer as far as the scan shows: {target.reason}; "
            f"scan its front from nearer, or name its URDF"
        )


def _moving(decisions: Iterable[Decision]) -> set[str]:
    """Names of the objects that are no boxes."""
    return {one.detection.name for one in decisions if one.model is not None}
