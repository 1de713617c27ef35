"""Measure the number of stops of tours, and the planning time.

    python benchmarks/tours.py [--robots fetch ...] [--tours 12] [--timeout 20] [--out DIR]

Random tours of the two built-in kitchens: two parts are opened, then both are closed. Only parts
that the robot can open in a single task count. Every plan is verified in the scene after the tasks
before it.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import default_cache_dir
from momapos.model.robots import load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PipelineConfig, Request, Tour, plan_base_placement, plan_tour
from momapos.planning.grasps import make_task, openable
from momapos.planning.reachability import load_reach_map
from momapos.verification import PlanVerifier
from placement import ROBOTS, machine
from rows import keep_rows

KITCHENS = ("kitchen_small", "kitchen_island")


def valid(tour: Tour, scene: Scene) -> bool:
    """Return whether every plan is valid in the scene after the tasks before it."""
    held = []
    for step in tour.steps:
        plan = step.plan
        if plan.motion is None or plan.base_pose is None:
            continue
        left = scene.with_joints(plan.scene_joints)
        verifier = PlanVerifier(left, step.prepared.robot, plan.task)
        checks = verifier.check(plan.base_pose, plan.motion).checks
        held += [check.ok for check in (*checks, *verifier.drive_checks(plan))]
    return all(held)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--tours", type=int, default=12)
    parser.add_argument("--timeout", type=float, default=20.0, help="time limit per tour [s]")
    parser.add_argument("--out", type=Path, help="folder for tours.json")
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    config = PipelineConfig(timeout=args.timeout)
    rows: list[dict[str, Any]] = []
    while len(rows) < args.tours:
        kitchen, name = str(rng.choice(KITCHENS)), str(rng.choice(args.robots))
        scene, robot = load_scene(kitchen), load_robot(name)
        reach = load_reach_map(robot, default_cache_dir(), None)
        parts = openable(scene)
        one, two = (parts[i] for i in rng.choice(len(parts), 2, replace=False))
        alone = [
            plan_base_placement(scene, robot, make_task(scene, "open", *part), reach, config=config)
            for part in (one, two)
        ]
        if any(answer.plan.status != "solved" for answer in alone):
            continue
        requests = [
            Request("open", *one), Request("open", *two),
            Request("close", *one), Request("close", *two),
        ]  # fmt: skip
        began = time.process_time()
        tour = plan_tour(scene, robot, requests, reach, config=config, clock=time.process_time)
        rows.append({
            "kitchen": kitchen, "robot": name, "parts": [one, two], "status": tour.status,
            "stops": list(tour.stops), "driving": tour.driving, "valid": valid(tour, scene),
            "seconds": time.process_time() - began,
        })  # fmt: skip
        print(json.dumps(rows[-1]), flush=True)
    done = [row for row in rows if row["status"] == "solved"]
    stops = np.array([max(row["stops"]) for row in done])
    counts = {int(n): int((stops == n).sum()) for n in np.unique(stops)}
    print(f"machine: {machine()}; {len(done)} of {len(rows)} tours of four tasks are solved")
    print(f"tours by their stops: {counts}; all plans valid: {all(row['valid'] for row in rows)}")
    print(f"processor time: {np.median([row['seconds'] for row in rows]):.1f} s at the median")
    keep_rows(rows, args.out, "tours")


if __name__ == "__main__":
    main()
