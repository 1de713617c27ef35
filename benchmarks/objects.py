"""Open real articulated objects by contact, each alone in a small kitchen.

    python benchmarks/objects.py [--robots fetch ...] [--set development|test] [--hold contact|weld]
                                 [--tasks 40] [--seeds 3] [--verifier verify_plan.py] [--out DIR]
                                 [--errors] [--families]

The simulator's fridges, ovens, dishwashers, microwaves, cabinets and drawers are scaled to their
usual size and placed at a wall, small ones on a counter or on the wall. Every robot opens every
door and drawer: the opening is planned, checked by an independent program (--verifier), driven to
and executed with noise. A hash of an object's name puts it into one of two sets: `development` may
be examined, `test` is only counted.

With --errors the world differs from the scene, as in execution.py: handle 1 cm, hinge 3 cm and 5
degrees, mass and friction 50 % off.

With --families nothing is executed: grasp families are added one by one until an opening is
feasible; infeasible ones are printed with their maximum opening.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from execution import ERRORS, SPREAD
from momapos.apps.bench.articulated import SETS, USUAL, Usual, lone_room, parts, set_of
from momapos.core import MomaposError, default_cache_dir
from momapos.model.plan_files import write_plan
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, SceneObject, copied, save_scene
from momapos.model.urdf import Articulated, read_urdf
from momapos.planning import PipelineConfig, plan_base_placement, with_max_opening
from momapos.planning.grasps import GraspConfig, make_task, slides
from momapos.planning.grasps.handles import has_handle
from momapos.planning.reachability import load_reach_map
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.simulation.config import ModelErrorConfig
from momapos.workflows import run_plan
from placement import ROBOTS, machine, shared

CONFIG = PipelineConfig(timeout=60.0)
FAMILIES: dict[str, GraspConfig] = {
    "pinch": GraspConfig(families=("pinch",), turning=False),
    "hook": GraspConfig(families=("pinch", "hook"), turning=False),
    "turning": GraspConfig(families=("pinch", "hook")),
    "two grasps": GraspConfig(),
}
"""Sets of families, each including the previous ones; the last is the default."""
OBVIOUS = ("beyond the arm's reach", "base in collision", "base off the floor")
"""Reasons that reject most poses of any grid; other reasons say more about a task."""
AS_THEY_ARE = Usual(0.0, 0.0)


def objects() -> Iterator[tuple[str, Path, Usual]]:
    """Yield the articulated objects of the BestMan simulator: name, URDF and usual size."""
    root = shared() / "bestman" / "Asset" / "Scene"
    if not root.is_dir():
        sys.exit(f"{root} does not exist; MOMAPOS_SHARED names the folder of the real data")
    files = sorted(root.glob("Kitchen_models/models/*/*/mobility.urdf"))
    files += sorted(root.glob("URDF_models/B512/*/*.urdf"))
    files += sorted(root.glob("Kitchen_models/models*/*/urdf/*.urdf"))
    for file in files:
        kind = file.parts[-3] if file.name == "mobility.urdf" else file.parts[-2]
        yield file.parent.relative_to(root).as_posix(), file, USUAL.get(kind, AS_THEY_ARE)


def room(name: str, file: Path, usual: Usual) -> Scene | None:
    """Build a kitchen with one object, its front toward -x; None without a door or drawer."""
    bare = Articulated(read_urdf(file))
    if not list(parts(bare)) or (file.name == "mobility.urdf" and usual is AS_THEY_ARE):
        return None
    low, high = SceneObject(name, "", np.eye(4), bare).bounds
    # Objects in meters already have a usual size.
    scale = usual.height / (high[2] - low[2]) if file.name == "mobility.urdf" else 1.0
    item = SceneObject.from_urdf("object", file, (0.0, 0.0, 0.0), scale=scale, category=name)
    item = replace(item, category=name.split("/")[-2].lower())
    return lone_room(name, item, usual)


def tasks(subset: str | None, robots: list[str]) -> list[tuple[str, str, Scene, str]]:
    """Return robot, object name, room and joint of every opening, in random order."""
    found = []
    for name, file, usual in objects():
        if subset in (None, set_of(name)):
            scene = room(name, file, usual)
            names = [] if scene is None else [j.name for j in parts(scene.object("object").model)]
            found += [(robot, name, scene, joint) for robot in robots for joint in names]
    return [found[i] for i in np.random.default_rng(0).permutation(len(found))]


def measure(
    robot: Robot, name: str, scene: Scene, joint: str, args: argparse.Namespace, folder: Path
) -> dict[str, Any]:
    """Plan one opening, check the plan, execute it."""
    reach = load_reach_map(robot, default_cache_dir(), None)
    model = scene.object("object").model
    row: dict[str, Any] = {
        "robot": robot.name, "object": name, "joint": joint, "set": set_of(name),
        "named": has_handle(model, joint),
    }  # fmt: skip
    try:
        file = folder / f"{robot.name}_{len(list(folder.iterdir()))}.json"
        with copied(scene, file) as near:
            scene = save_scene(near, file)
        task = make_task(scene, "open", "object", joint)
        begun = time.process_time()
        plan = plan_base_placement(scene, robot, task, reach, config=CONFIG).plan
        row |= {"status": plan.status, "seconds": time.process_time() - begun}
    except MomaposError as error:
        return {**row, "status": "refused", "reason": str(error)}
    row["feasible_to"] = plan.feasible_to
    if plan.status != "solved":
        return {**row, "reason": max(plan.candidates.rejections.items(), key=_count, default="")}
    if args.verifier is not None:
        row["valid"], row["violations"] = independent(plan, args.verifier, folder)
    physics = ExecutionConfig(
        hold=args.hold,
        furniture=FurnitureConfig(spread=SPREAD),
        errors=ERRORS if args.errors else ModelErrorConfig(),
    )
    row["runs"] = [execute(plan, scene, robot, reach, physics, s) for s in range(args.seeds)]
    return row


def first_family(robot: Robot, name: str, scene: Scene, joint: str) -> dict[str, Any]:
    """Return the first grasp family that opens a part, else the maximum opening."""
    reach = load_reach_map(robot, default_cache_dir(), None)
    task = make_task(scene, "open", "object", joint)
    row: dict[str, Any] = {
        "robot": robot.name, "object": name, "joint": joint, "set": set_of(name), "family": None,
    }  # fmt: skip
    for family, grasps in FAMILIES.items():
        config = replace(CONFIG, motion=replace(CONFIG.motion, grasps=grasps))
        answer = plan_base_placement(scene, robot, task, reach, config=config)
        if answer.plan.status == "solved":
            return {**row, "family": family}
    informative = [reason for reason in answer.plan.candidates.rejections if reason not in OBVIOUS]
    row |= {"status": answer.plan.status, "reason": ", ".join(informative[:2]), "to": task.to}
    assert answer.query is not None
    farthest = with_max_opening(replace(answer, query=replace(answer.query, config=CONFIG))).plan
    return {**row, "slides": slides(scene, task), "feasible_to": farthest.feasible_to}


def family_table(rows: list[dict[str, Any]]) -> str:
    """Count by family, set and robot, as Markdown; list infeasible openings (development set)."""
    names = (*FAMILIES, "no")
    lines = [f"| set | robot | openings | {' | '.join(names)} |", "|---" * (len(names) + 3) + "|"]
    for subset in SETS:
        for robot in sorted({r["robot"] for r in rows if r["set"] == subset}):
            mine = [r["family"] or "no" for r in rows if (r["set"], r["robot"]) == (subset, robot)]
            counts = " | ".join(str(mine.count(name)) for name in names)
            lines.append(f"| {subset} | {robot} | {len(mine)} | {counts} |")
    lines += ["", "| infeasible opening | robots: maximum | goal | reason |", "|---|---|---|---|"]
    groups: dict[tuple[str, ...], list[str]] = {}
    for row in sorted(rows, key=lambda r: (r["object"], r["joint"], r["robot"])):
        if row["family"] is None and row["set"] == SETS[0]:
            why = row["reason"].replace(row["robot"], "it").split(" (")[0]
            why = why if row["status"] == "infeasible" else f"{row['status']}: {why}"
            key = (f"{row['object']} {row['joint']}", _opened(row, "to"), why)
            groups.setdefault(key, []).append(f"{row['robot']}: {_opened(row, 'feasible_to')}")
    lines += [f"| {k[0]} | {'; '.join(each)} | {k[1]} | {k[2]} |" for k, each in groups.items()]
    return "\n".join(lines)


def _opened(row: dict[str, Any], key: str) -> str:
    """Format a joint value."""
    if row[key] is None:
        return "not at all"
    return f"{100 * row[key]:.0f} cm" if row["slides"] else f"{np.degrees(row[key]):.0f} deg"


def _count(item: tuple[str, int]) -> int:
    return item[1]


def independent(plan: PlacementPlan, verifier: Path, folder: Path) -> tuple[bool, list[str]]:
    """Check a plan with another program."""
    file = folder / "plan.json"
    write_plan(plan, file)
    command = [sys.executable, str(verifier), str(file), "--scene-root", "/"]
    done = subprocess.run(
        [*command, "--allow-hinge-grasp"], capture_output=True, text=True, check=False
    )
    lines = [line.strip() for line in done.stdout.splitlines() if "VIOL" in line.upper()]
    return done.returncode == 0, lines[:3] or done.stderr.splitlines()[-1:]


def execute(
    plan: PlacementPlan, scene: Scene, robot: Robot, reach: Any, physics: ExecutionConfig, seed: int
) -> dict[str, Any]:
    """Drive to the base pose and open the part, with noise."""
    begun = time.process_time()
    try:
        record = run_plan(
            plan, scene, robot, reach, seed=seed, physics=physics, clock=time.process_time
        )
    except MomaposError as error:
        return {"seed": seed, "success": False, "reason": f"error: {error}"}
    done = record.execution
    row: dict[str, Any] = {
        "seed": seed, "success": record.success, "reason": record.reason,
        "seconds": time.process_time() - begun,
    }  # fmt: skip
    if done is None:
        return row
    hardest = done.collisions[0].force if done.collisions else 0.0
    return {**row, "hardest": hardest, "reached": [done.start, done.asked, done.reached]}


def report(rows: list[dict[str, Any]]) -> str:
    """Summarize each set."""
    lines = [f"machine: {machine()}"]
    for subset in SETS:
        mine = [r for r in rows if r["set"] == subset]
        if not mine:
            continue
        lines.append(f"{subset}: {len(mine)} openings, {dict(Counter(r['status'] for r in mine))}")
        if any("valid" in r for r in mine):
            lines.append(f"  independently valid: {sum(r.get('valid', False) for r in mine)}")
        for named in (True, False):
            runs = [run for r in mine if r["named"] is named for run in r.get("runs", ())]
            good = sum(run["success"] for run in runs)
            hard = sum(run.get("hardest", 0.0) > 150 for run in runs)
            kind = "a named handle" if named else "no named handle"
            lines.append(f"  {kind}: {good} of {len(runs)} runs opened, {hard} touch above 150 N")
        for robot in sorted({r["robot"] for r in mine}):
            runs = [run for r in mine if r["robot"] == robot for run in r.get("runs", ())]
            solved = [r for r in mine if r["robot"] == robot and r["status"] == "solved"]
            count = sum(r["robot"] == robot for r in mine)
            good = sum(run["success"] for run in runs)
            lines.append(f"  {robot}: {len(solved)} of {count} planned; {good} of {len(runs)} runs")
        seconds = np.array([r["seconds"] for r in mine if r["status"] == "solved"])
        if len(seconds):
            median, late = 1000 * np.percentile(seconds, (50, 95))
            lines.append(f"  processor time of an answer: median {median:.0f}, 95 % {late:.0f} ms")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--set", choices=SETS, help="only the objects of one set")
    parser.add_argument("--hold", choices=("contact", "weld"), default="contact")
    parser.add_argument("--tasks", type=int, help="number of openings, drawn at random")
    parser.add_argument("--seeds", type=int, default=3, help="number of runs per plan")
    parser.add_argument("--errors", action="store_true", help="simulate with modeling errors")
    parser.add_argument("--families", action="store_true", help="count by grasp family only")
    parser.add_argument("--verifier", type=Path, help="independent check of plan files")
    parser.add_argument("--out", type=Path, help="folder for objects.json")
    args = parser.parse_args()
    rows = []
    robots = {name: load_robot(name) for name in args.robots}
    with tempfile.TemporaryDirectory() as folder:
        for robot, name, scene, joint in tasks(args.set, args.robots)[: args.tasks]:
            if args.families:
                rows.append(first_family(robots[robot], name, scene, joint))
                continue
            row = measure(robots[robot], name, scene, joint, args, Path(folder))
            rows.append(row)
            shown = row if row["set"] == SETS[0] else {**row, "runs": "", "violations": ""}
            print(json.dumps(shown), flush=True)
    print(family_table(rows) if args.families else report(rows))
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / ("families.json" if args.families else "objects.json")).write_text(
            json.dumps(rows, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
