"""Measure the minimum time of an answer: the time with a given base pose.

    python benchmarks/least_time.py DIR [--methods ours m3 ...] [--limit 60] [--out bench_out]

DIR is a results folder of `momapos bench run`. Its one-step tasks that move a joint and that all
methods solve are planned again by each method, and once more with the method's base pose as the
only candidate: this time does not depend on how a method chooses. "least" is the smallest such time
of each task. Processor time by stage of the second of two answers, with warm caches.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.apps.bench import all_rows, method_config, read_folder
from momapos.apps.bench.bench_records import SuiteTask
from momapos.apps.bench.folder import scene_path
from momapos.apps.bench.methods import without
from momapos.core import Stopwatch
from momapos.model.scene import load_scene
from momapos.planning import (
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    plan_by_method,
    prepare_search,
)
from momapos.planning.grasps import make_task, task_motion
from momapos.planning.placement import search_in_order
from placement import arm, machine
from rows import commands, keep_rows, markdown

if TYPE_CHECKING:
    from jaxtyping import Float

TIMEOUT = 20.0
"""Processor time for one answer [s]."""
PLAIN = method_config("m3", TIMEOUT)
"""Without departure check and cost terms, as for every method but ours."""


def answer_from(query: PlacementQuery, base: Float[np.ndarray, "3"]) -> PlacementResult:
    """Plan from one base pose, with more than one grasp if one is not enough.

    Args:
        query: The question.
        base: x [m], y [m], yaw [rad].
    """
    with query.watch.stage("model"):
        motion = task_motion(query.scene, query.robot, query.task, query.config.motion)
    ready = prepare_search(query, query.scene, motion)
    place = query.config.place
    with query.watch.stage("search"):
        found = search_in_order(ready.problem, iter([base[None]]), place)
    for way in ready.multi_grasp_variants() if found.is_no else ():
        with query.watch.stage("search"):
            found.merge(search_in_order(ready.with_grasps(way), iter([base[None]]), place))
        if not found.is_no:
            break
    result = ready.result(found)
    return replace(result, plan=replace(result.plan, timing=query.watch.timing))


def measure(folder: Path, task: SuiteTask, methods: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return the seconds by stage of each method's answer, and with its base pose given.

    Empty if a method does not solve the task.
    """
    robot, reach = arm(task.robot)
    scene = load_scene(scene_path(folder, task.scene)).with_joints(task.joints)
    scene = without(scene, task.carried) if task.carried else scene
    wanted = make_task(scene, task.verb, task.object, task.joint, task.to)
    start = None if task.start is None else np.array(task.start)

    def query_with(config: PipelineConfig) -> PlacementQuery:
        watch = Stopwatch(time.process_time)
        return PlacementQuery(
            scene, robot, wanted, reach, start, config, seed=task.seed, watch=watch
        )

    found: dict[str, dict[str, float]] = {}
    for method in methods:
        config = method_config(method, TIMEOUT)
        for _ in range(2):
            plan = plan_by_method(
                scene, robot, wanted, reach, start=start, config=config, seed=task.seed,
                clock=time.process_time,
            ).plan  # fmt: skip
            if plan.status != "solved" or plan.base_pose is None:
                return {}
            least = answer_from(query_with(PLAIN), np.array(plan.base_pose)).plan
        if least.status != "solved":
            return {}
        found[method], found[f"{method}, given pose"] = dict(plan.timing), dict(least.timing)
    least_of = min((f"{method}, given pose" for method in methods), key=lambda n: found[n]["total"])
    found["least"] = found[least_of]
    return found


def report(measured: Sequence[dict[str, dict[str, float]]]) -> str:
    """Format the medians as Markdown [ms]."""
    columns: dict[str, list[dict[str, float]]] = defaultdict(list)
    for one in measured:
        for name, timing in one.items():
            columns[name].append(timing)
    stages = dict.fromkeys(stage for timings in columns.values() for t in timings for stage in t)
    names = ["total", *(stage for stage in stages if stage != "total")]
    lines = [
        (
            name,
            *(f"{1000 * np.median([t.get(stage, 0.0) for t in some]):.1f} ms" for stage in names),
        )
        for name, some in columns.items()
    ]
    return markdown(["", *names], lines)


def main(
    folder: Path, methods: tuple[str, ...] = ("ours", "m3"), limit: int = 60,
    out: Path | None = None,
) -> None:  # fmt: skip
    """Measure the tasks that all methods solve.

    Args:
        folder: Results of `momapos bench run`.
        methods: Methods of the run.
        limit: Number of tasks, spaced evenly over all.
        out: Folder for least_time.json.
    """
    unsolved = {row.task for row in all_rows(folder) if row.outcome != "solved"}
    tasks = [
        task
        for task in read_folder(folder).suite.tasks
        if task.joint is not None and task.inside is None and task.name not in unsolved
    ]
    tasks = [tasks[k] for k in np.unique(np.linspace(0, len(tasks) - 1, limit).astype(int))]
    measured = [found for task in tasks if (found := measure(folder, task, methods))]
    print(f"machine: {machine()}; {len(measured)} of {len(tasks)} tasks, processor time\n")
    print(report(measured))
    keep_rows(measured, out, "least_time")


if __name__ == "__main__":
    commands(__doc__, main)
