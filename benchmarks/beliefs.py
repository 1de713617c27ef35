"""Count openings that are solved from a scan, by the probability of the joint that a plan is for.

    python benchmarks/beliefs.py [--kitchens kitchen_small ...] [--robots segway_ur5e ...]
        [--frames 60] [--limit 20] [--folder bench_out/beliefs]

Renders each built-in kitchen as a walk with an RGB-D camera, reconstructs a scene with all objects
modeled, and plans every opening in it as `momapos place` does. "Below one half" counts solved plans
for a hypothesis of the joint with a smaller probability; there must be none.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan, write_scan
from momapos.core import TaskError, default_cache_dir
from momapos.model.records import ReachScorer, Status, Task
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene
from momapos.perception import default_tools
from momapos.perception.recordings import read_scan
from momapos.planning import PlacementResult, plan_base_placement
from momapos.planning.grasps import make_task, openable
from momapos.planning.reachability import load_reach_map
from momapos.workflows import plan_by_hypothesis, scan_to_scene

HALF = 0.5


@dataclass(frozen=True)
class Opening:
    """The answer for one part of a scanned room."""

    name: str
    """OBJECT/JOINT."""
    status: Status | str
    probability: float
    """Probability of the joint motion that the answer is for [-]."""
    words: str = ""
    """The assumption of an assumed plan, or why the task was refused."""


def openings(scene: Scene, robot: Robot, reach: ReachScorer, limit: int) -> Iterator[Opening]:
    """Yield the answer for each part of a scene that has several hypotheses."""

    def plan(room: Scene, task: Task) -> list[PlacementResult]:
        return [plan_base_placement(room, robot, task, reach)]

    parts = [(o, j) for o, j in openable(scene) if j in scene.object(o).hypotheses]
    for item, joint in parts[:limit]:
        first = scene.object(item).hypotheses[joint][0].probability
        try:
            _, _, (answer,) = plan_by_hypothesis(scene, make_task(scene, "open", item, joint), plan)
        except TaskError as error:
            yield Opening(f"{item}/{joint}", "refused", first, str(error))
            continue
        found = answer.plan.assumption
        if found is None:
            yield Opening(f"{item}/{joint}", answer.plan.status, first)
        else:
            words = f"{found}, not {found.instead}"
            yield Opening(f"{item}/{joint}", answer.plan.status, found.probability, words)


def scan_of(kitchen: str, folder: Path, frames: int) -> Path:
    """Return the folder of a scan of a built-in kitchen; render it if needed."""
    scan = folder / kitchen / "scan"
    if not scan.exists():
        room = load_scene(kitchen)
        write_scan(synthetic_scan(room, frames=frames, seed=0, sensor=DepthSensor()), scan)
    return scan


def scanned_scene(kitchen: str, folder: Path, frames: int) -> Scene:
    """Return the scene reconstructed from a scan of a built-in kitchen."""
    scan, out = scan_of(kitchen, folder, frames), folder / kitchen / "found" / "scene.json"
    scan_to_scene(read_scan(scan), out, default_tools())
    return load_scene(out)


def summary(found: list[Opening]) -> str:
    """Return one line of results."""
    count = dict.fromkeys(("solved", "assumed", "infeasible", "timeout", "refused"), 0)
    for one in found:
        count[one.status] += 1
    below = sum(one.status == "solved" and one.probability < HALF for one in found)
    statuses = ", ".join(f"{number} {status}" for status, number in count.items())
    return f"{len(found)} openings: {statuses}; solved below one half: {below}"


def main() -> None:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kitchens", nargs="+", default=("kitchen_small", "kitchen_island"))
    parser.add_argument("--robots", nargs="+", default=("segway_ur5e", "fetch"))
    parser.add_argument("--frames", type=int, default=60, help="number of frames of new scans")
    parser.add_argument("--limit", type=int, default=20, help="openings per kitchen and robot")
    parser.add_argument("--folder", type=Path, default=Path("bench_out/beliefs"))
    args = parser.parse_args()
    everything: list[Opening] = []
    for kitchen in args.kitchens:
        scene = scanned_scene(kitchen, args.folder, args.frames)
        for name in args.robots:
            robot = load_robot(name)
            reach = load_reach_map(robot, default_cache_dir(), None)
            found = []
            for one in openings(scene, robot, reach, args.limit):
                found.append(one)
                print(
                    f"  {name} {one.name}: {one.status} ({one.probability:.3f}) {one.words}",
                    flush=True,
                )
            print(f"{kitchen}, {name}: {summary(found)}", flush=True)
            everything += found
    print(f"all: {summary(everything)}")


if __name__ == "__main__":
    main()
