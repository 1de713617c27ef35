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

import argparse
import json
import os
import platform
import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import MomaposError, default_cache_dir
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.navigation import DriveConfig
from momapos.planning.reachability import load_reach_map
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.simulation.config import ModelErrorConfig
from momapos.workflows import NO_NOISE, run_plan
from placement import shared
from rows import keep_rows

REAL = (
    "Asset/Scene/Scene/Kitchen.json",
    "Asset/Scene/Scene/Kitchen_1.json",
    "Asset/Scene/Scene/b512.json",
    "derived/kitchen_v2.json",
    "derived/MoMa_Kitchen.json",
)
BUILT_IN = ("kitchen_small", "kitchen_island")
ROBOTS = ("fetch", "segway_ur5e", "husky_ur5e", "ranger_rm63")
RIGID = ("pick", "place")
MAX_EDGE = 0.4
"""Longer objects, such as counters and walls, are not picked [m]."""
SPREAD = 0.3
ERRORS = ModelErrorConfig(handle=0.01, axis=0.03, tilt=float(np.radians(5.0)), resistance=0.5)


def scenes(rooms: str) -> list[Scene]:
    """Return the built-in kitchens and, with `all`, the real ones if they are available."""
    if rooms == "built-in":
        return [load_scene(name) for name in BUILT_IN]
    root = shared() / "bestman"
    if not root.is_dir():
        print(f"{root} does not exist (MOMAPOS_SHARED names its parent): built-in kitchens only")
    real = [load_scene(root / name) for name in REAL] if root.is_dir() else []
    return [*(load_scene(name) for name in BUILT_IN), *real]


def movable_objects(scene: Scene) -> list[tuple[str, None]]:
    """Return every object without joints that is small enough for one hand."""
    return [
        (item.name, None)
        for item in scene.objects
        if not item.model.joints and np.ptp(item.bounds, axis=0).max() < MAX_EDGE
    ]


def chosen(
    verb: str, robots: tuple[str, ...], most: int | None, seed: int, where: str
) -> list[tuple[Robot, Scene, str, str | None]]:
    """Return the tasks of all robots in random order, so that a subset is a fair sample."""
    rooms = scenes(where)
    every = [
        (robot, scene, item, joint)
        for robot in map(load_robot, robots)
        for scene in rooms
        for item, joint in (movable_objects(scene) if verb in RIGID else openable(scene))
    ]
    order = np.random.default_rng(seed).permutation(len(every))
    return [every[i] for i in order[:most]]


def measure(
    robot: Robot, scene: Scene, item: str, joint: str | None, args: argparse.Namespace
) -> list[dict[str, object]]:
    """Plan once and execute twice, or once if the base starts at the base pose."""
    what = item if joint is None else f"{item}/{joint}"
    base = {"robot": robot.name, "scene": scene.name, "task": what, "hold": args.hold}
    errors = ERRORS if args.errors else ModelErrorConfig()
    reach = load_reach_map(robot, default_cache_dir(), None)
    rows: list[dict[str, object]] = []
    try:
        task = make_task(scene, args.verb if args.verb in RIGID else "open", item, joint)
        if args.verb == "close":
            assert task.to is not None
            assert joint is not None
            scene = scene.with_joint(item, joint, task.to)
            task = make_task(scene, args.verb, item, joint)
        config = PipelineConfig(timeout=120.0)
        plan = plan_base_placement(scene, robot, task, reach, config=config).plan
    except MomaposError as error:
        return [{**base, "status": "refused", "reason": str(error)}]
    if plan.status != "solved":
        return [{**base, "status": plan.status, "rejections": dict(plan.candidates.rejections)}]
    for noise in (True,) if args.there or args.noisy else (False, True):
        furniture = FurnitureConfig(spread=SPREAD if noise else 0.0)
        row: dict[str, object] = {**base, "status": "solved", "noise": noise}
        try:
            record = run_plan(
                plan, scene, robot, reach, seed=args.seed,
                start=np.array(plan.base_pose) if args.there else None,
                driving=DriveConfig(noise=NO_NOISE) if args.there or not noise else DriveConfig(),
                physics=ExecutionConfig(hold=args.hold, furniture=furniture, errors=errors),
                clock=time.process_time,
            )  # fmt: skip
        except MomaposError as error:
            rows.append({**row, "success": False, "reason": str(error)})
            continue
        row |= {
            "success": record.success, "reason": record.reason, "seconds": dict(record.time),
            "visits": [asdict(visit) for visit in record.visits], "tries": 1 + len(record.failed),
            "first": [done.ending for done in record.failed],
        }  # fmt: skip
        if record.execution is not None:
            done = record.execution
            row |= {
                "simulated": done.simulated,
                "cpu": done.wall,
                "force": done.load.force,
                "torque": done.load.torque,
                "slip": done.slip.position,
                "tracking": done.tracking.worst,
                "effort": done.tracking.effort,
                "yield": max(done.base_shift[:2]),
                "clearance": done.clearance,
                "reached": [done.start, done.asked, done.reached],
                "ending": done.ending,
                "hardest": done.collisions[0].force if done.collisions else 0.0,
                "collisions": [[c.one, c.other, round(c.force, 1)] for c in done.collisions],
            }
        rows.append(row)
    return rows


def report(rows: list[dict[str, Any]]) -> str:
    """Return a summary."""
    lines = [f"machine: {platform.machine()}, {len(os.sched_getaffinity(0))} cores"]
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
        lines += [f"  {n} times: {ending}" for ending, n in _endings(mine)]
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


def _endings(rows: list[dict[str, Any]]) -> list[tuple[str, int]]:
    """Count the endings of failed runs."""
    ended = (str(r.get("ending", "not executed")) for r in rows if not r["success"])
    return Counter(ended).most_common()


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


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--tasks", type=int, help="number of openings, drawn at random")
    parser.add_argument("--verb", choices=("open", "close", *RIGID), default="open")
    parser.add_argument("--rooms", choices=("all", "built-in"), default="all")
    parser.add_argument("--hold", choices=("contact", "weld"), default="contact")
    parser.add_argument("--errors", action="store_true", help="simulate with modeling errors")
    parser.add_argument("--there", action="store_true", help="start at the base poses")
    parser.add_argument("--noisy", action="store_true", help="with noise only")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder for execution.json")
    args = parser.parse_args()
    rows = []
    robots = tuple(args.robots)
    for chosen_task in chosen(args.verb, robots, args.tasks, args.seed, args.rooms):
        for row in measure(*chosen_task, args):
            rows.append(row)
            print(json.dumps(row), flush=True)
    print(report(rows))
    keep_rows(rows, args.out, "execution")


if __name__ == "__main__":
    main()
