"""Is anything called infeasible that the grid with all families of grasps can solve?

    python benchmarks/completeness.py [--robots fetch ...] [--half tuned|measured] [--tasks 40]
                                      [--cells 4] [--kitchens] [--out DIR]

Every door and drawer of the kitchens of placement.py and of the objects of objects.py that is
called infeasible is asked of the whole grid again, with all families, without a limit of time that
matters, and with a reachability map that rules out only what is so many of its cells beyond the
boundary; inverse kinematics locks redundant joints at 33 values instead of 9. What that solves was
wrongly called infeasible. Answers that ran out of time are counted apart.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from momapos.core.cache import default_cache_dir
from momapos.core.errors import MomaposError
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.tasks import make_task, openable
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.plan import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.planning.reachability.reach_map import ReachMap
from objects import HALVES, half_of, tasks
from placement import ROBOTS, SCENES, machine, scene_of

CONFIG = PipelineConfig(timeout=120.0)
GRID = PipelineConfig(place=PlaceConfig(method="exhaustive"), timeout=3600.0)


def openings(
    half: str | None, robots: list[str], *, kitchens: bool
) -> Iterator[tuple[str, str, Scene, str, str]]:
    """Robot, name, room, object and joint of every opening: those of the kitchens first."""
    scenes = {name: scene_of(name) for name in SCENES}
    for robot in robots:
        for name, scene in scenes.items():
            for item, joint in openable(scene):
                yield robot, Path(name).stem, scene, item, joint
    for robot, name, scene, joint in [] if kitchens else tasks(half, robots):
        yield robot, name, scene, "object", joint


def ask(
    robot: Robot, reach: ReachMap, name: str, scene: Scene, item: str, joint: str, cells: float
) -> dict[str, Any]:
    """The answer, and what the grid says where that is a "no"."""
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
    """Count by robot, as Markdown."""
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
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    parser.add_argument("--tasks", type=int, help="as many openings, from the first")
    parser.add_argument("--kitchens", action="store_true", help="without the objects")
    parser.add_argument("--cells", type=float, default=4.0, help="doubt in the map [cells]")
    parser.add_argument("--out", type=Path, help="folder for completeness.json")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    robots = {name: load_robot(name) for name in args.robots}
    maps = {n: load_reach_map(r, default_cache_dir(), None) for n, r in robots.items()}
    asked = openings(args.half, args.robots, kitchens=args.kitchens)
    for robot, name, scene, item, joint in list(asked)[: args.tasks]:
        rows.append(ask(robots[robot], maps[robot], name, scene, item, joint, args.cells))
        wrong = rows[-1].get("grid") == "solved"
        if wrong and (item != "object" or half_of(name) == HALVES[0]):
            print(json.dumps(rows[-1]), flush=True)
    print(report(rows))
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "completeness.json").write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
