"""Measure the time of each further answer of `iter_placements`.

    python benchmarks/further_answers.py [--answers 40] [--out DIR]

Six openings of the built-in kitchen by four robots; --answers counts the answers after the second,
which includes modeling the whole scene.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from momapos.core import default_cache_dir
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.planning import PipelineConfig, iter_placements
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach_map
from placement import machine
from rows import keep_rows

ASKED = (
    ("segway_ur5e", "cabinet_right", "drawer_middle_slide"),
    ("segway_ur5e", "fridge", "door_hinge"),
    ("fetch", "fridge", "door_hinge"),
    ("fetch", "cabinet_left", "door_hinge"),
    ("husky_ur5e", "cabinet_left", "drawer_slide"),
    ("ranger_rm63", "fridge", "door_hinge"),
)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--answers", type=int, default=40)
    parser.add_argument("--out", type=Path, help="folder for further_answers.json")
    args = parser.parse_args()
    scene, config = load_scene("kitchen_small"), PipelineConfig()
    rows: list[dict[str, Any]] = []
    for name, item, joint in ASKED:
        robot = load_robot(name)
        reach = load_reach_map(robot, default_cache_dir(), None)
        given = iter_placements(
            scene, robot, make_task(scene, "open", item, joint), reach, config=config
        )
        times, used = [], []
        for _ in range(2 + args.answers):
            began, spent = time.perf_counter(), time.process_time()
            if next(given, None) is None:
                break
            times.append(time.perf_counter() - began)
            used.append(time.process_time() - spent)
        rows.append({"robot": name, "task": f"{item}/{joint}", "seconds": times, "used": used})
        print(
            f"{name} {item}/{joint}: first {1000 * times[0]:.0f} ms, second {1000 * times[1]:.0f} "
            f"ms, {len(times) - 2} others {1000 * np.median(times[2:]):.1f} ms at the median, "
            f"{1000 * np.percentile(times[2:], 95):.0f} ms at the 95th percentile",
            flush=True,
        )
    every = 1000 * np.concatenate([row["seconds"][2:] for row in rows])
    print(f"machine: {machine()}")
    print(
        f"all {len(every)}: {np.median(every):.1f} ms at the median, "
        f"{np.percentile(every, 95):.0f} ms at the 95th percentile"
    )
    keep_rows(rows, args.out, "further_answers")


if __name__ == "__main__":
    main()
