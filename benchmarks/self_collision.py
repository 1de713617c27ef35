"""Count self-collisions of random arm states by hulls, by spheres, and as planning decides.

    python benchmarks/self_collision.py [ROBOT ...]

The results are in docs/results/robots.md. Processor time of one thread.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from momapos.model.collision import contacts, decided_by_hulls
from momapos.model.robots import Robot, library_names, load_arms
from momapos.model.robots.load_limits import sample_states, touches

REPEATS = 5


def row(robot: Robot) -> str:
    """Return one line of the table."""
    chain, spheres = robot.chain, robot.spheres
    q = sample_states(chain, np.random.default_rng(5))
    found = contacts(chain, spheres, q)
    decided = touches(chain, spheres, q).mean()
    begin = time.process_time()
    for _ in range(REPEATS):
        touches(chain, spheres, q)
    each = (time.process_time() - begin) / REPEATS / len(q)
    shares = (found.by_hulls.any(1).mean(), found.by_spheres.any(1).mean(), decided)
    name = " ".join(filter(None, (robot.name, robot.arm)))
    percent = " | ".join(f"{100 * share:.1f}" for share in shares)
    return f"| {name} | {percent} | {len(decided_by_hulls(spheres))} | {1e6 * each:.1f} |"


def main() -> None:
    """Print the table for some robots, or for the whole library."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=library_names(), metavar="ROBOT")
    args = parser.parse_args()
    print(
        "| states blocked [%] | by hulls | by spheres only | as in planning | pairs left to hulls |"
    )
    for name in args.robots:
        for robot in load_arms(name):
            print(row(robot))


if __name__ == "__main__":
    main()
