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

import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from execution import ERRORS, SPREAD
from momapos.apps.bench.articulated import SETS, USUAL, Usual, lone_room, parts, set_of
from momapos.core import MomaposError
from momapos.model.plan_files import write_plan
from momapos.model.records import PlacementPlan
from momapos.model.scene import Scene, SceneObject, copied, save_scene
from momapos.model.urdf import Articulated, read_urdf
from momapos.planning import PipelineConfig, plan_base_placement, with_max_opening
from momapos.planning.grasps import GraspConfig, make_task, slides
from momapos.planning.grasps.handles import has_handle
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.simulation.config import ModelErrorConfig
from momapos.workflows import run_plan
from placement import ROBOTS, arm, machine, shared
from rows import commands, emit, keep_rows, milliseconds

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
Subset = Annotated[Literal["development", "test"] | None, tyro.conf.arg(name="set")]


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


def object_tasks(subset: str | None, robots: Sequence[str]) -> list[tuple[str, str, Scene, str]]:
    """Return robot, object name, room and joint of every opening, in random order."""
    found = []
    for name, file, usual in objects():
        if subset in (None, set_of(name)):
            scene = room(name, file, usual)
            names = [] if scene is None else [j.name for j in parts(scene.object("object").model)]
            found += [(robot, name, scene, joint) for robot in robots for joint in names]
    return [found[i] for i in np.random.default_rng(0).permutation(len(found))]


def saved(scene: Scene, folder: Path) -> Scene:
    """Write a scene into a folder; return it as it is in the file."""
    file = folder / f"scene_{len(list(folder.iterdir()))}.json"
    with copied(scene, file) as near:
        return save_scene(near, file)


def measure(
    row: dict[str, Any], scene: Scene, physics: ExecutionConfig, seeds: int,
    verifier: Path | None, folder: Path,
) -> dict[str, Any]:  # fmt: skip
    """Plan one opening, check the plan, execute it."""
    robot, reach = arm(row["robot"])
    row["named"] = has_handle(scene.object("object").model, row["joint"])
    try:
        scene = saved(scene, folder)
        task = make_task(scene, "open", "object", row["joint"])
        begun = time.process_time()
        plan = plan_base_placement(scene, robot, task, reach, config=CONFIG).plan
        row |= {"status": plan.status, "seconds": time.process_time() - begun}
    except MomaposError as error:
        return {**row, "status": "refused", "reason": str(error)}
    row["feasible_to"] = plan.feasible_to
    if plan.status != "solved":
        reasons = plan.candidates.rejections.items()
        return {**row, "reason": max(reasons, key=lambda one: one[1], default="")}
    if verifier is not None:
        row["valid"], row["violations"] = independent(plan, verifier, folder)
    row["runs"] = [execute(plan, scene, physics, seed) for seed in range(seeds)]
    return row


def first_family(row: dict[str, Any], scene: Scene) -> dict[str, Any]:
    """Return the first grasp family that opens a part, else the maximum opening."""
    robot, reach = arm(row["robot"])
    task = make_task(scene, "open", "object", row["joint"])
    row["family"] = None
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
    plan: PlacementPlan, scene: Scene, physics: ExecutionConfig, seed: int
) -> dict[str, Any]:
    """Drive to the base pose and open the part, with noise."""
    (robot, reach), clock = arm(plan.robot_name), time.process_time
    begun = clock()
    try:
        record = run_plan(plan, scene, robot, reach, seed=seed, physics=physics, clock=clock)
    except MomaposError as error:
        return {"seed": seed, "success": False, "reason": f"error: {error}"}
    row: dict[str, Any] = {
        "seed": seed, "success": record.success, "reason": record.reason,
        "seconds": clock() - begun,
    }  # fmt: skip
    if (done := record.execution) is not None:
        row["hardest"] = done.collisions[0].force if done.collisions else 0.0
        row["reached"] = [done.start, done.asked, done.reached]
    return row


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
        seconds = [r["seconds"] for r in mine if r["status"] == "solved"]
        lines += [f"  processor time of an answer: {milliseconds(seconds)}"] if seconds else []
    return "\n".join(lines)


def main(
    robots: tuple[str, ...] = ROBOTS, subset: Subset = None, tasks: int | None = None,
    hold: Literal["contact", "weld"] = "contact", seeds: int = 3, errors: bool = False,
    families: bool = False, verifier: Path | None = None, out: Path | None = None,
) -> None:  # fmt: skip
    """Open objects.

    Args:
        robots: Robots of the library.
        subset: Only the objects of one set.
        tasks: Number of openings, drawn at random.
        hold: How the hand holds the part.
        seeds: Number of runs per plan.
        errors: Simulate with modeling errors.
        families: Count by grasp family only.
        verifier: Independent check of plan files.
        out: Folder for objects.json or families.json.
    """
    rows = []
    physics = ExecutionConfig(
        hold=hold, furniture=FurnitureConfig(spread=SPREAD),
        errors=ERRORS if errors else ModelErrorConfig(),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        for robot, name, scene, joint in object_tasks(subset, robots)[:tasks]:
            row = {"robot": robot, "object": name, "joint": joint, "set": set_of(name)}
            if families:
                rows.append(first_family(row, scene))
                continue
            rows.append(measure(row, scene, physics, seeds, verifier, Path(folder)))
            hidden = {} if row["set"] == SETS[0] else {"runs": "", "violations": ""}
            emit({**rows[-1], **hidden})
    print(family_table(rows) if families else report(rows))
    keep_rows(rows, out, "families" if families else "objects")


if __name__ == "__main__":
    commands(__doc__, main)
