"""Ask the planner and the lattice about many openings, on several processes, until a deadline.

    python benchmarks/moving_library.py DIR [--robots fetch tiago] [--sample N]
                                            [--processes 16] [--seconds 500]
    python benchmarks/moving_lattice.py --robots fetch tiago --answers DIR/answers.log
                                        --rows DIR/rows.jsonl --no-only

Each opening of the five kitchens is asked with `fixed`; where that fails, with `stops` and
`moving`, and the lattice is asked, too. The openings come in one random order over all robots, so
that a run that ends early is a fair sample. Every answer is written at once: `answers.log` as
moving_base.py prints it, `rows.jsonl` as moving_lattice.py keeps it, and plan files in `plans/`.
A second run with the same folder goes on. The second command prints the table. Processor time; set
OMP_NUM_THREADS=1, so that each process has one thread.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import time
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from momapos.core import USER_CACHE, MomaposError, Stopwatch
from momapos.model.plan_files import write_plan
from momapos.model.records import ReachScorer
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import BaseUse, PipelineConfig, PlacementQuery
from momapos.planning.grasps import make_task, openable
from momapos.planning.plan import plan_placement
from momapos.planning.reachability import load_reach
from momapos.verification import verify_files
from moving_lattice import Opening, Row, farthest, kind_of, read_answers, read_rows
from placement import SCENES, machine, shared

LIBRARY = (
    "fetch", "husky_ur5e", "mobile_panda", "ranger_rm63", "segway_ur5e", "tiago", "tiago_dual",
)  # fmt: skip
USES: tuple[BaseUse, ...] = ("fixed", "stops", "moving")
"""What is asked, each where the first fails."""


@dataclass(frozen=True, eq=False)
class Asker:
    """Robots and kitchens in memory, which the processes share, and what is known already."""

    folder: Path
    until: float
    """Time after which nothing is asked [s, as `time.time`]."""
    robots: dict[str, tuple[Robot, ReachScorer]]
    scenes: dict[str, Scene]
    answers: dict[Opening, dict[str, str]]
    bounded: set[Opening]

    def openings(self) -> list[Opening]:
        """Return every door and drawer of the kitchens, for each robot."""
        return [
            (robot, place, item, joint)
            for robot in self.robots
            for place, scene in self.scenes.items()
            for item, joint in openable(scene)
        ]

    def ask(self, opening: Opening) -> str:
        """Ask about an opening what is not known; return a line about it."""
        given = dict(self.answers.get(opening, {}))
        for use in USES:
            if given.get("fixed") == "solved":
                break
            if use not in given and time.time() < self.until:
                given[use] = self._plan(opening, use)
        left = given.get("fixed") != "solved" and opening not in self.bounded
        if left and time.time() < self.until:
            self._bound(opening)
        return f"{' '.join(opening)} {given}"

    def _plan(self, opening: Opening, use: BaseUse) -> str:
        name, place, item, joint = opening
        (robot, reach), scene = self.robots[name], self.scenes[place]
        task = make_task(scene, "open", item, joint)
        query = PlacementQuery(
            scene, robot, task, reach, config=PipelineConfig(base=use),
            watch=Stopwatch(time.process_time),
        )  # fmt: skip
        try:
            plan = plan_placement(query).plan
        except MomaposError as error:
            self._append("errors.log", f"{' '.join(opening)} {use} {error}")
            return "error"
        words = ""
        if plan.feasible:
            parts = (name, use, Path(place).stem, item, joint)
            path = self.folder / "plans" / f"{'-'.join(parts)}.json"
            write_plan(plan, path)
            words = "valid" if verify_files(path, shared() / "bestman").valid else "INVALID"
        spent = plan.timing["total"]
        line = f"{name} {use} {place} {item}/{joint} {plan.status} {spent:.2f} s {words}"
        self._append("answers.log", line.strip())
        return plan.status

    def _bound(self, opening: Opening) -> None:
        name, place, item, joint = opening
        (robot, reach), scene = self.robots[name], self.scenes[place]
        kind = kind_of(scene, item, joint)
        row: Row = {"robot": name, "scene": place, "task": f"{item}/{joint}", "kind": kind}
        try:
            row |= farthest(robot, scene, item, joint, reach)
        except MomaposError as error:
            row |= {"shares": {}, "why": str(error), "seconds": 0.0}
        self._append("rows.jsonl", json.dumps(row))

    def _append(self, name: str, line: str) -> None:
        with (self.folder / name).open("a") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.write(line + "\n")


def main() -> None:
    """Ask until everything is asked or the time is over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", nargs="*", default=LIBRARY)
    parser.add_argument("--sample", type=int, default=0, help="number of random openings")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, default=1e9, help="after which nothing is asked")
    args = parser.parse_args()
    until, cache = time.time() + args.seconds, USER_CACHE
    print(machine())
    (args.folder / "plans").mkdir(parents=True, exist_ok=True)
    log, rows = args.folder / "answers.log", args.folder / "rows.jsonl"
    robots = {name: load_robot(name, cache=cache) for name in args.robots}
    asker = Asker(
        args.folder,
        until,
        {name: (robot, load_reach(robot)) for name, robot in robots.items()},
        {name: load_scene(shared() / "bestman" / name, cache=cache) for name in SCENES},
        read_answers([log] if log.exists() else []),
        set(read_rows(rows)),
    )
    every = asker.openings()
    drawn = np.random.default_rng(0).permutation(len(every))[: args.sample or None].tolist()
    # Processes are forked: they share what the first opening has loaded and compiled.
    print(asker.ask(every[drawn[0]]), flush=True)
    _askers.append(asker)
    with get_context("fork").Pool(args.processes) as pool:
        for line in pool.imap_unordered(_ask, [every[k] for k in drawn[1:]]):
            print(line, flush=True)


_askers: list[Asker] = []


def _ask(opening: Opening) -> str:
    return _askers[0].ask(opening)


if __name__ == "__main__":
    main()
