"""Scan real objects, reconstruct them, and open their doors and drawers.

    python benchmarks/scan_objects.py [--set development|test] [--robot segway_ur5e] [--frames 60]
                                      [--folder bench_out/scan_objects] [--no-answers]
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

import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from execution import SPREAD
from momapos.apps.bench.articulated import SETS, Usual, parts, set_of
from momapos.core import MomaposError
from momapos.core.geometry import apply, invert, pose_planar
from momapos.model.records import PlacementPlan, Scan
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject, load_scene, scene_with_part_motion
from momapos.model.urdf import opening_of
from momapos.perception import Tools, default_tools
from momapos.perception.detection import YoloxDetector
from momapos.perception.recordings import read_scan
from momapos.planning import PipelineConfig, plan_base_placement
from momapos.planning.grasps import make_task
from momapos.simulation import ExecutionConfig, FurnitureConfig
from momapos.simulation import moved as in_other_frame
from momapos.workflows import run_plan, scan_to_scene
from objects import Subset, objects, room
from placement import arm
from rows import commands
from scan import handle_at, moved, plan_in_scan, why_not
from scan import scanned as scan_of

BETWEEN = 0.08
"""Free width between two objects of a kitchen [m]."""
AISLE = 2.4
"""Distance between the fronts of the two rows [m]."""
WALL = 0.1
"""Thickness of walls [m]."""
CEILING = 2.6
"""Height of walls [m]."""


@dataclass(frozen=True)
class Place:
    """A room with objects whose parts are known."""

    name: str
    scene: Scene
    objects: dict[str, tuple[str, np.ndarray]]
    """By name in the room: the name in the list of objects, and the transform from the room's frame
    to the object's own, in which its front is toward -x."""


def kitchen(name: str, alone: Sequence[tuple[str, Scene]]) -> Place:
    """Place objects and their counters in two rows along opposite walls, in turn.

    Args:
        name: Name of the room.
        alone: Each object's name and its own room from `objects.room`: its front toward -x, a
            wall behind it, for small ones a counter below.
    """
    rows = (alone[0::2], alone[1::2])
    depth = max(-_span(scene)[0][0] for _, scene in alone)
    ends = AISLE / 2 + depth
    items: list[SceneObject] = []
    objects: dict[str, tuple[str, np.ndarray]] = {}
    lengths = [sum(_wide(scene) for _, scene in row) for row in rows]
    for row, length, turn in zip(rows, lengths, (0.0, np.pi), strict=True):
        T_room_row = pose_planar(np.array([0.0, 0.0, turn]))
        at = -length / 2
        for object_name, scene in row:
            low, high = _span(scene)
            wide = _wide(scene)
            shift = np.array([ends, at + wide / 2 - (low[1] + high[1]) / 2, 0.0])
            T = T_room_row @ pose_planar(shift)
            own = f"object_{len(objects) + 1}"
            objects[own] = (object_name, invert(T))
            for item in scene.objects:
                if item.name != "wall":
                    new = own if item.name == "object" else f"{item.name}_{len(objects)}"
                    where = T @ item.T_world_object
                    items.append(replace(item, name=new, T_world_object=where))
            at += wide
    y = max(lengths) / 2 + 0.5
    x = ends + max(_behind(scene) for _, scene in alone)
    walls = (
        ((WALL, 2 * y), (x + WALL / 2, 0.0)), ((WALL, 2 * y), (-x - WALL / 2, 0.0)),
        ((2 * x, WALL), (0.0, y + WALL / 2)), ((2 * x, WALL), (0.0, -y - WALL / 2)),
    )  # fmt: skip
    for k, (size, middle) in enumerate(walls, start=1):
        items.append(SceneObject.box(f"wall_{k}", (*size, CEILING), (*middle, CEILING / 2)))
    floor = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    return Place(name, Scene(name, tuple(items), floor_polygon=floor), objects)


def _span(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a room's object with its counter [m]."""
    corners = [item.bounds for item in scene.objects if item.name != "wall"]
    lows, highs = zip(*corners, strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _behind(scene: Scene) -> float:
    """Return the distance of a room's wall behind its object [m]."""
    return float(scene.object("wall").bounds[0][0])


def _wide(scene: Scene) -> float:
    """Return the width along the wall of an object with its counter [m]."""
    low, high = _span(scene)
    return float(high[1] - low[1]) + BETWEEN


LOCATED = 0.5
"""Minimum IoU of two fronts that are the same part [-]."""
MAX_DEPTH_GAP = 0.2
"""Maximum distance of their planes [m]."""
AXIS, TILT = 0.02, np.radians(3.0)
"""Maximum errors of a right axis [m], [rad]."""
FEASIBLE = ("solved", "assumed")
"""Statuses of plans that are executed."""
TIME_GOAL = 0.4
"""Intended maximum time to reconstruct an object [s]."""


@dataclass(frozen=True)
class Way:
    """Motion of a part, in the world."""

    kind: str
    """door, flap or drawer."""
    direction: np.ndarray
    """Direction of its axis."""
    point: np.ndarray
    """A point on the axis [m]."""
    low: np.ndarray
    high: np.ndarray
    """Corners of the closed part [m]."""


@dataclass(frozen=True)
class Row:
    """One door or drawer, and its results."""

    object: str
    joint: str
    subset: str
    kind: str
    match: str = ""
    """The joint of the scan; "" if there is no front."""
    label: str = ""
    found: str = ""
    """Kind of the joint in the scan."""
    side: bool = False
    """Whether kind and side of the hinge are right."""
    axis: float | None = None
    """Distance between the axes [m]."""
    tilt: float | None = None
    """Angle between them [rad]."""
    handle: tuple[float, ...] = ()
    """Errors of the handle at 0, 50 and 100 % open [m]."""
    solvable: bool = False
    planned: str = ""
    """Status of the plan in the reconstructed scene."""
    strict: str = "not found"
    """Why the plan fails the exact check in the room."""
    done: bool = False
    reason: str = ""
    """Why the execution did not open it."""
    item: str = "object"
    """Name of the object in its room."""
    seconds: float = 0.0
    """Time to reconstruct the object [s]."""

    @property
    def right(self) -> bool:
        """Return whether the axis is right."""
        return (
            self.side and self.axis is not None and self.axis < AXIS
            and self.tilt is not None and self.tilt < TILT
        )  # fmt: skip


def way_of(item: SceneObject, joint: str, T: np.ndarray) -> Way:
    """Return the motion of a part, in a frame that T maps the world to."""
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
    """Return the IoU of two fronts seen along x; 0 if one is far behind the other."""
    if abs(one.low[0] - other.low[0]) > MAX_DEPTH_GAP:
        return 0.0
    low, high = np.maximum(one.low, other.low)[1:], np.minimum(one.high, other.high)[1:]
    common = float(np.prod(np.maximum(high - low, 0.0)))
    area = sum(float(np.prod((w.high - w.low)[1:])) for w in (one, other))
    return common / max(area - common, 1e-9)


def off(true: Way, found: Way) -> tuple[bool, float | None, float]:
    """Return whether kind and side are right, and the axis errors [m], [rad]."""
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


def compare(
    name: str, item_name: str, truth: Scene, scanned: Scene, back: np.ndarray, T: np.ndarray
) -> list[Row]:
    """Compare every part of an object with the reconstructed scene.

    Args:
        name: Name in the list of objects.
        item_name: Its name in the room.
        truth, scanned: The room, and its reconstructed scene.
        back: Transform from that scene's frame to the room's.
        T: Transform from the room's frame to one in which the object's front is toward -x.
    """
    item = truth.object(item_name)
    ours = [(j.name, way_of(item, j.name, T)) for j in parts(item.model)]
    theirs = [
        (seen_item, joint, way_of(seen_item, joint, T @ back))
        for seen_item in scanned.objects
        for joint in seen_item.model.joints
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
        row = Row(name, joint, set_of(name), way.kind, item=item_name)
        if i in found:
            seen_item, other, seen = theirs[found[i]]
            side, axis, tilt = off(way, seen)
            errors: tuple[float, ...] = ()
            if (way.kind == "drawer") == (seen.kind == "drawer"):
                errors = tuple(
                    float(np.linalg.norm(
                        handle_at(truth, item_name, joint, share)
                        - apply(back, handle_at(scanned, seen_item.name, other, share)[None])[0]
                    ))
                    for share in (0.0, 0.5, 1.0)
                )  # fmt: skip
            row = replace(
                row, match=f"{seen_item.name}/{other}", label=seen_item.category, found=seen.kind,
                side=side, axis=axis, tilt=tilt, handle=errors,
            )  # fmt: skip
        rows.append(row)
    return rows


def false_parts(rows: Sequence[Row], scanned: Scene) -> list[Row]:
    """Return a row without a joint for each part of a reconstructed room that is none.

    Args:
        rows: The true parts of all objects of the room; at least one.
        scanned: The reconstructed scene.
    """
    matched = {row.match for row in rows}
    every = [
        (f"{item.name}/{joint}", way_of(item, joint, np.eye(4)).kind)
        for item in scanned.objects
        for joint in item.model.joints
    ]
    return [
        Row(rows[0].object, "", rows[0].subset, "", match=name, found=kind)
        for name, kind in every
        if name not in matched
    ]


def table(rows: Sequence[Row]) -> str:
    """Summarize one set, and list each part that was not opened with its reason."""
    false = [r for r in rows if not r.joint]
    rows = [r for r in rows if r.joint]
    located = [r for r in rows if r.match]
    kinds = [r for r in located if r.found == r.kind]
    hinged = [r for r in kinds if r.kind != "drawer"]
    solvable = [r for r in rows if r.solvable]
    errors = np.array([r.handle for r in located if r.side and r.handle]).reshape(-1, 3)

    counts = [
        ("parts located", len(located), len(rows)),
        ("precision", len(located), len(located) + len(false)),
        ("kind right, of those located", len(kinds), len(located)),
        ("hinge side right, of doors and flaps", sum(r.side for r in hinged), len(hinged)),
        ("axis within 2 cm, 3 degrees", sum(r.right for r in located), len(located)),
        ("the same, of all parts", sum(r.right for r in rows), len(rows)),
        (
            "plan in the reconstructed scene",
            sum(r.planned in FEASIBLE for r in solvable),
            len(solvable),
        ),
        (
            "of these for an improbable joint",
            sum(r.planned == "assumed" for r in solvable),
            sum(r.planned in FEASIBLE for r in solvable),
        ),
        ("plan valid in the room", sum(not r.strict for r in solvable), len(solvable)),
        ("opened in physics", sum(r.done for r in solvable), len(solvable)),
    ]
    lines = [
        f"| {name} | {part} of {whole} ({part / whole:.0%}) |"
        for name, part, whole in counts
        if whole
    ]
    if len(errors):
        medians = ", ".join(f"{100 * v:.1f}" for v in np.median(errors, axis=0))
        lines.append(f"| handle at 0, 50, 100 % open, if the side is right | {medians} cm |")
    times = [*{(r.object, r.match.partition("/")[0]): r.seconds for r in located}.values()]
    if times:
        soon = f"{sum(time <= TIME_GOAL for time in times)} of {len(times)} within {TIME_GOAL} s"
        spread = f"{np.median(times):.2f} s, max {max(times):.2f} s"
        lines.append(f"| time per object | {spread}, {soon} |")
    reasons = Counter(cause(r) for r in solvable if not r.done)
    taken = Counter((r.kind, r.found) for r in located if r.found != r.kind)
    lines += [
        f"  {count} {one} classified as {other}" for (one, other), count in sorted(taken.items())
    ]
    lines += [f"  {count} not opened: {reason}" for reason, count in reasons.most_common()]
    return "\n".join(lines)


def cause(row: Row) -> str:
    """Return the category of the reason that a part is not opened."""
    if not row.match:
        return "part not located"
    if row.found != row.kind:
        return f"{row.kind} classified as {row.found}"
    if not row.side:
        return "hinge on the wrong side"
    if row.planned not in FEASIBLE:
        return "no plan in the reconstructed scene"
    return "run fails, axis right" if row.right else "run fails, axis wrong"


def shown(row: Row) -> str:
    """Format a row as one line."""
    where = f"{row.object.removeprefix('Kitchen_models/')}/{row.joint} {row.kind}"
    if not row.joint:
        return f"{where}: {row.match} ({row.found}) is no part"
    if not row.match:
        return f"{where}: not located" + (" (solvable)" if row.solvable else "")
    axis = (
        "-" if row.axis is None else f"{100 * row.axis:.1f} cm {np.degrees(row.tilt or 0):.1f} deg"
    )
    handle = ", ".join(f"{100 * v:.1f}" for v in row.handle)
    text = f"{where}: {row.match} ({row.found}) side {row.side}, axis {axis}, handle {handle} cm"
    if row.planned:
        text += f"; {row.planned}; strict: {row.strict or 'valid'}; done {row.done} {row.reason}"
    return text


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


def listed(folder: Path) -> list[tuple[str, Path, Usual]]:
    """Read the objects of a models.json: name, URDF and placement; their fronts are toward -y."""
    rows = json.loads((folder / "models.json").read_text())
    return [
        (row["name"], folder / row["urdf"],
         Usual(0.0, row["above"], counter=row["counter"], front=(0.0, -1.0)))
        for row in rows
    ]  # fmt: skip


def measure(
    place: Place, home: Path, tools: Tools, arms: tuple[Robot, Any] | None, wrong: int, turn: float
) -> list[Row]:
    """Evaluate the objects of a room; without an arm only the reconstruction."""
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
    if arms is None:
        return [*rows, *false]
    if not wrong:
        made = [opened(row, truth, scanned, T_scene_room, *arms) for row in rows]
        return [*made, *false]
    made = []
    for row in filter(lambda row: row.side, rows):
        name, _, joint = row.match.partition("/")
        if len(scanned.object(name).hypotheses[joint]) > wrong:
            taken = misled(scanned, name, joint, wrong)
            made.append(opened(row, truth, taken, T_scene_room, *arms))
    return made


def moved_scan(scan: Scan, T: np.ndarray) -> Scan:
    """Return the same images in another world frame."""
    frames = tuple(replace(one, T_world_camera=T @ one.T_world_camera) for one in scan.frames)
    return replace(scan, frames=frames)


def main(
    subset: Subset = None, robot: str = "segway_ur5e", frames: int = 60, seed: int = 0,
    together: int = 1, folder: Path = Path("bench_out/scan_objects"), no_answers: bool = False,
    only: str = "", misled: int = 0, turned: float = 0.0, models: Path | None = None,
    detector: Path | None = None,
) -> None:  # fmt: skip
    """Scan, reconstruct and open objects.

    Args:
        subset: Only the objects of one set.
        robot: Robot of the library.
        frames: Number of images of a scan.
        seed: Seed of the walk, materials and noise.
        together: Number of objects per kitchen.
        folder: Folder of scans and results, which are reused.
        no_answers: Evaluate the reconstruction only.
        only: Only rooms with this in their name.
        misled: Swap the belief with the Nth other hypothesis.
        turned: Turn the scan's world [deg].
        models: Folder with a models.json of other objects.
        detector: ONNX file of an object detector.
    """
    tools, arms = default_tools(), None if no_answers else arm(robot)
    if detector is not None:
        tools = replace(tools, detect=YoloxDetector(detector))
    name = "seen" if no_answers else f"misled_{misled}" if misled else "answers"
    name += f"_turned_{turned:g}" if turned else ""
    rows: list[Row] = []
    for place in places(objects() if models is None else listed(models), subset, together):
        if only not in place.name:
            continue
        home = folder / place.name
        scan_of(place.scene, home / "scan", frames, seed)
        file = home / f"{name}.json"
        if not file.exists():
            made = measure(place, home, tools, arms, misled, turned)
            file.write_text(json.dumps([asdict(row) for row in made], indent=1) + "\n")
        found = [
            Row(**{**row, "handle": tuple(row["handle"])}) for row in json.loads(file.read_text())
        ]
        rows += found
        for row in found:
            if row.subset == SETS[0]:
                print(shown(row), flush=True)
    for one in SETS:
        mine = [row for row in rows if row.subset == one]
        if mine:
            print(f"{one}: {len({r.object for r in mine})} objects\n{table(mine)}")


if __name__ == "__main__":
    commands(__doc__, main)
