"""Scans of kitchens in which one door or flap stands open, made into scenes, against what is true.

    python benchmarks/open_doors.py [--rooms 8] [--first 0] [--robot segway_ur5e] [--frames 60]
                                    [--folder bench_out/open_doors] [--no-answers] [--anew]

In each generated kitchen one hinged part that has a handle, another one from room to room, is
opened by 40 to 100 degrees and the room is scanned once. A part is right when the scene has it with
its kind, its hinge's side, its axis (2 cm, 3 degrees) and how far it is open (5 degrees). Then it
is shut and opened wider: planned in the scene made, and checked exactly in the room as it stands
with 2 cm, where the room itself has an answer. What else the scene has of the room is counted
beside what it has when all is shut. What is done is kept in the folder and not done again.
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
from momapos.planning.grasps.tasks import make_task, openable
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.reachability.map_store import load_reach_map
from momapos.workflows.scan import scan_to_scene
from scan import match, moved, why_not
from scan_parts import AXIS, TILT, off, overlap, way_of

LOCATED = 0.5
"""IoU of two fronts from which on they are one [-]."""
VALUE = np.radians(5.0)
"""How far it is open is right within this [rad]."""
DEGREES = (40.0, 100.0)
"""How far parts stand open [deg]."""
WIDER = np.radians(20.0)
"""So much farther they are opened, as far as they go [rad]."""
CONFIG = PipelineConfig(timeout=60.0)


@dataclass(frozen=True)
class Row:
    """One room, and what became of the part that stands open in it."""

    room: str
    part: str
    category: str
    kind: str
    degrees: float
    match: str = ""
    """The joint of the scene; "" where no front is there."""
    found: str = ""
    axis: float | None = None
    """Distance between the axes [m]; None where the hinge is at another side."""
    tilt: float | None = None
    """Angle between them [rad]."""
    value: float | None = None
    """How far it is open in the scene [deg]."""
    others: int = 0
    """Other joints of the room that the scene has."""
    others_shut: int = 0
    """The same of a scan with all parts shut."""
    tasks: dict[str, str] = field(default_factory=dict)
    """What became of a task that the room has an answer to: "" where the answer from the scan
    holds in the room, exactly."""

    @property
    def right(self) -> bool:
        """Whether all of the part is right."""
        return (
            self.found == self.kind and self.axis is not None and self.axis < AXIS
            and self.tilt is not None and self.tilt < TILT
            and self.value is not None and abs(self.value - self.degrees) < np.degrees(VALUE)
        )  # fmt: skip


def opened_room(scene: Scene, number: int) -> tuple[Scene, str, str, float]:
    """A room with one of its hinged parts open; which one, and how far [rad]."""
    rng = np.random.default_rng((number, 7))
    hinged = [
        (thing, joint)
        for thing, joint in openable(scene)
        if scene.object(thing).model.joint(joint).kind == "revolute"
    ]
    kinds = sorted({scene.object(thing).category for thing, _ in hinged})
    kind = kinds[number % len(kinds)]
    of_kind = [pair for pair in hinged if scene.object(pair[0]).category == kind]
    thing, joint = of_kind[int(rng.integers(len(of_kind)))]
    opening = opening_of(scene.object(thing).model, joint)
    way = min(np.radians(rng.uniform(*DEGREES)), abs(opening.wide - opening.closed))
    value = float(opening.closed + opening.sign * way)
    return scene.with_joint(thing, joint, value), thing, joint, float(way)


def scanned(scene: Scene, folder: Path, frames: int, seed: int) -> Path:
    """The folder of a scan, which is made where there is none."""
    if not folder.exists():
        write_scan(synthetic_scan(scene, frames=frames, seed=seed, sensor=DepthSensor()), folder)
    return folder


def compare(row: Row, truth: Scene, result: Modeled, made: Scene) -> Row:
    """The open part of a room against the scene made."""
    thing, joint = row.part.split("/")
    item, back = truth.object(thing), invert(result.T_scene_scan)
    shut = replace(item, joints={})
    _, out = opening_direction(shut, joint)
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
    """How many joints of a room its scene has, one left out; both with all parts shut."""
    shut = [
        replace(scene, objects=tuple(replace(item, joints={}) for item in scene.objects))
        for scene in (truth, made)
    ]
    pairs = match(shut[0], shut[1], invert(result.T_scene_scan))
    return sum(f"{thing}/{joint}" != without for thing, joint in pairs)


def answers(
    row: Row, truth: Scene, result: Modeled, made: Scene, robot: Robot, reach: Any
) -> dict[str, str]:
    """Shut the part and open it wider, as planned in the scene made, checked in the room."""
    thing, joint = row.part.split("/")
    ours = opening_of(truth.object(thing).model, joint)
    now = truth.object(thing).values()[joint]
    farther = min(abs(now - ours.closed) + WIDER, abs(ours.wide - ours.closed))
    asked = {"close": ("close", 0.0), "open wider": ("open", float(farther))}
    found: dict[str, str] = {}
    for name, (verb, way) in asked.items():
        try:
            task = make_task(truth, verb, thing, joint, ours.closed + ours.sign * way)
            there = plan_base_placement(truth, robot, task, reach, config=CONFIG)
        except MomaposError:  # it is wide open, or open where the robot begins
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
                plan, truth, made, result.T_scene_scan, (thing, joint), (other, its), robot, task
            )
            if plan.status == "solved"
            else f"{plan.status} in the scan"
        )  # fmt: skip
    return found


def measure(
    number: int, folder: Path, frames: int, tools: Tools, robot: Robot | None, reach: Any
) -> Row:
    """Everything about one room."""
    layout, seed = LAYOUTS[number % len(LAYOUTS)], number // len(LAYOUTS)
    home = folder / f"{layout}_{seed}"
    path = home / "scene" / "scene.json"
    if not path.exists():
        generate_kitchen(layout, seed=seed, out=path)
    scene = load_scene(str(path))
    truth, thing, joint, way = opened_room(scene, number)
    part = f"{thing}/{joint}"
    row = Row(home.name, part, truth.object(thing).category, "", float(np.degrees(way)))
    counts = []
    for name, room in (("shut", scene), ("open", truth)):
        scan = read_scan(scanned(room, home / name, frames, seed))
        result = scan_to_scene(scan, home / f"{name}_found" / "scene.json", tools)
        made = load_scene(str(result.scene))
        counts.append(others(truth, result, made, part))
    row = compare(row, truth, result, made)
    row = replace(row, others_shut=counts[0], others=counts[1])
    if robot is None:
        return row
    return replace(row, tasks=answers(row, truth, result, made, robot, reach))


def shown(row: Row) -> str:
    """One line."""
    axis = "-" if row.axis is None else f"{100 * row.axis:.1f} cm"
    value = "-" if row.value is None else f"{row.value:.1f}"
    verdict = f"{'right' if row.right else 'WRONG'}, {row.match or 'not found'} {row.found}"
    return (
        f"{row.room} {row.part} ({row.category}) {row.kind} {row.degrees:.1f} deg: {verdict}, "
        f"axis {axis}, open by {value}; others {row.others}, when shut {row.others_shut}; "
        f"{row.tasks}"
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="leave out so many rooms")
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--folder", type=Path, default=Path("bench_out/open_doors"))
    parser.add_argument("--no-answers", action="store_true", help="only what is seen")
    parser.add_argument("--anew", action="store_true", help="do again what was done")
    args = parser.parse_args()
    tools, robot, reach = default_tools(), None, None
    if not args.no_answers:
        robot = load_robot(args.robot)
        reach = load_reach_map(robot, default_cache_dir(), None)
    rows = []
    for number in range(args.first, args.first + args.rooms):
        file = args.folder / f"{'seen' if args.no_answers else 'answers'}_{number}.json"
        if args.anew or not file.exists():
            row = measure(number, args.folder, args.frames, tools, robot, reach)
            file.write_text(json.dumps(asdict(row), indent=1) + "\n")
        rows.append(Row(**json.loads(file.read_text())))
        print(shown(rows[-1]), flush=True)
    tasks = [refusal for row in rows for refusal in row.tasks.values()]
    before = sum(row.others_shut for row in rows)
    print(
        f"right {sum(row.right for row in rows)} of {len(rows)}; "
        f"other joints {sum(row.others for row in rows)}, when all is shut {before}; "
        f"tasks {sum(not refusal for refusal in tasks)} of {len(tasks)}"
    )


if __name__ == "__main__":
    main()
