"""Plan every door and drawer with a handle in five BestMan kitchens, for four robots.

    python benchmarks/placement.py [--robots fetch ...] [--scenes kitchen_small ...] [--exhaustive]
        [--only fridge] [--out docs/data]

Prints the answer of each task, its time and, with --exhaustive, whether a grid of 5 cm and 10
degrees solves it; also writes JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import Cache, MomaposError, default_cache_dir
from momapos.model.records import PoseStatus
from momapos.model.robots import load_robot
from momapos.model.scene import Scene, builtin_names, load_scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import load_reach_map

SCENES = (
    "Asset/Scene/Scene/Kitchen.json",
    "Asset/Scene/Scene/Kitchen_1.json",
    "Asset/Scene/Scene/b512.json",
    "derived/kitchen_v2.json",
    "derived/MoMa_Kitchen.json",
)
CONFIG = PipelineConfig(timeout=120.0)
ROBOTS = ("fetch", "segway_ur5e", "husky_ur5e", "ranger_rm63")


def shared() -> Path:
    """Return the folder of real data that holds bestman/."""
    given = Path(os.environ.get("MOMAPOS_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    return given / "data" if (given / "data").is_dir() else given


def scene_of(name: str, cache: Cache | None = None) -> Scene:
    """Load a built-in kitchen, or a scene of the real data, by name; with a cache, shapes, too."""
    return load_scene(name if name in builtin_names() else shared() / "bestman" / name, cache=cache)


def openings(robots: Sequence[str]) -> list[tuple[str, str, str, str]]:
    """Return robot, scene, object and joint of every door and drawer of the kitchens."""
    return [
        (robot, name, item, joint)
        for robot in robots
        for name in SCENES
        for item, joint in openable(scene_of(name))
    ]


def machine() -> str:
    """Return the processor and the number of cores."""
    model = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    return f"{model}, {len(os.sched_getaffinity(0))} cores"


def run(
    robots: tuple[str, ...], scenes: tuple[str, ...], *, exhaustive: bool, only: str = ""
) -> list[dict[str, Any]]:
    """Answer every task with a text in its name, once to warm up and once for the time."""
    rows = []
    for robot_name in robots:
        robot = load_robot(robot_name)
        reach = load_reach_map(robot, default_cache_dir(), None)
        for scene_name in scenes:
            scene = scene_of(scene_name)
            for item, joint in openable(scene):
                if only not in f"{item}/{joint}":
                    continue
                row: dict[str, Any] = {
                    "robot": robot_name,
                    "scene": Path(scene_name).stem,
                    "task": f"{item}/{joint}",
                }
                try:
                    task = make_task(scene, "open", item, joint)
                    plan_base_placement(
                        scene, robot, task, reach, config=PipelineConfig(timeout=120.0)
                    )
                    began, used = time.perf_counter(), time.process_time()
                    answer = plan_base_placement(
                        scene, robot, task, reach, config=PipelineConfig(timeout=120.0)
                    )
                    row |= {
                        "status": answer.plan.status,
                        "seconds": time.perf_counter() - began,
                        "processor": time.process_time() - used,
                        "cost": answer.plan.navigation_cost,
                        "checked": answer.plan.candidates.checked,
                        "sampled": answer.plan.candidates.sampled,
                    }
                    if exhaustive:
                        row |= _ground_truth(scene, robot, task, reach)
                except MomaposError as error:
                    row |= {"status": "refused", "reason": str(error)}
                rows.append(row)
                print(json.dumps(row), flush=True)
    return rows


def _ground_truth(scene, robot, task, reach) -> dict[str, Any]:  # type: ignore[no-untyped-def]
    config = PipelineConfig(place=PlaceConfig(method="exhaustive"), timeout=600.0)
    began = time.perf_counter()
    answer = plan_base_placement(scene, robot, task, reach, config=replace(config))
    counts = answer.search.counts()
    passed = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND)
    return {
        "grid": answer.plan.status,
        "grid_seconds": time.perf_counter() - began,
        "grid_cost": answer.plan.navigation_cost,
        "grid_feasible": sum(n for outcome, n in counts.items() if outcome.status in passed),
        "grid_poses": counts.total(),
    }


def report(rows: list[dict[str, Any]]) -> str:
    """Summarize as Markdown."""
    done = [r for r in rows if "seconds" in r]
    lines = [f"machine: {machine()}", ""]
    used = 1000 * np.array([r["processor"] for r in done])
    if len(done):
        lines += [
            f"all: {sum(r['status'] == 'solved' for r in done)} of {len(done)} solved; processor "
            f"time (less affected by other programs): median {np.median(used):.0f} ms, 95th "
            f"percentile {np.percentile(used, 95):.0f} ms"
        ]
    for name in dict.fromkeys(r["robot"] for r in done):
        mine = [r for r in done if r["robot"] == name]
        seconds = np.array([r["seconds"] for r in mine])
        solved = np.array([r["status"] == "solved" for r in mine])
        lines.append(
            f"{name}: {solved.sum()} of {len(mine)} solved; median "
            f"{1000 * np.median(seconds):.0f} ms, 95th percentile "
            f"{1000 * np.percentile(seconds, 95):.0f} ms"
            + (
                f" (solved only: {1000 * np.median(seconds[solved]):.0f} and "
                f"{1000 * np.percentile(seconds[solved], 95):.0f} ms)"
                if solved.any()
                else ""
            )
        )
        truth = [r for r in mine if "grid" in r]
        if truth:
            can = [r for r in truth if r["grid"] == "solved"]
            kept = sum(r["status"] == "solved" for r in can)
            slow = max(r["grid_seconds"] for r in truth)
            lines.append(f"  grid: {kept} of {len(can)} solvable are solved; slowest {slow:.1f} s")
    return "\n".join(lines)


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--exhaustive", action="store_true")
    parser.add_argument("--only", default="", help="only tasks with this in their name")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    robots, scenes = tuple(args.robots), tuple(args.scenes)
    rows = run(robots, scenes, exhaustive=args.exhaustive, only=args.only)
    if not rows:
        parser.error(f"no task of these scenes has {args.only!r} in its name")
    print(report(rows))
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"machine": machine(), "rows": rows}, indent=1)
        (args.out / "placement.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
