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

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np

from momapos.core import MomaposError, default_cache_dir
from momapos.model.records import ReachScorer, Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, builtin_names
from momapos.planning import PipelineConfig, PlacementResult, plan_by_method
from momapos.planning.grasps import make_task, openable, slides
from momapos.planning.placement import Method, PlaceConfig
from momapos.planning.reachability import load_reach_map
from momapos.verification import PlanVerifier
from placement import machine, scene_of

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
    scene: Scene, robot: Robot, task: Task, reach: ReachScorer, method: Method,
    *, seed: int, timeout: float,
) -> dict[str, Any]:  # fmt: skip
    """Plan one task and return a row."""
    config = PipelineConfig(place=PlaceConfig(method=method), timeout=timeout)
    clock = time.process_time  # a busy machine gives no method less time
    began = clock()
    answer = plan_by_method(scene, robot, task, reach, config=config, seed=seed, clock=clock)
    row = {
        "method": method,
        "status": answer.plan.status,
        "seconds": clock() - began,
        "cost": answer.plan.navigation_cost,
        "checked": answer.search.checked,
        "first": _from_the_first_pose(answer),
    }
    if answer.plan.motion is not None and answer.plan.base_pose is not None:
        report = PlanVerifier(scene, robot, task).check(answer.plan.base_pose, answer.plan.motion)
        row["valid"] = report.valid
    return row


def _from_the_first_pose(answer: PlacementResult) -> bool:
    """Return whether the feasible pose is the first that was proposed."""
    search = answer.search
    return search.base is not None and bool((search.poses[0][0] == search.base).all())


def run(
    robots: list[str], scenes: list[str], methods: list[Method], *, seed: int, timeout: float
) -> Iterator[dict[str, Any]]:
    """Yield all rows: the grid's first, then the methods' if the grid has an answer."""
    for robot_name in robots:
        robot = load_robot(robot_name)
        reach, warm = load_reach_map(robot, default_cache_dir(), None), False
        for scene_name in scenes:
            scene = scene_of(scene_name)
            for kind, name, task in tasks_of(scene):
                common = {"robot": robot_name, "scene": scene.name, "kind": kind, "task": name}
                try:
                    grid = answer_row(
                        scene, robot, task, reach, "exhaustive", seed=seed, timeout=GRID_TIMEOUT
                    )
                except MomaposError:  # for example an object that is too large for the hand
                    continue
                yield common | grid
                if grid["status"] != "solved":
                    continue
                if not warm:
                    for method in methods:
                        answer_row(scene, robot, task, reach, method, seed=seed, timeout=timeout)
                    warm = True
                for method in methods:
                    row = answer_row(scene, robot, task, reach, method, seed=seed, timeout=timeout)
                    yield common | row | {"cheapest": grid["cost"]}


def report(rows: list[dict[str, Any]]) -> str:
    """Summarize as Markdown."""
    grid = [r for r in rows if r["method"] == "exhaustive"]
    can = [r for r in grid if r["status"] == "solved"]
    lines = [
        f"machine: {machine()}; {len(grid)} tasks, {len(can)} of which the grid solves",
        "",
        "| method | doors | drawers | picks | from its first pose | time, median | 95th percentile "
        "| full checks, mean | driving, median | over the cheapest |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method in dict.fromkeys(r["method"] for r in rows if r["method"] != "exhaustive"):
        mine = [r for r in rows if r["method"] == method]
        solved = [r for r in mine if r["status"] == "solved"]
        if not all(r["valid"] for r in solved):
            raise AssertionError(f"{method}: a plan is not valid in the whole room")
        kinds = " | ".join(_share([r for r in mine if r["kind"] == kind]) for kind in KINDS)
        seconds = np.array([r["seconds"] for r in mine])
        cost = np.array([r["cost"] for r in solved])
        over = cost - np.array([r["cheapest"] for r in solved])
        driving = f"{np.median(cost):.2f} m | {np.median(over):+.2f} m" if len(solved) else "- | -"
        lines.append(
            f"| {method} | {kinds} | {_first(mine)} "
            f"| {np.median(seconds):.2f} s | {np.percentile(seconds, 95):.2f} s "
            f"| {np.mean([r['checked'] for r in mine]):.1f} | {driving} |"
        )
    return "\n".join(lines)


def _share(rows: list[dict[str, Any]]) -> str:
    return f"{sum(r['status'] == 'solved' for r in rows)} of {len(rows)}"


def _first(rows: list[dict[str, Any]]) -> str:
    """Format the count of first poses; ours has none, since it compares all samples of a round."""
    ours = rows[0]["method"] == "ours"
    return "-" if ours else f"{sum(r['first'] for r in rows)} of {len(rows)}"


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=["segway_ur5e"])
    parser.add_argument("--scenes", nargs="+", default=list(builtin_names()))
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--timeout", type=float, default=20.0)
    parser.add_argument("--out", type=Path, default=Path("bench_out"))
    args = parser.parse_args()
    rows = []
    for row in run(args.robots, args.scenes, args.methods, seed=args.seed, timeout=args.timeout):
        rows.append(row)
        print(json.dumps(row), flush=True)
    print(report(rows))
    args.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": machine(), "seed": args.seed, "rows": rows}, indent=1)
    (args.out / "placers.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
