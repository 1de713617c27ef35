"""Measure which objects really matter for a task, and which score identifies them best.

    python benchmarks/importance_truth.py [--rooms 60] [--targets 2] [--cell 0.1] [--turn 30]
        [--scenes DIR] [--cache FILE] [--out DIR] [--figure FILE]

Ground truth: an object outside S stays a box. It matters for a task by the share of feasible base
poses that are lost if this object is a box and all others are models. A pose is feasible if the
base is free at every value of the joint and an arm path is found; the approach from home and the
exact check are omitted. Results are stored per room in the cache file, so that an interrupted run
can continue; delete the file when the method changes.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Float, Int

from importance_metrics import draw, summary, table
from importance_rooms import Room, built_in_rooms, is_wall, shared_rooms
from momapos.core import MomaposError, default_cache_dir
from momapos.core.geometry import compose
from momapos.model.records import ReachScorer, Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, SceneObject
from momapos.planning import PipelineConfig, collision_world
from momapos.planning.arm_motion import Feasibility, collision_free_grasps
from momapos.planning.grasps import hand_path, make_task, task_motion
from momapos.planning.importance import ImportanceConfig, ScorerName, rank
from momapos.planning.importance.config import EdgesName, GraphConfig
from momapos.planning.placement import BaseStatus, base_pose_status
from momapos.planning.placement.area import sampling_box, task_frame
from momapos.planning.reachability import load_reach_map
from momapos.planning.task_setup import placement_geometry

CONFIG = PipelineConfig()
GRASPS = 8
"""Number of grasps tried at one pose, best reached first [-]."""
MIN_POSES = 10
"""Tasks with fewer feasible poses are skipped [-]."""
SEEDS = 3
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
    cell: float
    """Cell size of the grid [m]."""
    turn: float
    """Yaw step of the grid [deg]."""

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
        x, y = (np.arange(low, high + self.cell, self.cell) for low, high in corners.T)
        yaw = np.radians(np.arange(-180.0, 180.0, self.turn))
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


def truth(question: Question) -> dict[str, Any] | None:
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
            for seed in range(SEEDS if config.scorer in WALKERS else 1)
            for ranked in [rank(question.scene, task.object, config, path=path, seed=seed)]
        ]
        for name, config in configs.items()
    }


def answer(
    room: Room, robot: Robot, reach: ReachScorer, args: argparse.Namespace
) -> list[dict[str, Any]]:
    """Return the truth and the scores of each task in a room."""
    tasks: dict[str, dict[str, Any]] = {}
    for name, joint in room.targets:
        if name in tasks or len(tasks) == room.most:
            continue
        began = time.perf_counter()
        try:
            task = make_task(room.scene, "open", name, joint)
            question = Question(room.scene, robot, reach, task, args.cell, args.turn)
            found = truth(question)
        except MomaposError:  # a handle too thick for the gripper
            continue
        if found is not None:
            head = {"room": room.key, "source": room.source, "task": f"{name}/{joint}"}
            seconds = round(time.perf_counter() - began, 1)
            tasks[name] = head | found | {"seconds": seconds, "scores": scores(question)}
    return list(tasks.values())


def measure(args: argparse.Namespace) -> list[dict[str, Any]]:
    """Read the rooms of these settings from the cache file, and measure the missing ones."""
    settings = [args.robot, args.cell, args.turn, args.targets]
    lines = args.cache.read_text().splitlines() if args.cache.exists() else []
    rows = [row for row in map(json.loads, lines) if row["settings"] == settings]
    if not args.report_only:
        known = {row["room"] for row in rows}
        robot = load_robot(args.robot)
        reach = load_reach_map(robot, default_cache_dir(), None)
        built_in = built_in_rooms(args.scenes, args.rooms, args.targets, args.workers)
        for room in chain(shared_rooms() if args.shared else (), built_in):
            if room.key in known:
                continue
            tasks = answer(room, robot, reach, args)
            rows.append({"room": room.key, "settings": settings, "tasks": tasks})
            with args.cache.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    return [task for row in rows for task in row["tasks"]]


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--rooms", type=int, default=60, help="number of built-in kitchens")
    parser.add_argument("--targets", type=int, default=2, help="targets per kitchen")
    parser.add_argument("--shared", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--scenes", type=Path, default=Path("bench_out/rooms"))
    parser.add_argument("--cache", type=Path, default=Path("bench_out/importance_truth.jsonl"))
    parser.add_argument("--cell", type=float, default=0.1, help="[m]")
    parser.add_argument("--turn", type=float, default=30.0, help="[deg]")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--report-only", action="store_true", help="report the cached results only")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args()
    args.cache.parent.mkdir(parents=True, exist_ok=True)
    tasks = measure(args)
    result = summary(tasks)
    print(table(result))
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"summary": result, "tasks": tasks}, indent=1)
        (args.out / "importance_truth.json").write_text(text + "\n")
    if args.figure:
        draw(tasks, args.figure)


if __name__ == "__main__":
    main()
