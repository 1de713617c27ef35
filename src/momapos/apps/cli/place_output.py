"""Draw, write and print an answer of `momapos place`."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING

from momapos.core import say

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from momapos.model.records import Task
    from momapos.model.robots import Robot
    from momapos.model.scene import Scene
    from momapos.planning import PipelineConfig, PlacementResult
    from momapos.planning.reachability import ArmLength, ReachMap


def with_all_time(
    answer: PlacementResult, planning: float, later: Mapping[str, float]
) -> PlacementResult:
    """Return an answer whose timing includes what was spent on others, and on more than it.

    Args:
        answer: The chosen answer.
        planning: Time of all answers: of every arm and hypothesis [s].
        later: Time of further stages [s].
    """
    timing = dict(answer.plan.timing)
    others = planning - timing.get("total", 0.0)
    more = {**({"other attempts": others} if others > 0.0 else {}), **later}
    timing |= {**more, "total": timing.get("total", 0.0) + sum(more.values())}
    return replace(answer, plan=replace(answer.plan, timing=timing))


def draw(
    scene: Scene,
    task: Task,
    arm: tuple[Robot, ReachMap | ArmLength],
    answer: PlacementResult,
    config: PipelineConfig,
    *,
    plot: Path | None,
    map_file: Path | None,
    seed: int,
) -> None:
    """Write the picture and the opening map, each if there is a file for it."""
    robot, reach = arm
    if plot is not None:
        from momapos.apps.plots import draw_answer

        draw_answer(scene, answer, reach, plot)
    if map_file is not None:
        from momapos.apps.plots import draw_opening_map
        from momapos.planning import opening_map

        from .console import progress

        with progress(f"{robot.name}: opening map") as report:
            farthest = opening_map(
                scene, robot, task, reach, config=config, seed=seed, report=report
            )
        draw_opening_map(scene, answer, farthest, map_file)


def write(answer: PlacementResult, out: Path | None, *, as_json: bool) -> PlacementResult:
    """Write the plan file, if there is one; return the answer with what files and JSON hold.

    Args:
        answer: The answer.
        out: The plan file; None for no file.
        as_json: Whether the plan is to be printed as JSON.
    """
    from momapos.model import with_times
    from momapos.model.plan_files import write_plan

    if out is not None or as_json:
        # Executors need the time of each state.
        plan = answer.with_notes().plan
        answer = replace(answer, plan=with_times(plan, answer.prepared.robot))
    if out is not None:
        write_plan(answer.plan, out)
    return answer


def show(
    answer: PlacementResult, out: Path | None, *, as_json: bool, most: bool, tried: str
) -> None:
    """Print the answer.

    Args:
        answer: The answer.
        out: The plan file; None for no file.
        as_json: Whether to print the plan as JSON.
        most: Whether the largest value was asked for.
        tried: Statuses of all arms; "" for a robot with one arm.
    """
    from momapos.model.plan_files import plan_to_dict

    from .console import summary

    if as_json:
        say(json.dumps(plan_to_dict(answer.plan)))
    else:
        say(summary(answer, out, most=most, tried=tried))
