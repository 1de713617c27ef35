"""Compare the driving length of answers with the cheapest base pose of the grid.

    python benchmarks/cheapest.py [--robots fetch ...] [--tasks 40] [--out DIR]

Random doors and drawers of the kitchens of placement.py are planned with the default cost, which
puts base-pose robustness first; with a smaller robustness margin; with robustness weighed against
driving; without it, for the shortest drive; and by a grid of 5 cm and 10 degrees in driving order,
with and without robustness. The extra driving of the grid with robustness is the price of
robustness; that of the default answer over the grid with robustness is the loss of sampling. The
benefit of robustness is the share of neighboring base poses, 2 cm and 2 degrees or 5 cm and 5
degrees off each answer, from which the arm still does the task.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.job import works_disturbed
from momapos.core import default_cache_dir
from momapos.model.robots import load_robot
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import load_reach_map
from placement import ROBOTS, machine, openings, scene_of
from rows import keep_rows

VARIANTS = {
    "usual": PlaceConfig(),
    "margin 2 cm": PlaceConfig(margin=0.02),
    "robustness weight 0.4": PlaceConfig(weight_robustness=0.4),
    "robustness weight 0.15": PlaceConfig(weight_robustness=0.15),
    "no robustness weight": PlaceConfig(weight_robustness=0.0),
    "grid with robustness": PlaceConfig(method="exhaustive", weight_robustness=100.0),
    "grid": PlaceConfig(method="exhaustive", weight_robustness=0.0),
}
NEIGHBORS = 4
"""Number of base poses near each answer, at 2 cm and at 5 cm [-]."""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--tasks", type=int, default=40, help="solved openings, drawn at random")
    parser.add_argument("--out", type=Path, help="folder for cheapest.json")
    args = parser.parse_args()
    every = openings(args.robots)
    rows: list[dict[str, Any]] = []
    for index in np.random.default_rng(1).permutation(len(every)):
        if len(rows) == args.tasks:
            break
        row = answers(*every[index])
        if row is not None:
            rows.append(row)
            print(json.dumps(row), flush=True)
    print(f"machine: {machine()}; {len(rows)} openings solved by all")
    grid = np.array([row["grid"]["drive"] for row in rows])
    for variant in VARIANTS:
        drives = np.array([row[variant]["drive"] for row in rows])
        spent = np.median([row[variant]["seconds"] for row in rows])
        at_2cm, at_5cm = np.mean([row[variant]["nearby"] for row in rows], axis=0)
        print(
            f"{variant}: {drives.mean():.3f} m on average, {drives.sum() / grid.sum() - 1.0:+.1%} "
            f"in all, {np.median(drives / grid) - 1.0:+.1%} at the median; {spent:.2f} s of "
            f"processor; feasible nearby {at_2cm:.0%}, {at_5cm:.0%}"
        )
    keep_rows(rows, args.out, "cheapest")


def answers(of_robot: str, name: str, item: str, joint: str) -> dict[str, Any] | None:
    """Return drive, time and robustness of each answer to an opening; None if any fails."""
    row: dict[str, Any] = {"robot": of_robot, "scene": name, "object": item, "joint": joint}
    scene, robot = scene_of(name), load_robot(of_robot)
    reach = load_reach_map(robot, default_cache_dir(), None)
    task = make_task(scene, "open", item, joint)
    for variant, place in VARIANTS.items():
        config = PipelineConfig(place=place, timeout=120.0)
        began = time.process_time()
        plan = plan_base_placement(scene, robot, task, reach, config=config).plan
        row[variant] = {"drive": plan.navigation_cost, "seconds": time.process_time() - began}
        if plan.motion is None:
            return None
        works = works_disturbed(plan, scene, robot, reach, count=NEIGHBORS, config=config, seed=0)
        row[variant]["nearby"] = works.mean(1).tolist()
    return row


if __name__ == "__main__":
    main()
