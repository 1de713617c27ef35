"""Measure importance: time of ranking, effect on answers, and which objects really matter.

    python benchmarks/importance.py ranking [--repeats 5]
    python benchmarks/importance.py answers [--robot segway_ur5e] [--runs everything reach]
    python benchmarks/importance.py truth [--rooms 60] [--targets 2] [--out DIR]

Processor times.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import rankdata

from momapos.core import MomaposError
from momapos.core.geometry import compose
from momapos.model.records import KeyObjects, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import (
    LAYOUTS,
    Scene,
    SceneObject,
    builtin_names,
    generate_kitchen,
    load_scene,
)
from momapos.planning import PipelineConfig, collision_world, plan_base_placement
from momapos.planning.arm_motion import Feasibility, collision_free_grasps
from momapos.planning.grasps import hand_path, make_task, openable, task_motion
from momapos.planning.importance import KINDS, ImportanceConfig, ScorerName, rank
from momapos.planning.importance.config import EdgesName, GraphConfig
from momapos.planning.importance.scene_graph import build_graph
from momapos.planning.importance.scorers import SCORERS
from momapos.planning.placement import BaseStatus, base_pose_status
from momapos.planning.placement.area import sampling_box, task_frame
from momapos.planning.task_setup import placement_geometry
from momapos.verification import PlanVerifier
from placement import SCENES, arm, machine, scene_of, shared
from rows import commands, keep_rows

SEEDS = 8


def boxes(count: int, *, scattered: bool) -> Scene:
    """Build a room of boxes."""
    rng = np.random.default_rng(0)
    items = []
    for k in range(count):
        size = tuple(rng.uniform(0.1, 0.8, 3))
        x, y = rng.uniform(0, 0.8 * np.sqrt(count), 2) * scattered
        items.append(SceneObject.box(f"box_{k}", size, (x, y, size[2] / 2), category="box"))
    return Scene(f"{count} boxes {'scattered' if scattered else 'at one place'}", tuple(items))


def milliseconds(work: Callable[[], object], repeats: int) -> float:
    """Return the median processor time of some work [ms]."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return 1000 * float(np.median(times))


def measure(scene: Scene, target: str, repeats: int) -> str:
    """Return one row of the table."""
    first = milliseconds(lambda: build_graph(scene), 1)
    graph = build_graph(scene)
    kinds = np.bincount(graph.kind, minlength=len(KINDS))
    cells = [scene.name, str(len(scene.objects)), " / ".join(map(str, kinds)), f"{first:.0f}"]
    cells.append(f"{milliseconds(lambda: build_graph(scene), repeats):.0f}")
    for scorer in SCORERS:
        config = ImportanceConfig(scorer=cast(ScorerName, scorer))
        cells.append(f"{milliseconds(partial(rank, scene, target, config), repeats):.0f}")
    cells.append(noise(scene, target))
    return f"| {' | '.join(cells)} |"


def noise(scene: Scene, target: str) -> str:
    """Return the standard deviation of deepwalk's scores over seeds, and how many cross alpha."""
    if len(scene.objects) > 100:
        return "-"
    graph = GraphConfig(edges="near")
    walks = ImportanceConfig(scorer="deepwalk", weights="scaled", exceed=False, graph=graph)
    runs = [rank(scene, target, walks, seed=seed) for seed in range(SEEDS)]
    scores = np.array([[run.score(name) for name in run.graph.names] for run in runs])
    mean, alpha = scores.mean(0), runs[0].alpha
    related = mean > 1e-3
    changes = ((scores >= alpha) != (mean >= alpha)).mean()
    return f"{scores[:, related].std(0).mean():.3f}, {100 * changes:.1f} %"


def ranking(repeats: int = 5) -> None:
    """Measure the time of ranking, and how much the scores depend on the seed.

    Synthetic rooms: boxes of 0.1 to 0.8 m, scattered over a floor that grows with their number, or
    all at one place. Kitchens: the built-in ones, and those of the BestMan simulator. Processor
    times, with compiled kernels and with the scene's hulls, which the first ranking of a scene
    builds.

    Args:
        repeats: Number of measurements of each time.
    """
    real = SCENES if (shared() / "bestman").is_dir() else ()
    scenes = [scene_of(name) for name in (*builtin_names(), *real)]
    scenes += [boxes(count, scattered=True) for count in (30, 100, 1000)]
    scenes.append(boxes(1000, scattered=False))
    rank(scenes[0], scenes[0].objects[0].name)  # compiles the kernels
    head = ["room", "objects", " / ".join(KINDS), "first graph", "graph", *SCORERS, "seeds"]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for scene in scenes:
        fridge = [item.name for item in scene.objects if item.category == "fridge"]
        print(measure(scene, (fridge or [scene.objects[0].name])[0], repeats), flush=True)


RUNS: dict[str, tuple[ScorerName, float]] = {
    "everything": ("reach", 0.0),
    "reach": ("reach", 0.45),
    "reach, alpha 0.32": ("reach", 0.32),
    "deepwalk": ("deepwalk", 0.45),
    "distance": ("distance", 0.45),
    "size": ("size", 0.45),
}
"""Scorer and alpha of each line; with alpha 0 all objects are modeled."""


def questions() -> list[tuple[str, Task]]:
    """Return all openings: the scene's name or path, and the task."""
    found = []
    for name in (*SCENES, *builtin_names()):
        scene = scene_of(name)
        for item, joint in openable(scene):
            try:
                found.append((name, make_task(scene, "open", item, joint)))
            except MomaposError:  # it is open already
                continue
    return found


def modeling_seconds(name: str, keep: tuple[str, ...]) -> float:
    """Return the time to build hulls and boxes of some objects of a new scene [s]."""
    scene = scene_of(name)
    began = time.process_time()
    for item in scene.objects:
        if item.name in keep:
            _ = item.model.boxes
    return time.process_time() - began


def row(label: str, of_robot: str, tasks: list[tuple[str, Task]], config: PipelineConfig) -> str:
    """Return one line of the table."""
    robot, reach = arm(of_robot)
    scenes: dict[str, Scene] = {name: scene_of(name) for name in {name for name, _ in tasks}}
    alpha = config.importance.alpha
    assert alpha is not None
    solved, missed, seconds, keys, cost = 0, 0, [], [], 0.0
    for name, task in tasks:
        plan_base_placement(scenes[name], robot, task, reach, config=config)
        plan = plan_base_placement(
            scenes[name], robot, task, reach, config=config, clock=time.process_time
        ).plan
        seconds.append(plan.timing["total"])
        assert plan.key_objects is not None
        keys.append(plan.key_objects)
        if plan.base_pose is not None and plan.motion is not None:
            exact = PlanVerifier(scenes[name], robot, task)
            missed += exact.first_violation(plan.base_pose, plan.motion) is not None
            solved, cost = solved + 1, cost + (plan.navigation_cost or 0.0)
    cells = [
        label, f"{solved} of {len(tasks)}", str(missed), f"{cost / max(1, solved):.2f} m",
        f"{100 * np.mean([len(k.names) / len(k.scores) for k in keys]):.0f} %",
        f"{np.mean([k.rounds for k in keys]):.2f}",
        str(sum(k.alpha < alpha for k in keys)),
        f"{1e3 * np.median(seconds):.0f} / {1e3 * np.percentile(seconds, 95):.0f} ms",
        f"{1e3 * np.mean(_modeling(tasks, keys)):.0f} ms",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _modeling(tasks: list[tuple[str, Task]], keys: list[KeyObjects]) -> list[float]:
    pairs = zip(tasks, keys, strict=True)
    return [modeling_seconds(name, key.names) for (name, _), key in pairs]


def answers(robot: str = "segway_ur5e", runs: tuple[str, ...] = tuple(RUNS)) -> None:
    """Measure the effect of importance on an answer: misses, rounds and modeling time.

    Every door and drawer with a handle in the five kitchens of the BestMan simulator and the
    built-in ones, with each scorer and with all objects modeled. A miss is a plan that the exact
    check with all objects rejects. Processor times, warm.

    Args:
        robot: Robot of the library.
        runs: Lines of the table.
    """
    tasks = questions()
    rooms = len({name for name, _ in tasks})
    print(f"machine: {machine()}; {robot}, {len(tasks)} tasks in {rooms} rooms\n")
    print(
        "| modeled | solved | rejected with all objects | drive | S | rounds | alpha lowered "
        "| median / 95th percentile | modeling |"
    )
    print("|" + "---|" * 9)
    for label in runs:
        scorer, alpha = RUNS[label]
        config = PipelineConfig(importance=ImportanceConfig(scorer=scorer, alpha=alpha))
        print(row(label, robot, tasks, config), flush=True)


OBJECTS = 30
"""Number of objects of a furnished built-in kitchen, without walls [-]."""
ON_COUNTERS = {
    "cup": (0.08, 0.08, 0.1), "box": (0.08, 0.18, 0.25), "kettle": (0.18, 0.16, 0.24),
    "bread_bin": (0.35, 0.25, 0.2), "jar": (0.1, 0.1, 0.16),
}  # fmt: skip
ON_FLOOR = {"stool": (0.35, 0.35, 0.65), "bin": (0.3, 0.25, 0.5), "crate": (0.4, 0.3, 0.3)}
"""Added objects and their sizes [m]."""
FLOOR_SHARE = 0.4
"""Share of added objects on the floor [-]."""
COUNTERS = ("counter", "kitchen island", "cabinet", "dishwasher")
TOP = (0.7, 1.1)
"""Range of heights of supporting surfaces [m]."""
TRIES = 300


@dataclass(frozen=True)
class Room:
    """A scene, its source and its openable parts."""

    key: str
    source: str
    """shared or built-in."""
    scene: Scene
    targets: tuple[tuple[str, str], ...]
    """(object, joint), in the order in which they are tried."""
    most: int
    """Maximum number of tasks, each with another object [-]."""


def is_wall(item: SceneObject) -> bool:
    """Return whether an object is part of the building, which is never removed or modeled."""
    return "wall" in item.category and "cabinet" not in item.category


def shared_rooms() -> Iterator[Room]:
    """Yield the shared kitchens; every openable object is a target."""
    for name in SCENES:
        scene = scene_of(name)
        targets = tuple(openable(scene))
        yield Room(Path(name).stem, "shared", scene, targets, len(targets))


def built_in_rooms(folder: Path, count: int, targets: int) -> Iterator[Room]:
    """Yield generated kitchens of all layouts in turn, with some targets in each."""
    for k in range(count):
        layout, seed = LAYOUTS[k % len(LAYOUTS)], 1 + k // len(LAYOUTS)
        file = folder / f"{layout}_{seed}.json"
        if not file.exists():
            generate_kitchen(layout, seed=seed, out=file)
        rng = np.random.default_rng((seed, LAYOUTS.index(layout)))
        scene = furnish(load_scene(file), rng)
        doors = openable(scene)
        shuffled = tuple(doors[i] for i in rng.permutation(len(doors)))
        yield Room(f"{layout}_{seed}", "built-in", scene, shuffled, targets)


def furnish(scene: Scene, rng: np.random.Generator) -> Scene:
    """Add small objects on counters and on the floor, until there are 30 objects."""
    wanted = OBJECTS - sum(not is_wall(item) for item in scene.objects)
    for k in range(max(0, wanted)):
        on_floor = rng.random() < FLOOR_SHARE
        kinds = ON_FLOOR if on_floor else ON_COUNTERS
        kind = str(rng.choice(list(kinds)))
        size = np.array(kinds[kind])
        spot = _spot(scene, size, rng, on_floor=on_floor)
        if spot is None:
            continue
        added = SceneObject.box(f"{kind}_{k}", size, spot, category=kind.replace("_", " "))
        scene = replace(scene, objects=(*scene.objects, added))
    return scene


def _spot(
    scene: Scene, size: Float[np.ndarray, "3"], rng: np.random.Generator, *, on_floor: bool
) -> tuple[float, float, float] | None:
    """Return a center at which a box is 2 cm clear of all others [m]; None if none was found."""
    bounds = np.array([item.bounds for item in scene.objects])
    tops = [
        item.bounds for item in scene.objects
        if item.category in COUNTERS and TOP[0] < item.bounds[1, 2] < TOP[1]
    ]  # fmt: skip
    for _ in range(TRIES):
        if on_floor and scene.floor_polygon is not None:
            low, high, z = scene.floor_polygon.min(0), scene.floor_polygon.max(0), 0.0
        elif tops:
            top = tops[int(rng.integers(len(tops)))]
            low, high, z = top[0, :2], top[1, :2], float(top[1, 2])
        else:
            return None
        slack = high - low - size[:2]
        if (slack < 0).any():
            continue
        x, y = low + size[:2] / 2 + rng.random(2) * slack
        center = np.array([x, y, z + 0.001 + size[2] / 2])
        near = np.maximum(bounds[:, 0] - center, center - bounds[:, 1]) < size / 2 + [0.02, 0.02, 0]
        if not near.all(1).any():
            return tuple(center.tolist())
    return None


ALPHA = 0.45
"""The paper's threshold [-]."""
ALPHAS = np.linspace(0.0, 1.0, 101)
SHARES = (0.0, 0.01, 0.05)
"""An object matters if modeling it as a box loses more than this share of the poses [-]."""


@dataclass(frozen=True)
class Pairs:
    """All pairs of a task and an object for one scorer, once per seed."""

    score: Float[np.ndarray, " n"]
    matters: Bool[np.ndarray, " n"]
    task: Int[np.ndarray, " n"]
    """Index of the pair's task and seed."""


def pairs(tasks: list[dict[str, Any]], scorer: str, share: float = SHARES[1]) -> Pairs:
    """Stack the scores and the truth of all tasks."""
    runs = [(task, one) for task in tasks for one in task["scores"][scorer]]
    matters = [np.array(task["lost"]) > share for task, _ in runs]
    owner = np.repeat(np.arange(len(runs)), [len(one) for _, one in runs])
    return Pairs(np.concatenate([one for _, one in runs]), np.concatenate(matters), owner)


def roc_area(p: Pairs) -> float:
    """Return how often an object that matters scores above one that does not; ties count 0.5."""
    many, few = p.matters.sum(), (~p.matters).sum()
    if not many or not few:
        return float("nan")
    return float((rankdata(p.score)[p.matters].sum() - many * (many + 1) / 2) / (many * few))


def roc_within(p: Pairs) -> float:
    """Return the mean of the same measure within each task: the quality of the order."""
    one = [Pairs(p.score[k], p.matters[k], p.task[k]) for t in set(p.task) for k in [p.task == t]]
    return float(np.nanmean([roc_area(part) for part in one]))


def curve(p: Pairs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return precision, recall and the share in S at every score, the highest first."""
    order = np.argsort(-p.score, kind="stable")
    hits = np.cumsum(p.matters[order])
    last = np.append(np.diff(p.score[order]) != 0, True)
    taken = np.arange(1, len(hits) + 1)
    return (hits / taken)[last], (hits / hits[-1])[last], (taken / len(hits))[last]


def average_precision(p: Pairs) -> float:
    """Return the area under the stepwise precision-recall curve."""
    precision, recall, _ = curve(p)
    return float((np.diff(recall, prepend=0.0) * precision).sum())


def at(p: Pairs, alpha: float) -> dict[str, float]:
    """Return precision, recall, F1 and the share of objects in S at a threshold."""
    chosen = p.score >= alpha
    hits = float((chosen & p.matters).sum())
    precision = hits / chosen.sum() if chosen.any() else 1.0
    recall = hits / p.matters.sum()
    f1 = 2 * hits / (chosen.sum() + p.matters.sum())
    return {"precision": precision, "recall": recall, "f1": f1, "kept": float(chosen.mean())}


def measures(tasks: list[dict[str, Any]], scorer: str, share: float) -> dict[str, Any]:
    """Return all measures of one scorer."""
    p = pairs(tasks, scorer, share)
    count = sum(len(task["objects"]) for task in tasks)
    everywhere = [at(p, alpha) for alpha in ALPHAS]
    best = int(np.argmax([row["f1"] for row in everywhere]))
    # The highest alpha with a recall of 90 %: the size of S if few misses are allowed.
    safe = int(np.flatnonzero([row["recall"] >= 0.9 for row in everywhere]).max())
    return {
        "pairs": count,
        "matter": float(p.matters.mean()),
        "roc": roc_area(p),
        "roc_within": roc_within(p),
        "ap": average_precision(p),
        "at_alpha": at(p, ALPHA),
        "best": {"alpha": float(ALPHAS[best])} | everywhere[best],
        "safe": {"alpha": float(ALPHAS[safe])} | everywhere[safe],
    }


def summary(tasks: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the measures of all scorers, over all rooms and by source, for each share."""
    rows = []
    for share in SHARES:
        for source in ("all", "shared", "built-in"):
            some = [t for t in tasks if source in ("all", t["source"]) and t["objects"]]
            if not some:
                continue
            head = {"share": share, "source": source, "tasks": len(some)}
            head["rooms"] = len({t["room"] for t in some})
            rows += [
                head | {"scorer": name} | measures(some, name, share) for name in some[0]["scores"]
            ]
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Format the measures as Markdown: by source for the default share, else over all rooms."""
    lines: list[str] = []
    group: tuple[str, ...] = ()
    for r in rows:
        if r["share"] != SHARES[1] and r["source"] != "all":
            continue
        if group != (group := (r["share"], r["source"])):
            lines += [
                f"\n{r['source']}: {r['rooms']} rooms, {r['tasks']} tasks, {r['pairs']} pairs; "
                f"{100 * r['matter']:.1f} % of the objects matter (> {100 * r['share']:g} %)\n",
                "| scorer | ROC | in a task | AP | at 0.45: P, R, S | best F1: P, R, S | "
                "R 90 %: P, S |",
                "|---|---|---|---|---|---|---|",
            ]
        a, b, c = r["at_alpha"], r["best"], r["safe"]
        lines.append(
            f"| {r['scorer']} | {r['roc']:.3f} | {r['roc_within']:.3f} | {r['ap']:.3f} | "
            f"{a['precision']:.2f}, {a['recall']:.2f}, {100 * a['kept']:.0f} % | "
            f"{b['f1']:.2f} at {b['alpha']:.2f}: "
            f"{b['precision']:.2f}, {b['recall']:.2f}, {100 * b['kept']:.0f} % | "
            f"at {c['alpha']:.2f}: {c['precision']:.2f}, {100 * c['kept']:.0f} % |"
        )
    return "\n".join(lines)


CONFIG = PipelineConfig()
GRASPS = 8
"""Number of grasps tried at one pose, best reached first [-]."""
CELL, TURN = 0.1, 30.0
"""Cell size [m] and yaw step [deg] of the grid."""
MIN_POSES = 10
"""Tasks with fewer feasible poses are skipped [-]."""
WALKS = 3
"""Number of seeds of a scorer that walks [-]."""
PLAIN: tuple[ScorerName, ...] = ("distance", "size", "reach", "names")
K0 = (0.0, 0.25, 0.5, 0.75, 1.0)
WALKERS: tuple[ScorerName, ...] = ("deepwalk", "node2vec")
"""Scorers that walk over the graph; each is measured with each choice of its edges."""
Rows = Int[np.ndarray, " m"]


@dataclass(frozen=True)
class Question:
    """A task of one robot, and the grid of base poses."""

    scene: Scene
    robot: Robot
    reach: ReachScorer
    task: Task

    @cached_property
    def others(self) -> tuple[SceneObject, ...]:
        """Return the objects that can be boxes, the nearest to the target first."""
        target = self.scene.object(self.task.object).bounds
        items = [o for o in self.scene.objects if o.name != self.task.object and not is_wall(o)]
        return tuple(sorted(items, key=lambda item: _gap(item.bounds, target)))

    @cached_property
    def poses(self) -> Float[np.ndarray, "n 3"]:
        """Return the grid over all poses within the arm's length, in the task's frame."""
        motion = task_motion(self.scene, self.robot, self.task, CONFIG.motion)
        geometry = placement_geometry(self.scene, self.robot, motion, CONFIG.place.clearance)
        corners = sampling_box(geometry)
        if corners is None:
            return np.zeros((0, 3))
        x, y = (np.arange(low, high + CELL, CELL) for low, high in corners.T)
        yaw = np.radians(np.arange(-180.0, 180.0, TURN))
        local = np.stack(np.meshgrid(x, y, yaw, indexing="ij"), -1).reshape(-1, 3)
        return compose(task_frame(geometry), local)

    def feasible(self, scene: Scene, rows: Rows) -> Rows:
        """Return which of the given grid poses are feasible in a scene."""
        if not len(rows):
            return rows
        motion = task_motion(scene, self.robot, self.task, CONFIG.motion)
        geometry = placement_geometry(scene, self.robot, motion, CONFIG.place.clearance)
        rows = rows[base_pose_status(geometry, self.poses[rows])[0] == BaseStatus.CLEAR]
        world = collision_world(self.robot, motion, CONFIG)
        roomy, _ = collision_free_grasps(self.robot, world, motion)
        scores = self.reach.min_score(self.poses[rows], geometry.Ts_world_tool) * roomy
        reached = scores.max(1, initial=0.0) > 0
        rows, scores = rows[reached], scores[reached]
        check = Feasibility(self.robot, world, motion, CONFIG.planner, lambda *_: None, 0)
        found = check.screen(self.poses[rows], scores, GRASPS)
        return rows[np.array([one.q is not None for one in found], bool)]

    def boxed(self, group: Iterable[SceneObject]) -> Scene:
        """Return the scene with some objects replaced by their boxes."""
        boxes = {item.name for item in group}
        return self.scene.with_box_proxies({o.name for o in self.scene.objects} - boxes)


def _gap(a: Float[np.ndarray, "2 3"], b: Float[np.ndarray, "2 3"]) -> float:
    """Return the horizontal distance of two boxes [m]."""
    return float(np.linalg.norm(np.maximum(np.maximum(a[0] - b[1], b[0] - a[1]), 0.0)[:2]))


def lost(question: Question, group: tuple[SceneObject, ...], rows: Rows) -> dict[str, int]:
    """Count the poses that are lost if each object alone is a box.

    Bisects the group: a box contains its object, so a pose that is feasible with a whole group as
    boxes is feasible with each of them as a box.

    Args:
        question: The task.
        group: Objects.
        rows: Poses that are feasible with all of them modeled.
    """
    if group and len(rows):
        rows = np.setdiff1d(rows, question.feasible(question.boxed(group), rows))
    if len(group) <= 1 or not len(rows):
        return {item.name: len(rows) for item in group}
    middle = len(group) // 2
    return lost(question, group[:middle], rows) | lost(question, group[middle:], rows)


def true_costs(question: Question) -> dict[str, Any] | None:
    """Return the share of poses that each object costs as a box; None with too few poses."""
    full = question.feasible(question.scene, np.arange(len(question.poses)))
    if len(full) < MIN_POSES:
        return None
    boxed = question.feasible(question.boxed(question.others), full)
    costs = lost(question, question.others, full)
    return {
        "poses": len(question.poses),
        "full": len(full),
        "boxed": len(boxed),
        "objects": [item.name for item in question.others],
        "lost": [costs[item.name] / len(full) for item in question.others],
    }


def scores(question: Question) -> dict[str, list[list[float]]]:
    """Return the scores of the objects by each scorer, one list per seed."""
    walks = ImportanceConfig(
        scorer="deepwalk", weights="scaled", exceed=False, graph=GraphConfig(edges="near")
    )
    configs = {f"deepwalk k0={k0:g}": replace(walks, k0=k0) for k0 in K0}
    for scorer in WALKERS:
        for edges in get_args(EdgesName):
            graph = GraphConfig(edges=edges)
            configs[f"{scorer}, {edges}"] = ImportanceConfig(scorer=scorer, graph=graph)
    configs |= {name: ImportanceConfig(scorer=name) for name in PLAIN}
    task = question.task
    path = hand_path(question.scene, task.object, task.joint, task.to)
    return {
        name: [
            [ranked.score(item.name) for item in question.others]
            for seed in range(WALKS if config.scorer in WALKERS else 1)
            for ranked in [rank(question.scene, task.object, config, path=path, seed=seed)]
        ]
        for name, config in configs.items()
    }


def answer(room: Room, robot: Robot, reach: ReachScorer) -> list[dict[str, Any]]:
    """Return the truth and the scores of each task in a room."""
    tasks: dict[str, dict[str, Any]] = {}
    for name, joint in room.targets:
        if name in tasks or len(tasks) == room.most:
            continue
        began = time.perf_counter()
        try:
            task = make_task(room.scene, "open", name, joint)
            question = Question(room.scene, robot, reach, task)
            found = true_costs(question)
        except MomaposError:  # a handle too thick for the gripper
            continue
        if found is not None:
            head = {"room": room.key, "source": room.source, "task": f"{name}/{joint}"}
            seconds = round(time.perf_counter() - began, 1)
            tasks[name] = head | found | {"seconds": seconds, "scores": scores(question)}
    return list(tasks.values())


def truth(
    robot: str = "segway_ur5e", rooms: int = 60, targets: int = 2,
    folder: Path = Path("bench_out/rooms"), out: Path | None = None,
) -> None:  # fmt: skip
    """Measure which objects really matter for a task, and which score identifies them best.

    Ground truth: an object outside S stays a box. It matters for a task by the share of feasible
    base poses that are lost if this object is a box and all others are models. A pose is feasible
    if the base is free at every value of the joint and an arm path is found; the approach from home
    and the exact check are omitted. Results are stored per room in FOLDER/truth.jsonl, so that an
    interrupted run can continue; delete it when the method changes.

    Args:
        robot: Robot of the library.
        rooms: Number of generated kitchens.
        targets: Targets per kitchen.
        folder: Folder of the kitchens and of what is measured.
        out: Folder for importance_truth.json.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cache, settings = folder / "truth.jsonl", [robot, targets]
    lines = cache.read_text().splitlines() if cache.exists() else []
    rows = [row for row in map(json.loads, lines) if row["settings"] == settings]
    known = {row["room"] for row in rows}
    for room in chain(shared_rooms(), built_in_rooms(folder, rooms, targets)):
        if room.key not in known:
            row = {"room": room.key, "settings": settings, "tasks": answer(room, *arm(robot))}
            rows.append(row)
            with cache.open("a") as file:
                file.write(json.dumps(row) + "\n")
    tasks = [task for row in rows for task in row["tasks"]]
    result = summary(tasks)
    print(table(result))
    keep_rows({"summary": result, "tasks": tasks}, out, "importance_truth")


if __name__ == "__main__":
    commands(__doc__, ranking, answers, truth)
