"""Count the objects in fridges that a tour fetches, and those that any opening could help with.

    python benchmarks/fridge_chains.py DIR [--robot segway_ur5e] [--base fixed] [--every 1]

DIR is the results folder of `momapos bench run paper-sim`. Each tour opens the fridge and picks the
object. "no door" is the pick alone in the room without the part: a bound for every opening and
stop, since a door only takes room away. The others have no plan. "usual" is the tour with the
default opening, "chosen" the one that chooses it where that fails; `--close` also closes it.
Processor time; all plans are verified.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.apps.bench import read_folder
from momapos.apps.bench.bench_records import SuiteTask
from momapos.core import Stopwatch
from momapos.model.robots import load_robot
from momapos.model.scene import Scene, load_scene
from momapos.planning import PipelineConfig, PlacementQuery, Request, Tour
from momapos.planning.chains import plan_chain, without_part
from momapos.planning.grasps import make_task
from momapos.planning.plan import plan_placement
from momapos.planning.reachability import load_reach
from momapos.planning.tour import plan_requests
from placement import machine
from tours import valid


def main() -> None:
    """Print a line for each object and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--base", default="fixed")
    parser.add_argument("--timeout", type=float, default=40.0, help="time limit per tour [s]")
    parser.add_argument("--every", type=int, default=1, help="of how many objects one is asked")
    parser.add_argument("--close", action="store_true", help="close the fridge afterwards")
    args = parser.parse_args()
    print(machine())
    suite = read_folder(args.folder).suite
    tasks = [t for t in suite.tasks if t.robot == args.robot and t.group == "in fridge"]
    config = PipelineConfig(timeout=args.timeout, base=args.base)
    robot = load_robot(args.robot)
    reach = load_reach(robot)
    counts, seconds = np.zeros(3, int), list[float]()
    tasks = tasks[:: args.every]
    for task in tasks:
        scene = load_scene(args.folder / task.scene)
        requests = _requests(task, close=args.close)
        query = PlacementQuery.of(
            scene, robot, make_task(scene, *requests[0]), reach, config=config,
            clock=time.process_time,
        )  # fmt: skip
        if not _has_plan_without_part(query, task):
            print(f"{task.name}: no plan without the door", flush=True)
            continue
        usual = plan_requests(replace(query, watch=Stopwatch(time.process_time)), requests)
        began, chosen = time.process_time(), usual
        if not _done(usual, requests, scene):
            chosen = plan_chain(replace(query, watch=Stopwatch(time.process_time)), requests)
            seconds.append(time.process_time() - began)
        done = np.array([True, _done(usual, requests, scene), _done(chosen, requests, scene)])
        counts += done
        words = " ".join(f"{name} {int(one)}" for name, one in zip(NAMES, done, strict=True))
        print(f"{task.name}: {words}; {usual.seconds:.1f} s; {_words(chosen)}", flush=True)
    print(f"{len(tasks)} objects:", dict(zip(NAMES, counts.tolist(), strict=True)))
    if seconds:
        print(f"seconds of the others: {np.percentile(seconds, [50, 95]).round(1)} (median, 95th)")


NAMES = ("no door", "usual", "chosen")


def _requests(task: SuiteTask, *, close: bool) -> list[Request]:
    assert task.inside is not None
    part = (task.inside.object, task.inside.joint)
    last = [Request("close", *part)] if close else []
    return [Request("open", *part), Request("pick", task.object), *last]


def _has_plan_without_part(query: PlacementQuery, task: SuiteTask) -> bool:
    assert task.inside is not None
    scene: Scene = without_part(query.scene, task.inside.object, task.inside.joint)
    pick = make_task(scene, "pick", task.object)
    alone = replace(query, scene=scene, task=pick, watch=Stopwatch(time.process_time))
    return plan_placement(alone).plan.feasible


def _done(tour: Tour, requests: list[Request], scene: Scene) -> bool:
    """Return whether every task has a valid plan."""
    if len(tour.steps) < len(requests) or not tour.steps[-1].plan.feasible:
        return False
    if not valid(tour, scene):
        raise AssertionError("the exact check rejects a plan")
    return True


def _words(tour: Tour) -> str:
    first, last = tour.steps[0], tour.steps[-1].plan
    to = "" if first.plan.task.to is None else f"opened to {first.value_words(first.plan.task.to)}"
    reasons = last.candidates.rejections
    why = "" if last.feasible else max(reasons, key=lambda word: reasons[word], default="")
    return f"{to} {last.task.verb}: {last.status} {why}"


if __name__ == "__main__":
    main()
