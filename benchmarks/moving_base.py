"""Count the openings that one base pose, several stops and a moving base solve.

    python benchmarks/moving_base.py [--robots stretch hsr] [--uses fixed stops moving]
                                     [--sample N] [--verifier verify_plan.py] [--out DIR]
    python benchmarks/moving_base.py --robots segway_ur5e --sample 25 --cost 5
    python benchmarks/moving_base.py --sample 10 --always --out DIR

Every door and drawer of the five kitchens of `placement.py`, or a fixed random sample. Several
stops and a moving base are asked only where one base pose fails. Processor time; every answer is
verified from its file; one that moves the base also by an independent program (--verifier). `--out`
keeps the plan files. `--cost` instead measures what `auto` costs where one base pose suffices: each
such opening is answered with both, in turn, so many times. `--always` asks for a moving base
whether or not one base pose suffices, to open each part and to close it, for `moving_runs.py`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias, get_args

import numpy as np

from momapos.core import USER_CACHE, MomaposError, Stopwatch
from momapos.model.plan_files import write_plan
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.planning import BaseUse, PipelineConfig, PlacementQuery
from momapos.planning.base_use import plan_moving
from momapos.planning.grasps import make_task
from momapos.planning.plan import plan_placement
from momapos.planning.reachability import load_reach
from momapos.verification import verify_files
from placement import machine, openings, shared

Opening: TypeAlias = tuple[str, str, str, str]
"""Robot, scene, object and joint."""


def main() -> None:
    """Print a line for each answer and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="*", default=["stretch", "hsr"])
    parser.add_argument("--uses", nargs="*", default=["fixed", "stops", "moving"])
    parser.add_argument("--sample", type=int, default=0, help="number of random openings")
    parser.add_argument("--verifier", type=Path, help="independent check of plan files")
    parser.add_argument("--out", type=Path, help="folder of the plan files")
    parser.add_argument("--cost", type=int, default=0, help="repeats of `fixed` and `auto`")
    parser.add_argument("--always", action="store_true", help="move the base in every answer")
    args = parser.parse_args()
    if not set(args.uses) <= set(get_args(BaseUse)):
        parser.error(f"--uses must be of {', '.join(get_args(BaseUse))}")
    print(machine())
    with TemporaryDirectory() as temporary:
        folder = args.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in args.robots:
            every = openings([name])
            if args.sample:
                drawn = np.random.default_rng(0).permutation(len(every))[: args.sample]
                every = [every[k] for k in sorted(drawn.tolist())]
            if args.cost:
                report_cost(name, every, args.cost)
            elif args.always:
                report_moving(name, every, folder)
            else:
                report(name, args.uses, every, args.verifier, folder)


def report(
    name: str,
    uses: Sequence[BaseUse],
    every: Sequence[Opening],
    verifier: Path | None,
    folder: Path,
) -> None:
    """Answer openings with each use of the base, the others where a fixed base fails, and count."""
    robot = load_robot(name)
    reach = load_reach(robot)
    bestman, cache = shared() / "bestman", USER_CACHE
    kitchens = {scene: load_scene(bestman / scene, cache=cache) for _, scene, _, _ in every}
    left = list(every)
    for use in uses:
        counts: Counter[str] = Counter()
        needed: list[float] = []
        for opening in every if use == "fixed" else left:
            _, scene_name, item, joint = opening
            query = PlacementQuery(
                kitchens[scene_name], robot, make_task(kitchens[scene_name], "open", item, joint),
                reach, config=PipelineConfig(base=use), watch=Stopwatch(time.process_time),
            )  # fmt: skip
            try:
                plan = plan_placement(query).plan
            except MomaposError as error:
                print(name, use, scene_name, item, joint, error, flush=True)
                counts["error"] += 1
                continue
            spent = plan.timing["total"]
            counts[plan.status] += 1
            words = ""
            if plan.feasible:
                path = folder / f"{name}-{use}-{every.index(opening)}.json"
                write_plan(plan, path)
                counts["valid"] += verify_files(path, shared() / "bestman").valid
                needed += [spent] if plan.moves_base else []
                if verifier and plan.moves_base:
                    words = independent(path, verifier)
                    counts["independently valid"] += not words
            elif use == "moving":
                words = cause(query)
            if use == "fixed" and plan.feasible:
                left.remove(opening)
            print(f"{name} {use} {scene_name} {item}/{joint} {plan.status} {spent:.2f} s {words}",
                  flush=True)  # fmt: skip
        times = np.percentile(needed, [50, 95]).round(2).tolist() if needed else []
        print(f"== {name} {use}: {dict(counts)}, time where needed [s]: {times}", flush=True)


def report_moving(name: str, every: Sequence[Opening], folder: Path) -> None:
    """Open and close each part with a base that moves, and keep the plans."""
    robot = load_robot(name)
    reach = load_reach(robot)
    counts: Counter[str] = Counter()
    for number, (_, scene_name, item, joint) in enumerate(every):
        scene = load_scene(shared() / "bestman" / scene_name)
        opens = make_task(scene, "open", item, joint)
        assert opens.to is not None
        ajar = scene.with_joint(item, joint, opens.to)
        closes = make_task(ajar, "close", item, joint)
        for there, task in ((scene, opens), (ajar, closes)):
            watch = Stopwatch(time.process_time)
            query = PlacementQuery(there, robot, task, reach, watch=watch)
            try:
                plan = plan_moving(query).plan
            except MomaposError as error:
                print(name, scene_name, task.verb, item, joint, error, flush=True)
                continue
            counts[f"{task.verb} {plan.status}"] += 1
            nearest = plan.candidates.nearest
            if plan.feasible:
                write_plan(plan, folder / f"{name}-{task.verb}-{number}.json")
            words = "" if plan.feasible or nearest is None else nearest.reason
            print(f"{name} {task.verb} {scene_name} {item}/{joint} {plan.status} "
                  f"{watch.total:.2f} s {words}", flush=True)  # fmt: skip
    print(f"== {name}: {dict(counts)}", flush=True)


def report_cost(name: str, every: Sequence[Opening], repeats: int) -> None:
    """Compare the processor time of `auto` and `fixed` where one base pose suffices."""
    robot = load_robot(name)
    reach, cache = load_reach(robot), USER_CACHE
    ratios: list[float] = []
    spent = np.zeros(2)
    for _, scene_name, item, joint in every:
        scene = load_scene(shared() / "bestman" / scene_name, cache=cache)
        task = make_task(scene, "open", item, joint)
        times = np.zeros((repeats + 1, 2))
        for repeat in range(repeats + 1):  # the first one compiles
            order: tuple[BaseUse, ...] = ("fixed", "auto") if repeat % 2 else ("auto", "fixed")
            for use in order:
                config, watch = PipelineConfig(base=use), Stopwatch(time.process_time)
                query = PlacementQuery(scene, robot, task, reach, config=config, watch=watch)
                begin = time.process_time()
                plan = plan_placement(query).plan
                times[repeat, int(use == "auto")] = time.process_time() - begin
                if not plan.feasible or plan.moves_base:
                    break
            else:
                continue
            break
        else:
            ratios.append(float(np.median(times[1:, 1] / times[1:, 0])))
            spent += times[1:].sum(0)
            print(f"{name} {scene_name} {item}/{joint} {ratios[-1]:.3f}", flush=True)
    print(f"== {name}: {len(ratios)} openings, median ratio {np.median(ratios):.3f}, "
          f"of all time {spent[1] / spent[0]:.3f}")  # fmt: skip


def cause(query: PlacementQuery) -> str:
    """Return why a moving base does not do a task: the most frequent reasons of the search."""
    plan = plan_moving(replace(query, watch=Stopwatch(time.process_time))).plan
    return "; ".join(f"{reason} ({count})" for reason, count in
                     Counter(plan.candidates.rejections).most_common(3))  # fmt: skip


def independent(plan: Path, verifier: Path) -> str:
    """Return what another program finds wrong with a plan file; "" for nothing."""
    root = shared() / "bestman"
    command = [sys.executable, str(verifier), str(plan), "--scene-root", str(root)]
    done = subprocess.run(
        [*command, "--allow-hinge-grasp"], capture_output=True, text=True, check=False
    )
    return "" if done.returncode == 0 else (done.stdout + done.stderr).strip()[-300:]


if __name__ == "__main__":
    main()
