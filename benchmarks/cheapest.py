"""How much farther than to the cheapest base pose of the grid does an answer drive?

    python benchmarks/cheapest.py [--robots fetch ...] [--tasks 40] [--out DIR]

Doors and drawers of the kitchens of placement.py, drawn at random, are answered as usual, where
room beside a base pose comes first; with less room, with room weighed against the way, and with no
weight on room, so that the shortest drive is asked for; and by a grid of 5 cm and 10 degrees that
is gone through in the order of driving, with room and without. What the grid with room drives
beyond that without is the price of the room; what the usual answer drives beyond the grid with room
is what samples miss. What the room buys is the share of base poses beside each answer, 2 cm and 2
degrees off or 5 of both, from which the arm still does the task.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.disturbances import still_does
from momapos.core.cache import default_cache_dir
from momapos.model.robots.robot import load_robot
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.tasks import make_task
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.plan import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from placement import ROBOTS, machine, openings, scene_of
from rows import keep_rows

ASKED = {
    "usual": PlaceConfig(),
    "2 cm of room": PlaceConfig(margin=0.02),
    "room weighed 0.4": PlaceConfig(weight_room=0.4),
    "room weighed 0.15": PlaceConfig(weight_room=0.15),
    "no weight on room": PlaceConfig(weight_room=0.0),
    "grid with room": PlaceConfig(method="exhaustive", weight_room=100.0),
    "grid": PlaceConfig(method="exhaustive", weight_room=0.0),
}
BESIDE = 4
"""Base poses beside an answer, at 2 cm and at 5 cm [-]."""


def main() -> None:
    """Run it."""
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
    for asked in ASKED:
        drives = np.array([row[asked]["drive"] for row in rows])
        spent = np.median([row[asked]["seconds"] for row in rows])
        at_2cm, at_5cm = np.mean([row[asked]["beside"] for row in rows], axis=0)
        print(
            f"{asked}: {drives.mean():.3f} m on average, {drives.sum() / grid.sum() - 1.0:+.1%} in "
            f"all, {np.median(drives / grid) - 1.0:+.1%} at the median; {spent:.2f} s of "
            f"processor; beside it {at_2cm:.0%}, {at_5cm:.0%}"
        )
    keep_rows(rows, args.out, "cheapest")


def answers(of_robot: str, name: str, item: str, joint: str) -> dict[str, Any] | None:
    """Drive, time and room of each answer to one opening; None where one of them is a "no"."""
    row: dict[str, Any] = {"robot": of_robot, "scene": name, "object": item, "joint": joint}
    scene, robot = scene_of(name), load_robot(of_robot)
    reach = load_reach_map(robot, default_cache_dir(), None)
    task = make_task(scene, "open", item, joint)
    for asked, place in ASKED.items():
        config = PipelineConfig(place=place, timeout=120.0)
        began = time.process_time()
        plan = plan_base_placement(scene, robot, task, reach, config=config).plan
        row[asked] = {"drive": plan.navigation_cost, "seconds": time.process_time() - began}
        if plan.motion is None:
            return None
        works = still_does(plan, scene, robot, reach, count=BESIDE, config=config, seed=0)
        row[asked]["beside"] = works.mean(1).tolist()
    return row


if __name__ == "__main__":
    main()
