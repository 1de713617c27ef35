"""Execute plans whose base moves or stops several times by contact, with noise.

    python benchmarks/moving_runs.py DIR [--count 100] [--seeds 1] [--limit 900] [--only stretch]

DIR holds plan files, such as `moving_base.py --out` keeps. A fixed random sample of those of
version 2 is executed as `momapos run` does: the base drives there with noise, the arm motion is
replanned, and the furniture's mass and friction differ by up to 30 %. The runs end after --limit
seconds of processor time.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np

from execution import SPREAD
from momapos.core import MomaposError
from momapos.model.plan_files import read_plan
from momapos.model.records import ReachScorer
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, as_planned, load_scene
from momapos.planning.reachability import load_reach
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.workflows import run_plan
from placement import machine

HARD = 150.0
"""Force above which a touch counts as hard [N]."""


@cache
def robot_of(name: str) -> tuple[Robot, ReachScorer]:
    """Return a robot of the library and its reachability map."""
    robot = load_robot(name)
    return robot, load_reach(robot)


@cache
def scene_at(path: Path) -> Scene:
    """Return the scene of a plan."""
    return load_scene(path)


def execute(path: Path, seed: int) -> tuple[str, float]:
    """Execute a plan; return "done" or why not, and the hardest touch [N]."""
    plan = read_plan(path)
    robot, reach = robot_of(plan.robot_name)
    physics = ExecutionConfig(hold="contact", furniture=FurnitureConfig(spread=SPREAD))
    try:
        scene = as_planned(scene_at(Path(plan.scene)), plan)
        record = run_plan(plan, scene, robot, reach, seed=seed, physics=physics)
    except MomaposError as error:
        return f"error: {error}", 0.0
    done = record.execution
    force = done.collisions[0].force if done is not None and done.collisions else 0.0
    return "done" if record.success else record.reason, force


def main() -> None:
    """Print a line for each run, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=100, help="number of plans")
    parser.add_argument("--seeds", type=int, default=1, help="number of runs of each plan")
    parser.add_argument("--limit", type=float, default=900.0, help="processor time [s]")
    parser.add_argument("--only", default="", help="text in the names of the files")
    args = parser.parse_args()
    print(machine())
    every = [path for path in sorted(args.folder.glob("*.json")) if args.only in path.name]
    every = [path for path in every if read_plan(path).moves_base]
    drawn = np.random.default_rng(0).permutation(len(every))[: args.count].tolist()
    counts: Counter[str] = Counter()
    hardest, began = 0.0, time.process_time()
    for seed in range(args.seeds):
        for path in [every[k] for k in drawn]:
            if time.process_time() - began > args.limit:
                break
            at = time.process_time()
            how, force = execute(path, seed)
            counts[how if how == "done" else "not done"] += 1
            counts[f"above {HARD:.0f} N"] += force > HARD
            hardest = max(hardest, force)
            spent = time.process_time() - at
            print(f"{path.stem} {seed} {how} {force:.0f} N {spent:.0f} s", flush=True)
    print(f"== {len(every)} plans, {dict(counts)}, hardest touch {hardest:.0f} N")


if __name__ == "__main__":
    main()
