"""Plan the public arm problems of MotionBenchMaker, as VAMP ships them.

    python benchmarks/motionbenchmaker.py [--robot fetch] [--count 30] [--planner ours RRTConnect]
        [--seed 0] [--problems DIR]

For another arm than the library's, name its URDF and links: --robot FILE.urdf --srdf FILE --base
LINK --tool LINK --joints NAME ... --suffix panda. These problems have no floor: stand the arm on a
fixed joint of 2 m and raise the scene by --lift 2. Prints a table by kind of scene: problems with
both ends valid, solved, processor time of the search and length of the paths.
"""

from __future__ import annotations

import argparse
import tarfile
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from momapos.model.collision.collision_world import build_world
from momapos.model.collision.self_collision import arm_spheres
from momapos.model.collision.spheres import Spheres
from momapos.model.collision.straight_motions import build_motions
from momapos.model.kinematics.chain import Chain, build_chain
from momapos.model.robots.robot import load_robot
from momapos.model.robots.srdf import read_srdf
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.hulls import Boxes, MovingBoxes
from momapos.model.urdf.reader import read_urdf
from momapos.planning.arm_motion.arm_planner import RESOLUTION, plan_with_clearance
from momapos.planning.arm_motion.config import PlannerConfig
from placement import machine, shared

KINDS = (
    "bookshelf_small", "bookshelf_tall", "bookshelf_thin", "box", "cage", "table_pick",
    "table_under_pick",
)  # fmt: skip
STRIPS = 24
"""Boxes that stand for a cylinder; they protrude by at most 7 % of its radius [-]."""


@dataclass
class Row:
    """Results of one kind of scene."""

    valid: int = 0
    times: list[float] = field(default_factory=list)
    """Processor time of each solved problem [s]."""
    failed: list[float] = field(default_factory=list)
    """Processor time of each problem with valid ends that is not solved [s]."""
    lengths: list[float] = field(default_factory=list)


def boxes_of(scene: dict[str, Any]) -> Boxes:
    """Return the shapes of a MoveIt planning scene as boxes."""
    parts = []
    for item in scene["world"]["collision_objects"]:
        for shape, pose in zip(item["primitives"], item["primitive_poses"], strict=True):
            center = np.array(pose["position"], float)
            turn = Rotation.from_quat(pose["orientation"]).as_matrix()
            if shape["type"] == "box":
                half = np.array(shape["dimensions"], float)[None] / 2
                parts.append(Boxes(center[None], turn[None], half))
            elif shape["type"] == "cylinder":
                parts.append(strips_of(center, turn, *shape["dimensions"]))
            else:
                raise ValueError(f"{item['id']}: a {shape['type']} is not read")
    return Boxes.join(parts)


def strips_of(center: np.ndarray, turn: np.ndarray, height: float, radius: float) -> Boxes:
    """Cover an upright cylinder by strips."""
    edge = radius * np.linspace(-1.0, 1.0, STRIPS + 1)
    nearest = np.maximum(np.minimum(np.abs(edge[1:]), np.abs(edge[:-1])), 0.0)
    half = np.stack(
        [np.diff(edge) / 2, np.sqrt(radius**2 - nearest**2), np.full(STRIPS, height / 2)], -1
    )
    middle = (edge[1:] + edge[:-1]) / 2
    return Boxes(center + middle[:, None] * turn[:, 0], np.tile(turn, (STRIPS, 1, 1)), half)


def ends_of(request: dict[str, Any], names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return start and goal of a MoveIt motion-plan request.

    Raises:
        KeyError: The request lacks a joint of the robot.
    """
    state = request["start_state"]["joint_state"]
    start = dict(zip(state["name"], state["position"], strict=True))
    wanted = request["goal_constraints"][0]["joint_constraints"]
    goal = {one["joint_name"]: one["position"] for one in wanted}
    return tuple(np.array([values[name] for name in names], float) for values in (start, goal))  # type: ignore[return-value]


def arm_of(args: argparse.Namespace) -> tuple[Chain, Spheres]:
    """Return the arm of a library robot, or of a URDF."""
    if not args.robot.endswith(".urdf"):
        robot = load_robot(args.robot)
        return robot.chain, robot.spheres.by_hulls
    model = Articulated(read_urdf(Path(args.robot)))
    chain, segments = build_chain(model, args.base, args.tool, args.joints)
    disabled = read_srdf(args.srdf) if args.srdf else frozenset()
    return chain, arm_spheres(model, chain, segments, disabled, []).by_hulls


def problems(folder: Path, suffix: str, kind: str, count: int) -> Iterator[tuple[Any, Any]]:
    """Yield scene and request of the first problems of a kind."""
    for i in range(1, count + 1):
        names = f"scene{i:04d}.yaml", f"request{i:04d}.yaml"
        files = (folder / f"{kind}_{suffix}" / name for name in names)
        yield tuple(yaml.load(file.read_text(), yaml.CSafeLoader) for file in files)


def run_kind(
    arm: tuple[Chain, Spheres], given: Iterator[tuple[Any, Any]], config: PlannerConfig,
    lift: float, seed: int,
) -> Row:  # fmt: skip
    """Plan the problems of one kind."""
    (chain, spheres), row = arm, Row()
    none = MovingBoxes(np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3)), np.zeros((1, 0, 3)))
    for scene, request in given:
        boxes = boxes_of(scene)
        raised = Boxes(boxes.center + np.array([0.0, 0.0, lift]), boxes.rotation, boxes.half)
        labels = [""] * len(boxes)
        world = build_world(raised, none, np.zeros(0, bool), labels, spheres, clearance=0.0)
        checker = partial(
            build_motions, world, chain, spheres, np.zeros(3), value=0, holding=False,
            step=RESOLUTION,
        )  # fmt: skip
        free = checker(fine=True)
        start, goal = ends_of(request, chain.names)
        if not (free(start, start) and free(goal, goal)):
            continue
        row.valid += 1
        begin = time.process_time()
        path = plan_with_clearance(
            start, goal, chain.lower, chain.upper, checker, config=config, seed=seed
        )
        spent = time.process_time() - begin
        if path is None:
            row.failed.append(spent)
            continue
        row.times.append(spent)
        row.lengths.append(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()))
    return row


def line(name: str, row: Row, asked: int) -> str:
    """Return a line of the table."""
    if not row.times:
        return f"| {name} | {row.valid} of {asked} | 0 | | | |"
    median, late = 1e3 * np.percentile(row.times, [50, 95])
    return (
        f"| {name} | {row.valid} of {asked} | {len(row.times)} | {median:.2f} | {late:.1f} | "
        f"{np.median(row.lengths):.1f} |"
    )


def report(args: argparse.Namespace, folder: Path) -> None:
    """Print a table for each planner."""
    arm = arm_of(args)
    print(f"{args.robot}, {args.count} problems of each kind, seed {args.seed}; {machine()}")
    for planner in args.planner:
        config = PlannerConfig(planner=None if planner == "ours" else planner, checks=args.checks)
        print(f"\n{planner}, {config.budget} checks\n")
        print("| scenes | both ends valid | solved | median [ms] | 95 % [ms] | length [rad] |")
        print("|---|---|---|---|---|---|")
        every = Row()
        run = partial(run_kind, arm, config=config, lift=args.lift, seed=args.seed)
        run(problems(folder, args.suffix, KINDS[0], 1))  # loads the compiled code
        for kind in KINDS:
            row = run(problems(folder, args.suffix, kind, args.count))
            print(line(kind.replace("_", " "), row, args.count))
            every.valid += row.valid
            every.times += row.times
            every.lengths += row.lengths
        print(line("all", every, args.count * len(KINDS)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--robot", default="fetch")
    parser.add_argument("--suffix", default="fetch", choices=("fetch", "panda", "ur5"))
    parser.add_argument("--base", default="base_link")
    parser.add_argument("--tool", default="")
    parser.add_argument("--joints", nargs="*", default=[])
    parser.add_argument("--srdf", type=Path)
    parser.add_argument("--lift", type=float, default=0.0, help="raise the scene [m]")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--planner", nargs="+", default=["ours"])
    parser.add_argument("--checks", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--problems", type=Path, default=shared() / "planning_problems")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        with tarfile.open(args.problems / f"{args.suffix}.tar.bz2") as archive:
            archive.extractall(place, filter="data")
        report(args, Path(place) / "problems")


if __name__ == "__main__":
    main()
