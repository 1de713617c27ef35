"""Run the paper's four tasks in its laboratory in physics, with random table poses.

    python benchmarks/paper_tasks.py [--trials 50] [--methods ours] [--seed 0] [--out bench_out]

Grasp an apple, grasp a cup, open the right-hinged fridge and the left-hinged microwave by 90
degrees, with a Ranger Mini and an RM63 in `b512.json`. In each trial the table and the objects on
it are moved; the fridge and the robot's start stay. Every method gets the same worlds: it plans a
base pose, the robot drives there with noise, replans the arm's motion and executes it. Prints, and
writes as JSON, time without driving, cost and success next to the paper's numbers.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.metrics import LABORATORY
from momapos.apps.bench.paper_rooms import (
    LABORATORY_FILE,
    TASKS,
    authors_data,
    draw_layout,
    small_objects,
)
from momapos.core import MomaposError, default_cache_dir
from momapos.model.records import ReachScorer, Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PipelineConfig, plan_by_method
from momapos.planning.grasps import make_task
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import load_reach_map
from momapos.workflows import run_plan
from placement import machine
from placers import METHODS

ROBOT = "ranger_rm63"


def trial(
    scene: Scene, robot: Robot, reach: ReachScorer, task: Task, method: str, seed: int
) -> dict[str, object]:
    """Plan a base pose, drive there and execute the task."""
    config = PipelineConfig(
        place=PlaceConfig(method=method),  # type: ignore[arg-type]
        timeout=120.0,
    )
    clock = time.process_time
    try:
        plan = plan_by_method(scene, robot, task, reach, config=config, seed=seed, clock=clock).plan
        row: dict[str, object] = {
            "status": plan.status, "place": plan.timing["total"], "cost": plan.navigation_cost
        }  # fmt: skip
        if plan.status != "solved":
            why = next(iter(plan.candidates.rejections), "")
            return {**row, "success": False, "reason": f"{plan.status}: {why}"}
        record = run_plan(plan, scene, robot, reach, config=config, seed=seed, clock=clock)
    except MomaposError as error:
        return {"status": "refused", "success": False, "reason": str(error)}
    done = record.execution
    return {
        **row,
        "success": record.success, "reason": record.reason, "driven": record.driven,
        "visits": len(record.visits), "replan": record.time["plan"],
        "arm": done.simulated if done is not None else None,
        "collisions": [] if done is None else [[c.one, c.other, c.force] for c in done.collisions],
    }  # fmt: skip


def run(trials: int, methods: list[str], tasks: list[str], seed: int) -> list[dict[str, Any]]:
    """Run all trials, with the same worlds for every method."""
    robot, small = load_robot(ROBOT), small_objects()
    room = load_scene(authors_data("paper-real") / LABORATORY_FILE)
    reach = load_reach_map(robot, default_cache_dir(), None)
    rows = []
    plan_by_method(
        room, robot, make_task(room, *TASKS["open microwave"]), reach
    )  # loads the kernels
    for number in range(trials):
        scene = draw_layout(room, robot, small, np.random.default_rng([seed, number]))
        for name in tasks:
            for method in methods:
                task = make_task(scene, *TASKS[name])
                row = {"trial": number, "task": name, "method": method}
                rows.append(row | trial(scene, robot, reach, task, method, number))
                print(json.dumps(rows[-1]), flush=True)
    return rows


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table as Markdown, the paper's rows after ours."""
    lines = [f"machine: {machine()}", ""]
    lines += ["| task | method | trials | planning CPU s | with the arm's motion s | cost m | "
              "driven m | success % |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for task in dict.fromkeys(r["task"] for r in rows):
        for method in dict.fromkeys(r["method"] for r in rows):
            mine = [r for r in rows if (r["task"], r["method"]) == (task, method)]
            acted = [r for r in mine if r.get("arm") is not None]
            plan = [r["place"] + r["replan"] for r in acted]
            whole = [p + r["arm"] for p, r in zip(plan, acted, strict=True)]
            good = 100 * np.mean([r["success"] for r in mine])
            cells = (plan, whole, [r["cost"] for r in acted], [r["driven"] for r in acted])
            numbers = " | ".join(_spread(values) for values in cells)
            lines.append(f"| {task} | {method} | {len(mine)} | {numbers} | {good:.0f} |")
        lines += [
            f"| | {one.name}, as printed | | | {one.time} +- {one.time_spread} | "
            f"{one.driving} +- {one.driving_spread} | | {one.success:.0f} |"
            for one in LABORATORY.lines
            if one.task == task
        ]
    failed = Counter((r["task"], r["method"], str(r["reason"])) for r in rows if not r["success"])
    lines += [f"failed {n} times: {', '.join(what)}" for what, n in failed.most_common()]
    touched = sum(bool(r.get("collisions")) for r in rows)
    again = sum(r.get("visits", 1) > 1 for r in rows)
    return "\n".join([*lines, f"{touched} trials with a collision, {again} with a second drive"])


def _spread(values: list[float]) -> str:
    return f"{np.mean(values):.2f} +- {np.std(values):.2f}" if values else "-"


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["ours"])
    parser.add_argument("--tasks", nargs="+", choices=tuple(TASKS), default=list(TASKS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for paper_tasks.json")
    args = parser.parse_args()
    rows = run(args.trials, args.methods, args.tasks, args.seed)
    print(report(rows))
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"machine": machine(), "rows": rows}, indent=1)
        (args.out / "paper_tasks.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
