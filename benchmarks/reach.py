"""Figures of the reachability maps: accuracy, size, building time, speed of look-ups.

    python benchmarks/reach.py [ROBOT ...] [--count 20000]

The maps are built anew. "Exact" is inverse kinematics in closed form with
self-collision and floor; the redundant joints of a longer arm are locked at 33 values for it, not
at the 9 that planning uses.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from momapos.geometry.transforms import pose
from momapos.kinematics.chain import chain_arrays
from momapos.kinematics.collision import FREE, check_states
from momapos.kinematics.ik import build_ik
from momapos.reachability import ReachConfig, ReachMap, build_map, evaluate
from momapos.reachability.evaluation import random_poses
from momapos.reachability.store import decode, encode
from momapos.robots.names import library_names
from momapos.robots.robot import Robot, load_robot


def machine() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        name = platform.processor() or platform.machine()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    return f"{name}, {os.cpu_count()} cores, load {load:.1f}"


def main(robots: tyro.conf.Positional[tuple[str, ...]] = (), count: int = 20_000) -> None:
    """Print a table.

    Args:
        robots: Names of library robots; all where none is given.
        count: Random poses per robot.
    """
    tiny = ReachConfig(cell=0.3, directions=3, azimuths=2, spins=1)
    # Compile first, and say what that takes.
    began = time.perf_counter()
    build_map(load_robot("husky_ur5e"), tiny)
    print(machine())
    print(
        f"compiling or loading the kernels, and a map of hardly any points: "
        f"{time.perf_counter() - began:.1f} s\n"
    )
    print(
        "| robot | grid | built, wall (CPU) | file | loaded | reachable | accuracy "
        "| false positives | misses | sampled states marked | `weakest` | `base_scores` |"
    )
    print("|" + "---|" * 12)
    for name in robots or library_names():
        print(row(load_robot(name), count), flush=True)


def row(robot: Robot, count: int) -> str:
    """One line of the table."""
    began, cpu = time.perf_counter(), time.process_time()
    content = encode(build_map(robot))
    built, cpu = time.perf_counter() - began, time.process_time() - cpu
    began = time.perf_counter()
    reach = decode(content)
    loaded = time.perf_counter() - began
    exact = build_ik(robot.chain, samples_per_joint=33, most_samples=1000)
    found = evaluate(reach, robot, np.random.default_rng(0), count, exact)
    weakest, floor = speeds(reach, robot)
    cells = [
        robot.name,
        " x ".join(map(str, reach.values.shape)),
        f"{built:.0f} s ({cpu:.0f})",
        f"{len(content) / 1e6:.2f} MB",
        f"{1e3 * loaded:.0f} ms",
        f"{100 * found.reachable:.1f} %",
        f"{100 * found.accuracy:.2f} %",
        f"{100 * found.false_positives:.2f} %",
        f"{100 * found.misses:.2f} %",
        f"{100 * marked(reach, robot):.2f} %",
        f"{weakest:.1f} ns",
        f"{floor:.2f} ms",
    ]
    return f"| {' | '.join(cells)} |"


def marked(reach: ReachMap, robot: Robot, count: int = 5_000) -> float:
    """Share of random arm states free of collision whose tool pose the map calls reachable."""
    chain, rng = robot.chain, np.random.default_rng(1)
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    q = rng.uniform(lower, upper, (10 * count, chain.size))
    boxes = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    codes = check_states(
        q, np.zeros(3), chain_arrays(chain), robot.spheres.arrays(), boxes, False, 0.0
    )
    return float((reach.score(chain.tool_poses(q[codes == FREE][:count])) > 0).mean())


def speeds(reach: ReachMap, robot: Robot) -> tuple[float, float]:
    """Nanoseconds per base, grasp and waypoint; milliseconds per grid of 6 m at 5 cm, the slowest
    of ten tool poses."""
    rng = np.random.default_rng(2)
    Ts = random_poses(robot, rng, 100)[:, None].repeat(12, 1)
    # A handle that is carried along a slanting line of 0.4 m.
    Ts[..., :3, 3] += np.linspace(0, 0.4, 12)[:, None] * pose((1, 0.5, 0))[:3, 3]
    bases = np.column_stack([rng.uniform(-1.2, 1.2, (2_000, 2)), rng.uniform(-3, 3, 2_000)])
    floor = np.arange(-3.0, 3.01, 0.05)
    weakest = best(lambda: reach.min_score(bases, Ts)) / (len(bases) * Ts.shape[0] * Ts.shape[1])
    return 1e9 * weakest, 1e3 * max(
        best(partial(reach.base_scores, T, floor, floor), 30) for T in Ts[:10, 0]
    )


def best(work: Callable[[], object], times: int = 7) -> float:
    """Least time of several runs [s]: other programs only ever add to it."""
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


if __name__ == "__main__":
    tyro.cli(main)
