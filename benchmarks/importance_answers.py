"""Measure the effect of importance on an answer: misses, rounds and modeling time.

    python benchmarks/importance_answers.py [--robot segway_ur5e] [--runs everything reach]

Every door and drawer with a handle in the five kitchens of the BestMan simulator and the built-in
ones, with each scorer and with all objects modeled. A miss is a plan that the exact check with all
objects rejects. Processor times, warm.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from momapos.core import MomaposError, default_cache_dir
from momapos.model.records import KeyObjects, Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, builtin_names, load_scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.importance import ImportanceConfig, ScorerName
from momapos.planning.reachability import load_reach_map
from momapos.verification import PlanVerifier
from placement import SCENES, machine, shared

RUNS: tuple[tuple[str, ScorerName, float], ...] = (
    ("everything", "reach", 0.0),
    ("reach", "reach", 0.45),
    ("reach, alpha 0.32", "reach", 0.32),
    ("deepwalk", "deepwalk", 0.45),
    ("distance", "distance", 0.45),
    ("size", "size", 0.45),
)


def questions() -> list[tuple[str, Task]]:
    """Return all openings: the scene's name or path, and the task."""
    names = [str(shared() / "bestman" / name) for name in SCENES] + list(builtin_names())
    found = []
    for name in names:
        scene = load_scene(name)
        for item, joint in openable(scene):
            try:
                found.append((name, make_task(scene, "open", item, joint)))
            except MomaposError:  # it is open already
                continue
    return found


def modeling_seconds(name: str, keep: tuple[str, ...]) -> float:
    """Return the time to build hulls and boxes of some objects of a new scene [s]."""
    scene = load_scene(name)
    began = time.process_time()
    for item in scene.objects:
        if item.name in keep:
            _ = item.model.boxes
    return time.process_time() - began


def row(label: str, robot: Robot, tasks: list[tuple[str, Task]], config: PipelineConfig) -> str:
    """Return one line of the table."""
    reach = load_reach_map(robot, default_cache_dir(), None)
    scenes: dict[str, Scene] = {name: load_scene(name) for name, _ in tasks}
    alpha = config.importance.alpha
    assert alpha is not None
    solved, missed, seconds, keys, cost = 0, 0, [], [], 0.0
    for name, task in tasks:
        plan_base_placement(scenes[name], robot, task, reach, config=config)
        plan = plan_base_placement(
            scenes[name], robot, task, reach, config=config, clock=time.process_time
        ).plan
        seconds.append(plan.timing["total"])
        assert plan.key_objects is not None
        keys.append(plan.key_objects)
        if plan.base_pose is not None and plan.motion is not None:
            exact = PlanVerifier(scenes[name], robot, task)
            missed += exact.first_violation(plan.base_pose, plan.motion) is not None
            solved, cost = solved + 1, cost + (plan.navigation_cost or 0.0)
    cells = [
        label, f"{solved} of {len(tasks)}", str(missed), f"{cost / max(1, solved):.2f} m",
        f"{100 * np.mean([len(k.names) / len(k.scores) for k in keys]):.0f} %",
        f"{np.mean([k.rounds for k in keys]):.2f}",
        str(sum(k.alpha < alpha for k in keys)),
        f"{1e3 * np.median(seconds):.0f} / {1e3 * np.percentile(seconds, 95):.0f} ms",
        f"{1e3 * np.mean(_modeling(tasks, keys)):.0f} ms",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _modeling(tasks: list[tuple[str, Task]], keys: list[KeyObjects]) -> list[float]:
    pairs = zip(tasks, keys, strict=True)
    return [modeling_seconds(name, key.names) for (name, _), key in pairs]


def main() -> None:
    """Run and print Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="segway_ur5e")
    labels = [label for label, _, _ in RUNS]
    parser.add_argument("--runs", nargs="+", choices=labels, default=labels, help="lines")
    args = parser.parse_args()
    robot, tasks = load_robot(args.robot), questions()
    rooms = len({Path(name).stem for name, _ in tasks})
    print(f"machine: {machine()}; {args.robot}, {len(tasks)} tasks in {rooms} rooms\n")
    print(
        "| modeled | solved | rejected with all objects | drive | S | rounds | alpha lowered "
        "| median / 95th percentile | modeling |"
    )
    print("|" + "---|" * 9)
    for label, scorer, alpha in (run for run in RUNS if run[0] in args.runs):
        config = PipelineConfig(importance=ImportanceConfig(scorer=scorer, alpha=alpha))
        print(row(label, robot, tasks, config), flush=True)


if __name__ == "__main__":
    main()
