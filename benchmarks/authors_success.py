"""Count what the authors' measure of success would add in the suite authors-sim.

    python benchmarks/authors_success.py DIR

DIR is a folder of `momapos bench run authors-sim`. In the authors' public code the arm moves with
RRTConnect to a pose above the object, and a tool within 0.1 m of it is a success. From the first
base pose of each baseline, this looks for a path of the open hand from home to a pose within that
distance: one of the pinches of momapos, or of the poses in front of them. Nothing is held or
lifted then, so that each pick that is solved has such a path.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from momapos.apps.bench import all_rows, read_folder
from momapos.apps.bench.bench_records import Suite
from momapos.apps.bench.methods import method_config
from momapos.apps.bench.suites import PAPER_PROTOCOL
from momapos.model.collision import build_motions
from momapos.model.robots import load_robot
from momapos.model.scene import load_scene
from momapos.planning import PlacementQuery
from momapos.planning.arm_motion.arm_planner import RESOLUTION, plan_with_clearance
from momapos.planning.baselines.by_method import PLACERS, _first_pose
from momapos.planning.grasps import TaskMotion, make_task, task_motion
from momapos.planning.search_setup import SearchSetup, prepare_search

DISTANCE = 0.1
"""Distance of the tool from the object at which the authors' code counts a success [m]."""


def main(argv: list[str] | None = None) -> int:
    """Print how many poses have such a path, by method, place and whether the pick is solved."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(argv).folder
    suite, every, near = read_folder(folder).suite, Counter[str](), Counter[str]()
    for row in all_rows(folder):
        if row.protocol == str(PAPER_PROTOCOL) and row.method in PLACERS:
            where = f"{row.method}, {row.group}, {row.outcome}"
            every[where] += 1
            near[where] += comes_near(suite, folder, row.task, row.method)
    for where, count in sorted(every.items()):
        print(f"{where}: {near[where]} of {count}")
    return 0


def comes_near(suite: Suite, folder: Path, name: str, method: str) -> bool:
    """Return whether the tool gets near the object from the first base pose of a method."""
    item = next(task for task in suite.tasks if task.name == name)
    scene = load_scene(folder / item.scene).with_joints(item.joints)
    robot = load_robot(item.robot)
    query = PlacementQuery.of(
        scene, robot, make_task(scene, item.verb, item.object), seed=item.seed,
        config=method_config(method, 20.0, PAPER_PROTOCOL),
    )  # fmt: skip
    motion = task_motion(scene, robot, query.task, query.config.motion)
    ready = prepare_search(query, scene, motion)
    poses = _first_pose(ready, PLACERS[method])
    center = scene.object(item.object).bounds.mean(axis=0)
    tools = motion.Ts_world_tool[:, : motion.grasp_step + 1, :3, 3]
    near = np.linalg.norm(tools - center, axis=2) <= DISTANCE
    return any(
        reaches(ready, until(motion.only(near[:, step]), step), base)
        for base in poses
        for step in np.flatnonzero(near.any(axis=0)).tolist()
    )


def until(motion: TaskMotion, step: int) -> TaskMotion:
    """Return a motion that stays at a step, with an open hand."""
    stay = [step, step]
    return replace(
        motion, Ts_world_tool=motion.Ts_world_tool[:, stay], object_q=motion.object_q[stay],
        value=motion.value[stay], waypoint_steps=np.arange(2), grasp_step=1,
        holding=np.zeros(2, bool),
    )  # fmt: skip


def reaches(ready: SearchSetup, motion: TaskMotion, base: np.ndarray) -> bool:
    """Return whether a path leads the arm from home to a tool pose of the motion."""
    query = ready.query
    prepared = replace(ready.prepared, motion=motion)
    feasible = prepared.feasibility(query.config, query.seed)
    chain, spheres = query.robot.chain, query.robot.spheres.by_hulls
    checker = partial(
        build_motions, feasible.world, chain, spheres, base, value=int(motion.value[0]),
        holding=False, step=RESOLUTION,
    )  # fmt: skip
    ends = feasible.arm_paths(base, np.arange(len(motion.Ts_world_tool)))
    return any(
        plan_with_clearance(
            query.robot.home, end.q[0], chain.lower, chain.upper, checker,
            config=query.config.arm_planner, seed=query.seed,
        ) is not None
        for end in ends
        if end.q is not None
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
