"""Measure the memory of a process that executes plans, or that plans with ever new inputs.

    python benchmarks/run_memory.py PLAN [PLAN ...] [--count 120] [--simulate]
    python benchmarks/run_memory.py --new scenes [robots] [--count 120] [--simulate]

In the first form each run opens its plan and drives with another seed. Without --simulate the
physics of a robot are computed once, because they take most of the time and leave nothing behind.

In the second form each run loads a scene, a robot or both from new files, copies of a built-in
kitchen and of a robot of the library, as files of a user. It opens a fridge, writes the plan and
verifies it; with --simulate it executes the plan, too.

Memory is measured after the C library has returned what is free (Linux with glibc), and printed
with the number of models, scenes and robots that exist. The benchmark collects no garbage before.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import functools
import gc
import io
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from momapos import (
    Robot,
    Scene,
    load_reach_map,
    load_robot,
    load_scene,
    make_task,
    plan_base_placement,
    verify_files,
    write_plan,
)
from momapos.apps.cli.main import main as momapos
from momapos.model.robots import library_file
from momapos.model.scene import find_scene
from momapos.model.urdf import Articulated
from momapos.workflows import run as workflow

KITCHEN, ROBOT = "kitchen_small", "fetch"
TASK = ("open", "fridge", "door_hinge")


def held() -> str:
    """Return the private memory of this process, and how many inputs exist, in words."""
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    with open("/proc/self/status") as file:
        (line,) = (line for line in file if line.startswith("RssAnon"))
    alive = [type(one) for one in gc.get_objects()]
    counts = [f"{alive.count(kind)} {kind.__name__}" for kind in (Articulated, Scene, Robot)]
    return f"{int(line.split()[1]) / 1024:.1f} MB, {len(alive)} objects, {', '.join(counts)}"


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
    """Empty the caches of all modules."""
    for one in gc.get_objects():
        if isinstance(one, functools._lru_cache_wrapper) and "momapos" in one.__module__:
            one.cache_clear()


def quietly(*words: str) -> None:
    """Run a command without its output."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        momapos(list(words))


def copied(folder: Path, source: Path) -> Path:
    """Copy a scene or robot file and the folders next to it; return the copy."""
    shutil.copytree(source.parent, folder, ignore=shutil.ignore_patterns("*.npz", "*.py*"))
    return folder / source.name


def new_scene(folder: Path) -> Scene:
    """Load the kitchen from a copy of its files."""
    return load_scene(copied(folder, find_scene(KITCHEN)))


def new_robot(folder: Path) -> Robot:
    """Load the robot from a copy of its files."""
    return load_robot(copied(folder, library_file(ROBOT)))


def answering(new: list[str], folder: Path, *, simulate: bool) -> Callable[[int], None]:
    """Return a function that answers a question with new inputs."""
    scene, robot = new_scene(folder / "scene"), new_robot(folder / "robot")
    reach = load_reach_map(load_robot(ROBOT))

    def answer(k: int) -> None:
        own = folder / str(k)
        room = new_scene(own / "scene") if "scenes" in new else scene
        arm = new_robot(own / "robot") if "robots" in new else robot
        plan = plan_base_placement(room, arm, make_task(room, *TASK), reach).plan
        assert plan.feasible, plan.status
        file = folder / "plan.json"
        write_plan(plan, file)
        assert verify_files(file).valid
        if simulate:
            quietly("run", str(file), "--seed", str(k), "--tries", "1")
        shutil.rmtree(own, ignore_errors=True)

    return answer


def main() -> None:
    """Print the memory after every tenth of the runs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("plans", nargs="*", type=Path)
    parser.add_argument("--new", nargs="+", choices=["scenes", "robots"], default=[])
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--simulate", action="store_true", help="simulate each run")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if args.new:
            run = answering(args.new, Path(folder), simulate=args.simulate)
        else:
            if not args.simulate:
                simulate_once()

            def run(k: int) -> None:
                quietly("run", str(args.plans[k % len(args.plans)]), "--seed", str(k))

        for k in range(args.count):
            run(k)
            if k == 0 or (k + 1) % max(args.count // 10, 1) == 0:
                spent = time.process_time()
                print(f"{k + 1:6d} runs: {held()}, {spent:.0f} s of processor time", flush=True)
    gc.collect()
    print(f"without garbage: {held()}")
    forget()
    gc.collect()
    print(f"without caches of modules: {held()}")


if __name__ == "__main__":
    main()
