"""Compare the verdicts of `momapos verify` and of an independent program on plans.

    python benchmarks/verifier_agreement.py VERIFIER [--plans 200] [--robots fetch ...] [--seed 0]
                                            [--sources cases kitchens objects] [--out DIR]

VERIFIER is an independent check of plan files. The first plans open everything in the small inputs
of other people (furniture and rooms); the others, --plans of them, open doors and drawers of the
built-in kitchens, of the kitchens of `placement.py` and of the rooms of `objects.py`, drawn at
random. Each valid plan is also broken in one way in turn: the base moved, a joint value changed,
states left out, the part moved without the hand. Disagreements are printed, those on objects of the
`test` set without their names.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.articulated import SETS, set_of
from momapos.core import USER_CACHE, MomaposError, default_cache_dir
from momapos.model.plan_files import write_plan
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, builtin_names, copied, load_scene, save_scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.reachability import ReachMap, load_reach_map
from momapos.verification import find_file, read_scene
from mutations import REFUSED, corrupted, loaded, ours, theirs
from objects import tasks
from placement import ROBOTS, SCENES, machine, scene_of, shared
from rows import keep_rows

CONFIG = PipelineConfig(timeout=60.0)
BROKEN = ("base_moved", "one_state_off", "states_left_out", "door_lags_behind")
"""How valid plans are broken, in turn; see `mutations.py`."""
WHOLE = "as planned"
SOURCES = ("cases", "kitchens", "objects")
PICKED = {"tray_mesh": "can", "tray_box": "can"}
"""Objects that are picked in the small inputs, by file."""


@dataclass(frozen=True)
class Question:
    """One task of one robot; the scene is read or built when it is needed."""

    source: str
    robot: str
    name: str
    """Empty for objects of the test set, which are not to be examined."""
    scene: Callable[[Path], Scene]
    """Returns the scene, as it is in a file; may write the file into a folder."""
    request: tuple[str, ...]
    root: Path


def small_inputs(robots: list[str]) -> Iterator[Question]:
    """Yield every opening of the small inputs, and what is picked there."""
    folder = shared().parent / "findings" / "cases"
    for file in sorted([*folder.glob("furniture/*.json"), *folder.glob("rooms/**/*.json")]):
        try:
            scene = load_scene(file)
        except MomaposError as error:
            print(f"{file.stem}: {error}", file=sys.stderr)
            continue
        found: list[tuple[str, ...]] = [("open", *pair) for pair in openable(scene)]
        found += [("pick", item) for name, item in PICKED.items() if name == file.stem]
        for robot in robots:
            for request in found:
                yield Question(
                    "cases", robot, file.stem, partial(unchanged, scene), request, Path("/")
                )


def others(robots: list[str], sources: list[str], rng: np.random.Generator) -> list[Question]:
    """Return openings of kitchens and objects, in random order, both kinds in turn."""
    kinds: list[list[Question]] = []
    if "kitchens" in sources:
        root = shared() / "bestman"
        scenes = {Path(name).stem: scene_of(name) for name in (*builtin_names(), *SCENES)}
        kinds.append([
            Question("kitchens", robot, name, partial(unchanged, scene), ("open", *pair), root)
            for name, scene in scenes.items()
            for pair in openable(scene)
            for robot in robots
        ])  # fmt: skip
    if "objects" in sources:
        kinds.append([
            Question(
                "objects", robot, name if set_of(name) == SETS[0] else "",
                partial(saved, scene), ("open", "object", joint), Path("/"),
            )
            for robot, name, scene, joint in tasks(None, robots)
        ])  # fmt: skip
    shuffled = [[one[i] for i in rng.permutation(len(one))] for one in kinds]
    most = max(map(len, shuffled), default=0)
    return [one[i] for i in range(most) for one in shuffled if i < len(one)]


def unchanged(scene: Scene, _folder: Path) -> Scene:
    """Return a scene that was read from a file."""
    return scene


def saved(scene: Scene, folder: Path) -> Scene:
    """Write a scene into a folder; return it as it is in the file."""
    file = folder / f"scene_{len(list(folder.iterdir()))}.json"
    with copied(scene, file) as near:
        return save_scene(near, file)


def planned(
    question: Question, robot: Robot, reach: ReachMap, folder: Path, seed: int
) -> Path | None:
    """Return the file of a plan; None if there is none."""
    try:
        scene = question.scene(folder)
        task = make_task(scene, *question.request)
        plan = plan_base_placement(
            scene, robot, task, reach, config=CONFIG, seed=seed, clock=time.process_time
        ).plan
    except MomaposError as error:
        if question.name:
            print(f"{question.name} {' '.join(question.request)}: {error}", file=sys.stderr)
        return None
    if plan.status != "solved":
        return None
    file = folder / "plan.json"
    write_plan(plan, file)
    return file


def compared(question: Question, kind: str, file: Path, other: Any) -> dict[str, Any]:
    """Return both verdicts on a plan file as a row; print a disagreement."""
    mine, why = ours(file, question.root)
    their, their_why = theirs(other, file, question.root)
    cause = "" if mine == their else cause_of(why, their_why, file, question.root)
    row = {
        "source": question.source, "robot": question.robot, "scene": question.name,
        "request": question.request, "kind": kind, "ours": mine, "why": why, "theirs": their,
        "their_why": their_why, "cause": cause,
    }  # fmt: skip
    if not question.name:
        row |= {"request": (), "why": "", "their_why": ""}
    if cause:
        print(json.dumps(row), flush=True)
    return row


def cause_of(why: str, their_why: str, file: Path, root: Path) -> str:
    """Return the known difference that a disagreement comes from, or that it is unknown.

    Args:
        why: Our first reason; empty if we accept the plan.
        their_why: The first reason of the other program.
        file: The plan.
        root: Folder of the scene's models.
    """
    if why.startswith("base path"):
        return "the drive, which the other program does not check"
    if why == "grasp slips: rotation in the moved part":
        return "the axis about which the hand may turn, which is any for the other program"
    name = json.loads(file.read_text())["scene"]
    scene = read_scene(find_file("scene", name, [file.parent, root], file), root, USER_CACHE)
    for item in scene.objects:
        for link, elements in item.model.static_elements.items():
            if f" in {item.name}/{link} by" in their_why:
                if any(len(element.hulls) > 1 for element in elements):
                    return "pieces of a hollow mesh, a hull for the other program"
                return "another shape of the same link"
    return "unknown"


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table by source and kind."""
    lines = [f"machine: {machine()}"]
    lines += ["| plans | kind | compared | both valid | both invalid | only ours valid | "]
    lines[-1] += "only theirs valid |"
    lines += ["|---" * 7 + "|"]
    for source in SOURCES:
        for kind in dict.fromkeys(row["kind"] for row in rows if row["source"] == source):
            mine = [row for row in rows if (row["source"], row["kind"]) == (source, kind)]
            counts = Counter((row["ours"] == REFUSED, row["theirs"] == REFUSED) for row in mine)
            pairs = [counts[pair] for pair in ((False,) * 2, (True,) * 2, (False, True))]
            numbers = [len(mine), *pairs, counts[True, False]]
            words = kind.replace("_", " ")
            lines.append(f"| {source} | {words} | {' | '.join(map(str, numbers))} |")
    lines += ["", "| disagreement comes from | whole plans | broken plans |", "|---|---|---|"]
    whole = Counter(row["cause"] for row in rows if row["kind"] == WHOLE)
    every = Counter(row["cause"] for row in rows if row["cause"])
    lines += [f"| {cause} | {whole[cause]} | {n - whole[cause]} |" for cause, n in every.items()]
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verifier", type=Path, help="independent check of plan files")
    parser.add_argument("--plans", type=int, default=200, help="number of other plans")
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--sources", nargs="+", choices=SOURCES, default=list(SOURCES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for agreement.json")
    args = parser.parse_args()
    rng, other = np.random.default_rng(args.seed), loaded(args.verifier)
    robots = {name: load_robot(name) for name in args.robots}
    maps = {
        name: load_reach_map(robot, default_cache_dir(), None) for name, robot in robots.items()
    }
    cases = list(small_inputs(args.robots[:1])) if "cases" in args.sources else []
    rows: list[dict[str, Any]] = []
    left = args.plans
    for question in (*cases, *others(args.robots, args.sources, rng)):
        if question.source != "cases" and not left:
            break
        with tempfile.TemporaryDirectory() as name:
            arm = robots[question.robot], maps[question.robot]
            file = planned(question, *arm, Path(name), args.seed)
            if file is None:
                continue
            left -= question.source != "cases"
            rows.append(compared(question, WHOLE, file, other))
            keep_rows(rows, args.out, "agreement")
            if rows[-1]["ours"] == REFUSED:
                continue
            content = json.loads(file.read_text())
            kinds = BROKEN if "holds" in content["manipulation"] else BROKEN[:2]
            kind = kinds[len(rows) // 2 % len(kinds)]
            kind, content = corrupted(content, arm[0], rng, (kind, kinds[0]))
            file.write_text(json.dumps(content))
            rows.append(compared(question, kind, file, other))
    print(report(rows))
    keep_rows(rows, args.out, "agreement")


if __name__ == "__main__":
    main()
