"""From a scan of a real object that nobody tuned to, to its opened doors and drawers.

    python benchmarks/scan_objects.py [--half tuned|measured] [--robot segway_ur5e] [--frames 60]
                                      [--folder bench_out/scan_objects] [--no-answers] [--anew]

Every object of `objects.py` stands alone in its small room. The room is scanned, the scan is made
into a scene, and every true door and drawer is held against it: whether its front is there (IoU of
the rectangles seen from before it 0.5), how it moves, where its axis and its handle are. Then it is
opened: planned in the scene made, checked exactly in the room with a margin of 2 cm, and executed
by contact with noise in the room as it truly is (`run_plan(..., world=)`). Only what can be planned
in the room itself counts. What is done is kept in the folder and not done again.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from execution import SPREAD
from momapos.cache import default_cache_dir
from momapos.config import PipelineConfig
from momapos.errors import MomaposError
from momapos.execution.config import ExecutionConfig, FurnitureConfig
from momapos.execution.true_world import moved as elsewhere
from momapos.geometry.transforms import apply, invert
from momapos.kinematics.opening import opening_of
from momapos.manipulation.tasks import make_task
from momapos.pipeline import plan_base_placement
from momapos.reachability.store import load_reach_map
from momapos.robots.robot import Robot, load_robot
from momapos.run_plan import run_plan
from momapos.scan_io.scan import read_scan
from momapos.scan_pipeline import default_tools, scan_to_scene
from momapos.scan_records import Modeled, Tools
from momapos.scene.files import load_scene
from momapos.scene.scene import Scene, SceneObject
from momapos.synthetic_scans.depth_sensor import DepthSensor
from momapos.synthetic_scans.recording import synthetic_scan, write_scan
from momapos.types import PlacementPlan
from objects import HALVES, half_of, objects, parts, room
from scan import handle_at, moved, plan_in_scan, why_not

CONFIG = PipelineConfig(timeout=60.0)
LOCATED = 0.5
"""IoU of two fronts from which on they are one [-]."""
APART = 0.2
"""Their planes are no farther apart [m]."""
WAY = 0.3
"""A drawer is open by this way at the latest [m]."""
AXIS, TILT = 0.02, np.radians(3.0)
"""An axis is right within these [m], [rad]."""


@dataclass(frozen=True)
class Way:
    """How a part moves, in the world."""

    kind: str
    """door, flap or drawer."""
    direction: np.ndarray
    """Of its axis."""
    point: np.ndarray
    """On the axis [m]."""
    low: np.ndarray
    high: np.ndarray
    """Corners of the part while it is shut [m]."""


@dataclass(frozen=True)
class Row:
    """One door or drawer, and what became of it."""

    object: str
    joint: str
    half: str
    kind: str
    match: str = ""
    """The joint of the scan; "" where no front is there."""
    label: str = ""
    found: str = ""
    """As what it is found."""
    side: bool = False
    """Whether kind and side of the hinge are right."""
    axis: float | None = None
    """Distance between the axes [m]."""
    tilt: float | None = None
    """Angle between them [rad]."""
    handle: tuple[float, ...] = ()
    """Errors of the handle shut, half and wide open [m]."""
    solvable: bool = False
    planned: str = ""
    """Status of the plan in the scene made."""
    strict: str = "not found"
    """Why the plan does not hold in the room, checked exactly."""
    done: bool = False
    reason: str = ""
    """Why the run did not open it."""

    @property
    def right(self) -> bool:
        """Whether the axis is right."""
        return (
            self.side and self.axis is not None and self.axis < AXIS
            and self.tilt is not None and self.tilt < TILT
        )  # fmt: skip


def way_of(item: SceneObject, joint: str, T: np.ndarray) -> Way:
    """How a part moves, in a frame that T maps the world to."""
    record = item.model.joint(joint)
    at = T @ item.link_poses()[record.parent] @ record.T_parent_joint
    sign = opening_of(item.model, joint).sign
    direction = sign * at[:3, :3] @ record.axis
    upright = abs(direction[2]) > np.sqrt(0.5)
    kind = "drawer" if record.kind == "prismatic" else "door" if upright else "flap"
    poses = item.link_poses({joint: opening_of(item.model, joint).closed})
    links = item.model.moved_by(joint)
    points = [apply(T @ poses[n], hull.vertices) for n in links for hull in item.model.hulls[n]]
    corners = np.concatenate(points)
    return Way(kind, direction, at[:3, 3], corners.min(0), corners.max(0))


def overlap(one: Way, other: Way) -> float:
    """IoU of two fronts seen along x; 0 where one lies far behind the other."""
    if abs(one.low[0] - other.low[0]) > APART:
        return 0.0
    low, high = np.maximum(one.low, other.low)[1:], np.minimum(one.high, other.high)[1:]
    common = float(np.prod(np.maximum(high - low, 0.0)))
    area = sum(float(np.prod((w.high - w.low)[1:])) for w in (one, other))
    return common / max(area - common, 1e-9)


def off(true: Way, found: Way) -> tuple[bool, float | None, float]:
    """Whether a part opens the right way, how far its axis is off [m] and at what angle [rad]."""
    cosine = float(np.clip(true.direction @ found.direction, -1.0, 1.0))
    if true.kind != found.kind or cosine < 0.0:
        return False, None, float(np.arccos(cosine))
    if true.kind == "drawer":
        return True, 0.0, float(np.arccos(cosine))
    middle = (true.low + true.high) / 2
    points = [
        way.point + way.direction * float((middle - way.point) @ way.direction)
        for way in (true, found)
    ]
    apart = float(np.linalg.norm(points[0] - points[1]))
    return True, apart, float(np.arccos(cosine))


def compare(name: str, truth: Scene, scanned: Scene, back: np.ndarray) -> list[Row]:
    """Every part of the object against the scene made, whose frame `back` maps to the room's."""
    item = truth.object("object")
    ours = [(j.name, way_of(item, j.name, np.eye(4))) for j in parts(item.model)]
    theirs = [
        (thing, joint, way_of(thing, joint, back))
        for thing in scanned.objects
        for joint in thing.model.joints
    ]
    pairs = sorted(
        ((overlap(a, b), i, k) for i, (_, a) in enumerate(ours)
         for k, (_, _, b) in enumerate(theirs)),
        reverse=True,
    )  # fmt: skip
    found: dict[int, int] = {}
    for common, i, k in pairs:
        if common >= LOCATED and i not in found and k not in found.values():
            found[i] = k
    rows = []
    for i, (joint, way) in enumerate(ours):
        row = Row(name, joint, half_of(name), way.kind)
        if i in found:
            thing, other, seen = theirs[found[i]]
            side, axis, tilt = off(way, seen)
            errors: tuple[float, ...] = ()
            if (way.kind == "drawer") == (seen.kind == "drawer"):
                errors = tuple(
                    float(np.linalg.norm(
                        handle_at(truth, "object", joint, share)
                        - apply(back, handle_at(scanned, thing.name, other, share)[None])[0]
                    ))
                    for share in (0.0, 0.5, 1.0)
                )  # fmt: skip
            row = replace(
                row, match=f"{thing.name}/{other}", label=thing.category, found=seen.kind,
                side=side, axis=axis, tilt=tilt, handle=errors,
            )  # fmt: skip
        rows.append(row)
    return rows


def opened(
    row: Row, truth: Scene, scanned: Scene, T_scene_truth: np.ndarray, robot: Robot, reach: Any
) -> Row:
    """Plan a part in the room and in the scene made, check the plan, and execute it."""
    try:
        task = make_task(truth, "open", "object", row.joint)
        there = plan_base_placement(truth, robot, task, reach, config=CONFIG)
    except MomaposError as error:
        return replace(row, planned=f"refused in the room: {error}")
    if there.plan.status != "solved":
        return replace(row, planned=f"{there.plan.status} in the room")
    row = replace(row, solvable=True)
    if not row.match:
        return replace(row, planned="not found", reason="not found")
    name, _, joint = row.match.partition("/")
    true, found = ("object", row.joint), (name, joint)
    start = moved(there.start, T_scene_truth)
    try:
        taken, plan = plan_in_scan(truth, scanned, true, found, robot, reach, CONFIG, start)
    except MomaposError as error:
        return replace(row, planned="refused", strict=str(error), reason=str(error))
    row = replace(row, planned=plan.status)
    if plan.status != "solved":
        why = max(plan.candidates.rejections.items(), key=lambda pair: pair[1], default=("",))[0]
        why = f"{plan.status} in the scan: {why}"
        return replace(row, strict=why, reason=why)
    physics = ExecutionConfig(hold="contact", furniture=FurnitureConfig(spread=SPREAD))
    slides = taken.object(name).model.joint(joint).kind == "prismatic"
    same = (row.kind == "drawer") == slides
    share = opened_share(truth, row.joint, plan) if same else 1.0
    if share < 1.0 - physics.tolerance:
        why = f"opens {share:.0%} of the way in the scene made"
        return replace(row, strict=why, reason=why)
    strict = why_not(plan, truth, taken, T_scene_truth, true, found, robot)
    world = elsewhere(truth, moved(np.zeros(3), T_scene_truth))
    try:
        record = run_plan(plan, taken, robot, reach, world=world, seed=0, physics=physics)
        done, reason = record.success, record.reason
    except MomaposError as error:
        done, reason = False, str(error)
    return replace(row, strict=strict, done=done, reason=reason)


def opened_share(truth: Scene, joint: str, plan: PlacementPlan) -> float:
    """How far a plan opens its part, as a share of what is asked in the room.

    Of a drawer `WAY` is enough: how far it slides is not to be seen.
    """
    model = truth.object("object").model
    asked = make_task(truth, "open", "object", joint).to
    assert asked is not None
    assert plan.motion is not None
    way = abs(asked - opening_of(model, joint).closed)
    if model.joint(joint).kind == "prismatic":
        way = min(way, WAY)
    return abs(float(plan.motion.object_q[-1] - plan.motion.object_q[0])) / way


def scanned_rooms(half: str | None, folder: Path, frames: int) -> Iterator[tuple[str, Path, Scene]]:
    """Every object with its room and the folder of its scan, which is made where there is none."""
    for name, file, usual in objects():
        truth = room(name, file, usual) if half in (None, half_of(name)) else None
        if truth is None:
            continue
        home = folder / name.replace("/", "_")
        if not (home / "scan").exists():
            home.mkdir(parents=True, exist_ok=True)
            write_scan(
                synthetic_scan(truth, frames=frames, seed=0, sensor=DepthSensor()), home / "scan"
            )
        yield name, home, truth


def model(home: Path, tools: Tools) -> Modeled:
    """Make the scene."""
    return scan_to_scene(read_scan(home / "scan"), home / "found" / "scene.json", tools)


def measure(
    name: str, home: Path, truth: Scene, tools: Tools, robot: Robot | None, reach: Any
) -> list[Row]:
    """Everything about one object; only what was seen where there is no robot."""
    try:
        result = model(home, tools)
    except MomaposError as error:
        print(f"{name}: {error}", file=sys.stderr)
        item = truth.object("object")
        return [
            Row(name, j.name, half_of(name), way_of(item, j.name, np.eye(4)).kind)
            for j in parts(item.model)
        ]
    scanned = load_scene(str(home / "found" / "scene.json"))
    rows = compare(name, truth, scanned, invert(result.T_scene_scan))
    if robot is None:
        return rows
    return [opened(row, truth, scanned, result.T_scene_scan, robot, reach) for row in rows]


def table(rows: Sequence[Row]) -> str:
    """One half in figures, and each part that is not opened with its reason."""
    located = [r for r in rows if r.match]
    kinds = [r for r in located if r.found == r.kind]
    hinged = [r for r in kinds if r.kind != "drawer"]
    solvable = [r for r in rows if r.solvable]
    errors = np.array([r.handle for r in located if r.side and r.handle]).reshape(-1, 3)

    counts = [
        ("parts located", len(located), len(rows)),
        ("kind right, of those located", len(kinds), len(located)),
        ("hinge side right, of doors and flaps", sum(r.side for r in hinged), len(hinged)),
        ("axis within 2 cm, 3 degrees", sum(r.right for r in located), len(located)),
        ("the same, of all parts", sum(r.right for r in rows), len(rows)),
        ("plan in the scene made", sum(r.planned == "solved" for r in solvable), len(solvable)),
        ("holds in the room, exactly", sum(not r.strict for r in solvable), len(solvable)),
        ("opened in physics", sum(r.done for r in solvable), len(solvable)),
    ]
    lines = [
        f"| {name} | {part} of {whole} ({part / whole:.0%}) |"
        for name, part, whole in counts
        if whole
    ]
    if len(errors):
        medians = ", ".join(f"{100 * v:.1f}" for v in np.median(errors, axis=0))
        lines.append(f"| handle shut, half, wide open, where the side is right | {medians} cm |")
    reasons = Counter(cause(r) for r in solvable if not r.done)
    lines += [f"  {count} {reason}" for reason, count in reasons.most_common()]
    return "\n".join(lines)


def cause(row: Row) -> str:
    """Why a part is not opened, in general words."""
    if not row.match:
        return "part not located"
    if row.found != row.kind:
        return f"{row.kind} taken for a {row.found}"
    if not row.side:
        return "hinge on the wrong side"
    if row.planned != "solved":
        return "no plan in the scene made"
    return "run fails, axis right" if row.right else "run fails, axis off"


def shown(row: Row) -> str:
    """One line."""
    where = f"{row.object.removeprefix('Kitchen_models/')}/{row.joint} {row.kind}"
    if not row.match:
        return f"{where}: not located" + (" (solvable)" if row.solvable else "")
    axis = (
        "-" if row.axis is None else f"{100 * row.axis:.1f} cm {np.degrees(row.tilt or 0):.1f} deg"
    )
    handle = ", ".join(f"{100 * v:.1f}" for v in row.handle)
    text = f"{where}: {row.match} ({row.found}) side {row.side}, axis {axis}, handle {handle} cm"
    if row.planned:
        text += f"; {row.planned}; strict: {row.strict or 'holds'}; done {row.done} {row.reason}"
    return text


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=HALVES, help="only the objects of one half")
    parser.add_argument("--robot", default="segway_ur5e")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--folder", type=Path, default=Path("bench_out/scan_objects"))
    parser.add_argument("--no-answers", action="store_true", help="only what is seen")
    parser.add_argument("--anew", action="store_true", help="do again what was done")
    parser.add_argument("--only", help="only objects with this in their name")
    args = parser.parse_args()
    tools, robot, reach = default_tools(), None, None
    if not args.no_answers:
        robot = load_robot(args.robot)
        reach = load_reach_map(robot, default_cache_dir(), None)
    rows: list[Row] = []
    for name, home, truth in scanned_rooms(args.half, args.folder, args.frames):
        if args.only is not None and args.only not in name:
            continue
        file = home / ("seen.json" if args.no_answers else "answers.json")
        if args.anew or not file.exists():
            made = measure(name, home, truth, tools, robot, reach)
            file.write_text(json.dumps([asdict(row) for row in made], indent=1) + "\n")
        found = [
            Row(**{**row, "handle": tuple(row["handle"])}) for row in json.loads(file.read_text())
        ]
        rows += found
        for row in found:
            if row.half == HALVES[0]:
                print(shown(row), flush=True)
    for half in HALVES:
        mine = [row for row in rows if row.half == half]
        if mine:
            print(f"{half}: {len({r.object for r in mine})} objects\n{table(mine)}")


if __name__ == "__main__":
    main()
