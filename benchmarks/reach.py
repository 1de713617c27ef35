"""Measure reachability maps: misses, false positives, size, building time, look-ups.

    python benchmarks/reach.py [ROBOT ...] [--count 20000] [--ready]

The reference is inverse kinematics (`Robot.finer`) with self-collision and floor; redundant joints
are locked at 33 values. Poses "near reach" are up to 17 cm per axis and 0.5 rad off a reachable
pose; the others fill the ball around the shoulder that the tool can reach.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import tyro

from momapos.core.geometry import pose
from momapos.model.collision import FREE, check_states
from momapos.model.kinematics import chain_arrays, one_turn
from momapos.model.robots import Robot, library_names, load_arms, load_robot
from momapos.planning.reachability import (
    ReachConfig,
    ReachMap,
    build_true_map,
    encode,
    evaluate,
    load_reach_map,
    no_map,
)
from momapos.planning.reachability.construct import build_map
from momapos.planning.reachability.map_store import decode, random_poses
from placement import machine
from rows import commands


def main(
    robots: tyro.conf.Positional[tuple[str, ...]] = (), count: int = 20_000, ready: bool = False
) -> None:
    """Print a table.

    Args:
        robots: Library robots or robot files; the whole library by default.
        count: Random poses per robot.
        ready: Use shipped and cached maps; by default all maps are built.
    """
    tiny = ReachConfig(cell=0.3, directions=3, azimuths=2, spins=1)
    # Compile first, and print the time.
    began = time.perf_counter()
    build_map(load_robot("husky_ur5e"), tiny)
    print(f"{machine()}, load {os.getloadavg()[0]:.1f}")
    print(
        f"compiling or loading the kernels, and a tiny map: {time.perf_counter() - began:.1f} s\n"
    )
    print(
        "| robot | grid | built, wall (CPU) | file | loaded | near reach: reachable "
        "| false positives | misses | in the ball: reachable | false positives | misses "
        "| sampled states marked | `weakest` | `base_scores` |"
    )
    print("|" + "---|" * 14)
    for name in robots or library_names():
        for robot in load_arms(name):
            why = no_map(robot)
            line = f"| {robot.title} | none: {why} |" if why else row(robot, count, ready)
            print(line, flush=True)


def row(robot: Robot, count: int, ready: bool) -> str:
    """Return one line of the table."""
    began, cpu = time.perf_counter(), time.process_time()
    content = encode(load_reach_map(robot) if ready else build_true_map(robot))
    built, cpu = time.perf_counter() - began, time.process_time() - cpu
    began = time.perf_counter()
    reach = decode(content)
    loaded = time.perf_counter() - began
    exact = robot.finer.ik
    near, ball = (
        evaluate(reach, robot, np.random.default_rng(0), count, exact, near=near_reach)
        for near_reach in (True, False)
    )
    weakest, floor = speeds(reach, robot)
    shape = (reach.values if reach.turned is None else reach.turned).shape
    cells = [
        robot.title,
        " x ".join(map(str, shape)),
        "ready" if ready else f"{built:.0f} s ({cpu:.0f})",
        f"{len(content) / 1e6:.2f} MB",
        f"{1e3 * loaded:.0f} ms",
        *(
            text
            for found in (near, ball)
            for text in (
                f"{100 * found.reachable:.1f} %",
                f"{100 * found.false_positives:.2f} %",
                f"{100 * found.misses:.2f} %",
            )
        ),
        f"{100 * marked(reach, robot):.2f} %",
        f"{weakest:.1f} ns",
        f"{floor:.2f} ms",
    ]
    return f"| {' | '.join(cells)} |"


def marked(reach: ReachMap, robot: Robot, count: int = 5_000) -> float:
    """Return the share of collision-free random arm states whose tool pose the map accepts."""
    chain, rng = robot.chain, np.random.default_rng(1)
    q = rng.uniform(*one_turn(chain), (10 * count, chain.size))
    boxes = (np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0, bool))
    codes = check_states(
        q, np.zeros(3), chain_arrays(chain), robot.spheres.arrays, boxes, False, 0.0
    )
    return float((reach.score(chain.tool_poses(q[codes == FREE][:count])) > 0).mean())


def speeds(reach: ReachMap, robot: Robot) -> tuple[float, float]:
    """Return the time per base, grasp and waypoint [ns], and per grid of 6 m at 5 cm [ms].

    The second is the slowest of ten tool poses.
    """
    rng = np.random.default_rng(2)
    Ts = random_poses(robot, rng, 100)[:, None].repeat(12, 1)
    # A handle that moves along a sloped line of 0.4 m.
    Ts[..., :3, 3] += np.linspace(0, 0.4, 12)[:, None] * pose((1, 0.5, 0))[:3, 3]
    bases = np.column_stack([rng.uniform(-1.2, 1.2, (2_000, 2)), rng.uniform(-3, 3, 2_000)])
    floor = np.arange(-3.0, 3.01, 0.05)
    weakest = best(lambda: reach.min_score(bases, Ts)) / (len(bases) * Ts.shape[0] * Ts.shape[1])
    return 1e9 * weakest, 1e3 * max(
        best(partial(reach.base_scores, T, floor, floor), 30) for T in Ts[:10, 0]
    )


def best(work: Callable[[], object], times: int = 7) -> float:
    """Return the minimum time of several runs [s]; other programs only increase it."""
    seconds = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


if __name__ == "__main__":
    commands(__doc__, main)
