"""Find how far any base could move a part: a lattice of base poses, values of the part and grasps.

    python benchmarks/moving_lattice.py [--robots stretch hsr] [--sample N] [--only TEXT ...]
                                        [--answers LOG ...] [--no-only] [--rows rows.jsonl]

A node is a base pose (10 cm, 22.5 degrees; 10 degrees for arms of five joints, whose base slides
within its cell to the arm state), a grasp and a value of the part at which some arm state is free
and bears the part. Edges join neighboring values: the same base pose, one next to it, or, where
friction holds the part, any. Neither the arm's path between nodes nor that to the grasp counts, so
the farthest value is an upper bound, but for the lattice's resolution. `--answers` reads output of
moving_base.py and compares: an answer must never open farther than the lattice. `--rows` keeps a
line of JSON for each opening; openings whose line is there are not computed again. With `--no-only`
an opening that an answer solves counts as one that the lattice solves.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from lattice_nodes import Lattice
from lattice_paths import Neighbors, Reach
from momapos.core import USER_CACHE, MomaposError, Stopwatch
from momapos.model.records import ReachScorer
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PlacementQuery, prepare_search
from momapos.planning.grasps import make_task, task_motion
from momapos.planning.reachability import load_reach
from placement import machine, openings, shared

_ANSWER = re.compile(r"^(\S+) (fixed|stops|moving) (\S+) (\S+)/(\S+) (solved|infeasible|timeout) ")
Opening: TypeAlias = tuple[str, str, str, str]
"""Robot, scene, object and joint."""
Answers: TypeAlias = dict[Opening, dict[str, str]]
"""Status by use of each opening."""
Row: TypeAlias = dict[str, Any]
ANSWERED = ("fixed", "stops", "moving")
"""Uses of the planner; the lattice's uses of these names bound them."""


def main() -> None:
    """Print a line for each opening, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="*", default=["stretch"])
    parser.add_argument("--sample", type=int, default=0, help="number of random openings")
    parser.add_argument("--only", nargs="*", default=[], help="openings with one of these texts")
    parser.add_argument("--answers", nargs="*", type=Path, default=[], help="of moving_base.py")
    parser.add_argument("--no-only", action="store_true", help="openings that no answer solves")
    parser.add_argument("--rows", type=Path, help="file with a JSON line per opening")
    args = parser.parse_args()
    print(machine())
    answers, known = read_answers(args.answers), read_rows(args.rows)
    rows: list[Row] = []
    for name in args.robots:
        every = openings([name])
        if args.sample:
            drawn = np.random.default_rng(0).permutation(len(every))[: args.sample]
            every = [every[k] for k in sorted(drawn.tolist())]
        every = [
            one for one in every
            if not args.only or any(text in f"{one[1]} {one[2]}/{one[3]}" for text in args.only)
        ]  # fmt: skip
        for row in report(name, every, answers, known, skips=args.no_only):
            rows.append(row)
            print(line_of(row), flush=True)
            if args.rows and "seconds" in row and opening_of(row) not in known:
                with args.rows.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    print(table(rows))


def read_rows(path: Path | None) -> dict[Opening, Row]:
    """Return the rows in a file, by opening."""
    lines = path.read_text().splitlines() if path and path.exists() else []
    return {opening_of(row): row for row in map(json.loads, lines)}


def opening_of(row: Row) -> Opening:
    """Return the opening of a row."""
    item, joint = row["task"].split("/")
    return row["robot"], row["scene"], item, joint


def read_answers(logs: Iterable[Path]) -> Answers:
    """Return the status by use of each opening in output of moving_base.py."""
    found: Answers = {}
    for line in (line for log in logs for line in log.read_text().splitlines()):
        match = _ANSWER.match(line)
        if match:
            robot, use, scene, item, joint, status = match.groups()
            found.setdefault((robot, scene, item, joint), {})[use] = status
    return found


def report(
    name: str,
    every: Iterable[Opening],
    answers: Answers,
    known: dict[Opening, Row],
    *,
    skips: bool,
) -> Iterable[Row]:
    """Yield a row for each opening.

    Args:
        name: The robot.
        every: The openings.
        answers: The planner's answers.
        known: Rows of an earlier run.
        skips: Whether openings that the planner solves need no lattice.
    """
    robot, cache = load_robot(name), USER_CACHE
    reach = load_reach(robot)
    scenes: dict[str, Scene] = {}
    for opening in every:
        _, place, item, joint = opening
        if place not in scenes:
            scenes[place] = load_scene(shared() / "bestman" / place, cache=cache)
        row: Row = {
            "robot": name,
            "scene": place,
            "task": f"{item}/{joint}",
            "shares": {},
            "why": "",
        }
        row |= {"kind": kind_of(scenes[place], item, joint)}
        given = answers.get(opening, {})
        try:
            if opening in known:
                row |= known[opening]
            elif not (skips and "solved" in given.values()):
                row |= farthest(robot, scenes[place], item, joint, reach)
        except MomaposError as error:
            row |= {"why": str(error), "seconds": 0.0}
        row["answers"] = given
        yield row | {"exceeded": exceeded(row)}


def farthest(robot: Robot, scene: Scene, item: str, joint: str, reach: ReachScorer) -> Row:
    """Return the share of the way that each use of the base moves a part, and what stops it."""
    began = time.process_time()
    task = make_task(scene, "open", item, joint)
    query = PlacementQuery(scene, robot, task, reach, watch=Stopwatch(time.process_time))
    motion = task_motion(scene, robot, task, query.config.motion)
    setup = prepare_search(query, scene, motion)
    found: Row = {"nodes": []}
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


def exceeded(row: Row) -> list[str]:
    """Return the uses whose answers open farther than the lattice."""
    shares = row["shares"]
    solved = [use for use in ANSWERED if row["answers"].get(use) == "solved"]
    return [use for use in solved if shares and shares[use] < 1.0]


def line_of(row: Row) -> str:
    """Return the line of a row."""
    shares = " ".join(f"{use} {share:.2f}" for use, share in row["shares"].items())
    answers = " ".join(f"{use}:{status}" for use, status in row["answers"].items())
    more = f" EXCEEDED by {row['exceeded']}" if row["exceeded"] else ""
    return (
        f"{row['robot']} {row['scene']} {row['task']} ({row['kind']}) [{answers}] {shares} "
        f"| {row['why']} | {row.get('seconds', 0.0):.1f} s{more}"
    )


def table(rows: list[Row]) -> str:
    """Return how many openings the planner and the lattice do all the way, in Markdown."""
    head = (*ANSWERED, "lattice: fixed", "moving", "turning", "any", "what stops the lattice")
    lines = ["| robot | part | openings | " + " | ".join(head) + " |"]
    lines.append("|" + "---|" * (3 + len(head)))
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        for kind in (*sorted({row["kind"] for row in mine}), "all"):
            some = [row for row in mine if kind in (row["kind"], "all")]
            lines.append(f"| {robot} | {kind} | {len(some)} | {' | '.join(_counts(some))} |")
    return "\n".join(lines)


def _counts(rows: list[Row]) -> list[str]:
    """Return the cells of a line of the table."""
    cells, solved = [], np.zeros(len(rows), bool)
    for use in ANSWERED:
        # Other uses are asked only where a base that stands does not do.
        known = np.array([row["answers"].get(use) == "solved" for row in rows])
        fixed = np.array([row["answers"].get("fixed") == "solved" for row in rows])
        cells.append(str(int((known | fixed).sum())))
        solved |= known
    for use in ("fixed", "moving", "turning", "any"):
        does = [row["shares"][use] == 1.0 if row["shares"] else None for row in rows]
        given = [own if one is None else one for one, own in zip(does, solved, strict=True)]
        cells.append(str(sum(map(bool, given))))
    why = Counter(row["why"] for row in rows if row["why"])
    return [*cells, "; ".join(f"{text} ({count})" for text, count in why.most_common())]


if __name__ == "__main__":
    main()
