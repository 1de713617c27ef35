"""Compare the stated farthest opening of drop-down doors with the one that physics reaches.

    python benchmarks/drop_down.py [--robots fetch ...] [--set development|test] [--seeds 1]
                                   [--plinth 0.1] [--out DIR]

The doors of `objects.py` that turn down about a horizontal axis: dishwashers, ovens, and a few
others. They stand on the floor, which some meet after a few degrees, or on a plinth. Each is opened
as far as the robot can (`--to max`), and the planned motion is executed at its base pose, with
contacts, without noise and without the drive: at the largest value, an arm seldom finds a motion a
few millimeters from that pose. Doors of the `test` set are only counted.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.articulated import SETS, parts, set_of
from momapos.core import MomaposError, default_cache_dir
from momapos.core.geometry import apply
from momapos.model.robots import Robot, load_robot, opened_as
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import opening_of
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach_map
from momapos.simulation import ExecutionConfig, FurnitureConfig, attempt
from objects import objects, room
from placement import ROBOTS, machine
from rows import keep_rows

CONFIG = PipelineConfig(timeout=120.0)
EXACT = ExecutionConfig(furniture=FurnitureConfig(spread=0.0))
CLOSE = 3.0
"""A reached value confirms a stated one within this difference [deg]."""
MIN_DROP = 0.05
"""Height by which a door's middle falls over its first 60 degrees, at least [m]."""


def drop_down_doors(subset: str | None, plinth: float = 0.0) -> Iterator[tuple[str, Scene, str]]:
    """Yield object name, room and joint of every door that turns down.

    Args:
        subset: Only objects of one set.
        plinth: Height by which furniture of a usual height is raised [m].
    """
    for name, file, usual in objects():
        raised = replace(usual, above=usual.above + plinth) if usual.height else usual
        scene = room(name, file, raised) if subset in (None, set_of(name)) else None
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


def confirmed(robot: Robot, scene: Scene, joint: str, seeds: int) -> dict[str, Any]:
    """Open a door as far as possible; return the stated and the reached values [deg]."""
    reach = load_reach_map(robot, default_cache_dir(), None)
    task = make_task(scene, "open", "object", joint, "max")
    answer = plan_base_placement(scene, robot, task, reach, config=CONFIG, clock=time.process_time)
    plan = answer.with_notes().plan
    if plan.status != "solved" or plan.task.to is None:
        return {"status": plan.status, "reason": next(iter(plan.candidates.rejections), "")}
    assert plan.motion is not None
    assert plan.base_pose is not None
    runs, hand = [], opened_as(robot, plan.robot_rest)
    for seed in range(seeds):
        outcome = attempt(
            scene.with_resistance(plan.resistance), hand, plan.base_pose, plan.motion, plan.task,
            EXACT, np.random.default_rng(seed),
        )  # fmt: skip
        done = outcome.execution
        reached = float(np.degrees(done.reached))
        runs.append({"success": done.success, "reason": done.ending, "reached": reached})
    return {
        "status": "solved", "stated": float(np.degrees(plan.task.to)),
        "sure": plan.task.farthest, "notes": plan.notes, "runs": runs,
    }  # fmt: skip


def report(rows: list[dict[str, Any]]) -> str:
    """Return a table by set, and one of every door of the development set."""
    lines = [f"machine: {machine()}"]
    lines += [
        f"| set | doors x robots | stated | runs | reached within {CLOSE:g} deg | farthest off |"
    ]
    lines += ["|---" * 6 + "|"]
    for subset in SETS:
        mine = [row for row in rows if row["set"] == subset]
        stated = [row for row in mine if row["status"] == "solved"]
        gaps = [gap(row, run) for row in stated for run in row["runs"]]
        close = sum(each <= CLOSE for each in gaps)
        worst = f"{max(gaps):.1f} deg" if gaps else ""
        numbers = [len(mine), len(stated), len(gaps), close, worst]
        lines.append(f"| {subset} | {' | '.join(map(str, numbers))} |")
    lines += ["", "| door | robot | stated | reached | reason |", "|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: (row["object"], row["robot"])):
        if row["set"] != SETS[0]:
            continue
        solved = row["status"] == "solved"
        value = f"{row['stated']:.0f} deg" if solved else row["status"]
        runs = ", ".join(reached_words(run) for run in row.get("runs", ()))
        why = "; ".join(row["notes"]) if solved else row["reason"]
        lines.append(f"| {row['object']} | {row['robot']} | {value} | {runs} | {why} |")
    return "\n".join(lines)


def gap(row: dict[str, Any], run: dict[str, Any]) -> float:
    """Return how far a run ends from the stated value [deg]."""
    return float(abs(run["reached"] - row["stated"]))


def reached_words(run: dict[str, Any]) -> str:
    """Format what a run reached."""
    return f"{run['reached']:.1f} deg" + ("" if run["success"] else f" ({run['reason']})")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--set", choices=SETS, help="only the objects of one set")
    parser.add_argument("--seeds", type=int, default=1, help="number of runs per plan")
    parser.add_argument("--plinth", type=float, default=0.0, help="raise the furniture [m]")
    parser.add_argument("--out", type=Path, help="folder for drop_down.json")
    args = parser.parse_args()
    robots = {name: load_robot(name) for name in args.robots}
    rows: list[dict[str, Any]] = []
    for name, scene, joint in drop_down_doors(args.set, args.plinth):
        for robot in args.robots:
            row: dict[str, Any] = {"object": name, "joint": joint, "robot": robot}
            row["set"] = set_of(name)
            try:
                row |= confirmed(robots[robot], scene, joint, args.seeds)
            except MomaposError as error:
                row |= {"status": "refused", "reason": str(error)}
            rows.append(row)
            keep_rows(rows, args.out, "drop_down")
            if row["set"] == SETS[0]:
                print(json.dumps(row), flush=True)
    print(report(rows))


if __name__ == "__main__":
    main()
