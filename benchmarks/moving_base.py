"""Count the openings that one base pose, several stops and a moving base solve.

    python benchmarks/moving_base.py [--robots stretch hsr] [--uses fixed stops moving] [--out DIR]

Every door and drawer of the five kitchens of `placement.py`. Processor time; every answer is
verified from its file. `--out` keeps the plan files, for other verifiers.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np

from momapos.core.cache import user_cache
from momapos.core.errors import MomaposError
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import load_robot
from momapos.planning.config import BaseUse, PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach
from momapos.verification.plan_check import verify_files
from placement import machine, openings, scene_of, shared


def main() -> None:
    """Print a line for each answer and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="*", default=["stretch", "hsr"])
    parser.add_argument("--uses", nargs="*", default=["fixed", "stops", "moving"])
    parser.add_argument("--limit", type=int, default=0, help="number of openings of each robot")
    parser.add_argument("--out", type=Path, help="folder of the plan files")
    args = parser.parse_args()
    if not set(args.uses) <= set(get_args(BaseUse)):
        parser.error(f"--uses must be of {', '.join(get_args(BaseUse))}")
    print(machine())
    with TemporaryDirectory() as folder:
        for name in args.robots:
            every = openings([name])
            for use in args.uses:
                report(every[: args.limit or None], use, args.out or Path(folder))


def report(every: list[tuple[str, str, str, str]], use: BaseUse, folder: Path) -> None:
    """Answer the openings with one use of the base, and print the counts."""
    robot = load_robot(every[0][0], cache=user_cache())
    reach = load_reach(robot)
    counts: Counter[str] = Counter()
    needed: list[float] = []
    kitchens = {name: scene_of(name) for _, name, _, _ in every}  # read once, as in one program
    for k, (_, scene_name, item, joint) in enumerate(every):
        scene = kitchens[scene_name]
        began = time.process_time()
        try:
            plan = plan_base_placement(
                scene,
                robot,
                make_task(scene, "open", item, joint),
                reach,
                config=PipelineConfig(base=use),
                clock=time.process_time,
            ).plan
        except MomaposError as error:
            print(robot.name, use, scene_name, item, joint, error, flush=True)
            counts["error"] += 1
            continue
        spent = time.process_time() - began
        counts[plan.status] += 1
        if plan.moves_base:
            needed.append(spent)
            counts["with it"] += 1
        if plan.feasible:
            path = folder / f"{robot.name}-{use}-{k}.json"
            write_plan(plan, path)
            counts["valid"] += verify_files(path, shared() / "bestman").valid
        print(
            f"{robot.name} {use} {scene_name} {item}/{joint} {plan.status} {spent:.2f} s",
            flush=True,
        )
    times = np.percentile(needed, [50, 95]).round(2).tolist() if needed else []
    print(f"== {robot.name} {use}: {dict(counts)}, time where needed [s]: {times}", flush=True)


if __name__ == "__main__":
    main()
