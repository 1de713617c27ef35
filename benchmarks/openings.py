"""Ask directly what answers state: how far parts open, drop-down doors in physics, and all notes.

    python benchmarks/openings.py farthest [--robots fetch ...] [--set development|test]
        [--tasks 20] [--values 6] [--seed 0] [--out DIR]
    python benchmarks/openings.py drop-down [--robots fetch ...] [--set development|test]
    python benchmarks/openings.py statements [--robots fetch hsr stretch] [--tasks 20] [--out DIR]

Processor times.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from momapos.apps.bench.articulated import SETS, parts, set_of
from momapos.core import MomaposError
from momapos.core.geometry import apply
from momapos.model.records import Task
from momapos.model.robots import opened_as
from momapos.model.scene import LAYOUTS, Scene, SceneObject, generate_kitchen, load_scene
from momapos.model.urdf import opening_of
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
from momapos.planning.max_opening import values_before
from momapos.simulation import ExecutionConfig, FurnitureConfig, attempt
from objects import CONFIG, Subset, object_tasks, objects, room
from placement import ROBOTS, arm, machine
from rows import commands, emit, keep_rows, markdown

NEXT = 3
"""Values right after the stated one that are always tried [-]."""


def farthest(
    robots: tuple[str, ...] = ROBOTS, subset: Subset = None, tasks: int | None = None,
    values: int | None = None, seed: int = 0, out: Path | None = None,
) -> None:  # fmt: skip
    """Ask directly for openings beyond the stated maximum: none may be solved.

    The rooms and openings are those of objects.py. Where an opening is infeasible, its stated
    maximum is compared with direct questions of the same seed for larger values: whole degrees or
    centimeters. A larger value with a plan contradicts the statement. Contradictions of the `test`
    set are only counted.

    Args:
        robots: Robots of the library.
        subset: Only the objects of one set.
        tasks: Number of openings, drawn at random.
        values: Number of larger values to ask for, the next three and some drawn; all by default.
        seed: Seed of all questions.
        out: Folder for farthest.json.
    """
    rows = []
    for name, item, scene, joint in object_tasks(subset, robots)[:tasks]:
        row: dict[str, Any] = {"robot": name, "object": item, "joint": joint, "set": set_of(item)}
        try:
            row |= _beyond(name, scene, joint, values, seed)
        except MomaposError as error:
            row |= {"status": "refused", "reason": str(error)}
        rows.append(row)
        if row["set"] == SETS[0]:
            emit(row)
    lines = []
    for one, robot in sorted({(row["set"], row["robot"]) for row in rows}):
        mine = [row for row in rows if (row["set"], row["robot"]) == (one, robot)]
        no = [row for row in mine if row["status"] == "infeasible"]
        stated, sure = sum(row["stated"] is not None for row in no), sum(row["sure"] for row in no)
        beyond, solved = (sum(len(row[key]) for row in no) for key in ("queried", "solved"))
        lines.append((one, robot, len(mine), len(no), stated, sure, beyond, solved))
    head = ("set", "robot", "openings", "infeasible", "stated", "sure", "tried beyond",
            "solved there")  # fmt: skip
    print(f"machine: {machine()}", markdown(head, lines), sep="\n")
    keep_rows(rows, out, "farthest")


def _beyond(name: str, scene: Scene, joint: str, count: int | None, seed: int) -> dict[str, Any]:
    """Ask for an opening, and if it is infeasible, for values beyond its stated maximum."""
    robot, reach = arm(name)
    task = make_task(scene, "open", "object", joint)
    assert task.to is not None
    begun = time.process_time()
    answer = plan_base_placement(scene, robot, task, reach, config=CONFIG, seed=seed)
    between = time.process_time()
    row = {
        "status": answer.plan.status,
        "goal": task.to,
        "stated": None,
        "queried": (),
        "solved": (),
    }
    if answer.plan.status != "infeasible":
        return {**row, "seconds": (between - begun, 0.0)}
    plan = with_max_opening(answer).plan
    seconds = between - begun, time.process_time() - between
    first = scene.object("object").values()[joint] if plan.feasible_to is None else plan.feasible_to
    values = values_before(first, task.to, slides=slides(scene, task))
    if count is not None:
        later = np.random.default_rng(seed).permutation(np.arange(NEXT, len(values)))
        order = np.append(np.arange(min(NEXT, len(values))), later)
        values = values[np.sort(order[:count])]
    solved = []
    for to in values.tolist():
        there = replace(task, to=to)
        found = plan_base_placement(scene, robot, there, reach, config=CONFIG, seed=seed)
        solved += [to] if found.plan.status == "solved" else []
    return {
        **row, "stated": plan.feasible_to, "sure": bool(plan.feasible_sure),
        "queried": values.tolist(), "solved": solved, "seconds": seconds,
    }  # fmt: skip


EXACT = ExecutionConfig(furniture=FurnitureConfig(spread=0.0))
CLOSE = 3.0
"""A reached value confirms a stated one within this difference [deg]."""
MIN_DROP = 0.05
"""Height by which a door's middle falls over its first 60 degrees, at least [m]."""


def drop_down(
    robots: tuple[str, ...] = ROBOTS, subset: Subset = None, out: Path | None = None
) -> None:
    """Compare the stated farthest opening of drop-down doors with the one that physics reaches.

    The doors of objects.py that turn down about a horizontal axis: dishwashers, ovens, and a few
    others. They stand on the floor, which some meet after a few degrees. Each is opened as far as
    the robot can (`--to max`), and the planned motion is executed at its base pose, with contacts,
    without noise and without the drive: at the largest value, an arm seldom finds a motion a few
    millimeters from that pose. Doors of the `test` set are only counted.

    Args:
        robots: Robots of the library.
        subset: Only the objects of one set.
        out: Folder for drop_down.json.
    """
    rows: list[dict[str, Any]] = []
    for (name, scene, joint), robot in product(drop_down_doors(subset), robots):
        row: dict[str, Any] = {"object": name, "joint": joint, "robot": robot, "set": set_of(name)}
        try:
            row |= _reached(robot, scene, joint)
        except MomaposError as error:
            row |= {"status": "refused", "reason": str(error)}
        rows.append(row)
        keep_rows(rows, out, "drop_down")
        if row["set"] == SETS[0]:
            emit(row)
    lines = []
    for one in SETS:
        mine = [row for row in rows if row["set"] == one]
        gaps = [abs(row["reached"] - row["stated"]) for row in mine if row["status"] == "solved"]
        worst = f"{max(gaps):.1f} deg" if gaps else ""
        lines.append((one, len(mine), len(gaps), sum(gap <= CLOSE for gap in gaps), worst))
    head = ("set", "doors x robots", "stated", f"reached within {CLOSE:g} deg", "farthest off")
    print(f"machine: {machine()}", markdown(head, lines), sep="\n")
    shown = []
    for row in sorted(rows, key=lambda row: (row["object"], row["robot"])):
        if row["set"] == SETS[0]:
            done = row["status"] == "solved"
            value = f"{row['stated']:.0f} deg" if done else row["status"]
            reached = f"{row['reached']:.1f} deg" if done else ""
            why = "; ".join(row["notes"]) if done else row["reason"]
            shown.append((row["object"], row["robot"], value, reached, row.get("ending", ""), why))
    print("", markdown(("door", "robot", "stated", "reached", "ending", "reason"), shown), sep="\n")


def drop_down_doors(subset: str | None) -> Iterator[tuple[str, Scene, str]]:
    """Yield object name, room and joint of every door that turns down."""
    for name, file, usual in objects():
        scene = room(name, file, usual) if subset in (None, set_of(name)) else None
        if scene is None:
            continue
        item = scene.object("object")
        for joint in parts(item.model):
            opened = opening_of(item.model, joint.name).sign * np.radians(60.0)
            drop = height(item, joint.name, 0.0) - height(item, joint.name, opened)
            if joint.kind == "revolute" and drop > MIN_DROP:
                yield name, scene, joint.name


def height(item: SceneObject, joint: str, value: float) -> float:
    """Return the height of a part's middle at a joint value [m]."""
    Ts = item.link_poses({joint: value})
    links = item.model.moved_by(joint)
    points = [apply(Ts[link], hull.vertices) for link in links for hull in item.model.hulls[link]]
    return float(np.concatenate(points)[:, 2].mean())


def _reached(name: str, scene: Scene, joint: str) -> dict[str, Any]:
    """Open a door as far as possible; return the stated and the reached values [deg]."""
    robot, reach = arm(name)
    task, config = make_task(scene, "open", "object", joint, "max"), PipelineConfig(timeout=120.0)
    answer = plan_base_placement(scene, robot, task, reach, config=config, clock=time.process_time)
    plan = answer.with_notes().plan
    if plan.status != "solved" or plan.task.to is None:
        return {"status": plan.status, "reason": next(iter(plan.candidates.rejections), "")}
    assert plan.motion is not None
    assert plan.base_pose is not None
    done = attempt(
        scene.with_resistance(plan.resistance), opened_as(robot, plan.robot_rest), plan.base_pose,
        plan.motion, plan.task, EXACT, np.random.default_rng(0),
    ).execution  # fmt: skip
    return {
        "status": "solved", "stated": float(np.degrees(plan.task.to)),
        "reached": float(np.degrees(done.reached)), "notes": plan.notes,
        "ending": "" if done.success else done.ending,
    }  # fmt: skip


TIMEOUT = 60.0
"""Processor time of each question [s]."""
USES: dict[str, BaseUse] = {
    "from one base pose": "fixed",
    "from up to 3 stops": "stops",
    "with a moving base": "moving",
}
BASES: tuple[BaseUse, ...] = ("fixed", "auto")
AHEAD = (1, 3)
"""Degrees or centimeters beyond a stated maximum that are tried [-]."""


class Asker:
    """Asks questions about one room and robot."""

    def __init__(self, scene: Scene, robot: str, seed: int) -> None:
        self.scene, self.robot, self.seed = scene, robot, seed
        self.counts: Counter[str] = Counter()
        self.wrong: list[dict[str, str]] = []

    def ask(
        self, task: Task, base: BaseUse = "fixed", scene: Scene | None = None, robot: str = ""
    ) -> PlacementResult:
        """Answer a question with the usual search."""
        own, reach = arm(robot or self.robot)
        return plan_base_placement(
            scene or self.scene, own, task, reach, seed=self.seed, clock=time.process_time,
            config=PipelineConfig(timeout=TIMEOUT, base=base),
        )  # fmt: skip

    def ask_at(
        self, base: tuple[float, float, float], task: Task, scene: Scene, robot: str = ""
    ) -> PlacementResult:
        """Answer a question from one base pose."""
        query = PlacementQuery.of(
            scene, arm(robot or self.robot)[0], task, config=PipelineConfig(timeout=TIMEOUT),
            seed=self.seed, clock=time.process_time,
        )  # fmt: skip
        return plan_at_pose(query, base)

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
                words = f"feasible to {to:.3f} at most, but {beyond:.3f}"
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
        there = self.ask_at((x, y, float(np.radians(yaw))), task, scene, robot)
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
        there = self.ask_at(miss.base_pose, task, self.scene)
        self.claim("nearest miss", f"{miss.base_pose}: {miss.reason}", there, solved=False)


def statements(
    robots: tuple[str, ...] = ("fetch", "hsr", "stretch"), tasks: int | None = None, seed: int = 0,
    out: Path | None = None,
) -> None:  # fmt: skip
    """Ask directly what answers state: how far parts open, from which uses of the base, and advice.

    The rooms are the built-in kitchens and generated ones. Each opening is planned with a base that
    stands still and with one that may stop several times or move. Every statement of the answer is
    then planned directly with the same seed: a value stated as reached must have a plan, one stated
    as infeasible must have none, advice must lead to a plan from the stated base pose, and none may
    exist from the nearest miss. Answers that the time limit ended are left out.

    Args:
        robots: Robots of the library.
        tasks: Number of openings, drawn at random.
        seed: Seed of all questions.
        out: Folder for statements.json.
    """
    rows: list[dict[str, Any]] = []
    counts, wrong = Counter[str](), Counter[str]()
    with TemporaryDirectory() as folder:
        rooms = [load_scene("kitchen_small"), load_scene("kitchen_island")]
        for layout in LAYOUTS:
            file = Path(folder) / f"{layout}.json"
            rooms.append(load_scene(generate_kitchen(layout, seed=1, out=file)))
        every = [
            (name, scene, make_task(scene, "open", item.name, joint.name), base)
            for name in robots
            for scene in rooms
            for item in scene.objects
            for joint in item.model.joints.values()
            if joint.mimic is None
            for base in BASES
        ]
        for name, scene, task, base in (
            every[k] for k in np.random.default_rng(0).permutation(len(every))[:tasks]
        ):
            asker = Asker(scene, name, seed)
            row: dict[str, Any] = {"robot": name, "room": scene.name, "base": base}
            row |= {"object": task.object, "joint": task.joint}
            try:
                row["status"] = asker.check(task, base)
            except MomaposError as error:
                row |= {"status": "refused", "reason": str(error)}
            rows.append(row | {"counts": dict(asker.counts), "wrong": asker.wrong})
            counts.update(asker.counts)
            wrong.update(one["kind"] for one in asker.wrong)
            emit(rows[-1])
            keep_rows(rows, out, "statements")
    lines = [(kind, count, wrong[kind]) for kind, count in sorted(counts.items())]
    print(
        f"machine: {machine()}",
        markdown(("statement", "planned directly", "wrong"), lines),
        sep="\n",
    )
    print(f"openings: {dict(Counter(row['status'] for row in rows))}")


if __name__ == "__main__":
    commands(__doc__, farthest, drop_down, statements)
