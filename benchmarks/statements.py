"""Ask directly what answers state: how far a part opens, from which uses of the base, and advice.

    python benchmarks/statements.py [--robots fetch hsr stretch] [--tasks 20] [--seed 0] [--out DIR]

The rooms are the built-in kitchens and generated ones. Each opening is asked with a base that
stands still and with one that may stop several times or move. Every statement of the answer, as
printed, is then asked directly with the same seed: a value that is said to be reached must have a
plan, one that is said to have none must have none, advice must lead to a plan from the stated base
pose, and none may exist from the nearest miss. Answers that the time limit ended are left out.
"""

from __future__ import annotations

import argparse
import json
import re
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import MomaposError, default_cache_dir
from momapos.model.records import Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import LAYOUTS, Scene, generate_kitchen, load_scene
from momapos.planning import (
    BaseUse,
    PipelineConfig,
    PlacementQuery,
    PlacementResult,
    plan_at_pose,
    plan_base_placement,
    with_advice,
    with_max_opening,
)
from momapos.planning.grasps import make_task, slides
from momapos.planning.reachability import load_reach_map
from placement import machine
from rows import keep_rows

ROBOTS = ("fetch", "hsr", "stretch")
TIMEOUT = 60.0
"""Processor time of each question [s]."""
USES: dict[str, BaseUse] = {
    "from one base pose": "fixed",
    "from up to 3 stops": "stops",
    "with a moving base": "moving",
}
AHEAD = (1, 3)
"""Degrees or centimeters beyond a stated maximum that are asked for [-]."""
Wrong = list[dict[str, str]]


class Asker:
    """Asks questions about one room and robot."""

    def __init__(self, scene: Scene, robot: Robot, seed: int) -> None:
        self.scene, self.robot, self.seed = scene, robot, seed
        self.counts: Counter[str] = Counter()
        self.wrong: Wrong = []

    def ask(
        self, task: Task, base: BaseUse = "fixed", scene: Scene | None = None, robot: str = ""
    ) -> PlacementResult:
        """Answer a question with the usual search."""
        return plan_base_placement(
            scene or self.scene, load_robot(robot) if robot else self.robot, task,
            load_reach_map(load_robot(robot) if robot else self.robot, default_cache_dir(), None),
            config=PipelineConfig(timeout=TIMEOUT, base=base), seed=self.seed,
            clock=time.process_time,
        )  # fmt: skip

    def claim(self, kind: str, words: str, found: PlacementResult, *, solved: bool) -> None:
        """Count a statement, and whether the direct answer contradicts it."""
        if found.plan.status == "timeout":
            return
        self.counts[kind] += 1
        if (found.plan.status in ("solved", "assumed")) != solved:
            self.wrong.append({"kind": kind, "said": words, "direct": found.plan.status})

    def check(self, task: Task, base: BaseUse) -> str:
        """Ask for an opening, then for everything that the answer states; return its status."""
        answer = self.ask(task, base)
        if answer.plan.status == "infeasible":
            answer = with_max_opening(answer, clock=time.process_time)
            if base == "fixed":
                answer = with_advice(answer, clock=time.process_time)
        if any(note.startswith("the time limit") for note in answer.notes):
            return "timeout"
        self.check_notes(task, answer)
        self.check_maximum(task, base, answer)
        self.check_advice(task, answer)
        self.check_nearest(task, base, answer)
        return answer.plan.status

    def check_notes(self, task: Task, answer: PlacementResult) -> None:
        """Ask for the values that notes state, and for the uses of the base that they exclude."""
        for note in answer.notes:
            use, _, rest = note.partition(", ")
            values = re.findall(
                r"(the part moves at least|no motion(?: even)?) to ([-\d.]+) (deg|cm)", rest
            )
            for words, number, unit in values if use in USES else ():
                to = float(number) * (0.01 if unit == "cm" else np.radians(1.0))
                found = self.ask(replace(task, to=float(to)), USES[use])
                self.claim("use of the base", note, found, solved=words.startswith("the part"))
            if note.startswith("no single base pose serves"):
                self.claim("no single base pose", note, self.ask(task), solved=False)
            if "nor do up to 3 stops" in note:
                self.claim("no stops", note, self.ask(task, "stops"), solved=False)
            if (met := re.search(r"meets the floor at ([-\d.]+) (deg|cm)", note)) is not None:
                unit = 0.01 if met[2] == "cm" else np.radians(1.0)
                beyond = float(unit * (float(met[1]) + max(AHEAD) * np.sign(float(met[1]))))
                found = self.ask(replace(task, to=beyond))
                self.claim("meets the floor", note, found, solved=False)

    def check_maximum(self, task: Task, base: BaseUse, answer: PlacementResult) -> None:
        """Ask for the stated largest value, and for values beyond it."""
        to = answer.plan.feasible_to
        if answer.plan.status != "infeasible" or task.to is None or to is None:
            return
        found = self.ask(replace(task, to=to), base)
        self.claim("largest value", f"feasible to {to:.3f}", found, solved=True)
        unit = 0.01 if slides(self.scene, task) else np.radians(1.0)
        step = unit * np.sign(task.to - to)
        for ahead in AHEAD if base == "fixed" else ():
            beyond = float(to + ahead * step)
            if abs(beyond - to) < abs(task.to - to):
                found = self.ask(replace(task, to=beyond))
                words = f"feasible to {to:.3f} at most, asked for {beyond:.3f}"
                self.claim("beyond the largest value", words, found, solved=False)

    def check_advice(self, task: Task, answer: PlacementResult) -> None:
        """Ask in the room, or with the robot, that the advice names."""
        if not answer.plan.advice:
            return
        change, _, rest = answer.plan.advice.partition(", from (")
        scene, robot = self.changed(change.removeprefix("feasible "))
        found = self.ask(task, scene=scene, robot=robot)
        self.claim("advice", answer.plan.advice, found, solved=True)
        x, y, yaw = map(float, rest.rstrip(" deg)").split(","))
        query = PlacementQuery.of(
            scene, load_robot(robot) if robot else self.robot, task,
            config=PipelineConfig(timeout=TIMEOUT), seed=self.seed, clock=time.process_time,
        )  # fmt: skip
        there = plan_at_pose(query, (x, y, float(np.radians(yaw))))
        self.claim("base pose of advice", answer.plan.advice, there, solved=True)

    def changed(self, words: str) -> tuple[Scene, str]:
        """Return the scene and the robot of a change in words; "" for the same robot."""
        scene = self.scene
        if words.startswith("without "):
            name = words.removeprefix("without ")
            objects = tuple(item for item in scene.objects if item.name != name)
            return replace(scene, objects=objects), ""
        if (met := re.fullmatch(r"with (.+)/(.+) at ([-\d.]+) (deg|cm)", words)) is not None:
            unit = 0.01 if met[4] == "cm" else np.radians(1.0)
            joint = scene.object(met[1]).joint(met[2])
            ends = np.array([joint.lower, joint.upper])
            value = float(ends[np.abs(ends - unit * float(met[3])).argmin()])
            return scene.with_joint(met[1], met[2], value), ""
        if (met := re.fullmatch(r"with (.+) moved .+ by \((.+), (.+)\)", words)) is not None:
            item = scene.object(met[1])
            T = item.T_world_object.copy()
            T[:2, 3] += [float(met[2]), float(met[3])]
            moved = replace(item, T_world_object=T)
            objects = tuple(moved if one is item else one for one in scene.objects)
            return replace(scene, objects=objects), ""
        return scene, words.removeprefix("with ")

    def check_nearest(self, task: Task, base: BaseUse, answer: PlacementResult) -> None:
        """Ask at the base pose of the nearest miss."""
        miss = answer.plan.candidates.nearest
        if miss is None or answer.plan.status != "infeasible" or base != "fixed":
            return
        query = PlacementQuery.of(
            self.scene, self.robot, task, config=PipelineConfig(timeout=TIMEOUT), seed=self.seed,
            clock=time.process_time,
        )  # fmt: skip
        there = plan_at_pose(query, miss.base_pose)
        self.claim("nearest miss", f"{miss.base_pose}: {miss.reason}", there, solved=False)


def tasks(names: list[str], folder: Path) -> Iterator[tuple[str, Scene, Task, BaseUse]]:
    """Yield robot, room, opening and use of the base, in random order."""
    rooms = [load_scene("kitchen_small"), load_scene("kitchen_island")]
    for layout in LAYOUTS:
        rooms.append(load_scene(generate_kitchen(layout, seed=1, out=folder / f"{layout}.json")))
    found = [
        (name, scene, make_task(scene, "open", item.name, joint.name), base)
        for name in names
        for scene in rooms
        for item in scene.objects
        for joint in item.model.joints.values()
        if joint.mimic is None
        for base in ("fixed", "auto")
    ]
    for i in np.random.default_rng(0).permutation(len(found)):
        yield found[i]


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table of statements by kind."""
    counts: Counter[str] = Counter()
    wrong: Counter[str] = Counter()
    for row in rows:
        counts.update(row["counts"])
        wrong.update(one["kind"] for one in row["wrong"])
    lines = [f"machine: {machine()}", "| statement | asked directly | wrong |", "|---|---|---|"]
    lines += [f"| {kind} | {count} | {wrong[kind]} |" for kind, count in sorted(counts.items())]
    status = Counter(row["status"] for row in rows)
    return "\n".join([*lines, f"openings: {dict(status)}"])


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--tasks", type=int, help="number of openings, drawn at random")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for statements.json")
    args = parser.parse_args()
    robots = {name: load_robot(name) for name in args.robots}
    rows: list[dict[str, Any]] = []
    folder = Path(tempfile.mkdtemp())
    for name, scene, task, base in list(tasks(args.robots, folder))[: args.tasks]:
        asker = Asker(scene, robots[name], args.seed)
        row: dict[str, Any] = {"robot": name, "room": scene.name, "base": base}
        row |= {"object": task.object, "joint": task.joint}
        try:
            row["status"] = asker.check(task, base)
        except MomaposError as error:
            row |= {"status": "refused", "reason": str(error)}
        row |= {"counts": dict(asker.counts), "wrong": asker.wrong}
        rows.append(row)
        print(json.dumps(row), flush=True)
        keep_rows(rows, args.out, "statements")
    print(report(rows))


if __name__ == "__main__":
    main()
