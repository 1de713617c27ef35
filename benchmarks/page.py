"""Measure the response of the web page: from the command to a page, and while dragging the base.

    python benchmarks/page.py [--poses 200] [--start]

Base poses are drawn around that of the answer, like a dragged base; half of them are infeasible.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import re
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np

from momapos.apps.web.answer_view import READY
from momapos.apps.web.follow import DRAG_TIME_LIMIT
from momapos.apps.web.probe import Probe
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.planning import plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach
from pages import Tab

TASKS = (
    ("fridge", "door_hinge"), ("oven", "door_hinge"), ("dishwasher", "door_hinge"),
    ("cabinet_right", "drawer_top_slide"), ("wall_cabinet", "door_left_hinge"),
)  # fmt: skip
ROBOTS = ("segway_ur5e", "fetch", "tiago")
SPREAD = np.array([0.25, 0.25, 0.5])
"""Standard deviation of the base poses around that of the answer [m, m, rad]."""


def dragging(poses: int, seed: int) -> np.ndarray:
    """Return wall and processor times of the answers to dragged bases [s], all robots and tasks."""
    scene, rng, times = load_scene("kitchen_small"), np.random.default_rng(seed), []
    for name in ROBOTS:
        robot = load_robot(name)
        reach = load_reach(robot)
        for item, joint in TASKS:
            task = make_task(scene, "open", item, joint)
            base = plan_base_placement(scene, robot, task, reach).plan.base_pose
            if base is None:  # no answer, so no base pose to drag
                continue
            probe = Probe(scene, robot, task, reach)
            probe.prepare()
            own = []
            for pose in np.array(base) + SPREAD * rng.normal(size=(poses, 3)):
                began = time.perf_counter(), time.process_time()
                probe.at(pose, time.perf_counter, within=DRAG_TIME_LIMIT)
                ended = time.perf_counter(), time.process_time()
                own.append((ended[0] - began[0], ended[1] - began[1]))
            print(f"{name:12} {item + '/' + joint:32} {percentiles(np.array(own))}", flush=True)
            times += own
    return np.array(times)


def percentiles(times: np.ndarray) -> str:
    """Format median, 95th percentile and maximum of wall and processor time."""
    low, high, worst = 1000 * np.quantile(times[:, 0], [0.5, 0.95, 1.0])
    own = 1000 * np.quantile(times[:, 1], [0.5, 0.95])
    return (
        f"median {low:4.0f} ms, 95 % {high:4.0f} ms, worst {worst:4.0f} ms; "
        f"processor {own[0]:4.0f} and {own[1]:4.0f} ms"
    )


async def ready(address: str) -> None:
    """Open a page and wait until room and robot are drawn and it is ready."""
    tab = Tab(address, 0)
    await tab.open()
    while not any(READY.notes[0] in words for words in tab.seen.words):
        await asyncio.sleep(0.01)
    await tab.close()


def usable() -> tuple[float, float]:
    """Return wall and processor time from the command to a ready page [s], with compiled kernels.

    The start and drawing of a browser are excluded.
    """
    command = [
        sys.executable, "-c", "from momapos.apps.cli.main import entry; entry()", "view",
        "kitchen_small", "--port", "0",
    ]  # fmt: skip
    began = time.perf_counter()
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        address = re.search(r"http://\S+", server.stdout.readline())
        assert address is not None
        with urllib.request.urlopen(address[0]) as answer:
            answer.read()
        asyncio.run(ready(address[0]))
        took = time.perf_counter() - began
        spent = Path(f"/proc/{server.pid}/stat").read_text().rpartition(")")[2].split()
        server.terminate()
    return took, sum(map(int, spent[11:13])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=200, help="number of poses per task and robot")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", action="store_true", help="measure the start only")
    args = parser.parse_args()
    usable()  # compile the kernels
    runs = [usable() for _ in range(3)]
    wall, own = (sorted(each)[1] for each in zip(*runs, strict=True))
    print(f"from the command to a page: {wall:.1f} s, {own:.1f} s of processor", flush=True)
    if args.start:
        sys.exit()
    print(f"all: {percentiles(dragging(args.poses, args.seed))}")
