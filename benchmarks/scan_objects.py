"""Scan real objects, reconstruct them, and open their doors and drawers.

    python benchmarks/scan_objects.py [--set development|test] [--robot segway_ur5e] [--frames 60]
                                      [--folder bench_out/scan_objects] [--no-answers] [--again]
                                      [--together 1] [--misled 1] [--models FOLDER]
                                      [--detector FILE] [--turned DEGREES]

Every object of `objects.py` stands alone in a small room or, with --together 10, with nine others
of its set in a kitchen. The room is scanned and reconstructed, and every true door and drawer is
compared with the scene: presence of its front (IoU 0.5 of the front rectangles), kind of motion,
axis and handle. Parts of the scene that are none lower the precision. Then it is opened: planned in
the reconstructed scene, checked exactly in the true room with a margin of 2 cm, and executed by
contact with noise in the true room (`run_plan(..., world=)`). Only parts that are feasible in the
true room count. Results are stored in the folder and reused.

With --models the objects are those of a folder's models.json, such as sweet_home.py writes it.

With --detector the images are processed with it, as by `momapos scan --detector`.

With --turned the scan's world is turned about z, as that of a phone with an arbitrary start.

With --misled N the belief about the part's joint is swapped: the Nth most probable other hypothesis
gets the probability of the best one. Only parts with a right kind and side before the swap count.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from execution import SPREAD
from momapos.apps.bench.articulated import SETS, Usual, parts, set_of
from momapos.apps.synthetic_scans import DepthSensor, synthetic_scan, write_scan
from momapos.core import MomaposError, default_cache_dir
from momapos.core.geometry import invert, pose_planar
from momapos.model.records import PlacementPlan, Scan
from momapos.model.robots import Robot, load_robot
from momapos.model.scene import Scene, load_scene, scene_with_part_motion
from momapos.model.urdf import opening_of
from momapos.perception import Tools, default_tools
from momapos.perception.detection import YoloxDetector
from momapos.perception.recordings import read_scan
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.planning.reachability import load_reach_map
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.simulation import moved as in_other_frame
from momapos.workflows import run_plan, scan_to_scene
from object_kitchens import Place, kitchen
from object_rooms import listed
from objects import objects, room
from scan import moved, plan_in_scan, why_not
from scan_parts import Row, compare, false_parts, shown, table, way_of

CONFIG = PipelineConfig(timeout=60.0)
MAX_SLIDE = 0.3
"""Travel at which a drawer counts as open at the latest [m]."""


def opened(
    row: Row, truth: Scene, scanned: Scene, T_scene_truth: np.ndarray, robot: Robot, reach: Any
) -> Row:
    """Plan a part in the true and in the reconstructed room, check the plan, and execute it."""
    try:
        task = make_task(truth, "open", row.item, row.joint)
        there = plan_base_placement(truth, robot, task, reach, config=CONFIG)
    except MomaposError as error:
        return replace(row, planned=f"invalid in the room: {error}")
    if there.plan.status != "solved":
        return replace(row, planned=f"{there.plan.status} in the room")
    row = replace(row, solvable=True)
    if not row.match:
        return replace(row, planned="not found", reason="not found")
    name, _, joint = row.match.partition("/")
    true, found = (row.item, row.joint), (name, joint)
    start = moved(there.start, T_scene_truth)
    try:
        taken, plan = plan_in_scan(truth, scanned, true, found, robot, reach, CONFIG, start)
    except MomaposError as error:
        return replace(row, planned="refused", strict=str(error), reason=str(error))
    row = replace(row, planned=plan.status)
    if not plan.feasible:
        why = max(plan.candidates.rejections.items(), key=lambda pair: pair[1], default=("",))[0]
        why = f"{plan.status} in the scan: {why}"
        return replace(row, strict=why, reason=why)
    physics = ExecutionConfig(hold="contact", furniture=FurnitureConfig(spread=SPREAD))
    slides = taken.object(name).model.joint(joint).kind == "prismatic"
    same = (row.kind == "drawer") == slides
    share = opened_share(truth, true, plan) if same else 1.0
    if share < 1.0 - physics.tolerance:
        why = f"opens {share:.0%} of the range in the reconstructed scene"
        return replace(row, strict=why, reason=why)
    strict = why_not(plan, truth, taken, T_scene_truth, true, found, robot)
    world = in_other_frame(truth, moved(np.zeros(3), T_scene_truth))
    try:
        record = run_plan(
            plan, taken, robot, reach, world=world, seed=0, physics=physics, allow_assumed=True
        )
        done, reason = record.success, record.reason
    except MomaposError as error:
        done, reason = False, str(error)
    return replace(row, strict=strict, done=done, reason=reason)


def opened_share(truth: Scene, true: tuple[str, str], plan: PlacementPlan) -> float:
    """Return how far a plan opens its part, as a share of the task in the room.

    `MAX_SLIDE` is enough for a drawer, since its range is not visible.
    """
    item, joint = true
    model = truth.object(item).model
    goal = make_task(truth, "open", item, joint).to
    assert goal is not None
    assert plan.motion is not None
    travel = abs(goal - opening_of(model, joint).closed)
    if model.joint(joint).kind == "prismatic":
        travel = min(travel, MAX_SLIDE)
    return abs(float(plan.motion.object_q[-1] - plan.motion.object_q[0])) / travel


def misled(scene: Scene, name: str, joint: str, index: int) -> Scene:
    """Return a scene in which another hypothesis about a joint swaps with the most probable one.

    Raises:
        SceneError: The hypothesis does not fit the object.
    """
    ways = list(scene.object(name).hypotheses[joint])
    first, other = ways[0], ways[index]
    ways[index] = replace(first, probability=other.probability)
    ways[0] = replace(other, probability=first.probability)
    taken = scene_with_part_motion(scene, name, joint, ways[0])
    item = taken.object(name)
    led = replace(item, hypotheses={**item.hypotheses, joint: tuple(ways)})
    return replace(taken, objects=tuple(led if o is item else o for o in taken.objects))


def places(
    models: Iterable[tuple[str, Path, Usual]], subset: str | None, together: int
) -> Iterator[Place]:
    """Yield the rooms of the objects of each set: one object per room, or several per kitchen."""
    alone = [
        (name, truth)
        for name, file, usual in models
        if subset in (None, set_of(name)) and (truth := room(name, file, usual)) is not None
    ]
    if together == 1:
        for name, truth in alone:
            yield Place(name.replace("/", "_"), truth, {"object": (name, np.eye(4))})
        return
    for one in SETS:
        mine = [pair for pair in alone if set_of(pair[0]) == one]
        for k in range(0, len(mine), together):
            yield kitchen(f"{one}_{k // together}", mine[k : k + together])


def scan_of(place: Place, folder: Path, frames: int, seed: int) -> Path:
    """Return the folder of a room with its scan, which is generated if missing."""
    home = folder / place.name
    if not (home / "scan").exists():
        home.mkdir(parents=True, exist_ok=True)
        scan = synthetic_scan(place.scene, frames=frames, seed=seed, sensor=DepthSensor())
        write_scan(scan, home / "scan")
    return home


def measure(
    place: Place, home: Path, tools: Tools, robot: Robot | None, reach: Any, wrong: int, turn: float
) -> list[Row]:
    """Evaluate the objects of a room; without a robot only the reconstruction."""
    truth, T_scan_room = place.scene, pose_planar(np.array([0.0, 0.0, np.radians(turn)]))
    try:
        scan = moved_scan(read_scan(home / "scan"), T_scan_room)
        result = scan_to_scene(scan, home / "found" / "scene.json", tools)
    except MomaposError as error:
        print(f"{place.name}: {error}", file=sys.stderr)
        return [
            Row(name, j.name, set_of(name), way_of(truth.object(item), j.name, T).kind)
            for item, (name, T) in place.objects.items()
            for j in parts(truth.object(item).model)
        ]
    scanned = load_scene(str(home / "found" / "scene.json"))
    T_scene_room = result.T_scene_scan @ T_scan_room
    rows = [
        row
        for item, (name, T) in place.objects.items()
        for row in compare(name, item, truth, scanned, invert(T_scene_room), T)
    ]
    took = {one.detection.name: one.seconds for one in result.decisions}
    rows = [replace(row, seconds=took.get(row.match.partition("/")[0], 0.0)) for row in rows]
    false = false_parts(rows, scanned)
    if robot is None:
        return [*rows, *false]
    if not wrong:
        made = [opened(row, truth, scanned, T_scene_room, robot, reach) for row in rows]
        return [*made, *false]
    made = []
    for row in filter(lambda row: row.side, rows):
        name, _, joint = row.match.partition("/")
        if len(scanned.object(name).hypotheses[joint]) > wrong:
            taken = misled(scanned, name, joint, wrong)
            made.append(opened(row, truth, taken, T_scene_room, robot, reach))
    return made


def moved_scan(scan: Scan, T: np.ndarray) -> Scan:
    """Return the same images in another world frame."""
    frames = tuple(replace(one, T_world_camera=T @ one.T_world_camera) for one in scan.frames)
    return replace(scan, frames=frames)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=SETS, help="only the objects of one set")
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0, help="seed of the walk, materials and noise")
    parser.add_argument("--together", type=int, default=1, help="number of objects per kitchen")
    parser.add_argument("--folder", type=Path, default=Path("bench_out/scan_objects"))
    parser.add_argument(
        "--no-answers", action="store_true", help="evaluate the reconstruction only"
    )
    parser.add_argument("--again", action="store_true", help="ignore stored results")
    parser.add_argument("--only", help="only rooms with this in their name")
    parser.add_argument(
        "--misled", type=int, default=0, help="swap the belief with the Nth other hypothesis"
    )
    parser.add_argument("--turned", type=float, default=0.0, help="turn the scan's world [degrees]")
    parser.add_argument("--models", type=Path, help="folder with a models.json of other objects")
    parser.add_argument("--detector", type=Path, help="ONNX file of an object detector")
    args = parser.parse_args()
    if args.misled and args.no_answers:
        parser.error("--misled needs answers; leave out --no-answers")
    if args.together < 1:
        parser.error(f"--together must be 1 or more, not {args.together}")
    models = objects() if args.models is None else listed(args.models)
    try:
        rooms = list(places(models, args.set, args.together))
    except MomaposError as error:
        sys.exit(str(error))
    tools, robot, reach = default_tools(), None, None
    if args.detector is not None:
        tools = replace(tools, detect=YoloxDetector(args.detector))
    if not args.no_answers:
        robot = load_robot(args.robot)
        reach = load_reach_map(robot, default_cache_dir(), None)
    rows: list[Row] = []
    for place in rooms:
        if args.only is not None and args.only not in place.name:
            continue
        home = scan_of(place, args.folder, args.frames, args.seed)
        name = "seen" if args.no_answers else f"misled_{args.misled}" if args.misled else "answers"
        if args.turned:
            name += f"_turned_{args.turned:g}"
        file = home / f"{name}.json"
        if args.again or not file.exists():
            made = measure(place, home, tools, robot, reach, args.misled, args.turned)
            file.write_text(json.dumps([asdict(row) for row in made], indent=1) + "\n")
        found = [
            Row(**{**row, "handle": tuple(row["handle"])}) for row in json.loads(file.read_text())
        ]
        rows += found
        for row in found:
            if row.subset == SETS[0]:
                print(shown(row), flush=True)
    for subset in SETS:
        mine = [row for row in rows if row.subset == subset]
        if mine:
            print(f"{subset}: {len({r.object for r in mine})} objects\n{table(mine)}")


if __name__ == "__main__":
    main()
