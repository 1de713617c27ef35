"""Bring drawn items to drawn places in seven kitchens, check the plans, and execute them.

    python benchmarks/bring.py [--count 100] [--seed 0] [--robots fetch ...] [--run] [--level DEG]
        [--out FILE]

An item is a rigid object of at most 30 cm; a place is any other object on which it has a free spot.
Only errands are drawn for which the robot reaches some grasp at both ends from somewhere. All plans
are verified from their files. With --run each is executed in physics, and with --level the largest
tilt of the item there is measured. Prints a table and what was not done.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import MomaposError
from momapos.model.plan_files import write_plan
from momapos.model.records import Task
from momapos.model.scene import builtin_names
from momapos.planning import PipelineConfig, PlacementQuery, Request, Tour, plan_tour
from momapos.planning.carries import carries_for
from momapos.simulation import RunTrace, run_exactly
from momapos.verification import verify_files
from placement import SCENES, arm, scene_of

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_EDGE = 0.3
"""Largest edge of an item [m]."""
ROBOTS = ("fetch", "segway_ur5e", "mobile_panda", "tiago")
CONFIG = PipelineConfig(timeout=60.0)
Errand = tuple[str, str, str, str]
"""Robot, scene, item and place."""


@cache
def errands_of(robot: str, name: str) -> list[Errand]:
    """Return the errands in a scene for which the hand has a grasp in reach at both ends."""
    scene, (machine, reach) = scene_of(name), arm(robot)
    found: list[Errand] = []
    for item in scene.objects:
        if item.model.joints or item.wall or np.ptp(item.bounds, axis=0).max() > MAX_EDGE:
            continue
        for place in scene.objects:
            if place is item or place.wall:
                continue
            try:
                query = PlacementQuery.of(
                    scene, machine, Task("pick", item.name), reach, config=CONFIG
                )
                ways = carries_for(query, scene, item.name, place.name)
            except MomaposError:  # no room there, or nothing that the hand holds
                continue
            if ways[0].reached:
                found.append((robot, name, item.name, place.name))
    return found


def drawn(robots: Sequence[str], count: int, seed: int) -> list[Errand]:
    """Draw errands, evenly over robots and scenes."""
    rng = np.random.default_rng(seed)
    every = [errands_of(robot, name) for robot in robots for name in (*builtin_names(), *SCENES)]
    every = [errands for errands in every if errands]
    return [(some := every[k % len(every)])[int(rng.integers(len(some)))] for k in range(count)]


def answer(errand: Errand, config: PipelineConfig = CONFIG, *, run: bool) -> dict[str, Any]:
    """Plan an errand; check its files, and execute them."""
    name, place_scene, item, place = errand
    scene, (robot, reach) = scene_of(place_scene), arm(name)
    row: dict[str, Any] = {"errand": errand}
    began = time.process_time()
    try:
        tour = plan_tour(scene, robot, [Request("bring", item, None, place)], reach, config=config)
    except MomaposError as error:
        return row | {
            "status": "refused",
            "why": str(error),
            "seconds": time.process_time() - began,
        }
    row |= {"status": tour.status, "seconds": time.process_time() - began}
    if tour.status != "solved":
        last = tour.steps[-1].plan
        row["why"] = f"{last.task.verb}: {dict(list(last.candidates.rejections.items())[:3])}"
        return row
    row |= {"stops": max(tour.stops), "driving": tour.driving}
    with tempfile.TemporaryDirectory() as folder:
        return row | check(tour, Path(folder), run=run)


def check(tour: Tour, folder: Path, *, run: bool) -> dict[str, Any]:
    """Verify the plans of a tour from their files, and execute each in physics."""
    tour = tour.with_scene_files(folder / "tour.json")
    found: dict[str, Any] = {"valid": True, "done": True}
    for k, (step, room) in enumerate(zip(tour.steps, tour.scenes, strict=True)):
        write_plan(step.plan, folder / f"{k}.json")
        found["valid"] &= verify_files(folder / f"{k}.json").valid
        if run:
            trace = RunTrace()
            done = run_exactly(step.plan, room, step.prepared.robot, watch=trace).execution
            if done is None or not done.success:
                found |= {"done": False, "failed": "" if done is None else done.reason}
            poses = np.array(trace.motion().poses)
            found["tilt"] = max(found.get("tilt", 0.0), tilt_in(step.plan.task.verb, poses))
    return found


def tilt_in(verb: str, poses: Float[np.ndarray, "s 7"]) -> float:
    """Return how far an item was tilted at most from how it stands [deg]."""
    w, x, y, z = poses[:, 3:].T
    up = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    standing = up[-1 if verb == "place" else 0]
    return float(np.degrees(np.arccos(np.clip(up @ standing, -1.0, 1.0)).max()))


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Summarize as Markdown by robot, then list what was not done."""
    lines = [
        "| robot | errands | solved | valid | done | stops 1 / 2 | median | 95th percentile |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in [*dict.fromkeys(row["errand"][0] for row in rows), "all"]:
        some = [row for row in rows if name in ("all", row["errand"][0])]
        done = [row for row in some if row["status"] == "solved"]
        seconds = np.array([row["seconds"] for row in done] or [np.nan])
        stops = [sum(row["stops"] == k for row in done) for k in (1, 2)]
        valid, executed = (sum(row[key] for row in done) for key in ("valid", "done"))
        lines.append(
            f"| {name} | {len(some)} | {len(done)} | {valid} | {executed} | "
            f"{stops[0]} / {stops[1]} | {np.median(seconds):.2f} s | "
            f"{np.percentile(seconds, 95):.2f} s |"
        )
    lines += [
        f"- {' '.join(row['errand'])}: {row['status']} after {row['seconds']:.1f} s, {row['why']}"
        for row in rows if row["status"] != "solved"
    ]  # fmt: skip
    lines += [f"- {' '.join(row['errand'])}: {row['failed']}" for row in rows if "failed" in row]
    tilts = np.array([row["tilt"] for row in rows if "tilt" in row])
    if len(tilts):
        lines.append(
            f"- tilt in physics: median {np.median(tilts):.1f}, most {tilts.max():.1f} deg"
        )
    return "\n".join(lines)


def main() -> None:
    """Answer the errands and print the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", nargs="+", default=list(ROBOTS))
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--level", type=float)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    config = replace(CONFIG, motion=replace(CONFIG.motion, level=args.level))
    rows = []
    for errand in drawn(args.robots, args.count, args.seed):
        rows.append(answer(errand, config, run=args.run))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    if args.out is not None:
        args.out.write_text("\n".join(json.dumps(row) for row in rows) + "\n")
    print(report(rows))


if __name__ == "__main__":
    main()
