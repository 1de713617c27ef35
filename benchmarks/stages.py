"""Measure the time per stage from a scan to a motion, next to the paper's table.

    python benchmarks/stages.py [--rooms 6] [--robot segway_ur5e] [--folder bench_out/scans]

Kitchens are generated and scanned as in scan.py. Every door and drawer of the first reconstructed
fridge and cabinet of each scan is solved with only important objects modeled, as in `momapos
solve`; the arm's motion is not counted. The paper's shares are those of its table.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from momapos.core import TaskError
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.perception import default_tools, model_room, survey
from momapos.planning.grasps import openable
from momapos.planning.reachability import load_reach_map
from momapos.workflows import ScanTask, solve_scan
from placement import machine
from scan_rooms import Room, rooms

MODELING = ("fuse", "boxes", "rows", "model", "write")
PAPER = {"modeling": 58.0, "feasibility": 40.0, "potential": 0.9, "importance": 0.8}
"""Shares of the time in the paper's table [%]."""
KINDS = ("fridge", "cabinet")


def tasks(room: Room, folder: Path) -> Iterator[ScanTask]:
    """Yield the doors and drawers of the first articulated object of each kind in the scan."""
    tools = default_tools()
    made = model_room(survey(room.scan, tools), folder / "whole.json", tools)
    parts = openable(load_scene(made.scene))
    for kind in KINDS:
        first = next((name for name, _ in parts if name.startswith(kind)), None)
        yield from (ScanTask("open", name, joint) for name, joint in parts if name == first)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=6)
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--folder", type=Path, default=Path("bench_out/scans"))
    args = parser.parse_args()
    robot = load_robot(args.robot)
    arms, tools = [(robot, load_reach_map(robot))], default_tools()
    spent: list[dict[str, float]] = []
    ends: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for room in rooms(args.folder, args.rooms):
            for task in tasks(room, Path(folder)):
                out = Path(folder) / "scene.json"
                try:
                    answer = solve_scan(
                        room.scan, arms, task, out, tools=tools, clock=time.process_time
                    )
                except TaskError as error:
                    ends[str(error)] += 1
                    continue
                ends[f"{answer.result.plan.status} at the {len(answer.alphas)}. alpha"] += 1
                spent.append(dict(answer.timing))
    print(f"machine: {machine()}; {len(spent)} tasks in {args.rooms} rooms: {dict(ends)}")
    total = np.array([row["total"] for row in spent])
    print(f"processor time from scan to motion: median {np.median(total):.1f} s")
    print("| stage | median [s] | share | paper |\n|---|---|---|---|")
    stages = {
        "modeling": [sum(row[name] for name in MODELING) for row in spent],
        "importance": [row["importance"] for row in spent],
        "placing": [row["place"] for row in spent],
    }
    theirs = {**PAPER, "placing": PAPER["feasibility"] + PAPER["potential"]}
    for name, seconds in stages.items():
        share = 100 * sum(seconds) / total.sum()
        print(f"| {name} | {np.median(seconds):.3f} | {share:.1f} % | {theirs[name]:.1f} % |")


if __name__ == "__main__":
    main()
