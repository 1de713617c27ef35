"""What a robot of a robot file does in the simulator's kitchens: its map, its answers, and physics.

    python benchmarks/robot_openings.py FILE [--scenes Kitchen.json ...] [--most 2] [--run 2]

Prints one JSON object. It says too what share of the tool poses of random arm states planning's
inverse kinematics finds. Of each kitchen some openings are asked for, spread over it, by the
robot's first arm. What is not solved is asked of every pose of a grid of 5 cm and 10 degrees, with
more time: what a search of all of them solves is what the answers are counted against.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from inverse import found_of
from momapos.core.cache import user_cache
from momapos.core.errors import MomaposError
from momapos.model.records.outcomes import PoseStatus
from momapos.model.records.plans import PlacementPlan
from momapos.model.records.protocols import ReachScorer
from momapos.model.robots.robot import Robot, load_robot
from momapos.planning.grasps.hand_boxes import empty_handed
from momapos.planning.grasps.tasks import make_task, openable
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.reachability.evaluation import evaluate
from momapos.planning.reachability.map_store import encode, load_reach
from momapos.planning.reachability.reach_map import ReachMap
from momapos.workflows.run import run_plan
from placement import CONFIG, SCENES, scene_of

POSES, DRAWN = 12_000, 4_000
"""Tool poses near reach that a map is held against, and tool poses of random arm states that
inverse kinematics is asked for [-]."""


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenes", nargs="*", default=SCENES)
    parser.add_argument("--most", type=int, default=2, help="openings of each scene")
    parser.add_argument("--run", type=int, default=2, help="answers that are executed")
    parser.add_argument("--timeout", type=float, default=30.0, help="for one opening [s]")
    parser.add_argument("--grid", type=float, default=30.0, help="for all poses of the grid [s]")
    parser.add_argument("--arm", help="of several; the first by default")
    args = parser.parse_args()
    start, wall = time.process_time(), time.monotonic()
    robot = load_robot(args.file, cache=user_cache(), arm=args.arm)
    began, began_wall = time.process_time(), time.monotonic()
    reach = load_reach(robot)
    built, built_wall = time.process_time() - began, time.monotonic() - began_wall
    found: dict[str, Any] = {"robot": robot.name, "joints": robot.chain.size}
    found |= {"built": built, "built_wall": built_wall, "holds": not empty_handed(robot)}
    rows, solved = [], []
    for name in args.scenes:
        scene = scene_of(name)
        doors = openable(scene)
        for item, joint in doors[:: max(1, len(doors) // args.most)][: args.most]:
            row, plan = answered(robot, reach, name, item, joint, args.timeout)
            first = {"first": time.process_time() - start, "wall": time.monotonic() - wall}
            found = first | found
            if row["status"] in ("infeasible", "timeout"):
                row["grid"] = by_grid(robot, reach, name, item, joint, args.grid)
            rows.append(row)
            print(row, file=sys.stderr, flush=True)
            if plan is not None and plan.status == "solved":
                solved.append((name, plan))
    found |= of_map(reach, robot) | {"found": found_of(robot.chain, DRAWN).share}
    found["answers"] = rows
    found["runs"] = [executed(robot, reach, *pair) for pair in solved[: args.run]]
    print(json.dumps(found))


def of_map(reach: ReachScorer, robot: Robot) -> dict[str, float]:
    """What the map misses and invents near reach [-], and its size [MB]; nothing without one.

    Held against inverse kinematics at 33 values of what is redundant: what the 9 of planning
    overlook is not the map's invention.
    """
    if not isinstance(reach, ReachMap):
        return {}
    near = evaluate(reach, robot, np.random.default_rng(0), POSES, robot.finer.ik, near=True)
    size = len(encode(reach)) / 1e6
    return {"misses": near.misses, "false_positives": near.false_positives, "megabytes": size}


def answered(
    robot: Robot, reach: ReachScorer, scene: str, item: str, joint: str, timeout: float
) -> tuple[dict[str, Any], PlacementPlan | None]:
    """The answer for one opening, and its processor time."""
    row: dict[str, Any] = {"task": f"{Path(scene).stem} {item}/{joint}"}
    room = scene_of(scene)
    began = time.process_time()
    try:
        task = make_task(room, "open", item, joint)
        config = replace(CONFIG, timeout=timeout)
        plan = plan_base_placement(room, robot, task, reach, config=config).plan
    except MomaposError as error:
        return row | {"status": "refused", "why": str(error)[:100]}, None
    most = max(plan.candidates.rejections.items(), key=lambda one: one[1], default=("", 0))
    row |= {"status": plan.status, "seconds": time.process_time() - began, "to": plan.feasible_to}
    return row | {"why": "" if plan.status == "solved" else most[0][:100]}, plan


def by_grid(
    robot: Robot, reach: ReachScorer, scene: str, item: str, joint: str, timeout: float
) -> str:
    """What the whole grid of base poses says of an opening, in one of the words of an answer."""
    room = scene_of(scene)
    config = replace(CONFIG, timeout=timeout, place=PlaceConfig(method="exhaustive"))
    task = make_task(room, "open", item, joint)
    answer = plan_base_placement(room, robot, task, reach, config=config)
    passed = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND)
    found = any(one.status in passed for batch in answer.search.outcomes for one in batch)
    return "solved" if found else str(answer.plan.status)


def executed(robot: Robot, reach: ReachScorer, scene: str, plan: PlacementPlan) -> bool:
    """Whether physics carries an answer out."""
    return run_plan(plan, scene_of(scene), robot, reach).success


if __name__ == "__main__":
    main()
