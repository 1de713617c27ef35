"""Ask directly for openings beyond the stated maximum: none may be solved.

    python benchmarks/farthest.py [--robots fetch ...] [--set development|test] [--tasks 20]
                                  [--values 6] [--seed 0] [--out DIR]

The rooms and openings are those of `objects.py`. Where an opening is infeasible, its stated maximum
is compared with direct questions of the same seed for larger values: whole degrees or centimeters,
all of them or (--values) the next three and some drawn at random. A larger value with a plan
contradicts the statement. Contradictions of the `test` set are only counted.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.articulated import SETS, set_of
from momapos.core import MomaposError, default_cache_dir
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene
from momapos.planning import plan_base_placement, with_max_opening
from momapos.planning.grasps import make_task, slides
from momapos.planning.max_opening import values_before
from momapos.planning.reachability import load_reach_map
from objects import CONFIG, tasks
from placement import ROBOTS, machine
from rows import keep_rows

NEXT = 3
"""Values right after the stated one that are always asked for [-]."""


@dataclass(frozen=True)
class Answer:
    """An opening, its stated maximum, and what direct questions find beyond it."""

    status: str
    goal: float
    """Requested value [rad] or [m]."""
    stated: float | None = None
    """Stated maximum [rad] or [m]."""
    sure: bool = False
    asked: tuple[float, ...] = ()
    """Larger values that were asked for [rad] or [m]."""
    solved: tuple[float, ...] = ()
    """Those with a plan, which contradict the statement [rad] or [m]."""
    seconds: tuple[float, float] = (0.0, 0.0)
    """Processor time of the answer and of its stated maximum [s]."""


def ask(robot: Robot, scene: Scene, joint: str, count: int | None, seed: int) -> Answer:
    """Ask for an opening, and if it is infeasible, for values beyond its stated maximum.

    Args:
        robot: The robot.
        scene: The room, with the part in `object`.
        joint: The part's joint.
        count: Number of larger values to ask for; None for all.
        seed: Seed of all questions.
    """
    reach = load_reach_map(robot, default_cache_dir(), None)
    task = make_task(scene, "open", "object", joint)
    assert task.to is not None
    begun = time.process_time()
    answer = plan_base_placement(scene, robot, task, reach, config=CONFIG, seed=seed)
    between = time.process_time()
    if answer.plan.status != "infeasible":
        return Answer(answer.plan.status, task.to, seconds=(between - begun, 0.0))
    plan = with_max_opening(answer).plan
    seconds = between - begun, time.process_time() - between
    first = scene.object("object").values()[joint] if plan.feasible_to is None else plan.feasible_to
    values = values_before(first, task.to, slides=slides(scene, task))
    if count is not None:
        later = np.random.default_rng(seed).permutation(np.arange(NEXT, len(values)))
        order = np.append(np.arange(min(NEXT, len(values))), later)
        values = values[np.sort(order[:count])]
    solved = [
        to
        for to in values.tolist()
        if plan_base_placement(
            scene, robot, replace(task, to=to), reach, config=CONFIG, seed=seed
        ).plan.status
        == "solved"
    ]
    return Answer(
        "infeasible", task.to, plan.feasible_to, bool(plan.feasible_sure), tuple(values.tolist()),
        tuple(solved), seconds,
    )  # fmt: skip


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table by set and robot."""
    lines = [f"machine: {machine()}"]
    lines += [
        "| set | robot | openings | infeasible | stated | sure | asked beyond | solved there |"
    ]
    lines += ["|---" * 8 + "|"]
    for subset in SETS:
        for robot in sorted({row["robot"] for row in rows if row["set"] == subset}):
            mine = [row for row in rows if (row["set"], row["robot"]) == (subset, robot)]
            no = [row for row in mine if row["status"] == "infeasible"]
            counts = [
                len(mine), len(no), sum(row["stated"] is not None for row in no),
                sum(row["sure"] for row in no), sum(len(row["asked"]) for row in no),
                sum(len(row["solved"]) for row in no),
            ]  # fmt: skip
            lines.append(f"| {subset} | {robot} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--set", choices=SETS, help="only the objects of one set")
    parser.add_argument("--tasks", type=int, help="number of openings, drawn at random")
    parser.add_argument("--values", type=int, help="number of larger values to ask for")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for farthest.json")
    args = parser.parse_args()
    robots = {name: load_robot(name) for name in args.robots}
    rows = []
    for name, item, scene, joint in tasks(args.set, args.robots)[: args.tasks]:
        row: dict[str, Any] = {"robot": name, "object": item, "joint": joint}
        row["set"] = set_of(item)
        try:
            row |= vars(ask(robots[name], scene, joint, args.values, args.seed))
        except MomaposError as error:
            row |= {"status": "refused", "reason": str(error)}
        rows.append(row)
        if row["set"] == SETS[0]:
            print(json.dumps(row), flush=True)
    print(report(rows))
    keep_rows(rows, args.out, "farthest")


if __name__ == "__main__":
    main()
