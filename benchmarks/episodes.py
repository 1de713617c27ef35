"""Make a set of episodes in LeRobot's format from the suite `smoke`: episodes an hour.

    python benchmarks/episodes.py --out FOLDER [--count 1000] [--minutes 60] [--workers 2]

Runs `momapos bench run smoke --execute --record` with one seed after another until there are as
many records, or the time is up, and then one `momapos export --to lerobot`. Prints wall and
processor time of both, and whether an episode costs more at the end than at the beginning. Exit
status 1 if a command fails, or if the set does not hold one episode for each record in which the
arm moves.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

ROBOT = "segway_ur5e"
"""Robot of the suite."""
COMMAND = (sys.executable, "-m", "momapos")


@dataclass(frozen=True)
class Cost:
    """Cost of one command."""

    wall: float
    """Wall time [s]."""
    processor: float
    """Processor time of all its processes [s]."""
    memory: float
    """Largest memory of any command so far [MB]."""
    episodes: int
    """Episodes that it made."""


def measured(*words: str) -> tuple[float, float, float]:
    """Run a command; return wall time [s], processor time [s] and memory [MB]."""
    began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*COMMAND, *words], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - began, spent, after.ru_maxrss / 1024


def make_runs(out: Path, count: int, minutes: float, workers: int) -> list[Cost]:
    """Record runs with one seed after another; return the cost of each seed."""
    runs, costs = out / "runs" / ROBOT, list[Cost]()
    end, made = time.monotonic() + 60 * minutes, 0
    while made < count and time.monotonic() < end:
        seed = len(costs)
        cost = measured(
            "bench", "run", "smoke", "--out", str(out / f"seed_{seed}"), "--seed", str(seed),
            "--methods", "ours", "--execute", "--disturbances", "0", "--workers", str(workers),
            "--record", str(out / "runs"),
        )  # fmt: skip
        now = sum(not path.name.endswith(".plan.json") for path in runs.glob("*.json"))
        costs.append(Cost(*cost, now - made))
        made = now
        print(f"seed {seed}: {made} episodes, {cost[1] / max(costs[-1].episodes, 1):.2f} s of "
              f"processor time for each new one, {cost[2]:.0f} MB", flush=True)  # fmt: skip
    return costs


def runs_with_arm(folder: Path) -> int:
    """Return the number of runs in which the arm moves: the others are no episodes."""
    records = (path for path in folder.glob("*.json") if not path.name.endswith(".plan.json"))
    return sum(bool(json.loads(path.read_text())["motion"]["joints"]) for path in records)


def per_episode(costs: list[Cost]) -> float:
    """Return the processor time of an episode [s]."""
    return sum(cost.processor for cost in costs) / max(sum(cost.episodes for cost in costs), 1)


def main() -> int:
    """Make the set; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="a new folder")
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=60.0, help="time for the runs")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    if find_spec("pyarrow") is None:
        parser.error("pyarrow is not installed, and the export needs it; pip install pyarrow")
    args.out.mkdir(parents=True)
    costs = make_runs(args.out, args.count, args.minutes, args.workers)
    wall, spent, memory = measured(
        "export", str(args.out / "runs" / ROBOT), "--to", "lerobot", "--out", str(args.out / "set")
    )
    info = json.loads((args.out / "set" / "meta" / "info.json").read_text())
    made, frames = info["total_episodes"], info["total_frames"]
    size = sum(path.stat().st_size for path in (args.out / "set").rglob("*.*") if path.is_file())
    third = max(len(costs) // 3, 1)
    first, last = per_episode(costs[:third]), per_episode(costs[-third:])
    ran = sum(cost.wall for cost in costs)
    print(f"{made} episodes, {frames} frames, {size / 1e6:.0f} MB")
    print(f"runs: {ran:.0f} s, {per_episode(costs):.2f} s of processor time for each episode; "
          f"{first:.2f} s in the first third of the seeds, {last:.2f} s in the last")  # fmt: skip
    print(f"export: {wall:.0f} s, {spent / made:.2f} s of processor time for each episode, "
          f"{memory:.0f} MB")  # fmt: skip
    print(f"{3600 * made / (ran + wall):.0f} episodes an hour on this machine; "
          f"{2 * 3600 / (per_episode(costs) + spent / made):.0f} on two free cores")  # fmt: skip
    return int(made != runs_with_arm(args.out / "runs" / ROBOT))


if __name__ == "__main__":
    sys.exit(main())
