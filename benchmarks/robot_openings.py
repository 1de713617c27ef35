"""Evaluate a robot file in the simulator's kitchens: map, answers, and execution in physics.

    python benchmarks/robot_openings.py FILE [--scenes Kitchen.json ...] [--most 2] [--run 2]

Prints one JSON object, including the recall of planning's inverse kinematics on tool poses of
random arm states. Some openings of each kitchen, spread over it, are planned for the robot's first
arm. Unsolved ones are searched by a grid of 5 cm and 10 degrees with more time; answers are
compared with this exhaustive search.
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
from momapos.core import USER_CACHE, MomaposError
from momapos.model.records import PlacementPlan, PoseStatus, ReachScorer
from momapos.model.robots import Robot, load_robot
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.grasps.hand_boxes import empty_handed
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import ReachMap, encode, evaluate, load_reach
from momapos.workflows import run_plan
from placement import CONFIG, SCENES, scene_of

POSES, DRAWN = 12_000, 4_000
"""Number of tool poses near reach that evaluate a map, and of tool poses of random arm states that
evaluate inverse kinematics [-]."""


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenes", nargs="*", default=SCENES)
    parser.add_argument("--most", type=int, default=2, help="number of openings per scene")
    parser.add_argument("--run", type=int, default=2, help="number of executed answers")
    parser.add_argument("--timeout", type=float, default=30.0, help="time limit per opening [s]")
    parser.add_argument("--grid", type=float, default=30.0, help="time limit of the grid [s]")
    parser.add_argument("--arm", help="arm of a robot with several; the first by default")
    args = parser.parse_args()
    start, wall = time.process_time(), time.monotonic()
    robot = load_robot(args.file, arm=args.arm)
    began, began_wall = time.process_time(), time.monotonic()
    reach = load_reach(robot)
    built, built_wall = time.process_time() - began, time.monotonic() - began_wall
    found: dict[str, Any] = {"robot": robot.name, "joints": robot.chain.size}
    found |= {"built": built, "built_wall": built_wall, "holds": not empty_handed(robot)}
    rows, solved = [], []
    for name in args.scenes:
        scene = scene_of(name, USER_CACHE)
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
    """Return misses and false positives of the map near reach [-], and its size [MB].

    Empty without a map. The reference is inverse kinematics with redundant joints locked at 33
    values, since the 9 values of planning miss solutions.
    """
    if not isinstance(reach, ReachMap):
        return {}
    near = evaluate(reach, robot, np.random.default_rng(0), POSES, robot.finer.ik, near=True)
    size = len(encode(reach)) / 1e6
    return {"misses": near.misses, "false_positives": near.false_positives, "megabytes": size}


def answered(
    robot: Robot, reach: ReachScorer, scene: str, item: str, joint: str, timeout: float
) -> tuple[dict[str, Any], PlacementPlan | None]:
    """Plan one opening; return the row with the processor time, and the plan."""
    row: dict[str, Any] = {"task": f"{Path(scene).stem} {item}/{joint}"}
    room = scene_of(scene, USER_CACHE)
    began = time.process_time()
    try:
        task = make_task(room, "open", item, joint)
        config = replace(CONFIG, timeout=timeout)
        plan = plan_base_placement(room, robot, task, reach, config=config).plan
    except MomaposError as error:
        return row | {"status": "refused", "why": str(error)[:100]}, None
    row |= {"status": plan.status, "seconds": time.process_time() - began, "to": plan.feasible_to}
    return row | {"why": "" if plan.status == "solved" else why_not(plan)[:100]}, plan


def why_not(plan: PlacementPlan) -> str:
    """Return what the base pose that came nearest lacks, or else the most frequent reason."""
    if plan.candidates.nearest is not None:
        return plan.candidates.nearest.reason
    return max(plan.candidates.rejections.items(), key=lambda one: one[1], default=("", 0))[0]


def by_grid(
    robot: Robot, reach: ReachScorer, scene: str, item: str, joint: str, timeout: float
) -> str:
    """Return the status of an opening from the whole grid of base poses."""
    room = scene_of(scene, USER_CACHE)
    config = replace(CONFIG, timeout=timeout, place=PlaceConfig(method="exhaustive"))
    task = make_task(room, "open", item, joint)
    answer = plan_base_placement(room, robot, task, reach, config=config)
    passed = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND)
    found = any(one.status in passed for one in answer.search.counts())
    return "solved" if found else str(answer.plan.status)


def executed(robot: Robot, reach: ReachScorer, scene: str, plan: PlacementPlan) -> bool:
    """Return whether the execution of an answer in physics succeeds."""
    return run_plan(plan, scene_of(scene), robot, reach).success


if __name__ == "__main__":
    main()
