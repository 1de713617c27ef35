"""Compare the answers and times of two versions, task by task and in turn.

    python benchmarks/ab.py COMMIT [--count 45] [--seed 0] [--robots fetch ...] [--explained]
        [--out FILE]

Draws openings of the kitchens of `placement.py`. Both versions answer each task twice, in turn, in
a process of its own each; the faster answer counts. So other programs on the machine slow both.
Prints the ratio of processor times, this version to the other, and each answer that differs. With
`--explained` a "no" includes its largest opening and its advice, as `momapos place` prints them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 120.0
"""Time limit of an answer [s]."""
ROBOTS = ["fetch", "segway_ur5e", "husky_ur5e", "ranger_rm63"]
STATUS, COST = "status", "cost"


def answer_tasks(*, explained: bool) -> None:
    """Answer the tasks on standard input, by public names that all versions have."""
    import time
    from functools import cache

    import momapos
    from momapos.planning import with_advice, with_max_opening

    scenes = cache(momapos.load_scene)
    robots = cache(lambda name: (r := momapos.load_robot(name), momapos.load_reach_map(r)))
    config = momapos.PipelineConfig(timeout=TIMEOUT)
    for line in sys.stdin:
        name, path, item, joint = json.loads(line)
        robot, reach = robots(name)
        row: dict[str, Any] = {}
        try:
            task = momapos.make_task(scenes(path), "open", item, joint)
            for _ in range(2):
                began = time.process_time()
                answer = momapos.plan_base_placement(
                    scenes(path), robot, task, reach, config=config
                )
                if explained:
                    answer = with_advice(with_max_opening(answer))
                plan = answer.plan
                row.setdefault("seconds", []).append(time.process_time() - began)
            cost = plan.navigation_cost
            row |= {STATUS: plan.status, COST: cost if cost is None else round(cost, 6)}
            if explained:
                row[COST] = [row[COST], plan.feasible_to, plan.advice]
        except momapos.MomaposError as error:
            row = {STATUS: "refused", COST: str(error)}
        print(json.dumps(row), flush=True)


@contextmanager
def version(source: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a process that answers tasks with the package in a folder."""
    env = {**os.environ, "PYTHONPATH": str(source)}
    with subprocess.Popen(
        [sys.executable, __file__, "--answer", *options], env=env, text=True, cwd=source,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def checkout(commit: str) -> Iterator[Path]:
    """Check out a commit into a folder for a while."""
    git = ["git", "-C", str(ROOT), "worktree"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "other"
        subprocess.run([*git, "add", "--quiet", "--detach", str(path), commit], check=True)
        try:
            yield path
        finally:
            subprocess.run([*git, "remove", "--force", str(path)], check=True)


def ask(process: subprocess.Popen[str], task: Sequence[str]) -> dict[str, Any]:
    """Return a version's answer to a task."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(task) + "\n")
    process.stdin.flush()
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"the process ended at {task}")
    row: dict[str, Any] = json.loads(line)
    return row


def drawn(robots: Sequence[str], count: int, seed: int) -> list[list[str]]:
    """Draw openings: robot, scene file, object and joint."""
    from placement import openings, shared

    every = openings(robots)
    chosen = np.random.default_rng(seed).permutation(len(every))[:count]
    tasks = [every[i] for i in chosen]
    return [[robot, str(shared() / "bestman" / s), item, joint] for robot, s, item, joint in tasks]


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Summarize as Markdown: ratios by status, and the answers that differ."""
    timed = [row for row in rows if all("seconds" in row[side] for side in ("this", "other"))]
    lines = [
        "| answers | count | median | 95th percentile | total |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, chosen in {
        "all": timed,
        "solved": [row for row in timed if row["other"][STATUS] == "solved"],
        "infeasible": [row for row in timed if row["other"][STATUS] == "infeasible"],
    }.items():
        if not chosen:
            continue
        this, other = (
            np.array([min(row[side]["seconds"]) for row in chosen]) for side in ("this", "other")
        )
        cells = [f"{1000 * f(this):.0f} / {1000 * f(other):.0f} ms ({f(this) / f(other):.2f})"
                 for f in (np.median, lambda x: np.percentile(x, 95), np.sum)]  # fmt: skip
        lines.append(f"| {name} | {len(chosen)} | {' | '.join(cells)} |")
    for row in rows:
        before, now = (f"{row[side][STATUS]} {row[side][COST]}" for side in ("other", "this"))
        if before != now:
            lines.append(f"- {' '.join(row['task'])}: {before} -> {now}")
    return "\n".join(lines)


def main() -> None:
    """Compare, print the report, and write the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit", nargs="?", default="")
    parser.add_argument("--answer", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--count", type=int, default=45)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--robots", nargs="+", default=["fetch", "segway_ur5e", "husky_ur5e", "ranger_rm63"]
    )
    parser.add_argument("--explained", action="store_true")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    if args.answer:
        answer_tasks(explained=args.explained)
        return
    tasks = drawn(args.robots, args.count, args.seed)
    options = ["--explained"] if args.explained else []
    rows = []
    with (
        checkout(args.commit) as folder,
        version(ROOT / "src", *options) as this,
        version(folder / "src", *options) as other,
    ):
        for task in tasks:
            rows.append({"task": task, "this": ask(this, task), "other": ask(other, task)})
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    if args.out is not None:
        args.out.write_text("\n".join(json.dumps(row) for row in rows) + "\n")
    print(report(rows))


if __name__ == "__main__":
    main()
