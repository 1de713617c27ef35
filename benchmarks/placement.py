"""Plan every door and drawer with a handle in five BestMan kitchens, for four robots.

    python benchmarks/placement.py [--robots fetch ...] [--scenes kitchen_small ...] [--exhaustive]
        [--only fridge] [--out docs/data]

Prints the answer of each task, its time and, with --exhaustive, whether a grid of 5 cm and 10
degrees solves it; also writes JSON.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import Cache, MomaposError
from momapos.model.records import PoseStatus, Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, builtin_names, load_scene
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.placement import PlaceConfig
from momapos.planning.reachability import load_reach
from rows import commands, emit, keep_rows, milliseconds

SCENES = (
    "Asset/Scene/Scene/Kitchen.json",
    "Asset/Scene/Scene/Kitchen_1.json",
    "Asset/Scene/Scene/b512.json",
    "derived/kitchen_v2.json",
    "derived/MoMa_Kitchen.json",
)
CONFIG = PipelineConfig(timeout=120.0)
ROBOTS = ("fetch", "segway_ur5e", "husky_ur5e", "ranger_rm63")
Opening = tuple[str, str, str, str]
"""Robot, scene, object and joint."""


def shared() -> Path:
    """Return the folder of real data that holds bestman/."""
    given = Path(os.environ.get("MOMAPOS_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    return given / "data" if (given / "data").is_dir() else given


def scene_of(name: str, cache: Cache | None = None) -> Scene:
    """Load a built-in kitchen, or a scene of the real data, by name; with a cache, shapes, too."""
    return load_scene(name if name in builtin_names() else shared() / "bestman" / name, cache=cache)


@cache
def arm(name: str) -> tuple[Robot, Any]:
    """Return a robot of the library, and what rates its reach."""
    robot = load_robot(name)
    return robot, load_reach(robot)


def openings(robots: Sequence[str], count: int = 0) -> list[Opening]:
    """Return every door and drawer of the kitchens, or a fixed random sample."""
    every = [
        (robot, name, item, joint)
        for robot in robots
        for name in SCENES
        for item, joint in openable(scene_of(name))
    ]
    if not count:
        return every
    drawn = np.random.default_rng(0).permutation(len(every))[:count]
    return [every[k] for k in sorted(drawn.tolist())]


def machine() -> str:
    """Return the processor and the number of cores."""
    model = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    return f"{model}, {len(os.sched_getaffinity(0))} cores"


def answered(name: str, scene: Scene, task: Task, *, exhaustive: bool) -> dict[str, Any]:
    """Answer a task, once to warm up and once for the time."""
    robot, reach = arm(name)
    plan_base_placement(scene, robot, task, reach, config=CONFIG)
    began, used = time.perf_counter(), time.process_time()
    plan = plan_base_placement(scene, robot, task, reach, config=CONFIG).plan
    row = {
        "status": plan.status, "seconds": time.perf_counter() - began,
        "processor": time.process_time() - used, "cost": plan.navigation_cost,
        "checked": plan.candidates.checked, "sampled": plan.candidates.sampled,
    }  # fmt: skip
    if not exhaustive:
        return row
    config = PipelineConfig(place=PlaceConfig(method="exhaustive"), timeout=600.0)
    began = time.perf_counter()
    answer = plan_base_placement(scene, robot, task, reach, config=config)
    counts = answer.search.counts()
    passed = (PoseStatus.FEASIBLE, PoseStatus.PATH_FOUND)
    return row | {
        "grid": answer.plan.status, "grid_seconds": time.perf_counter() - began,
        "grid_cost": answer.plan.navigation_cost,
        "grid_feasible": sum(n for outcome, n in counts.items() if outcome.status in passed),
        "grid_poses": counts.total(),
    }  # fmt: skip


def report(rows: list[dict[str, Any]]) -> str:
    """Summarize as Markdown."""
    done = [r for r in rows if "seconds" in r]
    lines = [f"machine: {machine()}", ""]
    if done:
        times = milliseconds([r["processor"] for r in done])
        words = "processor time (less affected by other programs)"
        lines.append(f"all: {_solved(done)}; {words}: {times}")
    for name in dict.fromkeys(r["robot"] for r in done):
        mine = [r for r in done if r["robot"] == name]
        solved = [r["seconds"] for r in mine if r["status"] == "solved"]
        only = f" (solved only: {milliseconds(solved)})" if solved else ""
        times = milliseconds([r["seconds"] for r in mine])
        lines.append(f"{name}: {_solved(mine)}; {times}{only}")
        if truth := [r for r in mine if "grid" in r]:
            can = [r["status"] == "solved" for r in truth if r["grid"] == "solved"]
            slow = max(r["grid_seconds"] for r in truth)
            lines.append(
                f"  grid: {sum(can)} of {len(can)} solvable are solved; slowest {slow:.1f} s"
            )
    return "\n".join(lines)


def _solved(rows: list[dict[str, Any]]) -> str:
    return f"{sum(r['status'] == 'solved' for r in rows)} of {len(rows)} solved"


def main(
    robots: tuple[str, ...] = ROBOTS, scenes: tuple[str, ...] = SCENES, exhaustive: bool = False,
    only: str = "", out: Path | None = None,
) -> None:  # fmt: skip
    """Answer every task with a text in its name.

    Args:
        robots: Robots of the library.
        scenes: Built-in kitchens, or scenes of the real data.
        exhaustive: Search the grid, too.
        only: Only tasks with this in their name.
        out: Folder for placement.json.
    """
    rows: list[dict[str, Any]] = []
    for robot, name in ((robot, name) for robot in robots for name in scenes):
        scene = scene_of(name)
        for item, joint in openable(scene):
            if only not in f"{item}/{joint}":
                continue
            row = {"robot": robot, "scene": Path(name).stem, "task": f"{item}/{joint}"}
            try:
                task = make_task(scene, "open", item, joint)
                row |= answered(robot, scene, task, exhaustive=exhaustive)
            except MomaposError as error:
                row |= {"status": "refused", "reason": str(error)}
            rows.append(row)
            emit(row)
    if not rows:
        raise SystemExit(f"no task of these scenes has {only!r} in its name")
    print(report(rows))
    keep_rows({"machine": machine(), "rows": rows}, out, "placement")


if __name__ == "__main__":
    commands(__doc__, main)
