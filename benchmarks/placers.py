"""Compare all base placement methods: same tasks, checks, arm motions and time.

    python benchmarks/placers.py [--robots segway_ur5e ...] [--scenes kitchen_small ...]
        [--methods ours habitat ...] [--seed 0] [--timeout 20] [--out bench_out]

Tasks are the doors and drawers of the rooms and the objects in them that fit the hand. An
exhaustive grid of 5 cm and 10 degrees determines which tasks are feasible, and the cheapest base
pose; the methods get the feasible tasks. Every plan is verified again in the whole room. Times are
processor times of an answer, warm. "From its first pose" counts tasks that a method solves with the
first pose that it proposes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from momapos.core import MomaposError
from momapos.model.records import Task
from momapos.model.scene import Scene, builtin_names
from momapos.planning import PipelineConfig, plan_by_method
from momapos.planning.grasps import make_task, openable, slides
from momapos.planning.placement import Method, PlaceConfig
from momapos.verification import PlanVerifier
from placement import arm, machine, scene_of
from rows import commands, emit, keep_rows, markdown

METHODS = tuple(method for method in get_args(Method) if method != "exhaustive")
KINDS = ("door", "drawer", "pick")
GRID_TIMEOUT = 120.0
"""Time limit of the grid for one task [s]."""


def tasks_of(scene: Scene) -> Iterator[tuple[str, str, Task]]:
    """Yield kind, name and task of all openings, and of all rigid objects on surfaces."""
    for item, joint in openable(scene):
        task = make_task(scene, "open", item, joint)
        yield "drawer" if slides(scene, task) else "door", f"{item}/{joint}", task
    for rigid in scene.objects:
        try:
            task = make_task(scene, "pick", rigid.name)
        except MomaposError:
            continue
        yield "pick", rigid.name, task


def answer_row(
    scene: Scene, of_robot: str, task: Task, method: Method, *, seed: int, timeout: float
) -> dict[str, Any]:
    """Plan one task and return a row."""
    config = PipelineConfig(place=PlaceConfig(method=method), timeout=timeout)
    clock, (robot, reach) = time.process_time, arm(of_robot)  # a busy machine gives no less time
    began = clock()
    answer = plan_by_method(scene, robot, task, reach, config=config, seed=seed, clock=clock)
    search = answer.search
    row = {
        "method": method,
        "status": answer.plan.status,
        "seconds": clock() - began,
        "cost": answer.plan.navigation_cost,
        "checked": search.checked,
        "first": search.base is not None and bool((search.poses[0][0] == search.base).all()),
    }
    if answer.plan.motion is not None and answer.plan.base_pose is not None:
        report = PlanVerifier(scene, robot, task).check(answer.plan.base_pose, answer.plan.motion)
        row["valid"] = report.valid
    return row


def rows_of(
    robots: Sequence[str], scenes: Sequence[str], methods: Sequence[Method], seed: int,
    timeout: float,
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """Yield all rows: the grid's first, then the methods' if the grid has an answer."""
    for of_robot in robots:
        warm = False
        every = ((room, *one) for room in map(scene_of, scenes) for one in tasks_of(room))
        for scene, kind, name, task in every:
            common = {"robot": of_robot, "scene": scene.name, "kind": kind, "task": name}
            try:
                grid = answer_row(
                    scene, of_robot, task, "exhaustive", seed=seed, timeout=GRID_TIMEOUT
                )
            except MomaposError:  # for example an object that is too large for the hand
                continue
            yield common | grid
            if grid["status"] != "solved":
                continue
            for _ in range(1 if warm else 2):  # the first answers load the kernels
                rows = [
                    answer_row(scene, of_robot, task, method, seed=seed, timeout=timeout)
                    for method in methods
                ]
            warm = True
            yield from (common | row | {"cheapest": grid["cost"]} for row in rows)


def report(rows: list[dict[str, Any]]) -> str:
    """Summarize as Markdown."""
    grid = [r for r in rows if r["method"] == "exhaustive"]
    can = [r for r in grid if r["status"] == "solved"]
    lines = []
    for method in dict.fromkeys(r["method"] for r in rows if r["method"] != "exhaustive"):
        mine = [r for r in rows if r["method"] == method]
        solved = [r for r in mine if r["status"] == "solved"]
        if not all(r["valid"] for r in solved):
            raise AssertionError(f"{method}: a plan is not valid in the whole room")
        kinds = [_share([r for r in mine if r["kind"] == kind]) for kind in KINDS]
        # Ours has no first pose, since it compares all samples of a round.
        first = "-" if method == "ours" else f"{sum(r['first'] for r in mine)} of {len(mine)}"
        times = [
            f"{np.percentile([r['seconds'] for r in mine], share):.2f} s" for share in (50, 95)
        ]
        cost = np.array([r["cost"] for r in solved])
        over = cost - np.array([r["cheapest"] for r in solved])
        driving = (
            (f"{np.median(cost):.2f} m", f"{np.median(over):+.2f} m") if solved else ("-", "-")
        )
        checks = f"{np.mean([r['checked'] for r in mine]):.1f}"
        lines.append((method, *kinds, first, *times, checks, *driving))
    head = ("method", "doors", "drawers", "picks", "from its first pose", "time, median",
            "95th percentile", "full checks, mean", "driving, median",
            "over the cheapest")  # fmt: skip
    count = f"{len(grid)} tasks, {len(can)} of which the grid solves"
    return f"machine: {machine()}; {count}\n\n{markdown(head, lines)}"


def _share(rows: list[dict[str, Any]]) -> str:
    return f"{sum(r['status'] == 'solved' for r in rows)} of {len(rows)}"


def main(
    robots: tuple[str, ...] = ("segway_ur5e",), scenes: tuple[str, ...] = tuple(builtin_names()),
    methods: tuple[Method, ...] = METHODS, seed: int = 0, timeout: float = 20.0,
    out: Path = Path("bench_out"),
) -> None:  # fmt: skip
    """Compare methods.

    Args:
        robots: Robots of the library.
        scenes: Built-in kitchens, or scenes of the real data.
        methods: Methods to compare with the grid.
        seed: Seed of all answers.
        timeout: Time limit of an answer [s].
        out: Folder for placers.json.
    """
    rows = []
    for row in rows_of(robots, scenes, methods, seed, timeout):
        rows.append(row)
        emit(row)
    print(report(rows))
    keep_rows({"machine": machine(), "seed": seed, "rows": rows}, out, "placers")


if __name__ == "__main__":
    commands(__doc__, main)
