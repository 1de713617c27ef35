"""Execute plans in physics: openings of five real and two built-in kitchens, for four robots.

    python benchmarks/execution.py [--robots fetch ...] [--tasks 20] [--hold weld]
                                   [--verb open|close|pick|place]
                                   [--errors] [--there] [--noisy] [--rooms built-in]
                                   [--out bench_out]

The base drives from its start to the base pose of every plan, and the arm's motion is replanned
there: once with exact sensors (not with --noisy), once with noisy ones and joint friction that is
up to 30 % off. With --there the base starts at the base poses, and each plan is executed once, with
this friction. With --errors the world also differs from the scene: handle 1 cm, hinge 3 cm and 5
degrees, mass and friction 50 %. Closing begins where opening ends. Picked and placed objects are
those without joints that are at most 40 cm long. Prints the result of each run, with the reason of
a failure, and writes it as JSON.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from momapos.core import MomaposError
from momapos.model.records import PlacementPlan
from momapos.model.scene import Scene
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.navigation import DriveConfig
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.simulation.config import ModelErrorConfig
from momapos.workflows import NO_NOISE, run_plan
from placement import CONFIG, ROBOTS, SCENES, arm, machine, scene_of, shared
from rows import commands, emit, keep_rows

Verb = Literal["open", "close", "pick", "place"]
RIGID = ("pick", "place")
BUILT_IN = ("kitchen_small", "kitchen_island")
MAX_EDGE = 0.4
"""Longer objects, such as counters and walls, are not picked [m]."""
SPREAD = 0.3
ERRORS = ModelErrorConfig(handle=0.01, axis=0.03, tilt=float(np.radians(5.0)), resistance=0.5)


def movable_objects(scene: Scene) -> list[tuple[str, None]]:
    """Return every object without joints that is small enough for one hand."""
    return [
        (item.name, None)
        for item in scene.objects
        if not item.model.joints and np.ptp(item.bounds, axis=0).max() < MAX_EDGE
    ]


def measure(
    row: dict[str, Any], scene: Scene, part: tuple[str, str | None], verb: Verb,
    noises: tuple[bool, ...], **run: Any,
) -> list[dict[str, Any]]:  # fmt: skip
    """Plan once, and execute with and without noise, or once."""
    robot, reach = arm(row["robot"])
    try:
        task = make_task(scene, verb if verb in RIGID else "open", *part)
        if verb == "close":
            scene = scene.with_joint(task.object, str(task.joint), float(task.to or 0.0))
            task = make_task(scene, verb, *part)
        plan = plan_base_placement(scene, robot, task, reach, config=CONFIG).plan
    except MomaposError as error:
        return [{**row, "status": "refused", "reason": str(error)}]
    if plan.status != "solved":
        return [{**row, "status": plan.status, "rejections": dict(plan.candidates.rejections)}]
    there = bool(run["there"])
    return [
        {**row, "status": "solved", "noise": noise}
        | executed(
            plan, scene, seed=run["seed"], clock=time.process_time,
            start=np.array(plan.base_pose) if there else None,
            driving=DriveConfig(noise=NO_NOISE) if there or not noise else DriveConfig(),
            physics=ExecutionConfig(
                hold=row["hold"], errors=ERRORS if run["errors"] else ModelErrorConfig(),
                furniture=FurnitureConfig(spread=SPREAD if noise else 0.0),
            ),
        )
        for noise in noises
    ]  # fmt: skip


def executed(plan: PlacementPlan, scene: Scene, **run: Any) -> dict[str, Any]:
    """Execute a plan; return what happened."""
    try:
        record = run_plan(plan, scene, *arm(plan.robot_name), **run)
    except MomaposError as error:
        return {"success": False, "reason": str(error)}
    row = {
        "success": record.success, "reason": record.reason, "seconds": dict(record.time),
        "visits": [asdict(visit) for visit in record.visits], "tries": 1 + len(record.failed),
        "first": [done.ending for done in record.failed],
    }  # fmt: skip
    if (done := record.execution) is not None:
        row |= {
            "simulated": done.simulated, "cpu": done.wall, "force": done.load.force,
            "torque": done.load.torque, "slip": done.slip.position,
            "tracking": done.tracking.worst, "effort": done.tracking.effort,
            "yield": max(done.base_shift[:2]), "clearance": done.clearance,
            "reached": [done.start, done.asked, done.reached], "ending": done.ending,
            "hardest": done.collisions[0].force if done.collisions else 0.0,
            "collisions": [[c.one, c.other, round(c.force, 1)] for c in done.collisions],
        }  # fmt: skip
    return row


def report(rows: list[dict[str, Any]]) -> str:
    """Return a summary."""
    lines = [f"machine: {machine()}"]
    plans = {(r["robot"], r["scene"], r["task"]): r["status"] for r in rows}
    lines.append(f"plans: {dict(Counter(plans.values()))}")
    for noise in (False, True):
        mine = [r for r in rows if r.get("noise") is noise]
        if not mine:
            continue
        good = sum(r["success"] for r in mine)
        touched = sum(bool(r.get("collisions")) for r in mine)
        lines.append(
            f"noise {'on' if noise else 'off'}: {good} of {len(mine)} executed with success, "
            f"{sum(r['success'] and r.get('tries') == 1 for r in mine)} at the first try; "
            f"{touched} with a collision"
        )
        endings = Counter(str(r.get("ending", "not executed")) for r in mine if not r["success"])
        lines += [f"  {n} times: {ending}" for ending, n in endings.most_common()]
        lines += [f"  {_name(r)}: {r['reason']}" for r in mine if not r["success"]]
        lines += _of_drives([r for r in mine if r.get("visits")])
    touches = Counter(" with ".join(c[:2]) for r in rows for c in r.get("collisions", ()))
    lines += [f"touched {count} times: {pair}" for pair, count in touches.most_common()]
    done = [r for r in rows if "cpu" in r]
    if done:
        factor = np.array([r["simulated"] / r["cpu"] for r in done])
        lines.append(
            f"simulated {np.median(factor):.1f} times faster than real time at the median, "
            f"{factor.min():.1f} times at the slowest (CPU time of one core)"
        )
        for key, unit, scale in (
            ("force", "N", 1), ("torque", "Nm", 1), ("slip", "mm", 1000),
            ("tracking", "mrad|mm", 1000), ("effort", "% of the limit", 100), ("yield", "mm", 1000),
            ("hardest", "N in contact", 1),
        ):  # fmt: skip
            values = scale * np.array([r[key] for r in done])
            lines.append(f"{key}: median {np.median(values):.2g}, worst {values.max():.2g} {unit}")
    return "\n".join(lines)


def _name(row: dict[str, Any]) -> str:
    return f"{row['robot']}, {row['scene']}, {row['task']}"


def _of_drives(rows: list[dict[str, Any]]) -> list[str]:
    """Summarize the drives, and why base poses were abandoned."""
    visits = [(r, visit) for r in rows for visit in r["visits"]]
    if not visits:
        return []
    arrived = [visit for _, visit in visits if visit["arrived"]]
    length, clear = (np.array([v[key] for v in arrived]) for key in ("length", "clearance"))
    simulated = sum(visit["seconds"] for _, visit in visits)
    lines = [
        f"  {len(visits)} base poses for {len(rows)} plans, {len(arrived)} reached; driven "
        f"{np.median(length):.1f} m at the median, {length.max():.1f} m at most; least clearance "
        f"{100 * clear.min():.1f} cm; driving simulated "
        f"{simulated / sum(r['seconds']['drive'] for r in rows):.0f} times faster than real time"
    ]
    for r, visit in visits:
        if visit["reason"]:
            kind = "arm" if visit["arrived"] else "drive"
            lines.append(f"  abandoned, {kind}: {_name(r)}: {visit['reason']}")
    return lines


def main(
    robots: tuple[str, ...] = ROBOTS, tasks: int | None = None, verb: Verb = "open",
    rooms: Literal["all", "built-in"] = "all", hold: Literal["contact", "weld"] = "contact",
    errors: bool = False, there: bool = False, noisy: bool = False, seed: int = 0,
    out: Path | None = None,
) -> None:  # fmt: skip
    """Execute plans.

    Args:
        robots: Robots of the library.
        tasks: Number of tasks, drawn at random.
        verb: The task.
        rooms: All kitchens, or the built-in ones.
        hold: How the hand holds the part.
        errors: Simulate with modeling errors.
        there: Start at the base poses.
        noisy: With noise only.
        seed: Seed of the drawn tasks and of the noise.
        out: Folder for execution.json.
    """
    scenes = [scene_of(name) for name in BUILT_IN]
    if rooms == "all" and not (shared() / "bestman").is_dir():
        print(f"{shared() / 'bestman'} does not exist: built-in kitchens only")
    elif rooms == "all":
        scenes += map(scene_of, SCENES)
    every = [
        (robot, scene, part)
        for robot in robots
        for scene in scenes
        for part in (movable_objects(scene) if verb in RIGID else openable(scene))
    ]
    rows = []
    for k in np.random.default_rng(seed).permutation(len(every))[:tasks]:
        robot, scene, part = every[k]
        row = {"robot": robot, "scene": scene.name, "hold": hold}
        row["task"] = "/".join(filter(None, part))
        noises = (True,) if there or noisy else (False, True)
        run = {"seed": seed, "there": there, "errors": errors}
        for done in measure(row, scene, part, verb, noises, **run):
            rows.append(done)
            emit(done)
    print(report(rows))
    keep_rows(rows, out, "execution")


if __name__ == "__main__":
    commands(__doc__, main)
