"""Find how far any base could move a part: a lattice of base poses, values of the part and grasps.

    python benchmarks/moving_lattice.py [--robots stretch hsr] [--sample N] [--only TEXT ...]
                                        [--answers LOG ...] [--no-only] [--out rows.jsonl]

A node is a base pose (10 cm, 22.5 degrees; 10 degrees for arms of five joints, whose base slides
within its cell to the arm state), a grasp and a value of the part at which some arm state is free
and bears the part. Edges join neighboring values: the same base pose, one next to it, or, where
friction holds the part, any. Neither the arm's path between nodes nor that to the grasp counts, so
the farthest value is an upper bound, but for the lattice's resolution. `--answers` reads output of
moving_base.py and compares: an answer must never open farther than the lattice.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from lattice_nodes import Lattice
from lattice_paths import Neighbors, Reach
from momapos.core.cache import user_cache
from momapos.core.errors import MomaposError
from momapos.core.stopwatch import Stopwatch
from momapos.model.records.protocols import ReachScorer
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.task_motions import task_motion
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.query import PlacementQuery
from momapos.planning.reachability.map_store import load_reach
from momapos.planning.search_setup import prepare_search
from placement import machine, openings, shared

_ANSWER = re.compile(r"^(\S+) (fixed|stops|moving) (\S+) (\S+)/(\S+) (solved|infeasible|timeout) ")
MOVED = {"fixed": "fixed", "stops": "stops", "moving": "moving"}
"""The lattice's use that bounds each use of the planner."""


def main() -> None:
    """Print a line for each opening and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="*", default=["stretch"])
    parser.add_argument("--sample", type=int, default=0, help="number of random openings")
    parser.add_argument("--only", nargs="*", default=[], help="openings with one of these texts")
    parser.add_argument("--answers", nargs="*", type=Path, default=[], help="of moving_base.py")
    parser.add_argument("--no-only", action="store_true", help="openings that no answer solves")
    parser.add_argument("--out", type=Path, help="file for a JSON line per opening")
    args = parser.parse_args()
    print(machine())
    answers = read_answers(args.answers)
    for name in args.robots:
        every = openings([name])
        if args.sample:
            drawn = np.random.default_rng(0).permutation(len(every))[: args.sample]
            every = [every[k] for k in sorted(drawn.tolist())]
        chosen = [
            one for one in every
            if (not args.only or any(text in f"{one[1]} {one[2]}/{one[3]}" for text in args.only))
            and not (args.no_only and "solved" in answers.get(one, {}).values())
        ]  # fmt: skip
        rows = list(report(name, chosen, answers))
        print(f"== {name}: {summary(rows)}", flush=True)
        if args.out:
            with args.out.open("a") as file:
                file.writelines(json.dumps(row) + "\n" for row in rows)


def read_answers(logs: Iterable[Path]) -> dict[tuple[str, ...], dict[str, str]]:
    """Return the status by use of each opening in output of moving_base.py."""
    found: dict[tuple[str, ...], dict[str, str]] = {}
    for line in (line for log in logs for line in log.read_text().splitlines()):
        match = _ANSWER.match(line)
        if match:
            robot, use, scene, item, joint, status = match.groups()
            found.setdefault((robot, scene, item, joint), {})[use] = status
    return found


def report(
    name: str,
    every: Iterable[tuple[str, str, str, str]],
    answers: dict[tuple[str, ...], dict[str, str]],
) -> Iterable[dict[str, Any]]:
    """Yield a row for each opening, and print it."""
    robot, cache = load_robot(name, cache=user_cache()), user_cache()
    reach = load_reach(robot)
    scenes: dict[str, Scene] = {}
    for opening in every:
        _, place, item, joint = opening
        if place not in scenes:
            scenes[place] = load_scene(shared() / "bestman" / place, cache=cache)
        row: dict[str, Any] = {"robot": name, "scene": place, "task": f"{item}/{joint}"}
        row |= {"answers": answers.get(opening, {})}
        try:
            row |= farthest(robot, scenes[place], item, joint, reach)
        except MomaposError as error:
            row |= {"why": str(error), "shares": {}, "seconds": 0.0}
        row["exceeded"] = exceeded(row)
        print(line_of(row), flush=True)
        yield row


def farthest(
    robot: Robot, scene: Scene, item: str, joint: str, reach: ReachScorer
) -> dict[str, Any]:
    """Return the share of the way that each use of the base moves a part, and what stops it."""
    began = time.process_time()
    task = make_task(scene, "open", item, joint)
    query = PlacementQuery(scene, robot, task, reach, watch=Stopwatch(time.process_time))
    motion = task_motion(scene, robot, task, query.config.motion)
    setup = prepare_search(query, scene, motion)
    found: dict[str, Any] = {"kind": kind_of(scene, item, joint), "nodes": []}
    blocked, latch = setup.prepared.blocked, motion.latch_q is not None
    lattice = None if blocked or latch else Lattice.of(query, setup, pushes=False)
    if lattice is None or not lattice.sets:
        why = blocked or (
            "a latch is turned" if latch else motion.refusal or setup.prepared.no_grasp
        )
        return found | {"shares": {}, "why": why, "seconds": time.process_time() - began}
    bound, last = through(lattice), len(lattice.values) - 1
    if bound.farthest["fixed"] < last:
        pushing = Lattice.of(query, setup, pushes=True)
        bound = through(pushing) if len(pushing.sets) > len(lattice.sets) else bound
    found["shares"] = {use: at / last if at >= 0 else -1.0 for use, at in bound.farthest.items()}
    found |= {"nodes": bound.nodes, "grasps": bound.lattice.shape[0]}
    return found | {"why": bound.why, "seconds": time.process_time() - began}


def through(lattice: Lattice) -> Reach:
    """Return what the uses of the base reach in a lattice."""
    reach = Reach(lattice, Neighbors(lattice))
    for layer in range(len(lattice.values)):
        if not reach.add(layer, lattice.levels(layer)):
            break
    return reach


def kind_of(scene: Scene, item: str, joint: str) -> str:
    """Return the kind of a part: drawer, flap, or door of a kind of furniture."""
    target = scene.object(item)
    model = target.model.joint(joint)
    words = f"{item}/{joint}".lower()
    kinds = {"fridge": "fridge door", "mic": "microwave", "dishwasher": "dishwasher"}
    named = [kind for text, kind in kinds.items() if text in words]
    if named:
        return named[0]
    if model.kind == "prismatic":
        return "drawer"
    T = target.link_poses()[model.child]
    upright = abs(float((T[:3, :3] @ np.asarray(model.axis, float))[2])) > 0.7
    return "cabinet door" if upright else "flap"


def exceeded(row: dict[str, Any]) -> list[str]:
    """Return the uses whose answers open farther than the lattice."""
    shares = row["shares"]
    return [
        use for use, status in row["answers"].items()
        if status == "solved" and shares.get(MOVED[use], -1.0) < 1.0
    ]  # fmt: skip


def line_of(row: dict[str, Any]) -> str:
    """Return the line of a row."""
    shares = " ".join(f"{use} {share:.2f}" for use, share in row["shares"].items())
    answers = " ".join(f"{use}:{status}" for use, status in row["answers"].items())
    more = f" EXCEEDED by {row['exceeded']}" if row["exceeded"] else ""
    return (
        f"{row['robot']} {row['scene']} {row['task']} ({row.get('kind', '')}) [{answers}] {shares} "
        f"| {row['why']} | {row['seconds']:.1f} s{more}"
    )


def summary(rows: list[dict[str, Any]]) -> dict[str, int]:
    """Return how many openings each use of the base does all the way."""
    uses = dict.fromkeys(use for row in rows for use in row["shares"])
    return {
        use: sum(row["shares"].get(use, -1.0) == 1.0 for row in rows) for use in uses
    } | {"of": len(rows)}  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
