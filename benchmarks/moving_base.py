"""Measure what a moving base adds: openings, what bounds them, what `auto` costs, runs in physics.

    OMP_NUM_THREADS=1 python benchmarks/moving_base.py ask DIR [--robots fetch tiago] [--sample 5]
        [--processes 2] [--seconds 500] [--bound-all]
    python benchmarks/moving_base.py table DIR
    python benchmarks/moving_base.py cost [--robot segway_ur5e] [--sample 25] [--repeats 5]
    python benchmarks/moving_base.py always DIR [--robots hsr stretch] [--sample 10]
    python benchmarks/moving_base.py run DIR [--count 100] [--seeds 1] [--limit 900]
    python benchmarks/moving_base.py fridges DIR [--base fixed] [--every 1] [--close]

The openings are those of placement.py. Times are processor times, and every plan is verified from
its file.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from lattice import Lattice, Neighbors, Reach
from momapos.apps.bench import read_folder
from momapos.apps.bench.bench_records import SuiteTask
from momapos.core import USER_CACHE, MomaposError, Stopwatch
from momapos.model.plan_files import read_plan, write_plan
from momapos.model.scene import Scene, as_planned, load_scene
from momapos.planning import BaseUse, PipelineConfig, PlacementQuery, Request, Tour
from momapos.planning.base_use import plan_moving
from momapos.planning.chains import plan_chain, without_part
from momapos.planning.grasps import make_task, task_motion
from momapos.planning.plan import plan_placement
from momapos.planning.search_setup import prepare_search
from momapos.planning.tour import plan_requests
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.verification import PlanVerifier, verify_files
from momapos.workflows import run_plan
from placement import SCENES, Opening, arm, machine, openings, scene_of, shared
from rows import commands, markdown

USES: tuple[BaseUse, ...] = ("fixed", "stops", "moving")
"""Uses of the base, each tried where the first fails; the lattice's uses of these names bound
them."""
LIBRARY = (
    "fetch", "husky_ur5e", "mobile_panda", "ranger_rm63", "segway_ur5e", "tiago", "tiago_dual",
)  # fmt: skip
SPREAD = 0.3
"""Largest relative error of masses and friction in physics [-]."""
HARD = 150.0
"""Force above which a touch counts as hard [N]."""
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Asker:
    """Kitchens in memory, which the processes share, and what is known already."""

    folder: Path
    until: float
    """Time after which no other task begins [s, as `time.time`]."""
    bound_all: bool
    """Whether the lattice also bounds openings that one base pose solves."""
    scenes: dict[str, Scene]
    known: dict[Opening, Row] = field(default_factory=dict)

    def ask(self, opening: Opening) -> Row:
        """Ask about an opening what is not known, and write it down."""
        robot, place, item, joint = opening
        scene = self.scenes[place]
        row = self.known.get(opening) or {
            "robot": robot, "scene": place, "task": f"{item}/{joint}",
            "kind": kind_of(scene, item, joint), "answers": {}, "seconds": {}, "shares": None,
        }  # fmt: skip
        before = json.dumps(row)
        watch, (own, reach) = Stopwatch(time.process_time), arm(robot)
        task = make_task(scene, "open", item, joint)
        query = PlacementQuery(scene, own, task, reach, watch=watch)
        for use in USES:
            done = row["answers"].get("fixed") == "solved" or time.time() > self.until
            if use not in row["answers"] and not done:
                self._plan(query, use, row)
        bounds = self.bound_all or row["answers"].get("fixed") != "solved"
        if bounds and row["shares"] is None and time.time() < self.until:
            try:
                row |= farthest(query)
            except MomaposError as error:
                row |= {"shares": {}, "why": str(error)}
        if json.dumps(row) != before:
            with (self.folder / "rows.jsonl").open("a") as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                file.write(json.dumps(row) + "\n")
        return row

    def _plan(self, query: PlacementQuery, use: BaseUse, row: Row) -> None:
        watch = Stopwatch(time.process_time)
        try:
            plan = plan_placement(replace(query, config=PipelineConfig(base=use), watch=watch)).plan
        except MomaposError as error:
            row["answers"][use] = f"error: {error}"
            return
        row["answers"][use], row["seconds"][use] = plan.status, plan.timing["total"]
        if plan.feasible:
            parts = (row["robot"], use, Path(row["scene"]).stem, row["task"].replace("/", "-"))
            path = self.folder / "plans" / f"{'-'.join(parts)}.json"
            write_plan(plan, path)
            if not verify_files(path, shared() / "bestman").valid:
                row["answers"][use] = "INVALID"


def farthest(query: PlacementQuery) -> Row:
    """Return the share of the opening that each use of the base reaches, and what stops it."""
    scene, began = query.scene, time.process_time()
    motion = task_motion(scene, query.robot, query.task, query.config.motion)
    setup = prepare_search(query, scene, motion)
    blocked, latch = setup.prepared.blocked, motion.latch_q is not None
    lattice = None if blocked or latch else Lattice.of(query, setup, pushes=False)
    if lattice is None or not lattice.sets:
        why = blocked or (
            "a latch is turned" if latch else motion.refusal or setup.prepared.no_grasp
        )
        return {"shares": {}, "why": why, "bounded": time.process_time() - began}
    bound, last = through(lattice), len(lattice.values) - 1
    if bound.farthest["fixed"] < last:
        pushing = Lattice.of(query, setup, pushes=True)
        bound = through(pushing) if len(pushing.sets) > len(lattice.sets) else bound
    shares = {use: at / last if at >= 0 else -1.0 for use, at in bound.farthest.items()}
    return {"shares": shares, "why": bound.why, "bounded": time.process_time() - began}


def through(lattice: Lattice) -> Reach:
    """Return what the uses of the base reach in a lattice."""
    reach = Reach(lattice, Neighbors(lattice))
    for layer in range(len(lattice.values)):
        if not reach.add(layer, lattice.levels(layer)):
            break
    return reach


def kind_of(scene: Scene, item: str, joint: str) -> str:
    """Return the kind of a part: drawer, flap, or door of a kind of furniture."""
    target = scene.object(item)
    model = target.model.joint(joint)
    kinds = {"fridge": "fridge door", "mic": "microwave", "dishwasher": "dishwasher"}
    for text, kind in kinds.items():
        if text in f"{item}/{joint}".lower():
            return kind
    if model.kind == "prismatic":
        return "drawer"
    T = target.link_poses()[model.child]
    upright = abs(float((T[:3, :3] @ np.asarray(model.axis, float))[2])) > 0.7
    return "cabinet door" if upright else "flap"


def read_rows(folder: Path) -> dict[Opening, Row]:
    """Return the last row of each opening in a folder."""
    path = folder / "rows.jsonl"
    rows = map(json.loads, path.read_text().splitlines() if path.exists() else ())
    return {(row["robot"], row["scene"], *row["task"].split("/")): row for row in rows}


def exceeded(row: Row) -> list[str]:
    """Return the uses whose answers open farther than the lattice."""
    solved = [use for use in USES if row["answers"].get(use) == "solved"]
    return [use for use in solved if row["shares"] and row["shares"][use] < 1.0]


def line_of(row: Row) -> str:
    """Return a row as one line."""
    shares = " ".join(f"{use} {share:.2f}" for use, share in (row["shares"] or {}).items())
    answers = " ".join(f"{use}:{status}" for use, status in row["answers"].items())
    more = f" EXCEEDED by {exceeded(row)}" if exceeded(row) else ""
    return (
        f"{row['robot']} {row['scene']} {row['task']} ({row['kind']}) [{answers}] {shares} "
        f"| {row.get('why', '')} | {row.get('bounded', 0.0):.1f} s{more}"
    )


def ask(
    folder: Path, robots: tuple[str, ...] = LIBRARY, sample: int = 0,
    processes: int = os.cpu_count() or 1, seconds: float = 1e9, bound_all: bool = False,
) -> None:  # fmt: skip
    """Ask the planner about each opening, and the lattice where one base pose does not do it.

    A node of the lattice is a base pose (10 cm, 22.5 degrees; 10 degrees for arms of five joints,
    whose base slides within its cell to the arm state), a grasp and a value of the part at which
    some arm state is free and bears the part. Edges join neighboring values: the same base pose,
    one next to it, or, where friction holds the part, any. Neither the arm's path between nodes nor
    that to the grasp counts, so the farthest value is an upper bound, but for the resolution.

    The openings come in one random order over all robots, so that a run that ends early is a fair
    sample. A second run with the same folder goes on.

    Args:
        folder: Folder of rows.jsonl, and of the plan files in `plans/`.
        robots: Robots of the library.
        sample: Number of random openings of each robot; 0 for all.
        processes: Number of processes; set OMP_NUM_THREADS=1, so that each has one thread.
        seconds: Time after which no other task begins [s].
        bound_all: Bound openings that one base pose solves, too.
    """
    print(machine())
    (folder / "plans").mkdir(parents=True, exist_ok=True)
    scenes = {name: scene_of(name, USER_CACHE) for name in SCENES}
    asker = Asker(folder, time.time() + seconds, bound_all, scenes, read_rows(folder))
    every = [opening for name in robots for opening in openings([name], sample)]
    for name in robots:
        arm(name)
    order = np.random.default_rng(0).permutation(len(every)).tolist()
    # Processes are forked: they share what the first opening has loaded and compiled.
    print(line_of(asker.ask(every[order[0]])), flush=True)
    _askers.append(asker)
    with get_context("fork").Pool(processes) as pool:
        for row in pool.imap_unordered(_ask, [every[k] for k in order[1:]]):
            print(line_of(row), flush=True)


_askers: list[Asker] = []


def _ask(opening: Opening) -> Row:
    return _askers[0].ask(opening)


def table(folder: Path) -> None:
    """Count the openings that the planner and the lattice do all the way, and the time of answers.

    Args:
        folder: Folder of `ask`.
    """
    every = list(read_rows(folder).values())
    head = ("robot", "part", "openings", *USES, "lattice: fixed", "moving", "turning", "any",
            "what stops the lattice")  # fmt: skip
    lines, times = [], []
    for robot in dict.fromkeys(row["robot"] for row in every):
        mine = [row for row in every if row["robot"] == robot]
        for kind in (*sorted({row["kind"] for row in mine}), "all"):
            some = [row for row in mine if kind in (row["kind"], "all")]
            lines.append([robot, kind, len(some), *_counts(some)])
        for use in USES:
            spent = [row["seconds"][use] for row in mine if use in row["seconds"]]
            if spent:
                median, late = np.percentile(spent, (50, 95))
                times.append(f"{robot} {use}: median {median:.2f} s, 95th percentile {late:.2f} s")
    print(markdown(head, lines), *times, sep="\n")
    print(f"answers that open farther than the lattice: {sum(bool(exceeded(r)) for r in every)}")


def _counts(rows: list[Row]) -> list[Any]:
    """Return the cells of a line of the table."""
    solved = {use: [row["answers"].get(use) == "solved" for row in rows] for use in USES}
    # Other uses are tried only where one base pose does not do.
    cells: list[Any] = [int(np.sum(np.array(solved[u]) | np.array(solved["fixed"]))) for u in USES]
    does = np.any([solved[use] for use in USES], axis=0)
    for use in ("fixed", "moving", "turning", "any"):
        reached = [row["shares"][use] == 1.0 if row["shares"] else own
                   for row, own in zip(rows, does, strict=True)]  # fmt: skip
        cells.append(sum(map(bool, reached)))
    why = Counter(row["why"] for row in rows if row.get("why"))
    return [*cells, "; ".join(f"{text} ({count})" for text, count in why.most_common())]


def cost(robot: str = "segway_ur5e", sample: int = 25, repeats: int = 5) -> None:
    """Compare the processor time of `auto` and `fixed` where one base pose suffices.

    Args:
        robot: Robot of the library.
        sample: Number of random openings; 0 for all.
        repeats: Answers with each, in turn.
    """
    print(machine())
    ratios, spent, (own, reach) = list[float](), np.zeros(2), arm(robot)
    for _, name, item, joint in openings([robot], sample):
        scene, times = scene_of(name, USER_CACHE), np.zeros((repeats + 1, 2))
        task, fits = make_task(scene, "open", item, joint), True
        for repeat in range(repeats + 1):  # the first one compiles
            order: tuple[BaseUse, ...] = ("fixed", "auto") if repeat % 2 else ("auto", "fixed")
            for use in order if fits else ():
                config, watch = PipelineConfig(base=use), Stopwatch(time.process_time)
                query = PlacementQuery(scene, own, task, reach, config=config, watch=watch)
                began = time.process_time()
                plan = plan_placement(query).plan
                times[repeat, int(use == "auto")] = time.process_time() - began
                fits = fits and plan.feasible and not plan.moves_base
        if fits:
            ratios.append(float(np.median(times[1:, 1] / times[1:, 0])))
            spent += times[1:].sum(0)
            print(f"{robot} {name} {item}/{joint} {ratios[-1]:.3f}", flush=True)
    print(f"== {robot}: {len(ratios)} openings, median ratio {np.median(ratios):.3f}, "
          f"of all time {spent[1] / spent[0]:.3f}")  # fmt: skip


def always(folder: Path, robots: tuple[str, ...] = ("stretch", "hsr"), sample: int = 0) -> None:
    """Open and close each part with a base that moves, and keep the plans.

    Args:
        folder: Folder of the plan files.
        robots: Robots of the library.
        sample: Number of random openings of each robot; 0 for all.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in robots:
        counts, (own, reach) = Counter[str](), arm(name)
        for number, (_, scene_name, item, joint) in enumerate(openings([name], sample)):
            scene = scene_of(scene_name)
            opens = make_task(scene, "open", item, joint)
            assert opens.to is not None
            ajar = scene.with_joint(item, joint, opens.to)
            for there, task in ((scene, opens), (ajar, make_task(ajar, "close", item, joint))):
                watch = Stopwatch(time.process_time)
                query = PlacementQuery(there, own, task, reach, watch=watch)
                what = f"{name} {task.verb} {scene_name} {item}/{joint}"
                try:
                    plan = plan_moving(query).plan
                except MomaposError as error:
                    print(what, error, flush=True)
                    continue
                counts[f"{task.verb} {plan.status}"] += 1
                nearest = plan.candidates.nearest
                if plan.feasible:
                    write_plan(plan, folder / f"{name}-{task.verb}-{number}.json")
                words = "" if plan.feasible or nearest is None else nearest.reason
                print(f"{what} {plan.status} {watch.total:.2f} s {words}", flush=True)
        print(f"== {name}: {dict(counts)}", flush=True)


def run(
    folder: Path, count: int = 100, seeds: int = 1, limit: float = 900.0, only: str = ""
) -> None:
    """Execute plans whose base moves or stops several times by contact, with noise.

    The base drives there as in `momapos run`, the arm motion is replanned, and the furniture's mass
    and friction differ by up to 30 %.

    Args:
        folder: Folder of plan files, as `always` keeps them.
        count: Number of plans, drawn at random.
        seeds: Number of runs of each plan.
        limit: Processor time after which no run begins [s].
        only: Text in the names of the files.
    """
    print(machine())
    every = [path for path in sorted(folder.glob("*.json")) if only in path.name]
    every = [path for path in every if read_plan(path).moves_base]
    drawn = np.random.default_rng(0).permutation(len(every))[:count].tolist()
    counts: Counter[str] = Counter()
    hardest, began = 0.0, time.process_time()
    physics = ExecutionConfig(hold="contact", furniture=FurnitureConfig(spread=SPREAD))
    for seed, path in ((seed, every[k]) for seed in range(seeds) for k in drawn):
        at = time.process_time()
        if at - began > limit:
            break
        plan, force = read_plan(path), 0.0
        try:
            scene = as_planned(load_scene(plan.scene), plan)
            robot, reach = arm(plan.robot_name)
            record = run_plan(plan, scene, robot, reach, seed=seed, physics=physics)
            how = "done" if record.success else record.reason
            if record.execution is not None and record.execution.collisions:
                force = record.execution.collisions[0].force
        except MomaposError as error:
            how = f"error: {error}"
        counts[how if how == "done" else "not done"] += 1
        counts[f"above {HARD:.0f} N"] += force > HARD
        hardest = max(hardest, force)
        spent = time.process_time() - at
        print(f"{path.stem} {seed} {how} {force:.0f} N {spent:.0f} s", flush=True)
    print(f"== {len(every)} plans, {dict(counts)}, hardest touch {hardest:.0f} N")


def fridges(
    folder: Path, robot: str = "segway_ur5e", base: BaseUse = "fixed", timeout: float = 40.0,
    every: int = 1, close: bool = False,
) -> None:  # fmt: skip
    """Count the objects in fridges that a tour fetches, and those that any opening could help with.

    Each tour opens the fridge and picks the object. "no door" is the pick alone in the room without
    the part: a bound for every opening and stop, since a door only takes room away. "usual" is the
    tour with the default opening, "chosen" the one that chooses it where that fails.

    Args:
        folder: Results of `momapos bench run paper-sim`.
        robot: Robot of the suite.
        base: Use of the base.
        timeout: Time limit of a tour [s].
        every: Of how many objects one is tried.
        close: Close the fridge afterwards.
    """
    print(machine())
    suite = read_folder(folder).suite
    tasks = [t for t in suite.tasks if t.robot == robot and t.group == "in fridge"][::every]
    config, names = PipelineConfig(timeout=timeout, base=base), ("no door", "usual", "chosen")
    counts, seconds, (own, reach) = np.zeros(3, int), list[float](), arm(robot)
    for task in tasks:
        assert task.inside is not None
        part = (task.inside.object, task.inside.joint)
        requests = [Request("open", *part), Request("pick", task.object)]
        requests += [Request("close", *part)] if close else []
        scene = load_scene(folder / task.scene)
        query = PlacementQuery.of(
            scene, own, make_task(scene, *requests[0]), reach, config=config,
            clock=time.process_time,
        )  # fmt: skip
        if not _has_plan_without_part(query, task, part):
            print(f"{task.name}: no plan without the door", flush=True)
            continue
        usual = plan_requests(replace(query, watch=Stopwatch(time.process_time)), requests)
        began, chosen = time.process_time(), usual
        if not _done(usual, requests, scene):
            chosen = plan_chain(replace(query, watch=Stopwatch(time.process_time)), requests)
            seconds.append(time.process_time() - began)
        done = np.array([True, _done(usual, requests, scene), _done(chosen, requests, scene)])
        counts += done
        words = " ".join(f"{name} {int(one)}" for name, one in zip(names, done, strict=True))
        print(f"{task.name}: {words}; {usual.seconds:.1f} s; {_words(chosen)}", flush=True)
    print(f"{len(tasks)} objects:", dict(zip(names, counts.tolist(), strict=True)))
    if seconds:
        print(f"seconds of the others: {np.percentile(seconds, [50, 95]).round(1)} (median, 95th)")


def _has_plan_without_part(query: PlacementQuery, task: SuiteTask, part: tuple[str, str]) -> bool:
    scene = without_part(query.scene, *part)
    pick = make_task(scene, "pick", task.object)
    alone = replace(query, scene=scene, task=pick, watch=Stopwatch(time.process_time))
    return plan_placement(alone).plan.feasible


def _done(tour: Tour, requests: list[Request], scene: Scene) -> bool:
    """Return whether every task has a plan; each is checked in the scene after those before it."""
    if len(tour.steps) < len(requests) or not tour.steps[-1].plan.feasible:
        return False
    for step in tour.steps:
        plan = step.plan
        assert plan.motion is not None
        assert plan.base_pose is not None
        verifier = PlanVerifier(
            scene.with_joints(plan.scene_joints), step.prepared.robot, plan.task
        )
        checks = verifier.check(plan.base_pose, plan.motion).checks
        if not all(check.ok for check in (*checks, *verifier.drive_checks(plan))):
            raise AssertionError("the exact check rejects a plan")
    return True


def _words(tour: Tour) -> str:
    first, last = tour.steps[0], tour.steps[-1].plan
    to = "" if first.plan.task.to is None else f"opened to {first.value_words(first.plan.task.to)}"
    reasons = last.candidates.rejections
    why = "" if last.feasible else max(reasons, key=lambda word: reasons[word], default="")
    return f"{to} {last.task.verb}: {last.status} {why}"


if __name__ == "__main__":
    commands(__doc__, ask, table, cost, always, run, fridges)
