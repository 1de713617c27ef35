"""Count tasks reported infeasible that a grid with all grasp families can solve.

    python benchmarks/completeness.py [--robots fetch ...] [--set development|test] [--tasks 40]
                                      [--cells 4] [--kitchens] [--out DIR]

Every door and drawer of the kitchens of placement.py and the objects of objects.py that is reported
infeasible is searched again by the whole grid, with all grasp families, practically no time limit,
and a reachability map that excludes only tool poses at least --cells cells beyond its boundary;
inverse kinematics locks redundant joints at 33 values instead of 9. Tasks that this solves were
wrongly reported infeasible. Timeouts are counted separately.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from momapos.apps.bench.articulated import SETS, set_of
from momapos.core import MomaposError, default_cache_dir
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import ReachMap, load_reach_map
from objects import tasks
from placement import ROBOTS, SCENES, machine, scene_of

CONFIG = PipelineConfig(timeout=120.0)
GRID = PipelineConfig(place=PlaceConfig(method="exhaustive"), timeout=3600.0)


def openings(
    subset: str | None, robots: list[str], *, kitchens: bool
) -> Iterator[tuple[str, str, Scene, str, str]]:
    """Yield robot, name, room, object and joint of every opening, kitchens first."""
    scenes = {name: scene_of(name) for name in SCENES}
    for robot in robots:
        for name, scene in scenes.items():
            for item, joint in openable(scene):
                yield robot, Path(name).stem, scene, item, joint
    for robot, name, scene, joint in [] if kitchens else tasks(subset, robots):
        yield robot, name, scene, "object", joint


def search_again(
    robot: Robot, reach: ReachMap, name: str, scene: Scene, item: str, joint: str, cells: float
) -> dict[str, Any]:
    """Return the answer and, if it is infeasible, the result of the grid."""
    row: dict[str, Any] = {"robot": robot.name, "scene": name, "task": f"{item}/{joint}"}
    try:
        task = make_task(scene, "open", item, joint)
        plan = plan_base_placement(scene, robot, task, reach, config=CONFIG).plan
    except MomaposError as error:
        return {**row, "status": "refused", "reason": str(error)}
    row["status"] = plan.status
    if plan.status != "infeasible":
        return row
    generous = replace(reach, threshold=reach.threshold - cells)
    found = plan_base_placement(scene, robot.finer, task, generous, config=GRID).plan
    return {**row, "grid": found.status, "base_pose": found.base_pose}


def report(rows: list[dict[str, Any]]) -> str:
    """Return the counts by robot, as Markdown."""
    lines = [
        f"machine: {machine()}", "",
        "| robot | openings | solved | infeasible | wrongly | out of time |",
        "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        count = {
            s: sum(r["status"] == s for r in mine) for s in ("solved", "infeasible", "timeout")
        }
        wrong = sum(row.get("grid") == "solved" for row in mine)
        lines.append(
            f"| {robot} | {len(mine)} | {count['solved']} | {count['infeasible']} | {wrong} | "
            f"{count['timeout']} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--set", choices=SETS, default=SETS[0])
    parser.add_argument("--tasks", type=int, help="number of openings, from the first")
    parser.add_argument("--kitchens", action="store_true", help="kitchens only")
    parser.add_argument("--cells", type=float, default=4.0, help="uncertainty of the map [cells]")
    parser.add_argument("--out", type=Path, help="folder for completeness.json")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    robots = {name: load_robot(name) for name in args.robots}
    maps = {n: load_reach_map(r, default_cache_dir(), None) for n, r in robots.items()}
    tasks = openings(args.set, args.robots, kitchens=args.kitchens)
    for robot, name, scene, item, joint in list(tasks)[: args.tasks]:
        rows.append(search_again(robots[robot], maps[robot], name, scene, item, joint, args.cells))
        wrong = rows[-1].get("grid") == "solved"
        if wrong and (item != "object" or set_of(name) == SETS[0]):
            print(json.dumps(rows[-1]), flush=True)
    print(report(rows))
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "completeness.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
