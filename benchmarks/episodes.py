"""Make a set of episodes in LeRobot's format from the suite `smoke`: episodes an hour.

    python benchmarks/episodes.py FOLDER [--count 1000] [--minutes 60] [--workers 2]

Runs `momapos bench run smoke --execute --record` with one seed after another until there are as
many records, or the time is up, and then one `momapos export --to lerobot`. Prints wall and
processor time of both, and whether an episode costs more at the end than at the beginning. Exit
status 1 if a command fails, or if the set does not hold one episode for each record in which the
arm moves.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

from rows import child, commands

ROBOT = "segway_ur5e"
"""Robot of the suite."""
COMMAND = (sys.executable, "-m", "momapos")


def measured(*words: str) -> tuple[float, float, float]:
    """Run a command; return wall time [s], processor time [s] and memory [MB]."""
    status, wall, spent, memory = child([*COMMAND, *words], stdout=subprocess.DEVNULL)
    if status:
        sys.exit(f"{' '.join(words)}: exit status {status}")
    return wall, spent, 1000 * memory


def make_runs(out: Path, count: int, minutes: float, workers: int) -> list[tuple[float, ...]]:
    """Record runs with one seed after another; return the cost of each, and its new episodes."""
    runs, costs = out / "runs" / ROBOT, list[tuple[float, ...]]()
    end, made = time.monotonic() + 60 * minutes, 0
    while made < count and time.monotonic() < end:
        seed = len(costs)
        wall, spent, memory = measured(
            "bench", "run", "smoke", "--out", str(out / f"seed_{seed}"), "--seed", str(seed),
            "--methods", "ours", "--execute", "--disturbances", "0", "--workers", str(workers),
            "--record", str(out / "runs"),
        )  # fmt: skip
        now = sum(not path.name.endswith(".plan.json") for path in runs.glob("*.json"))
        costs.append((wall, spent, now - made))
        print(f"seed {seed}: {now} episodes, {spent / max(now - made, 1):.2f} s of "
              f"processor time for each new one, {memory:.0f} MB", flush=True)  # fmt: skip
        made = now
    return costs


def runs_with_arm(folder: Path) -> int:
    """Return the number of runs in which the arm moves: the others are no episodes."""
    records = (path for path in folder.glob("*.json") if not path.name.endswith(".plan.json"))
    return sum(bool(json.loads(path.read_text())["motion"]["joints"]) for path in records)


def per_episode(costs: list[tuple[float, ...]]) -> float:
    """Return the processor time of an episode [s]."""
    return sum(spent for _, spent, _ in costs) / max(sum(new for *_, new in costs), 1)


def main(out: Path, count: int = 1000, minutes: float = 60.0, workers: int = 2) -> None:
    """Make the set.

    Args:
        out: A new folder.
        count: Number of episodes.
        minutes: Time for the runs [min].
        workers: Number of processes.
    """
    if find_spec("pyarrow") is None:
        sys.exit("pyarrow is not installed, and the export needs it; pip install pyarrow")
    out.mkdir(parents=True)
    costs, runs = make_runs(out, count, minutes, workers), out / "runs" / ROBOT
    wall, spent, memory = measured(
        "export", str(runs), "--to", "lerobot", "--out", str(out / "set")
    )
    info = json.loads((out / "set" / "meta" / "info.json").read_text())
    made, frames = info["total_episodes"], info["total_frames"]
    size = sum(path.stat().st_size for path in (out / "set").rglob("*.*") if path.is_file())
    third = max(len(costs) // 3, 1)
    first, last = per_episode(costs[:third]), per_episode(costs[-third:])
    ran = sum(took for took, *_ in costs)
    print(f"{made} episodes, {frames} frames, {size / 1e6:.0f} MB")
    print(f"runs: {ran:.0f} s, {per_episode(costs):.2f} s of processor time for each episode; "
          f"{first:.2f} s in the first third of the seeds, {last:.2f} s in the last")  # fmt: skip
    print(f"export: {wall:.0f} s, {spent / made:.2f} s of processor time for each episode, "
          f"{memory:.0f} MB")  # fmt: skip
    print(f"{3600 * made / (ran + wall):.0f} episodes an hour on this machine; "
          f"{2 * 3600 / (per_episode(costs) + spent / made):.0f} on two free cores")  # fmt: skip
    sys.exit(made != runs_with_arm(runs))


if __name__ == "__main__":
    commands(__doc__, main)
