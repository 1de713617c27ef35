"""Evaluate scenes from scans of kitchens in which one door or flap is open.

    python benchmarks/open_doors.py [--rooms 8] [--first 0] [--robot segway_ur5e] [--frames 60]
                                    [--folder bench_out/open_doors] [--no-answers] [--again]

In each generated kitchen one hinged part with a handle is opened by 40 to 100 degrees; its kind
varies between rooms. The room is scanned once. A part is right if the scene has its kind, hinge
side, axis (2 cm, 3 degrees) and opening angle (5 degrees). Then it is closed and opened wider:
planned in the reconstructed scene, and checked exactly in the true room with a margin of 2 cm, if
the task is feasible in the true room. The other joints of the scene are counted and compared with a
scan of the closed room. Results are stored in the folder and reused.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from momapos.apps.synthetic_scans.depth_sensor import DepthSensor
from momapos.apps.synthetic_scans.recording import synthetic_scan, write_scan
from momapos.core.cache import default_cache_dir
from momapos.core.errors import MomaposError
from momapos.core.geometry.transforms import invert, rotation_about
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.scene.kitchens import LAYOUTS, generate_kitchen
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.joint_opening import opening_of
from momapos.perception.pipeline import default_tools
from momapos.perception.recordings.scan_reader import read_scan
from momapos.perception.records import Modeled, Tools
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.handles import opening_direction
from momapos.planning.grasps.task_requests import make_task, openable
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.workflows.scan import scan_to_scene
from scan import match, moved, why_not
from scan_parts import AXIS, TILT, off, overlap, way_of

LOCATED = 0.5
"""Minimum IoU of two fronts that are the same part [-]."""
VALUE = np.radians(5.0)
"""Maximum error of a right opening angle [rad]."""
DEGREES = (40.0, 100.0)
"""Range of opening angles [deg]."""
WIDER = np.radians(20.0)
"""Additional opening, up to the joint limit [rad]."""
CONFIG = PipelineConfig(timeout=60.0)


@dataclass(frozen=True)
class Row:
    """One room, and the results of its open part."""

    room: str
    part: str
    category: str
    kind: str
    degrees: float
    match: str = ""
    """The joint of the scene; "" if there is no front."""
    found: str = ""
    axis: float | None = None
    """Distance between the axes [m]; None if the hinge is on another side."""
    tilt: float | None = None
    """Angle between them [rad]."""
    value: float | None = None
    """Opening angle in the scene [deg]."""
    others: int = 0
    """Number of other joints of the room in the scene."""
    others_closed: int = 0
    """The same for a scan with all parts closed."""
    tasks: dict[str, str] = field(default_factory=dict)
    """Result of each task that is feasible in the room; "" if the plan is also valid there."""

    @property
    def right(self) -> bool:
        """Return whether the part is right in all respects."""
        return (
            self.found == self.kind and self.axis is not None and self.axis < AXIS
            and self.tilt is not None and self.tilt < TILT
            and self.value is not None and abs(self.value - self.degrees) < np.degrees(VALUE)
        )  # fmt: skip


def opened_room(scene: Scene, number: int) -> tuple[Scene, str, str, float]:
    """Open one hinged part of a room; return the room, the part, and its angle [rad]."""
    rng = np.random.default_rng((number, 7))
    hinged = [
        (name_of, joint)
        for name_of, joint in openable(scene)
        if scene.object(name_of).model.joint(joint).kind == "revolute"
    ]
    kinds = sorted({scene.object(name_of).category for name_of, _ in hinged})
    kind = kinds[number % len(kinds)]
    of_kind = [pair for pair in hinged if scene.object(pair[0]).category == kind]
    name_of, joint = of_kind[int(rng.integers(len(of_kind)))]
    opening = opening_of(scene.object(name_of).model, joint)
    way = min(np.radians(rng.uniform(*DEGREES)), abs(opening.wide - opening.closed))
    value = float(opening.closed + opening.sign * way)
    return scene.with_joint(name_of, joint, value), name_of, joint, float(way)


def scanned(scene: Scene, folder: Path, frames: int, seed: int) -> Path:
    """Return the folder of a scan, which is generated if missing."""
    if not folder.exists():
        write_scan(synthetic_scan(scene, frames=frames, seed=seed, sensor=DepthSensor()), folder)
    return folder


def compare(row: Row, truth: Scene, result: Modeled, made: Scene) -> Row:
    """Compare the open part of a room with the reconstructed scene."""
    name_of, joint = row.part.split("/")
    item, back = truth.object(name_of), invert(result.T_scene_scan)
    closed = replace(item, joints={})
    _, out = opening_direction(closed, joint)
    T = np.eye(4)  # to where the front is toward -x
    T[:3, :3] = rotation_about(np.array([0.0, 0.0, 1.0]), np.pi - np.arctan2(out[1], out[0]))
    true = way_of(item, joint, T)
    best = (LOCATED, "")
    for other in made.objects:
        for name in other.model.joints:
            seen = way_of(other, name, T @ back)
            common = overlap(true, seen)
            if common > best[0]:
                best = common, f"{other.name}/{name}"
                side, axis, tilt = off(true, seen)
                value = abs(other.values()[name] - opening_of(other.model, name).closed)
                row = replace(
                    row, match=best[1], found=seen.kind, axis=axis if side else None, tilt=tilt,
                    value=float(np.degrees(value)) if seen.kind != "drawer" else None,
                )  # fmt: skip
    return replace(row, kind=true.kind)


def others(truth: Scene, result: Modeled, made: Scene, without: str) -> int:
    """Count the joints of a room in its scene, except one; both with all parts closed."""
    closed = [
        replace(scene, objects=tuple(replace(item, joints={}) for item in scene.objects))
        for scene in (truth, made)
    ]
    pairs = match(closed[0], closed[1], invert(result.T_scene_scan))
    return sum(f"{name_of}/{joint}" != without for name_of, joint in pairs)


def answers(
    row: Row, truth: Scene, result: Modeled, made: Scene, robot: Robot, reach: Any
) -> dict[str, str]:
    """Close the part and open it wider: plan in the reconstructed scene, check in the room."""
    name_of, joint = row.part.split("/")
    ours = opening_of(truth.object(name_of).model, joint)
    now = truth.object(name_of).values()[joint]
    farther = min(abs(now - ours.closed) + WIDER, abs(ours.wide - ours.closed))
    tasks = {"close": ("close", 0.0), "open wider": ("open", float(farther))}
    found: dict[str, str] = {}
    for name, (verb, way) in tasks.items():
        try:
            task = make_task(truth, verb, name_of, joint, ours.closed + ours.sign * way)
            there = plan_base_placement(truth, robot, task, reach, config=CONFIG)
        except MomaposError:  # it is fully open, or open at the robot's start
            continue
        if there.plan.status != "solved":
            continue
        if not row.match:
            found[name] = "not found in the scan"
            continue
        other, _, its = row.match.partition("/")
        theirs = opening_of(made.object(other).model, its)
        to = theirs.closed + theirs.sign * min(way, abs(theirs.wide - theirs.closed))
        start = moved(there.start, result.T_scene_scan)
        try:
            plan = plan_base_placement(
                made, robot, make_task(made, verb, other, its, to), reach, start=start,
                config=CONFIG,
            ).plan  # fmt: skip
        except MomaposError as error:
            found[name] = str(error)
            continue
        found[name] = (
            why_not(
                plan, truth, made, result.T_scene_scan, (name_of, joint), (other, its), robot, task
            )
            if plan.status == "solved"
            else f"{plan.status} in the scan"
        )  # fmt: skip
    return found


def measure(
    number: int, folder: Path, frames: int, tools: Tools, robot: Robot | None, reach: Any
) -> Row:
    """Evaluate one room."""
    layout, seed = LAYOUTS[number % len(LAYOUTS)], number // len(LAYOUTS)
    home = folder / f"{layout}_{seed}"
    path = home / "scene" / "scene.json"
    if not path.exists():
        generate_kitchen(layout, seed=seed, out=path)
    scene = load_scene(str(path))
    truth, name_of, joint, way = opened_room(scene, number)
    part = f"{name_of}/{joint}"
    row = Row(home.name, part, truth.object(name_of).category, "", float(np.degrees(way)))
    counts = []
    for name, room in (("closed", scene), ("open", truth)):
        scan = read_scan(scanned(room, home / name, frames, seed))
        result = scan_to_scene(scan, home / f"{name}_found" / "scene.json", tools)
        made = load_scene(str(result.scene))
        counts.append(others(truth, result, made, part))
    row = compare(row, truth, result, made)
    row = replace(row, others_closed=counts[0], others=counts[1])
    if robot is None:
        return row
    return replace(row, tasks=answers(row, truth, result, made, robot, reach))


def shown(row: Row) -> str:
    """Format a row as one line."""
    axis = "-" if row.axis is None else f"{100 * row.axis:.1f} cm"
    value = "-" if row.value is None else f"{row.value:.1f}"
    verdict = f"{'right' if row.right else 'WRONG'}, {row.match or 'not found'} {row.found}"
    return (
        f"{row.room} {row.part} ({row.category}) {row.kind} {row.degrees:.1f} deg: {verdict}, "
        f"axis {axis}, open by {value}; others {row.others}, when closed {row.others_closed}; "
        f"{row.tasks}"
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="number of rooms to skip")
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--folder", type=Path, default=Path("bench_out/open_doors"))
    parser.add_argument("--no-answers", action="store_true", help="evaluate the scene only")
    parser.add_argument("--again", action="store_true", help="ignore stored results")
    args = parser.parse_args()
    tools, robot, reach = default_tools(), None, None
    if not args.no_answers:
        robot = load_robot(args.robot)
        reach = load_reach_map(robot, default_cache_dir(), None)
    rows = []
    for number in range(args.first, args.first + args.rooms):
        file = args.folder / f"{'seen' if args.no_answers else 'answers'}_{number}.json"
        if args.again or not file.exists():
            row = measure(number, args.folder, args.frames, tools, robot, reach)
            file.write_text(json.dumps(asdict(row), indent=1) + "\n")
        rows.append(Row(**json.loads(file.read_text())))
        print(shown(rows[-1]), flush=True)
    tasks = [refusal for row in rows for refusal in row.tasks.values()]
    before = sum(row.others_closed for row in rows)
    print(
        f"right {sum(row.right for row in rows)} of {len(rows)}; "
        f"other joints {sum(row.others for row in rows)}, when all are closed {before}; "
        f"tasks {sum(not refusal for refusal in tasks)} of {len(tasks)}"
    )


if __name__ == "__main__":
    main()
