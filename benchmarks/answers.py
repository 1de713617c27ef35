"""Check placement answers: driving, infeasible ones, tolerances, and the time of further ones.

    python benchmarks/answers.py cost [--robots fetch ...] [--tasks 40] [--out DIR]
    python benchmarks/answers.py completeness [--set development|test] [--tasks 40] [--kitchens]
    python benchmarks/answers.py tolerance [--tasks 24] [--runs 2000] [--out DIR]
    python benchmarks/answers.py further [--answers 40] [--out DIR]

The openings are those of the kitchens of placement.py. Times are processor times.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.bench.articulated import SETS, set_of
from momapos.apps.bench.job import works_disturbed
from momapos.core import MomaposError, Stopwatch
from momapos.model.scene import Scene, load_scene
from momapos.planning import (
    BasePoseChecks,
    PipelineConfig,
    PlacementQuery,
    iter_placements,
    plan_base_placement,
)
from momapos.planning.grasps import make_task, openable
from momapos.planning.placement import PlaceConfig
from momapos.planning.robust import unit_offsets
from objects import Subset, object_tasks
from placement import CONFIG, ROBOTS, SCENES, arm, machine, openings, scene_of
from rows import commands, emit, keep_rows, markdown, milliseconds

GRID = PipelineConfig(place=PlaceConfig(method="exhaustive"), timeout=3600.0)
VARIANTS = {
    "usual": PlaceConfig(),
    "margin 2 cm": PlaceConfig(margin=0.02),
    "robustness weight 0.4": PlaceConfig(weight_robustness=0.4),
    "robustness weight 0.15": PlaceConfig(weight_robustness=0.15),
    "no robustness weight": PlaceConfig(weight_robustness=0.0),
    "grid with robustness": PlaceConfig(method="exhaustive", weight_robustness=100.0),
    "grid": PlaceConfig(method="exhaustive", weight_robustness=0.0),
}
NEIGHBORS = 4
"""Number of base poses near each answer, at 2 cm and at 5 cm [-]."""
ASKED = (
    ("segway_ur5e", "cabinet_right", "drawer_middle_slide"),
    ("segway_ur5e", "fridge", "door_hinge"),
    ("fetch", "fridge", "door_hinge"),
    ("fetch", "cabinet_left", "door_hinge"),
    ("husky_ur5e", "cabinet_left", "drawer_slide"),
    ("ranger_rm63", "fridge", "door_hinge"),
)


def shuffled(robots: tuple[str, ...], rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    """Yield all openings in random order."""
    every = openings(robots)
    return (every[index] for index in rng.permutation(len(every)))


def cost(robots: tuple[str, ...] = ROBOTS, tasks: int = 40, out: Path | None = None) -> None:
    """Compare the driving length of answers with the cheapest base pose of the grid.

    Random openings are planned with the default cost, which puts base-pose robustness first; with a
    smaller robustness margin; with robustness weighed against driving; without it, for the shortest
    drive; and by a grid of 5 cm and 10 degrees in driving order, with and without robustness. The
    extra driving of the grid with robustness is the price of robustness; that of the default answer
    over the grid with robustness is the loss of sampling. The benefit of robustness is the share of
    neighboring base poses, 2 cm and 2 degrees or 5 cm and 5 degrees off each answer, from which the
    arm still does the task.

    Args:
        robots: Robots of the library.
        tasks: Number of openings that all variants solve.
        out: Folder for cheapest.json.
    """
    rows: list[dict[str, Any]] = []
    for opening in shuffled(robots, np.random.default_rng(1)):
        if len(rows) == tasks:
            break
        if (row := _variants(*opening)) is not None:
            rows.append(row)
            emit(row)
    print(f"machine: {machine()}; {len(rows)} openings solved by all")
    grid = np.array([row["grid"]["drive"] for row in rows])
    for variant in VARIANTS:
        drives = np.array([row[variant]["drive"] for row in rows])
        spent = np.median([row[variant]["seconds"] for row in rows])
        at_2cm, at_5cm = np.mean([row[variant]["nearby"] for row in rows], axis=0)
        print(
            f"{variant}: {drives.mean():.3f} m on average, {drives.sum() / grid.sum() - 1.0:+.1%} "
            f"in all, {np.median(drives / grid) - 1.0:+.1%} at the median; {spent:.2f} s of "
            f"processor; feasible nearby {at_2cm:.0%}, {at_5cm:.0%}"
        )
    keep_rows(rows, out, "cheapest")


def _variants(name: str, place: str, item: str, joint: str) -> dict[str, Any] | None:
    """Return drive, time and robustness of each answer to an opening; None if any fails."""
    row: dict[str, Any] = {"robot": name, "scene": place, "object": item, "joint": joint}
    scene, (robot, reach) = scene_of(place), arm(name)
    task = make_task(scene, "open", item, joint)
    for variant, how in VARIANTS.items():
        config = PipelineConfig(place=how, timeout=120.0)
        began = time.process_time()
        plan = plan_base_placement(scene, robot, task, reach, config=config).plan
        row[variant] = {"drive": plan.navigation_cost, "seconds": time.process_time() - began}
        if plan.motion is None:
            return None
        works = works_disturbed(plan, scene, robot, reach, count=NEIGHBORS, config=config, seed=0)
        row[variant]["nearby"] = works.mean(1).tolist()
    return row


def completeness(
    robots: tuple[str, ...] = ROBOTS, subset: Subset = "development", tasks: int | None = None,
    kitchens: bool = False, cells: float = 4.0, out: Path | None = None,
) -> None:  # fmt: skip
    """Count tasks reported infeasible that a grid with all grasp families can solve.

    Every opening of the kitchens and of the objects of objects.py that is reported infeasible is
    searched again by the whole grid, with all grasp families, practically no time limit, and a
    reachability map that excludes only tool poses at least `cells` beyond its boundary; inverse
    kinematics locks redundant joints at 33 values instead of 9. Tasks that this solves were wrongly
    reported infeasible. Timeouts are counted separately.

    Args:
        robots: Robots of the library.
        subset: Set of objects.
        tasks: Number of openings, from the first.
        kitchens: Kitchens only.
        cells: Uncertainty of the map [cells].
        out: Folder for completeness.json.
    """
    rows: list[dict[str, Any]] = []
    scenes = {Path(name).stem: scene_of(name) for name in SCENES}
    every: list[tuple[str, str, Scene, str, str]] = [
        (robot, name, scene, *part)
        for robot in robots
        for name, scene in scenes.items()
        for part in openable(scene)
    ]
    if not kitchens:
        every += [(r, n, s, "object", j) for r, n, s, j in object_tasks(subset, robots)]
    for robot, name, scene, item, joint in every[:tasks]:
        rows.append(_searched_again(robot, name, scene, item, joint, cells))
        wrong = rows[-1].get("grid") == "solved"
        if wrong and (item != "object" or set_of(name) == SETS[0]):
            emit(rows[-1])
    head = ("robot", "openings", "solved", "infeasible", "wrongly", "out of time")
    lines = []
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        count, wrongly = Counter(r["status"] for r in mine), Counter(r.get("grid") for r in mine)
        lines.append((robot, len(mine), count["solved"], count["infeasible"], wrongly["solved"],
                      count["timeout"]))  # fmt: skip
    print(f"machine: {machine()}", markdown(head, lines), sep="\n\n")
    keep_rows(rows, out, "completeness")


def _searched_again(
    name: str, place: str, scene: Scene, item: str, joint: str, cells: float
) -> dict[str, Any]:
    """Return the answer and, if it is infeasible, the result of the grid."""
    row: dict[str, Any] = {"robot": name, "scene": place, "task": f"{item}/{joint}"}
    robot, reach = arm(name)
    try:
        task = make_task(scene, "open", item, joint)
        plan = plan_base_placement(scene, robot, task, reach, config=CONFIG).plan
    except MomaposError as error:
        return {**row, "status": "refused", "reason": str(error)}
    row["status"] = plan.status
    if plan.status != "infeasible":
        return row
    generous = replace(reach, threshold=reach.threshold - cells)
    found = plan_base_placement(scene, robot.finer, task, generous, config=GRID).plan
    return {**row, "grid": found.status, "base_pose": found.base_pose}


def tolerance(
    robots: tuple[str, ...] = ROBOTS, tasks: int = 24, runs: int = 2000, out: Path | None = None
) -> None:
    """Check measured tolerances with newly sampled base poses.

    Random openings are planned with a tolerance. Then new base poses are sampled in its disc, and
    the motion is replanned from each. Poses where the base collides also count as failures.

    Args:
        robots: Robots of the library.
        tasks: Number of random openings.
        runs: Total number of poses.
        out: Folder for tolerance.json.
    """
    rng = np.random.default_rng(0)
    rows: list[dict[str, Any]] = []
    for name, place, item, joint in shuffled(robots, rng):
        if len(rows) == tasks:
            break
        scene, (robot, reach) = scene_of(place), arm(name)
        task = make_task(scene, "open", item, joint)
        answer = plan_base_placement(scene, robot, task, reach)
        if answer.plan.base_pose is None or answer.plan.motion is None:
            continue
        began = time.process_time()
        found = answer.tolerance
        seconds = time.process_time() - began
        assert found is not None
        watch = Stopwatch(lambda: 0.0)
        checks = BasePoseChecks(PlacementQuery(scene, robot, task, reach, watch=watch))
        size = np.array([found.radius, found.radius, found.turn])
        offsets = unit_offsets(-(-runs // tasks) if found.radius else 0, rng)
        base = np.array(answer.plan.base_pose)
        done = sum(checks(base + offset * size).motion is not None for offset in offsets)
        rows.append({
            "robot": name, "scene": place, "object": item, "joint": joint, "done": done,
            "radius": found.radius, "runs": len(offsets), "seconds": seconds,
        })  # fmt: skip
        emit(rows[-1])
    done, count = (sum(row[key] for row in rows) for key in ("done", "runs"))
    radii = np.array([row["radius"] for row in rows])
    print(f"machine: {machine()}")
    print(f"{len(rows)} answers, {(radii == 0).sum()} of them without any tolerance")
    spent = milliseconds([row["seconds"] for row in rows])
    print(f"radius: median {100 * np.median(radii):.1f} cm; processor time: {spent}")
    print(f"newly sampled poses in the discs: {done} of {count} work ({done / max(count, 1):.1%})")
    keep_rows(rows, out, "tolerance")


def further(answers: int = 40, out: Path | None = None) -> None:
    """Measure the wall time of each further answer of `iter_placements`.

    Six openings of the built-in kitchen by four robots.

    Args:
        answers: Number of answers after the second, which includes modeling the whole scene.
        out: Folder for further_answers.json.
    """
    scene, rows = load_scene("kitchen_small"), list[dict[str, Any]]()
    for name, item, joint in ASKED:
        robot, reach = arm(name)
        given = iter_placements(scene, robot, make_task(scene, "open", item, joint), reach)
        times, used = [], []
        for _ in range(2 + answers):
            began, spent = time.perf_counter(), time.process_time()
            if next(given, None) is None:
                break
            times.append(time.perf_counter() - began)
            used.append(time.process_time() - spent)
        rows.append({"robot": name, "task": f"{item}/{joint}", "seconds": times, "used": used})
        first, second = 1000 * np.array(times[:2])
        print(f"{name} {item}/{joint}: first {first:.0f} ms, second {second:.0f} ms, "
              f"{len(times) - 2} others {milliseconds(times[2:])}", flush=True)  # fmt: skip
    every = np.concatenate([row["seconds"][2:] for row in rows])
    print(f"machine: {machine()}\nall {len(every)}: {milliseconds(every.tolist())}")
    keep_rows(rows, out, "further_answers")


if __name__ == "__main__":
    commands(__doc__, cost, completeness, tolerance, further)
