"""Check measured tolerances with newly sampled base poses.

    python benchmarks/tolerance.py [--robots fetch ...] [--tasks 24] [--runs 2000] [--out DIR]

Random doors and drawers of the kitchens of placement.py are planned with a tolerance. Then new base
poses are sampled in its disc, --runs in total, and the motion is replanned from each. Poses where
the base collides also count as failures.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import Stopwatch, default_cache_dir
from momapos.model.robots import load_robot
from momapos.planning import BasePoseChecks, PipelineConfig, PlacementQuery, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach_map
from momapos.planning.robust import unit_offsets
from placement import ROBOTS, machine, openings, scene_of
from rows import keep_rows

CONFIG = PipelineConfig()


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--tasks", type=int, default=24, help="number of random openings")
    parser.add_argument("--runs", type=int, default=2000, help="total number of poses")
    parser.add_argument("--out", type=Path, help="folder for tolerance.json")
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    every = openings(args.robots)
    rows: list[dict[str, Any]] = []
    for index in rng.permutation(len(every)):
        if len(rows) == args.tasks:
            break
        of_robot, name, item, joint = every[index]
        scene, robot = scene_of(name), load_robot(of_robot)
        reach = load_reach_map(robot, default_cache_dir(), None)
        task = make_task(scene, "open", item, joint)
        answer = plan_base_placement(scene, robot, task, reach, config=CONFIG)
        plan = answer.plan
        if plan.base_pose is None or plan.motion is None:
            continue
        began = time.process_time()
        found = answer.tolerance
        seconds = time.process_time() - began
        assert found is not None
        watch = Stopwatch(lambda: 0.0)
        query = PlacementQuery(scene, robot, task, reach, config=CONFIG, watch=watch)
        checks = BasePoseChecks(query)
        size = np.array([found.radius, found.radius, found.turn])
        drawn = -(-args.runs // args.tasks) if found.radius else 0
        offsets = unit_offsets(drawn, rng)
        done = sum(
            checks(np.array(plan.base_pose) + offset * size).motion is not None
            for offset in offsets
        )
        rows.append({
            "robot": of_robot, "scene": name, "object": item, "joint": joint, "done": done,
            "radius": found.radius, "runs": len(offsets), "seconds": seconds,
        })  # fmt: skip
        print(json.dumps(rows[-1]), flush=True)
    done, runs = sum(row["done"] for row in rows), sum(row["runs"] for row in rows)
    radii = np.array([row["radius"] for row in rows])
    spent = 1000 * np.array([row["seconds"] for row in rows])
    print(f"machine: {machine()}")
    print(f"{len(rows)} answers, {(radii == 0).sum()} of them without any tolerance")
    print(
        f"radius: median {100 * np.median(radii):.1f} cm; processor time: median "
        f"{np.median(spent):.0f} ms, 95th percentile {np.percentile(spent, 95):.0f} ms"
    )
    print(f"newly sampled poses in the discs: {done} of {runs} work ({done / max(runs, 1):.1%})")
    keep_rows(rows, args.out, "tolerance")


if __name__ == "__main__":
    main()
