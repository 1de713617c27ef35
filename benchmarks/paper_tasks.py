"""The paper's four tasks in its laboratory, with the table moved at random, in physics.

    python benchmarks/paper_tasks.py [--trials 50] [--methods ours] [--seed 0] [--out bench_out]

Grasp an apple, grasp a cup, open the right-hinged fridge and the left-hinged microwave by 90
degrees, with a Ranger Mini and an RM63 in `b512.json`. In each trial the table moves, and so do the
things on it; the fridge and the robot's start stay. Every method meets the same worlds: it is asked
for a base pose, the robot drives there with noise, plans the arm's motion anew and executes it.
Prints, and writes as JSON, time without driving, cost and success beside the paper's numbers.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.baselines.answer import plan_by_method
from momapos.cache import default_cache_dir
from momapos.config import PipelineConfig
from momapos.errors import MomaposError
from momapos.geometry.transforms import pose, pose_planar
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.base_collision import base_hits
from momapos.kinematics.collision import FREE
from momapos.kinematics.urdf import box_urdf
from momapos.manipulation.tasks import make_task
from momapos.placement.config import PlaceConfig
from momapos.protocols import ReachScorer
from momapos.reachability.store import load_reach_map
from momapos.robots.robot import Robot, load_robot
from momapos.run_plan import run_plan
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene, SceneObject, upright_boxes
from momapos.types import Task
from momapos.verification.exact import PlanVerifier
from placement import machine, shared
from placers import METHODS

ROOM = "Asset/Scene/Scene/b512.json"
ROBOT = "ranger_rm63"
START = (-2.0, -6.0, np.pi)
"""Where the robot begins in every trial: 3 m before the table, facing it [m], [rad]."""
TABLE, MICROWAVE = "Table", "Mic"
THINGS = {"apple": "plastic_apple", "cup": "blue_cup", "box": "lipton_tea", "can": "green_cup"}
"""What stands on the table, and whose size it has in the shared data."""
SHIFT, TURN = 0.3, np.radians(15.0)
"""The table moves by up to so much in x and in y [m], and turns by up to so much [rad]."""
FRONT = 0.45
"""Small things stand within this of the table's front edge [m]."""
EDGE, APART = 0.02, 0.03
"""Distance of things from the table's edges, and from each other [m]."""
DRAWS = 1000
TASKS = {
    "grasp apple": ("pick", "apple", None),
    "grasp cup": ("pick", "cup", None),
    "open fridge": ("open", "Fridge", "doorR1_to_base_link"),
    "open microwave": ("open", MICROWAVE, "doorL0_to_base_link"),
}
PAPER = (  # task, method, time [s], cost [m], success [%]: the main table of Shao et al.
    ("grasp apple", "MoMa-Pos", "13.5 +- 2.0", "3.2 +- 1.2", 100),
    ("grasp apple", "Habitat", "17.3 +- 0.2", "3.0 +- 0.0", 100),
    ("grasp apple", "M3*", "17.8 +- 2.3", "3.2 +- 1.1", 100),
    ("grasp apple", "Reuleaux", "19.2 +- 4.3", "3.6 +- 1.6", 100),
    ("grasp cup", "MoMa-Pos", "13.2 +- 2.4", "3.5 +- 1.4", 100),
    ("grasp cup", "Habitat", "16.9 +- 2.7", "3.2 +- 0.0", 100),
    ("grasp cup", "M3*", "17.3 +- 3.2", "3.3 +- 0.1", 100),
    ("grasp cup", "Reuleaux", "18.7 +- 3.9", "3.7 +- 1.1", 100),
    ("open fridge", "MoMa-Pos", "17.4 +- 2.3", "2.3 +- 0.1", 100),
    ("open fridge", "Habitat", "15.7 +- 1.4", "2.2 +- 0.0", 18),
    ("open fridge", "M3*", "18.2 +- 8.4", "2.2 +- 0.1", 26),
    ("open fridge", "Reuleaux", "17.7 +- 2.7", "2.5 +- 0.1", 70),
    ("open microwave", "MoMa-Pos", "17.2 +- 1.0", "3.7 +- 1.6", 100),
    ("open microwave", "Habitat", "14.4 +- 0.4", "3.2 +- 0.0", 22),
    ("open microwave", "M3*", "17.4 +- 1.4", "3.5 +- 0.0", 44),
    ("open microwave", "Reuleaux", "18.0 +- 2.0", "3.6 +- 1.4", 82),
)


def things() -> list[SceneObject]:
    """Boxes of the size of household objects, on the floor at the origin."""
    path = shared() / "bestman" / "derived" / "urdf_models_sizes.csv"
    with path.open() as file:
        sizes = {row["object_name"]: row for row in csv.DictReader(file)}
    made = []
    for name, like in THINGS.items():
        x, y, z = (float(sizes[like][f"size_{axis}"]) for axis in "xyz")
        T = pose((0.0, 0.0, z / 2))
        made.append(SceneObject(name, name, T, Articulated(box_urdf(name, (x, y, z)))))
    return made


def moved(item: SceneObject, T_world_world: np.ndarray) -> SceneObject:
    """The same thing, moved by a transform of the world."""
    return replace(item, T_world_object=T_world_world @ item.T_world_object)


def set_table(room: Scene, small: list[SceneObject], rng: np.random.Generator) -> list[SceneObject]:
    """Put microwave and things on the table as the room has it, the microwave along its back."""
    table, oven = room.object(TABLE), room.object(MICROWAVE)
    (_, y0, _), (x1, y1, top) = table.bounds
    (_, o0, _), (_, o1, _) = oven.bounds
    shift = (rng.uniform(-0.15, 0.0), rng.uniform(y0 + EDGE - o0, y1 - EDGE - o1), 0.0)
    placed = [moved(oven, pose(shift))]
    for item in small:
        radius = float(np.hypot(*np.ptp(item.bounds[:, :2], axis=0)) / 2)
        low, high = (x1 - FRONT, y0), (x1, y1)
        xy = rng.uniform(np.array(low) + radius + EDGE, np.array(high) - radius - EDGE)
        on_table = pose_planar(np.array([*xy, rng.uniform(-np.pi, np.pi)]))
        on_table[2, 3] = top
        placed.append(moved(item, on_table))
    return placed


def layout(room: Scene, robot: Robot, small: list[SceneObject], rng: np.random.Generator) -> Scene:
    """Draw a trial's world: nothing overlaps, and each door has room to swing."""
    table = room.object(TABLE)
    middle = pose((*table.bounds[:, :2].mean(0), 0.0))
    fixed = [item for item in room.objects if item.name not in (TABLE, MICROWAVE)]
    for _ in range(DRAWS):
        on_table = set_table(room, small, rng)
        if _too_near(on_table):
            continue
        change = pose_planar(rng.uniform([-SHIFT, -SHIFT, -TURN], [SHIFT, SHIFT, TURN]))
        T = middle @ change @ np.linalg.inv(middle)
        group = [moved(item, T) for item in (table, *on_table)]
        hits = base_hits(
            np.zeros((1, 3)), upright_boxes(group), upright_boxes(fixed), clearance=EDGE
        )
        scene = replace(room, objects=(*fixed, *group), start=np.array(START))
        doors = [make_task(scene, *TASKS[name]) for name in ("open fridge", "open microwave")]
        if hits[0] == FREE and all(
            PlanVerifier(scene, robot, d).blocked(0.0) is None for d in doors
        ):
            return scene
    raise SystemExit(f"no layout without overlaps in {DRAWS} draws")


def _too_near(items: list[SceneObject]) -> bool:
    """Whether two things on the table are nearer than `APART`."""
    boxes = [upright_boxes([item]) for item in items]
    return any(
        base_hits(np.zeros((1, 3)), boxes[i], boxes[j], clearance=APART)[0] != FREE
        for i in range(len(items))
        for j in range(i)
    )


def trial(
    scene: Scene, robot: Robot, reach: ReachScorer, task: Task, method: str, seed: int
) -> dict[str, object]:
    """Ask for a base pose, drive there, do it."""
    config = PipelineConfig(
        place=PlaceConfig(method=method),  # type: ignore[arg-type]
        timeout=120.0,
    )
    clock = time.process_time
    try:
        plan = plan_by_method(scene, robot, task, reach, config=config, seed=seed, clock=clock).plan
        row: dict[str, object] = {
            "status": plan.status, "place": plan.timing["total"], "cost": plan.navigation_cost
        }  # fmt: skip
        if plan.status != "solved":
            why = next(iter(plan.candidates.rejections), "")
            return {**row, "success": False, "reason": f"{plan.status}: {why}"}
        record = run_plan(plan, scene, robot, reach, config=config, seed=seed, clock=clock)
    except MomaposError as error:
        return {"status": "refused", "success": False, "reason": str(error)}
    done = record.execution
    return {
        **row,
        "success": record.success, "reason": record.reason, "driven": record.driven,
        "visits": len(record.visits), "replan": record.time["plan"],
        "arm": done.simulated if done is not None else None,
        "collisions": [] if done is None else [[c.one, c.other, c.force] for c in done.collisions],
    }  # fmt: skip


def run(trials: int, methods: list[str], tasks: list[str], seed: int) -> list[dict[str, Any]]:
    """All trials, the same worlds for every method."""
    robot, room, small = load_robot(ROBOT), load_scene(shared() / "bestman" / ROOM), things()
    reach = load_reach_map(robot, default_cache_dir(), None)
    rows = []
    plan_by_method(
        room, robot, make_task(room, *TASKS["open microwave"]), reach
    )  # loads the kernels
    for number in range(trials):
        scene = layout(room, robot, small, np.random.default_rng([seed, number]))
        for name in tasks:
            for method in methods:
                task = make_task(scene, *TASKS[name])
                row = {"trial": number, "task": name, "method": method}
                rows.append(row | trial(scene, robot, reach, task, method, number))
                print(json.dumps(rows[-1]), flush=True)
    return rows


def report(rows: list[dict[str, Any]]) -> str:
    """A table as Markdown, the paper's rows after ours."""
    lines = [f"machine: {machine()}", ""]
    lines += ["| task | method | trials | planning CPU s | with the arm's motion s | cost m | "
              "driven m | success % |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for task in dict.fromkeys(r["task"] for r in rows):
        for method in dict.fromkeys(r["method"] for r in rows):
            mine = [r for r in rows if (r["task"], r["method"]) == (task, method)]
            acted = [r for r in mine if r.get("arm") is not None]
            plan = [r["place"] + r["replan"] for r in acted]
            whole = [p + r["arm"] for p, r in zip(plan, acted, strict=True)]
            good = 100 * np.mean([r["success"] for r in mine])
            cells = (plan, whole, [r["cost"] for r in acted], [r["driven"] for r in acted])
            numbers = " | ".join(_spread(values) for values in cells)
            lines.append(f"| {task} | {method} | {len(mine)} | {numbers} | {good:.0f} |")
        for _, method, seconds, cost, share in (row for row in PAPER if row[0] == task):
            lines.append(f"| | {method}, as printed | | | {seconds} | {cost} | | {share} |")
    failed = Counter((r["task"], r["method"], str(r["reason"])) for r in rows if not r["success"])
    lines += [f"failed {n} times: {', '.join(what)}" for what, n in failed.most_common()]
    touched = sum(bool(r.get("collisions")) for r in rows)
    again = sum(r.get("visits", 1) > 1 for r in rows)
    return "\n".join([*lines, f"{touched} trials with a collision, {again} with a second drive"])


def _spread(values: list[float]) -> str:
    return f"{np.mean(values):.2f} +- {np.std(values):.2f}" if values else "-"


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["ours"])
    parser.add_argument("--tasks", nargs="+", choices=tuple(TASKS), default=list(TASKS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for paper_tasks.json")
    args = parser.parse_args()
    rows = run(args.trials, args.methods, args.tasks, args.seed)
    print(report(rows))
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"machine": machine(), "rows": rows}, indent=1)
        (args.out / "paper_tasks.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
