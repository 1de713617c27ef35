"""Measure the memory of a process that executes plans one after another.

    python benchmarks/run_memory.py PLAN [PLAN ...] [--count 120] [--simulate]

Each run opens its plan and drives with another seed. Without --simulate the physics of a robot are
computed once, because they take most of the time and leave nothing behind. Memory is measured after
the C library has returned what is free (Linux with glibc).
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import functools
import gc
import io
import time
from pathlib import Path
from typing import Any

from momapos.apps.cli.main import main as momapos
from momapos.workflows import run as workflow


def held() -> float:
    """Return the private memory of this process [MB]."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    with open("/proc/self/status") as file:
        (line,) = (line for line in file if line.startswith("RssAnon"))
    return int(line.split()[1]) / 1024


def simulate_once() -> None:
    """Reuse the outcome of the first simulation of each robot."""
    real, known = vars(workflow)["attempt"], dict[str, Any]()

    def attempt(*given: Any, **named: Any) -> Any:
        name = given[1].name
        if name not in known:
            known[name] = real(*given, **named)
        return known[name]

    vars(workflow)["attempt"] = attempt


def forget() -> None:
    """Empty all caches."""
    for one in gc.get_objects():
        if isinstance(one, functools._lru_cache_wrapper) and "momapos" in one.__module__:
            one.cache_clear()


def main() -> None:
    """Print the memory after every tenth of the runs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("plans", nargs="+", type=Path)
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--simulate", action="store_true", help="simulate each run")
    args = parser.parse_args()
    if not args.simulate:
        simulate_once()
    for k in range(args.count):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            momapos(["run", str(args.plans[k % len(args.plans)]), "--seed", str(k)])
        if k == 0 or (k + 1) % max(args.count // 10, 1) == 0:
            spent = time.process_time()
            print(f"{k + 1:6d} runs: {held():.1f} MB, {spent:.0f} s of processor time", flush=True)
    forget()
    print(f"without caches: {held():.1f} MB")


if __name__ == "__main__":
    main()
