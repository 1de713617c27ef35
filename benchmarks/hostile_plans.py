"""Give mutated plan files to `momapos export`, `run`, `view` and `verify`: each refuses in words.

    python benchmarks/hostile_plans.py PLAN [PLAN ...] [--count 5000] [--seed 0] [--commands run]

Each file has one to three changed places: other types, numbers of 20 digits, no numbers, missing
and repeated rows, unknown keys. The commands run in this process. Exit status 1 if one raises,
prints a traceback or several lines of error, refuses a plan but writes a file, or exits with a
status that it does not document, or if memory grows from the middle third to the last.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import math
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from momapos.apps.cli.main import main as momapos
from pages import memory

SPECIAL: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**31, 2**63, -1e300, 1e20, 12345678901234567890, math.nan, math.inf, 0.1,
    "", "x", "../../etc/passwd", "a" * 5000, "\x00\x1b[2J", [], [1, 2, 3], [[[[]]]], {}, {"x": 1},
)  # fmt: skip
"""Values that replace right ones."""
COMMANDS: dict[str, tuple[str, ...]] = {
    "csv": ("export", "{plan}", "--to", "csv", "--out", "{out}.csv"),
    "npz": ("export", "{plan}", "--to", "npz", "--out", "{out}.npz"),
    "ros2": ("export", "{plan}", "--to", "ros2", "--out", "{out}.json"),
    "mcap": ("export", "{plan}", "--to", "mcap", "--out", "{out}"),
    "moveit": ("export", "{plan}", "--to", "moveit", "--out", "{out}.yaml"),
    "view": ("view", "{plan}", "--static", "{out}.html"),
    "verify": ("verify", "{plan}"),
    "run": ("run", "{plan}", "--tries", "1", "--out", "{out}.json"),
}
GROWTH = 1.1
"""Largest ratio of the memory in the last third to that in the middle one [-]."""


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the paths to all values below one, a few of each list."""
    if isinstance(value, dict):
        items: list[tuple[Any, Any]] = list(value.items())
    elif isinstance(value, list):
        picked = {0, len(value) // 2, len(value) - 1} if value else set()
        items = [(i, value[i]) for i in sorted(picked)]
    else:
        items = []
    return [below for key, one in items for below in [(*path, key), *places(one, (*path, key))]]


def mutated(plan: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Return a plan with one to three changed places."""
    plan = copy.deepcopy(plan)
    for _ in range(rng.randint(1, 3)):
        path = rng.choice(places(plan))
        holder: Any = plan
        for key in path[:-1]:
            holder = holder[key]
        key, kind = path[-1], rng.random()
        if kind < 0.15:
            del holder[key]
        elif kind < 0.25 and isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        elif kind < 0.3 and isinstance(holder, dict):
            holder["unknown"] = rng.choice(SPECIAL)
        elif kind < 0.6 and isinstance(holder[key], int | float):
            holder[key] = holder[key] * rng.choice((-1, 1.001, 2, 1e6)) + rng.choice((0, 1e-3, 1))
        else:
            holder[key] = rng.choice(SPECIAL)
    return plan


def outcome(command: str, plan: Path, out: Path) -> str:
    """Run a command on a plan file; return what happened, beginning with WRONG for a defect."""
    words = [word.format(plan=plan, out=out / "made") for word in COMMANDS[command]]
    printed, errors = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(errors):
            status = momapos(words)
    except SystemExit as exit_:
        status = exit_.code if isinstance(exit_.code, int) else 2
    except Exception as error:
        return f"WRONG: {command} raises {type(error).__name__}: {error!s:.200}"
    told = errors.getvalue().strip()
    if "Traceback" in told or status not in (0, 1, 2):
        return f"WRONG: {command} exits with {status}: {told[-300:]}"
    if status == 2 and (not told or len(told.splitlines()) > 1):
        return f"WRONG: {command} refuses in {len(told.splitlines())} lines: {told[:300]}"
    if status == 2 and any(out.iterdir()):
        return f"WRONG: {command} refuses and leaves {[p.name for p in out.iterdir()]}"
    return f"{command}: exit status {status}"


def main() -> int:
    """Fuzz the commands; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("plans", nargs="+", type=Path)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+", default=list(COMMANDS), choices=list(COMMANDS))
    args = parser.parse_args()
    rng = random.Random(args.seed)
    plans = [json.loads(path.read_text()) for path in args.plans]
    seen: Counter[str] = Counter()
    held: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(args.count):
            plan, out = Path(folder, "plan.json"), Path(folder, "out")
            plan.write_text(json.dumps(mutated(rng.choice(plans), rng)))
            out.mkdir()
            told = outcome(args.commands[k % len(args.commands)], plan, out)
            shutil.rmtree(out)
            if told.startswith("WRONG"):
                kept = Path(f"wrong_{args.seed}_{k}.json")
                shutil.copy(plan, kept)
                print(f"{told} ({kept})", flush=True)
            seen[told.split(":")[0] if told.startswith("WRONG") else told] += 1
            held.append(memory(os.getpid()))
    for told, count in sorted(seen.items()):
        print(f"{count:6d} {told}")
    third = len(held) // 3
    middle, last = max(held[third : 2 * third]), max(held[-third:])
    tenths = [f"{held[k * len(held) // 10 - 1]:.0f}" for k in range(1, 11)]
    print(f"memory: {middle:.0f} MB in the middle third, {last:.0f} MB in the last")
    print(f"after each tenth: {' '.join(tenths)} MB")
    return int(bool(seen["WRONG"]) or last > GROWTH * middle)


if __name__ == "__main__":
    sys.exit(main())
